"""Rebuilt models as files: what is read again is the same model."""

from __future__ import annotations

import re

import pyarrow as pa
import pytest

pytest.importorskip("OCP")

import cadquery as cq
from OCP.BinTools import BinTools
from OCP.BRep import BRep_Builder
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
from OCP.ShapeCustom import ShapeCustom
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Compound, TopoDS_Shape
from OCP.XCAFDoc import XCAFDoc_DocumentTool

from breplake.errors import NameNotFoundError, UsageError
from breplake.ingest.brep import extract
from breplake.ingest.canonical import canonical, explore
from breplake.ingest.heal import add_missing_pcurves
from breplake.ingest.load import load
from breplake.ingest.lossless.carried import table_differences
from breplake.ingest.lossless.compare import differences, measure
from breplake.ingest.lossless.files import write_model
from breplake.ingest.lossless.graph import ShapeGraph
from breplake.ingest.lossless.rebuild import rebuilt_shapes
from breplake.ingest.lossless.step_out import write_step
from breplake.ingest.lossless.step_proof import step_differences
from breplake.ingest.rows import brep_tables
from breplake.ingest.samples import write_samples
from breplake.ingest.step_writer import Paint, new_document, set_name, write_document


def ingested(path, format="step"):
    document = load(path, format)
    shapes = canonical(document.shapes)
    add_missing_pcurves(shapes.compound)
    return brep_tables(1, extract(shapes, document.labels)), document.scale_to_mm


def write(tables, path, **options):
    parts, patches = tables["parts"].to_pylist(), tables["patches"].to_pylist()
    compound = rebuilt_shapes(tables)[0]
    write_step(compound, path, name="model", parts=parts, patches=patches, **options)


@pytest.mark.parametrize(
    "name",
    [
        *("dice", "hinge", "flange_joint", "base_plate_inch", "ball_steel", "hull_boat"),
        *("panel_offset", "mug", "duct_surface", "screw_countersunk", "weight_lemon", "bottle"),
        *("nozzle_nurbs", "chain_links", "fairing_open", "bodies_touching"),
    ],
)
def test_step_read_again_gives_the_same_tables(name, tmp_path):
    (path,) = write_samples(tmp_path, [name])
    before, scale = ingested(path)
    again = tmp_path / "again.step"
    write(before, again, scale_to_mm=scale)
    after, scale_again = ingested(again)
    assert table_differences(before, after) == []
    assert scale_again == scale


def test_a_model_without_curves_or_without_parts(tmp_path):
    (path,) = write_samples(tmp_path, ["ball_steel"])
    before, _ = ingested(path)
    empty = before | {name: before[name].slice(0, 0) for name in ("parts", "coedges")}
    none = {name: table.schema.empty_table() for name, table in before.items()}
    assert table_differences(empty, empty) == []
    assert table_differences(none, none) == []


def test_the_comparison_sees_a_difference(tmp_path):
    (path,) = write_samples(tmp_path, ["ball_steel"])
    before, _ = ingested(path)
    place = before["patches"].schema.get_field_index("radius")
    field = before["patches"].schema.field(place)
    radius = pa.array([r * (1 + 1e-8) for r in before["patches"].column("radius").to_pylist()])
    changed = before | {"patches": before["patches"].set_column(place, field, radius)}
    (difference,) = table_differences(before, changed)
    assert re.fullmatch(r"patches\.radius differs by up to 1\.0e-08", difference)


def placed(shape, motion):
    return shape.wrapped.Located(TopLoc_Location(motion), False)


def compound(*shapes):
    builder, made = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(made)
    for shape in shapes:
        builder.Add(made, shape)
    return made


def assembly(tmp_path):
    """One part thrice: as it is, shifted and mirrored; with looks that the test gives them."""
    solid = cq.Workplane().box(4, 3, 2).faces(">Z").workplane().center(1, 0).hole(1).val()
    shift, mirror = gp_Trsf(), gp_Trsf()
    shift.SetTranslation(gp_Vec(20, 0, 0))
    mirror.SetMirror(gp_Ax2(gp_Pnt(0, 20, 0), gp_Dir(0, 1, 0)))
    shape = compound(solid.wrapped, placed(solid, shift), placed(solid, mirror))
    path = tmp_path / "assembly.brep"
    cq.Shape.cast(shape).exportBrep(str(path))
    return ingested(path, "brep")[0]


def dressed(tables, names, colours, faces):
    """Return the tables with other names and colours of parts, and of their first patches."""
    patches = [dict(row) for row in tables["patches"].to_pylist()]
    for part, (name, colour) in enumerate(faces):
        mine = [row for row in patches if row["part_id"] == part]
        for row in mine:
            row["colour"] = colours[part]
        mine[0] |= {"name": name, "colour": colour or colours[part]}
    parts = [
        row | {"name": name, "colour": colour}
        for row, name, colour in zip(tables["parts"].to_pylist(), names, colours, strict=True)
    ]
    made = {"parts": parts, "patches": patches}
    return tables | {n: pa.Table.from_pylist(r, tables[n].schema) for n, r in made.items()}


@pytest.mark.parametrize("alike", [True, False], ids=["alike", "each-its-own"])
def test_names_and_colours_of_instances(alike, tmp_path):
    tables = assembly(tmp_path)
    tables = dressed(
        tables,
        ["bracket"] * 3 if alike else ["left", None, "mirrored"],
        ["#ff8000"] * 3 if alike else ["#ff8000", "#0040c0", None],
        [("bore", "#10a020")] * 3 if alike else [("a", None), ("b", "#10a020"), (None, None)],
    )
    path = tmp_path / "again.step"
    write(tables, path)
    after, _ = ingested(path)
    for name in ("parts", "patches"):
        assert after[name].column("colour").to_pylist() == tables[name].column("colour").to_pylist()
    # readers take the number of an instance for the name that it has not
    names = ["bracket"] * 3 if alike else ["left", "2", "mirrored"]
    assert after["parts"].column("name").to_pylist() == names
    text = path.read_text()
    for row in tables["patches"].to_pylist():
        if row["name"]:
            assert f"ADVANCED_FACE('{row['name']}'" in text
    # one product is written once, unless its instances look different; mirrors are no motion
    count = text.count("MANIFOLD_SOLID_BREP(")
    assert count == (2 if alike else 3)


def test_the_same_bytes_each_time(tmp_path):
    tables = assembly(tmp_path)
    texts = []
    for name in ("a.step", "b.step"):
        write(tables, tmp_path / name)
        texts.append((tmp_path / name).read_bytes())
    assert texts[0] == texts[1]


@pytest.mark.parametrize(
    "names",
    [("a", "b"), (None, None), ("Träger 13°", "支架"), ("Open CASCADE STEP translator 7.9 1",) * 2],
)
def test_names_come_back(names, tmp_path):
    """Also in other alphabets, none at all, and those that the kernel makes up."""
    boxes = [cq.Solid.makeBox(1, 2, 3 + i).moved(cq.Location((9 * i, 0, 0))) for i in range(2)]
    line = cq.Edge.makeLine(cq.Vector(5, 0, 0), cq.Vector(6, 0, 0))
    source = tmp_path / "two.brep"
    cq.Shape.cast(compound(*(shape.wrapped for shape in (*boxes, line)))).exportBrep(str(source))
    before, _ = ingested(source, "brep")
    parts = before["parts"]
    at = parts.schema.get_field_index("name")
    before["parts"] = parts.set_column(at, parts.schema.field(at), pa.array(names, pa.string()))
    write(before, tmp_path / "again.step")
    after, _ = ingested(tmp_path / "again.step")
    assert after["parts"].column("name").to_pylist() == list(names)
    assert table_differences(before, after) == []


def test_wires_and_points_go_along(tmp_path):
    line = cq.Edge.makeLine(cq.Vector(5, 0, 0), cq.Vector(6, 0, 0)).wrapped
    shape = compound(cq.Solid.makeBox(1, 2, 3).wrapped, line)
    source = tmp_path / "mixed.brep"
    cq.Shape.cast(shape).exportBrep(str(source))
    before, _ = ingested(source, "brep")
    write(before, tmp_path / "again.step")
    after, _ = ingested(tmp_path / "again.step")
    for tables in (before, after):
        assert tables["parts"].column("kind").to_pylist() == ["solid"]
        (free,) = (row for row in tables["curves"].to_pylist() if row["kind"] == "free")
        assert free["length"] == pytest.approx(1)
        assert len(tables["corners"]) == 10


def test_files_of_a_lake(sample_lake, tmp_path, capfd):
    import breplake

    lake = breplake.open(sample_lake)
    model_id = lake.model("base_plate_inch")["model_id"]
    assert write_model(lake, "base_plate_inch", tmp_path / "inch.stp") == []
    assert write_model(lake, "base_plate_inch", tmp_path / "mm.step", unit="mm") == []
    inch, inch_scale = ingested(tmp_path / "inch.stp")
    mm, mm_scale = ingested(tmp_path / "mm.step")
    assert (inch_scale, mm_scale) == (25.4, 1.0)
    assert table_differences(inch, mm) == []
    stored = {name: lake.read(name, model_id) for name in inch}
    assert table_differences(stored, inch) == []
    assert capfd.readouterr().out == ""  # the kernel's chatter is not the user's


def test_the_kernels_own_formats(sample_lake, tmp_path):
    import breplake

    lake = breplake.open(sample_lake)
    model_id = lake.model("hinge")["model_id"]
    for name in ("hinge.bin", "hinge.brep"):
        assert write_model(lake, "hinge", tmp_path / name) == []
    shape = TopoDS_Shape()
    assert BinTools.Read_s(shape, str(tmp_path / "hinge.bin"))
    for name, table in ShapeGraph(shape).tables(model_id).items():
        assert table.equals(lake.read(name, model_id)), name
    (text,) = load(tmp_path / "hinge.brep", "brep").shapes
    assert differences(measure(shape), measure(text)) == []


def test_what_step_loses_is_said(sample_lake, tmp_path):
    """OCCT writes a periodic ellipsoid with a bore such that it reads another solid."""
    tables, _ = ingested(write_samples(tmp_path, ["float_ellipsoid"])[0])

    class Lake:
        def model(self, name):
            return {"model_id": 1, "name": name, "scale_to_mm": 1.0}

        def read(self, table, model_id):
            return tables[table]

    losses = write_model(Lake(), "float", tmp_path / "float.step")
    assert losses[0].startswith("volume is")
    assert write_model(Lake(), "float", tmp_path / "float.brep") == []


def test_the_source_written_alike_tells_whose_loss_it_is(tmp_path):
    path, other = write_samples(tmp_path, ["float_ellipsoid", "ball_steel"])
    tables, scale = ingested(path)

    def shapes(path):
        found = canonical(load(path, "step").shapes).compound
        add_missing_pcurves(found)
        return found

    def never():
        raise AssertionError("nothing differs")

    losses, is_own = step_differences(tables, scale, "float", lambda: shapes(path))
    assert losses
    assert is_own
    # what differs from the source is not excused
    assert step_differences(tables, scale, "float", lambda: shapes(other)) == (losses, False)
    assert step_differences(ingested(other)[0], scale, "ball", never) == ([], True)


def test_what_the_kernel_does_not_write_is_not_painted(tmp_path):
    made = (cq.Workplane().box(1, 1, 1).val().wrapped for _ in range(2))
    box, elsewhere = (ShapeCustom.DirectFaces_s(s.Located(TopLoc_Location())) for s in made)
    document = new_document()
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    set_name(tool.AddShape(box, False), "box")
    red = Quantity_Color(1, 0, 0, Quantity_TypeOfColor.Quantity_TOC_sRGB)
    faces = [next(explore(shape, TopAbs_ShapeEnum.TopAbs_FACE)) for shape in (box, elsewhere)]
    paints = [Paint(face, "painted", red, box) for face in faces]
    path = tmp_path / "box.step"
    write_document(document, path, name="box", unit="MM", author="me", paints=paints)
    assert path.read_text().count("'painted'") == 1
    assert ingested(path)[0]["patches"].num_rows == 6


def test_errors(sample_lake, tmp_path):
    import breplake

    lake = breplake.open(sample_lake)
    with pytest.raises(UsageError, match=r"must end with \.step"):
        write_model(lake, "hinge", tmp_path / "hinge.stl")
    with pytest.raises(NameNotFoundError):
        write_model(lake, "no such model", tmp_path / "a.step")
    with pytest.raises(OSError, match="cannot write"):
        write_model(lake, "hinge", tmp_path / "missing" / "a.brep")
