"""The shape graph in tables: what is shared, in which order, and each coedge's own pcurve."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

pytest.importorskip("OCP")

import cadquery as cq
from OCP.BRep import BRep_Builder
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Compound

from breplake.ingest.canonical import canonical
from breplake.ingest.lossless.graph import ShapeGraph
from breplake.ingest.lossless.rebuild import rebuilt_shapes


def compound(*shapes):
    builder, made = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(made)
    for shape in shapes:
        builder.Add(made, getattr(shape, "wrapped", shape))
    return made


def tables(*shapes):
    return ShapeGraph(canonical([compound(*shapes)]).compound).tables(7)


def rows(made, name):
    return made[name].to_pylist()


def test_a_box_has_a_node_for_each_shape():
    made = tables(cq.Solid.makeBox(1, 2, 3))
    counts = Counter(row["type"] for row in rows(made, "shapes"))
    assert counts == {
        "compound": 1, "solid": 1, "shell": 1, "face": 6, "wire": 6, "edge": 12, "vertex": 8,
    }  # fmt: skip
    assert made["surfaces"].num_rows == 6
    assert made["space_curves"].num_rows == 12
    assert made["motions"].num_rows == 0
    assert {row["model_id"] for row in rows(made, "shapes")} == {7}


def test_numbers_are_in_order_of_first_appearance():
    """Depth first from the compound, and geometry in the order in which shapes refer to it."""
    made = tables(cq.Solid.makeBox(1, 2, 3), cq.Solid.makeCylinder(1, 2, pnt=(9, 0, 0)))
    shapes = rows(made, "shapes")
    seen: list[int] = []

    def visit(number):
        if number in seen:
            return
        seen.append(number)
        for child in shapes[number]["children"]:
            visit(child["shape"])

    visit(0)
    assert seen == list(range(len(shapes)))
    assert [row["shape_id"] for row in shapes] == seen
    curves = [row["space_curve"] for row in rows(made, "edge_curves") if row["kind"] == "curve"]
    assert list(dict.fromkeys(curves)) == list(range(made["space_curves"].num_rows))


def test_instances_share_all_but_their_place():
    box = cq.Solid.makeBox(1, 2, 3)
    there = gp_Trsf()
    there.SetTranslation(gp_Vec(10, 0, 0))
    made = tables(box, box.wrapped.Moved(TopLoc_Location(there)))
    assert Counter(row["type"] for row in rows(made, "shapes"))["face"] == 6
    first, second = rows(made, "shapes")[0]["children"]
    assert first["shape"] == second["shape"] == 1
    assert first["placement"] == []
    assert second["placement"] == [{"motion": 0, "power": 1}]
    (motion,) = rows(made, "motions")
    assert motion["translation"] == {"x": 10.0, "y": 0.0, "z": 0.0}
    assert (motion["form"], motion["scale"]) == ("Translation", 1.0)


def test_powers_and_order_of_motions():
    """The leftmost is applied last, as in a product of matrices."""
    turn, shift = gp_Trsf(), gp_Trsf()
    turn.SetRotation(gp_Ax2(gp_Pnt(), gp_Dir(0, 0, 1)).Axis(), math.pi / 2)
    shift.SetTranslation(gp_Vec(10, 0, 0))
    first, second = TopLoc_Location(turn), TopLoc_Location(shift)
    place = second.Powered(-2).Multiplied(first)
    made = tables(cq.Solid.makeBox(1, 2, 3).wrapped.Moved(place))
    (child,) = rows(made, "shapes")[0]["children"]
    forms = [rows(made, "motions")[item["motion"]]["form"] for item in child["placement"]]
    assert forms == ["Translation", "Rotation"]
    assert [item["power"] for item in child["placement"]] == [-2, 1]
    box = cq.Shape.cast(rebuilt_shapes(made)[0]).BoundingBox()
    # turned by 90 degrees the box reaches from x = -2 to 0, and then goes back by 20
    assert (box.xmin, box.xmax) == pytest.approx((-22, -20), abs=1e-6)


def test_flags_and_tolerances():
    box = cq.Solid.makeBox(1, 2, 3)
    edge = box.Edges()[0].wrapped
    BRep_Builder().UpdateEdge(edge, 0.01)
    edge.TShape().SameParameter(False)
    box.Faces()[0].wrapped.TShape().NaturalRestriction(True)
    box.wrapped.TShape().Locked(True)
    shapes = rows(tables(box), "shapes")
    edges = [row for row in shapes if row["type"] == "edge"]
    assert sorted(row["tolerance"] for row in edges)[-2:] == [1e-7, 0.01]
    assert sum(not row["same_parameter"] for row in edges) == 1
    assert sum(row["natural_restriction"] for row in shapes if row["type"] == "face") == 1
    assert [row["type"] for row in shapes if row["locked"]] == ["solid"]
    assert [row["type"] for row in shapes if row["closed"]].count("shell") == 1


def test_each_use_of_a_seam_has_its_own_pcurve(ingest_shape):
    record = ingest_shape(cq.Solid.makeCylinder(1, 2))
    curves = record.tables["curves"].to_pylist()
    pcurves = record.tables["pcurves"].to_pylist()
    (seam,) = (row["curve_id"] for row in curves if row["kind"] == "seam")
    uses = [u for u in record.tables["coedges"].to_pylist() if u["curve_id"] == seam]
    at = {u["reversed"]: pcurves[u["pcurve"]]["location"]["u"] for u in uses}
    assert sorted(at.values()) == pytest.approx([0, 2 * math.pi])
    assert len({use["pcurve"] for use in uses}) == 2
    assert [(use["t_min"], use["t_max"]) for use in uses] == [(0, 2)] * 2


def test_instances_refer_to_the_same_pcurve(ingest_shape):
    solid = cq.Solid.makeCylinder(1, 2).wrapped
    there = gp_Trsf()
    there.SetTranslation(gp_Vec(10, 0, 0))
    record = ingest_shape(compound(solid, solid.Moved(TopLoc_Location(there))))
    uses = record.tables["coedges"].to_pylist()
    by_patch = {i: [u["pcurve"] for u in uses if u["patch_id"] == i] for i in range(6)}
    assert [by_patch[i] for i in range(3)] == [by_patch[i + 3] for i in range(3)]
    shapes = record.column("patches", "shape").tolist()
    assert shapes[:3] == shapes[3:]


@pytest.mark.parametrize("flip", [False, True], ids=["forward", "reversed"])
def test_pcurves_lie_on_their_curves(ingest_shape, flip):
    """Every coedge's pcurve, taken to space by its surface, is the edge's curve."""
    shape = cq.Workplane().sphere(3).cut(cq.Workplane().cylinder(9, 1)).val().wrapped
    record = ingest_shape(shape.Reversed() if flip else shape)
    made = {name: record.tables[name] for name in record.tables}
    placed = rebuilt_shapes(made)
    off, checked = 0.0, 0
    for use in record.tables["coedges"].to_pylist():
        if use["pcurve"] is None:
            continue
        face = placed[made["patches"].column("shape")[use["patch_id"]].as_py()]
        surface = face.TShape().Surface()
        edge = made["curves"].to_pylist()[use["curve_id"]]
        if edge["kind"] == "degenerate":
            continue
        pcurve = pcurve_of(made, use["pcurve"])
        for t in np.linspace(use["t_min"], use["t_max"], 7):
            uv = pcurve.Value(t)
            point = surface.Value(uv.X(), uv.Y())
            off = max(off, distance(placed, edge, made, point, t))
            checked += 1
    assert checked > 20
    assert off < 1e-6


def pcurve_of(made, number):
    from breplake.ingest.lossless.columns import table_rows
    from breplake.ingest.lossless.geometry_in import GeometryBuilder

    return GeometryBuilder((), (), table_rows(made["pcurves"])).pcurve(number)


def distance(placed, edge, made, point, t):
    from OCP.BRep import BRep_Tool
    from OCP.TopoDS import TopoDS

    curve = BRep_Tool.Curve_s(TopoDS.Edge_s(placed[edge["shape"]]), 0.0, 0.0)
    return curve.Value(t).Distance(point)


def test_tables_are_the_same_each_time(tmp_path):
    """Nothing of an address in memory or of a set's order gets into them."""
    from breplake.ingest.load import load
    from breplake.ingest.samples import write_samples

    (path,) = write_samples(tmp_path, ["flange_joint"])

    def read():
        return ShapeGraph(canonical(load(path, "step").shapes).compound).tables(1)

    first, second = read(), read()
    assert {name: table.num_rows for name, table in first.items()}["motions"] > 0
    for name, table in first.items():
        assert table.equals(second[name]), name
