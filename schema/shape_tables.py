"""The tables from which a B-Rep can be rebuilt without its file.

They mirror what Open CASCADE holds in memory: a graph of shapes (``TShape``) that are shared
by orientation and location, and the geometry that these refer to. ``patches``, ``curves``,
``coedges`` and ``corners`` say the same in flat rows with every location applied; each of their
rows names its row here. Coordinates are millimetres, before any location is applied.
"""

from __future__ import annotations

from typing import Final

import pyarrow as pa

from breplake.schema.contract import VEC2, VEC3, Column, Table

__all__ = [
    "CONTINUITIES",
    "CURVE_CLASSES",
    "EDGE_CURVES",
    "EDGE_CURVE_KINDS",
    "MOTIONS",
    "ORIENTATIONS",
    "PCURVES",
    "SHAPES",
    "SHAPE_TABLES",
    "SHAPE_TYPES",
    "SPACE_CURVES",
    "SURFACES",
    "SURFACE_CLASSES",
]

SHAPE_TYPES: Final = (
    "compound",
    "compsolid",
    "solid",
    "shell",
    "face",
    "wire",
    "edge",
    "vertex",
)
"""Kinds of shapes, OCCT's ``TopAbs_ShapeEnum``."""

ORIENTATIONS: Final = ("forward", "reversed", "internal", "external")
"""OCCT's ``TopAbs_Orientation``."""

SURFACE_CLASSES: Final = (
    "Plane",
    "Cylinder",
    "Cone",
    "Sphere",
    "Torus",
    "Revolution",
    "Extrusion",
    "BSpline",
    "Bezier",
    "Offset",
    "Trimmed",
)
"""Classes of surfaces as they are stored, OCCT's ``Geom_Surface``."""

CURVE_CLASSES: Final = (
    "Line",
    "Circle",
    "Ellipse",
    "Parabola",
    "Hyperbola",
    "BSpline",
    "Bezier",
    "Offset",
    "Trimmed",
)
"""Classes of curves as they are stored, OCCT's ``Geom_Curve`` and ``Geom2d_Curve``."""

EDGE_CURVE_KINDS: Final = ("curve", "pcurve", "seam", "continuity")
"""What an edge may carry: its curve in space, a curve in the parameters of a surface, two of them
on a closed surface, and the continuity between two surfaces."""

CONTINUITIES: Final = ("C0", "G1", "C1", "G2", "C2", "C3", "CN")
"""Orders of continuity, OCCT's ``GeomAbs_Shape``."""

_I64, _I32 = pa.int64(), pa.int32()
_F64, _BOOL, _STR = pa.float64(), pa.bool_(), pa.string()

_MODEL_ID = Column("model_id", _I64, "the model, as in models")

PLACEMENT: Final = pa.list_(
    pa.struct([pa.field("motion", _I32, nullable=False), pa.field("power", _I32, nullable=False)])
)
"""A location, OCCT's ``TopLoc_Location``: powers of motions, the leftmost applied last."""

_CHILD = pa.struct(
    [
        pa.field("shape", _I32, nullable=False),
        pa.field("orientation", _STR, nullable=False),
        pa.field("placement", PLACEMENT, nullable=False),
    ]
)


def _flag(name: str, meaning: str) -> Column:
    return Column(name, _BOOL, meaning)


SHAPES = Table(
    "shapes",
    "a node of the shape graph (OCCT TShape)",
    (
        _MODEL_ID,
        Column("shape_id", _I32, "index of the shape; 0 is the compound of the whole model"),
        Column("type", _STR, "one of " + ", ".join(SHAPE_TYPES)),
        Column("children", pa.list_(_CHILD), "sub-shapes with orientation and location, in order"),
        _flag("free", "OCCT flag: may be modified"),
        _flag("modified", "OCCT flag: was modified since its last check"),
        _flag("checked", "OCCT flag: was checked"),
        _flag("orientable", "OCCT flag: has an orientation"),
        _flag("closed", "OCCT flag: bounds a closed space"),
        _flag("infinite", "OCCT flag: is infinite"),
        _flag("convex", "OCCT flag: is convex"),
        _flag("locked", "OCCT flag: must not be modified"),
        Column("tolerance", _F64, "of a face, edge or vertex", "mm", nullable=True),
        Column("surface", _I32, "surface_id of a face", nullable=True),
        Column("placement", PLACEMENT, "location of the surface of a face", nullable=True),
        Column(
            "natural_restriction",
            _BOOL,
            "the face is bounded by the bounds of its surface",
            nullable=True,
        ),
        Column("same_parameter", _BOOL, "all curves of the edge agree at each parameter", "", True),
        Column("same_range", _BOOL, "all curves of the edge have the same range", nullable=True),
        Column("degenerated", _BOOL, "the edge is a point", nullable=True),
        Column("point", VEC3, "of a vertex", "mm", nullable=True),
    ),
    key=("model_id", "shape_id"),
)

EDGE_CURVES = Table(
    "edge_curves",
    "a geometric representation of an edge",
    (
        _MODEL_ID,
        Column("shape_id", _I32, "the edge in shapes"),
        Column("place", _I32, "place in the list of the edge"),
        Column("kind", _STR, "one of " + ", ".join(EDGE_CURVE_KINDS)),
        Column("space_curve", _I32, "space_curve_id of a curve", nullable=True),
        Column("surface", _I32, "surface_id of a pcurve, seam or continuity", nullable=True),
        Column("placement", PLACEMENT, "location of the curve or surface"),
        Column("pcurve", _I32, "pcurve_id of a pcurve or seam", nullable=True),
        Column("pcurve2", _I32, "pcurve_id of the reversed edge on a seam", nullable=True),
        Column("surface2", _I32, "surface_id on the other side of a continuity", nullable=True),
        Column("placement2", PLACEMENT, "location of surface2", nullable=True),
        Column("continuity", _STR, "one of " + ", ".join(CONTINUITIES), nullable=True),
        Column("t_min", _F64, "first parameter of a curve, pcurve or seam", nullable=True),
        Column("t_max", _F64, "last parameter", nullable=True),
    ),
    key=("model_id", "shape_id", "place"),
)

MOTIONS = Table(
    "motions",
    "a transformation that locations refer to (OCCT gp_Trsf)",
    (
        _MODEL_ID,
        Column("motion_id", _I32, "index of the motion"),
        Column("form", _STR, "OCCT's name of the kind of motion: Translation, CompoundTrsf ..."),
        Column("scale", _F64, "scale factor; -1 for some mirrors"),
        Column("row_x", VEC3, "first row of the matrix, the scale factor left out"),
        Column("row_y", VEC3, "second row"),
        Column("row_z", VEC3, "third row"),
        Column("translation", VEC3, "translation", "mm"),
    ),
    key=("model_id", "motion_id"),
)


def _spline(points: pa.DataType, unit: str) -> tuple[Column, ...]:
    return (
        Column("degree", _I32, "degree of the B-spline", nullable=True),
        Column("periodic", _BOOL, "the B-spline is periodic", nullable=True),
        Column("poles", pa.list_(points), "control points", unit, nullable=True),
        Column("knots", pa.list_(_F64), "knots, multiplicity expanded, as in curves", "", True),
        Column("weights", pa.list_(_F64), "weights; null if not rational", nullable=True),
    )


SURFACES = Table(
    "surfaces",
    "a surface as it is stored, nested ones by reference",
    (
        _MODEL_ID,
        Column("surface_id", _I32, "index of the surface"),
        Column("type", _STR, "one of " + ", ".join(SURFACE_CLASSES)),
        Column("location", VEC3, "origin of the axes", "mm", nullable=True),
        Column("x_axis", VEC3, "first axis", nullable=True),
        Column("y_axis", VEC3, "second axis", nullable=True),
        Column("z_axis", VEC3, "third axis, or axis of rotation", nullable=True),
        Column("direction", VEC3, "unit direction of an extrusion", nullable=True),
        Column("radius", _F64, "radius (of the cone: at location)", "mm", nullable=True),
        Column("min_radius", _F64, "minor radius of the torus", "mm", nullable=True),
        Column("max_radius", _F64, "major radius of the torus", "mm", nullable=True),
        Column("angle", _F64, "half angle of the cone", "rad", nullable=True),
        Column("space_curve", _I32, "space_curve_id that is revolved or extruded", nullable=True),
        Column("basis", _I32, "surface_id that is offset or trimmed", nullable=True),
        Column("offset", _F64, "distance along du x dv of the basis", "mm", nullable=True),
        Column("u_min", _F64, "trimmed from; null if not trimmed in u", nullable=True),
        Column("u_max", _F64, "trimmed to", nullable=True),
        Column("v_min", _F64, "trimmed from; null if not trimmed in v", nullable=True),
        Column("v_max", _F64, "trimmed to", nullable=True),
        Column("u_degree", _I32, "degree in u", nullable=True),
        Column("v_degree", _I32, "degree in v", nullable=True),
        Column("u_periodic", _BOOL, "the B-spline is periodic in u", nullable=True),
        Column("v_periodic", _BOOL, "the B-spline is periodic in v", nullable=True),
        Column("poles", pa.list_(pa.list_(VEC3)), "control points, u first", "mm", nullable=True),
        Column("u_knots", pa.list_(_F64), "knots in u, multiplicity expanded", nullable=True),
        Column("v_knots", pa.list_(_F64), "knots in v, multiplicity expanded", nullable=True),
        Column(
            "weights", pa.list_(pa.list_(_F64)), "weights, u first; null if not rational", "", True
        ),
    ),
    key=("model_id", "surface_id"),
)

SPACE_CURVES = Table(
    "space_curves",
    "a curve in space as it is stored, nested ones by reference",
    (
        _MODEL_ID,
        Column("space_curve_id", _I32, "index of the curve"),
        Column("type", _STR, "one of " + ", ".join(CURVE_CLASSES)),
        Column("location", VEC3, "origin", "mm", nullable=True),
        Column("direction", VEC3, "of a line, or reference direction of an offset", nullable=True),
        Column("x_axis", VEC3, "first axis of the conic", nullable=True),
        Column("y_axis", VEC3, "second axis of the conic", nullable=True),
        Column("z_axis", VEC3, "normal of the conic", nullable=True),
        Column("radius", _F64, "radius of the circle", "mm", nullable=True),
        Column("x_radius", _F64, "major radius", "mm", nullable=True),
        Column("y_radius", _F64, "minor radius", "mm", nullable=True),
        Column("focal", _F64, "focal length of the parabola", "mm", nullable=True),
        Column("basis", _I32, "space_curve_id that is offset or trimmed", nullable=True),
        Column("offset", _F64, "distance of the offset", "mm", nullable=True),
        Column("t_min", _F64, "trimmed from", nullable=True),
        Column("t_max", _F64, "trimmed to", nullable=True),
        *_spline(VEC3, "mm"),
    ),
    key=("model_id", "space_curve_id"),
)

PCURVES = Table(
    "pcurves",
    "a curve in the parameter plane of a surface, nested ones by reference",
    (
        _MODEL_ID,
        Column("pcurve_id", _I32, "index of the curve"),
        Column("type", _STR, "one of " + ", ".join(CURVE_CLASSES)),
        Column("location", VEC2, "origin", nullable=True),
        Column("direction", VEC2, "of a line", nullable=True),
        Column("x_axis", VEC2, "first axis of the conic", nullable=True),
        Column("y_axis", VEC2, "second axis of the conic", nullable=True),
        Column("radius", _F64, "radius of the circle", nullable=True),
        Column("x_radius", _F64, "major radius", nullable=True),
        Column("y_radius", _F64, "minor radius", nullable=True),
        Column("focal", _F64, "focal length of the parabola", nullable=True),
        Column("basis", _I32, "pcurve_id that is offset or trimmed", nullable=True),
        Column("offset", _F64, "distance of the offset", nullable=True),
        Column("t_min", _F64, "trimmed from", nullable=True),
        Column("t_max", _F64, "trimmed to", nullable=True),
        *_spline(VEC2, ""),
    ),
    key=("model_id", "pcurve_id"),
)

SHAPE_TABLES: Final = (SHAPES, EDGE_CURVES, MOTIONS, SURFACES, SPACE_CURVES, PCURVES)
"""All tables of this module."""
