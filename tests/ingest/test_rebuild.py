"""B-Reps made from their tables alone are the same, bit for bit."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pyarrow as pa
import pytest

pytest.importorskip("OCP")

import cadquery as cq
from OCP import Geom, TopoDS
from OCP.BRep import BRep_Builder
from OCP.BRepBuilderAPI import (
    BRepBuilderAPI_MakeEdge,
    BRepBuilderAPI_MakeWire,
    BRepBuilderAPI_Transform,
)
from OCP.BRepGProp import BRepGProp
from OCP.Geom2d import Geom2d_BezierCurve, Geom2d_Circle, Geom2d_OffsetCurve, Geom2d_TrimmedCurve
from OCP.gp import (
    gp_Ax1,
    gp_Ax2,
    gp_Ax3,
    gp_Ax22d,
    gp_Dir,
    gp_Dir2d,
    gp_Pnt,
    gp_Pnt2d,
    gp_Trsf,
)
from OCP.GProp import GProp_GProps
from OCP.TColgp import TColgp_Array1OfPnt, TColgp_Array1OfPnt2d, TColgp_Array2OfPnt
from OCP.TopAbs import TopAbs_Orientation
from OCP.TopLoc import TopLoc_Location

from breplake.errors import LakeFormatError, NameNotFoundError
from breplake.ingest.canonical import canonical
from breplake.ingest.load import load
from breplake.ingest.lossless.compare import differences, measure
from breplake.ingest.lossless.graph import ShapeGraph
from breplake.ingest.lossless.rebuild import rebuild, rebuilt_shapes
from breplake.ingest.mass import INTEGRAL
from breplake.ingest.samples import PARTS, write_samples

PLACE = gp_Ax3(gp_Pnt(1, -2, 3), gp_Dir(1, 2, 2), gp_Dir(2, 1, -2))
LEFT = gp_Ax3(gp_Pnt(1, -2, 3), gp_Dir(1, 2, 2), gp_Dir(2, 1, -2))
LEFT.YReverse()
CONIC = gp_Ax2(gp_Pnt(1, -2, 3), gp_Dir(1, 2, 2), gp_Dir(2, 1, -2))
AXIS = gp_Ax1(gp_Pnt(9, 8, 7), gp_Dir(3, 2, 1))


def compound(*shapes):
    builder, made = BRep_Builder(), TopoDS.TopoDS_Compound()
    builder.MakeCompound(made)
    for shape in shapes:
        builder.Add(made, getattr(shape, "wrapped", shape))
    return made


def round_trip(*shapes):
    """Return the canonical shape and what comes back, after their tables were compared."""
    source = canonical([compound(*shapes)]).compound
    before = ShapeGraph(source).tables(1)
    rebuilt = rebuilt_shapes(before)[0]
    after = ShapeGraph(rebuilt).tables(1)
    for name, table in before.items():
        assert table.equals(after[name]), name
    return source, rebuilt, before


def bezier_surface():
    poles = TColgp_Array2OfPnt(1, 3, 1, 4)
    for i in range(3):
        for j in range(4):
            poles.SetValue(i + 1, j + 1, gp_Pnt(i, j, math.sin(i * j)))
    return Geom.Geom_BezierSurface(poles)


def bezier_curve():
    poles = TColgp_Array1OfPnt(1, 4)
    for i, point in enumerate([(3, 0, 0), (4, 0, 1), (3, 0, 3), (4, 0, 4)]):
        poles.SetValue(i + 1, gp_Pnt(*point))
    return Geom.Geom_BezierCurve(poles)


def trimmed(curve, low=0.25, high=0.75):
    return Geom.Geom_TrimmedCurve(curve, low, high)


def conics():
    return [
        Geom.Geom_Circle(CONIC, 2),
        Geom.Geom_Ellipse(CONIC, 3, 2),
        Geom.Geom_Hyperbola(CONIC, 3, 2),
        Geom.Geom_Parabola(CONIC, 1.5),
    ]


SURFACES = {
    "plane": Geom.Geom_Plane(PLACE),
    "left-handed plane": Geom.Geom_Plane(LEFT),
    "cylinder": Geom.Geom_CylindricalSurface(LEFT, 2),
    "cone": Geom.Geom_ConicalSurface(PLACE, -0.3, 5),
    "sphere": Geom.Geom_SphericalSurface(LEFT, 2),
    "torus": Geom.Geom_ToroidalSurface(PLACE, 5, 2),
    "bezier": bezier_surface(),
    "trimmed": Geom.Geom_RectangularTrimmedSurface(
        Geom.Geom_SphericalSurface(PLACE, 3), 1, 2, 0, 1
    ),
    "trimmed across the seam": Geom.Geom_RectangularTrimmedSurface(
        Geom.Geom_CylindricalSurface(PLACE, 3), 5, 7, 0, 1
    ),
    "trimmed in v alone": Geom.Geom_RectangularTrimmedSurface(
        Geom.Geom_CylindricalSurface(PLACE, 3), 0.0, 1.0, False, True
    ),
    "trimmed in u alone": Geom.Geom_RectangularTrimmedSurface(
        bezier_surface(), 0.2, 0.9, True, True
    ),
    "extrusion": Geom.Geom_SurfaceOfLinearExtrusion(trimmed(bezier_curve()), gp_Dir(1, 2, 3)),
    "extruded offset": Geom.Geom_SurfaceOfLinearExtrusion(
        Geom.Geom_OffsetCurve(Geom.Geom_Ellipse(CONIC, 3, 2), 0.5, gp_Dir(1, 2, 2)), gp_Dir(1, 2, 2)
    ),
    "revolution": Geom.Geom_SurfaceOfRevolution(trimmed(bezier_curve()), AXIS),
    "offset": Geom.Geom_OffsetSurface(bezier_surface(), -0.125),
    "offset of trimmed": Geom.Geom_OffsetSurface(
        Geom.Geom_RectangularTrimmedSurface(bezier_surface(), 0.1, 0.9, 0.2, 0.8), 0.5
    ),
    "trimmed offset of revolution": Geom.Geom_RectangularTrimmedSurface(
        Geom.Geom_OffsetSurface(Geom.Geom_SurfaceOfRevolution(bezier_curve(), AXIS), 0.5),
        *(1, 2, 0.25, 0.5),
    ),
}
CURVES = {
    **{type(c).__name__: c for c in conics()},
    "line": Geom.Geom_Line(gp_Pnt(1, 2, 3), gp_Dir(1, 2, -3)),
    "bezier": bezier_curve(),
    "trimmed": trimmed(bezier_curve()),
    "offset": Geom.Geom_OffsetCurve(bezier_curve(), 0.25, gp_Dir(0, 3, 1)),
    "offset of trimmed": Geom.Geom_OffsetCurve(
        trimmed(Geom.Geom_Circle(CONIC, 2)), 0.5, gp_Dir(1, 2, 2)
    ),
}


@pytest.mark.parametrize("name", SURFACES)
def test_surfaces(name):
    """Any surface, also nested ones, under a face."""
    face = TopoDS.TopoDS_Face()
    BRep_Builder().MakeFace(face, SURFACES[name], TopLoc_Location(), 1e-6)
    _, rebuilt, _ = round_trip(face)
    (made,) = cq.Shape.cast(rebuilt).Faces()
    stored = made.wrapped.TShape().Surface()
    assert type(stored) is type(SURFACES[name])
    assert stored.Bounds() == SURFACES[name].Bounds()
    for u, v in np.random.default_rng(0).uniform(0.3, 0.4, (20, 2)):
        assert stored.Value(u, v).Distance(SURFACES[name].Value(u, v)) == 0


@pytest.mark.parametrize("name", CURVES)
def test_curves(name):
    edge = TopoDS.TopoDS_Edge()
    BRep_Builder().MakeEdge(edge, CURVES[name], 1e-6)
    BRep_Builder().Range(edge, 0.3, 0.7)
    _, rebuilt, _ = round_trip(edge)
    (made,) = cq.Shape.cast(rebuilt).Edges()
    (stored,) = (c.Curve3D() for c in representations(made))
    assert type(stored) is type(CURVES[name])
    for t in np.linspace(0.3, 0.7, 20):
        assert stored.Value(t).Distance(CURVES[name].Value(t)) == 0


def representations(edge):
    return list(edge.wrapped.TShape().Curves())


def flat_bezier():
    poles = TColgp_Array1OfPnt2d(1, 3)
    for i, point in enumerate([(0, 0), (1, 2), (2, 0)]):
        poles.SetValue(i + 1, gp_Pnt2d(*point))
    return Geom2d_BezierCurve(poles)


@pytest.mark.parametrize(
    "pcurve",
    [
        flat_bezier(),
        Geom2d_Circle(gp_Ax22d(gp_Pnt2d(1, 2), gp_Dir2d(3, 4), False), 2),
        Geom2d_TrimmedCurve(flat_bezier(), 0.2, 0.7),
        Geom2d_OffsetCurve(flat_bezier(), 0.5),
    ],
    ids=lambda curve: type(curve).__name__,
)
def test_pcurves(pcurve):
    edge = TopoDS.TopoDS_Edge()
    BRep_Builder().MakeEdge(edge)
    BRep_Builder().UpdateEdge(edge, pcurve, SURFACES["cylinder"], TopLoc_Location(), 1e-6)
    BRep_Builder().Range(edge, 0.3, 0.6)
    _, rebuilt, tables = round_trip(edge)
    (kind,) = tables["edge_curves"].column("kind").to_pylist()
    assert kind == "pcurve"
    (made,) = cq.Shape.cast(rebuilt).Edges()
    (stored,) = representations(made)
    assert type(stored.PCurve()) is type(pcurve)
    for t in np.linspace(0.3, 0.6, 9):
        assert stored.PCurve().Value(t).Distance(pcurve.Value(t)) == 0


@pytest.mark.parametrize("name", PARTS)
def test_samples(name, tmp_path):
    (path,) = write_samples(tmp_path, [name])
    source, rebuilt, _ = round_trip(*load(path, "step").shapes)
    assert measure(source) == measure(rebuilt)  # equal, not nearly equal


def part(size=4.0):
    """A part without symmetry that has seams, splines and blends."""
    return (
        cq.Workplane()
        .box(size, 3, 2)
        .faces(">Z")
        .workplane(offset=-0.25)
        .center(0.5, 0.25)
        .hole(1)
        .edges("|X")
        .fillet(0.25)
        .val()
    )


def moved(shape, motion):
    return getattr(shape, "wrapped", shape).Located(TopLoc_Location(motion), False)


def mirror():
    motion = gp_Trsf()
    motion.SetMirror(gp_Ax2(gp_Pnt(9, 1, 2), gp_Dir(1, 2, 3)))
    return motion


def scaling():
    motion = gp_Trsf()
    motion.SetScale(gp_Pnt(1, 2, 3), 2.5)
    return motion


def turn():
    motion = gp_Trsf()
    motion.SetRotation(AXIS, 0.7)
    return motion


@pytest.mark.parametrize(
    "motion", [turn(), mirror(), scaling()], ids=["turned", "mirrored", "scaled"]
)
@pytest.mark.parametrize("baked", [False, True], ids=["placed", "baked"])
def test_moved_parts(motion, baked):
    if baked:
        shapes = [BRepBuilderAPI_Transform(part().wrapped, motion, True).Shape()]
    else:
        shapes = [part(), moved(part(), motion)]
    source, rebuilt, _ = round_trip(*shapes)
    assert measure(source) == measure(rebuilt)
    size = part().Volume()
    wanted = size * abs(motion.ScaleFactor()) ** 3 + (0 if baked else size)
    assert measure(rebuilt).volume == pytest.approx(wanted, rel=1e-9)


def test_assemblies_share_motions_and_shapes():
    """A nested assembly: the same part, by chains of motions that have members in common."""
    solid = part().wrapped
    first, second = TopLoc_Location(turn()), TopLoc_Location(mirror())
    places = [first, first.Multiplied(second), second.Multiplied(first), first.Powered(-3)]
    shapes = [solid.Located(place, False) for place in places]
    source, rebuilt, tables = round_trip(*shapes)
    forms = Counter(tables["motions"].column("form").to_pylist())
    assert (forms["Rotation"], forms["Ax2Mirror"]) == (1, 1)
    assert Counter(tables["shapes"].column("type").to_pylist())["solid"] == 1
    assert measure(source) == measure(rebuilt)
    before, after = (cq.Shape.cast(shape).Solids() for shape in (source, rebuilt))
    for a, b in zip(before, after, strict=True):
        assert a.Center().toTuple() == b.Center().toTuple()
        assert b.wrapped.IsPartner(after[0].wrapped)


def test_a_solid_turned_inside_out():
    inside_out = part().wrapped.Reversed()
    source, rebuilt, tables = round_trip(inside_out)
    (child,) = tables["shapes"].to_pylist()[0]["children"]
    assert child["orientation"] == "forward"  # canonical shapes have their normals outside
    kept = ShapeGraph(compound(inside_out)).tables(1)
    assert kept["shapes"].to_pylist()[0]["children"][0]["orientation"] == "reversed"
    again = rebuilt_shapes(kept)[0]
    assert cq.Shape.cast(again).Solids()[0].wrapped.Orientation().name == "TopAbs_REVERSED"
    assert measure(source) == measure(rebuilt) == measure(again)


@pytest.mark.parametrize("orientation", ["INTERNAL", "EXTERNAL"])
def test_edges_inside_faces(orientation):
    face = cq.Face.makePlane(4, 4).wrapped
    edge = BRepBuilderAPI_MakeEdge(gp_Pnt(-1, 0, 0), gp_Pnt(1, 0, 0)).Edge()
    wire = BRepBuilderAPI_MakeWire(edge).Wire()
    kind = getattr(TopAbs_Orientation, f"TopAbs_{orientation}")
    BRep_Builder().Add(face, wire.Oriented(kind))
    source, rebuilt, tables = round_trip(face)
    found = [c["orientation"] for row in tables["shapes"].to_pylist() for c in row["children"]]
    assert orientation.lower() in found
    assert measure(source) == measure(rebuilt)


def test_wires_edges_and_points_on_their_own():
    wire = cq.Wire.makeCircle(2, cq.Vector(0, 0, 0), cq.Vector(0, 0, 1))
    edge = cq.Edge.makeLine(cq.Vector(5, 0, 0), cq.Vector(6, 0, 0))
    point = cq.Vertex.makeVertex(7, 0, 0)
    source, rebuilt, _ = round_trip(wire, edge, point)
    assert measure(rebuilt).counts == {
        "solid": 0, "shell": 0, "face": 0, "wire": 1, "edge": 2, "vertex": 4,
    }  # fmt: skip
    assert differences(measure(source), measure(rebuilt)) == []


def test_closed_forms():
    """The rebuilt shape is not only equal to the source, it is right."""
    _, torus, _ = round_trip(cq.Solid.makeTorus(5, 2))
    _, cone, _ = round_trip(cq.Solid.makeCone(3, 1, 4))
    found = measure(torus)
    assert found.volume == pytest.approx(2 * math.pi**2 * 5 * 4, rel=1e-12)
    assert found.area == pytest.approx(4 * math.pi**2 * 5 * 2, rel=1e-12)
    assert measure(cone).volume == pytest.approx(math.pi * 4 / 3 * (9 + 3 + 1), rel=1e-12)


def replaced(tables, name, column, values):
    table = tables[name]
    place = table.schema.get_field_index(column)
    array = pa.array(values, table.schema.field(place).type)
    return tables | {name: table.set_column(place, table.schema.field(place), array)}


@pytest.mark.parametrize(
    ("name", "column", "value", "message"),
    [
        ("shapes", "type", "blob", "no shape is called 'blob'"),
        ("shapes", "surface", 99, "no surface 99"),
        ("edge_curves", "kind", "rumour", "nothing is called 'rumour'"),
        ("surfaces", "type", "Klein bottle", "no geometry is called 'Klein bottle'"),
    ],
)
def test_contradictions_are_named(name, column, value, message):
    _, _, tables = round_trip(cq.Solid.makeBox(1, 2, 3))
    values = tables[name].column(column).to_pylist()
    values[next(i for i, v in enumerate(values) if v is not None)] = value
    with pytest.raises(LakeFormatError, match=message):
        rebuilt_shapes(replaced(tables, name, column, values))


def test_circles_of_references_are_named():
    _, _, tables = round_trip(cq.Solid.makeBox(1, 2, 3))
    children = tables["shapes"].column("children").to_pylist()
    children[2][0]["shape"] = 0
    with pytest.raises(LakeFormatError, match="lies within itself"):
        rebuilt_shapes(replaced(tables, "shapes", "children", children))
    face = TopoDS.TopoDS_Face()
    BRep_Builder().MakeFace(face, SURFACES["offset"], TopLoc_Location(), 1e-6)
    _, _, tables = round_trip(face)
    with pytest.raises(LakeFormatError, match="its own basis"):
        rebuilt_shapes(replaced(tables, "surfaces", "basis", [0, None]))


def exact_volume(shape):
    """The volume as ingest integrates it; None without solids."""
    volumes = []
    for solid in cq.Shape.cast(shape).Solids():
        properties = GProp_GProps()
        BRepGProp.VolumeProperties_s(solid.wrapped, properties, INTEGRAL)
        volumes.append(properties.Mass())
    return sum(volumes) if volumes else None


def test_from_a_lake(sample_lake):
    import breplake

    lake = breplake.open(sample_lake)
    models = lake.sql("SELECT name, n_patches, n_curves, volume FROM models").fetchall()
    for name, n_patches, n_curves, volume in models:
        rebuilt = rebuild(lake, name)
        counts = measure(rebuilt).counts
        assert (counts["face"], counts["edge"]) == (n_patches, n_curves)
        assert exact_volume(rebuilt) == volume
    with pytest.raises(NameNotFoundError):
        rebuild(lake, "no such model")


def test_a_lake_without_shapes_says_so(tiny_lake):
    import breplake

    with pytest.raises(LakeFormatError, match="ingest it again"):
        rebuild(breplake.open(tiny_lake), "small")
