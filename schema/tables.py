"""The tables of a lake: the single source for names, types, units and meanings.

The data dictionary (``docs/tables.md``) is generated from here and a test compares them.
Lengths are millimetres, angles radians, curvatures 1/mm. Every id is 0-based and local to
its model; patch, curve and corner ids follow the order of OCCT's ``TopExp::MapShapes`` on
the model's canonical compound.
"""

from __future__ import annotations

from typing import Final

import pyarrow as pa

from breplake.schema.contract import VEC3, Column, Table
from breplake.schema.shape_tables import SHAPE_TABLES
from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES, count_column

__all__ = [
    "COEDGES",
    "CORNERS",
    "CURVES",
    "CURVE_GEOMETRY",
    "FACES",
    "FAILURES",
    "MODELS",
    "PARTS",
    "PATCHES",
    "SCHEMA_VERSION",
    "TABLES",
    "VERTICES",
]

SCHEMA_VERSION: Final = 1
"""Version of the tables and arrays. Readers refuse a higher one."""

_I64, _I32, _I8 = pa.int64(), pa.int32(), pa.int8()
_F64, _BOOL, _STR = pa.float64(), pa.bool_(), pa.string()

_MODEL_ID = Column(
    "model_id", _I64, "first 63 bits of SHA-256 of collection/name; the same in every lake"
)


def _counts(types: tuple[str, ...], *, curve: bool) -> tuple[Column, ...]:
    what = "curves" if curve else "patches"
    return tuple(
        Column(count_column(t, curve=curve), _I32, f"number of {what} of type {t}") for t in types
    )


MODELS = Table(
    "models",
    "a CAD file that was read",
    (
        _MODEL_ID,
        Column("collection", _STR, "group of models in which names are unique"),
        Column("name", _STR, "path below the given source without extension"),
        Column("path", _STR, "path of the file as it was given"),
        Column("format", _STR, "step, iges, brep or abc"),
        Column("bytes", _I64, "size of the source file", "byte"),
        Column("sha256", _STR, "SHA-256 of the source bytes, hexadecimal"),
        Column("licence", _STR, "licence of the model, where its source states one", nullable=True),
        Column("owner", _STR, "owner of the model, where its source states one", nullable=True),
        Column("source_url", _STR, "where the model was published", nullable=True),
        Column("metadata", pa.map_(_STR, _STR), "other facts that the source states"),
        Column(
            "import_repairs",
            pa.list_(_STR),
            "faults of original ABC files that were repaired on import; null for CAD files",
            nullable=True,
        ),
        Column("length_unit", _STR, "length unit the file declares", nullable=True),
        Column("scale_to_mm", _F64, "millimetres in one such unit, if known", nullable=True),
        Column("n_parts", _I32, "number of parts"),
        Column("n_solids", _I32, "number of solids"),
        Column("n_shells", _I32, "number of shells"),
        Column("n_patches", _I32, "number of patches (B-Rep faces)"),
        Column("n_curves", _I32, "number of curves (B-Rep edges)"),
        Column("n_corners", _I32, "number of corners (B-Rep vertices)"),
        *_counts(SURFACE_TYPES, curve=False),
        *_counts(CURVE_TYPES, curve=True),
        Column("n_sharp_curves", _I32, "number of curves whose column sharp is true"),
        Column("bbox_min", VEC3, "lower corner of the bounding box", "mm"),
        Column("bbox_max", VEC3, "upper corner of the bounding box", "mm"),
        Column("diagonal", _F64, "diagonal of the bounding box", "mm"),
        Column("area", _F64, "area of all patches", "mm^2"),
        Column("volume", _F64, "volume of all solids; null without any", "mm^3", nullable=True),
        Column("is_valid", _BOOL, "OCCT's BRepCheck_Analyzer finds no fault"),
        Column("n_added_pcurves", _I32, "pcurves that the file lacks and that were computed"),
        Column("is_closed", _BOOL, "has patches, and no curve is a boundary"),
        Column("is_single_primitive", _BOOL, "one box, cylinder, cone, sphere, torus or plane"),
        Column(
            "mesh_kind", _STR, "uniform, adaptive or tessellation; null without mesh", nullable=True
        ),
        Column("mesh_limit", _F64, "edge length asked for", "mm", nullable=True),
        Column("n_vertices", _I32, "number of mesh vertices", nullable=True),
        Column(
            "n_normals", _I32, "number of (vertex, patch) pairs, rows of vertices", nullable=True
        ),
        Column("n_faces", _I32, "number of triangles", nullable=True),
        Column("max_edge", _F64, "longest mesh edge", "mm", nullable=True),
        Column("min_angle", _F64, "smallest triangle angle", "rad", nullable=True),
        Column("regular_angles", _F64, "share of angles between 30 and 90 degrees", nullable=True),
        Column("is_watertight", _BOOL, "every mesh edge has exactly two triangles", nullable=True),
        Column("n_boundary_edges", _I32, "mesh edges with one triangle", nullable=True),
        Column(
            "n_nonmanifold_edges", _I32, "mesh edges with three or more triangles", nullable=True
        ),
        Column("mesh_note", _STR, "why the mesh is not as asked for", nullable=True),
        Column(
            "fingerprint",
            _STR,
            "form-hand-size: the same for copies, however placed or written; null without patches",
            nullable=True,
        ),
        Column(
            "duplicate_group",
            _I64,
            "the same for models with the same fingerprint, in every lake",
        ),
        Column("shard", _STR, "name of the files that hold the model"),
        Column("vertex_offset", _I64, "first row in position and feature", nullable=True),
        Column("normal_offset", _I64, "first row in normal, curvature and patch", nullable=True),
        Column("face_offset", _I64, "first row in triangle and its companions", nullable=True),
        Column("patch_offset", _I64, "first row in the UV-grids of patches", nullable=True),
        Column("curve_offset", _I64, "first row in the UV-grids of curves", nullable=True),
        Column("occt_version", _STR, "version of OCP, which begins with that of Open CASCADE"),
        Column("gmsh_version", _STR, "version of Gmsh"),
        Column("breplake_version", _STR, "version of breplake"),
        Column("config_hash", _STR, "hash of the settings that decide the content"),
        Column("seconds", _F64, "wall time of the model in its worker", "s"),
        Column("cpu_load", _F64, "CPU time to read and translate the file", "s"),
        Column("cpu_brep", _F64, "CPU time for the exact B-Rep rows", "s"),
        Column("cpu_mesh", _F64, "CPU time to mesh", "s"),
        Column("cpu_truth", _F64, "CPU time for normals, curvatures and labels", "s"),
        Column("cpu_write", _F64, "CPU time to hand the record over", "s"),
        Column("cpu_kernel", _F64, "CPU time inside OCCT's and Gmsh's heavy calls", "s"),
        Column("cpu_total", _F64, "CPU time of the model's worker, failed attempts included", "s"),
        Column("peak_memory", _I64, "peak resident memory of the worker", "byte"),
    ),
    key=("model_id",),
)

PARTS = Table(
    "parts",
    "a solid, or a shell or face outside any solid",
    (
        _MODEL_ID,
        Column("part_id", _I32, "index of the part"),
        Column("kind", _STR, "solid, shell or face"),
        Column("name", _STR, "name in the file", nullable=True),
        Column("colour", _STR, "sRGB colour as #rrggbb", nullable=True),
        Column("volume", _F64, "volume; null if not a solid", "mm^3", nullable=True),
        Column("area", _F64, "area of its patches", "mm^2"),
        Column("centroid", VEC3, "centre of mass (of the surface if not a solid)", "mm"),
        Column("bbox_min", VEC3, "lower corner of the bounding box", "mm"),
        Column("bbox_max", VEC3, "upper corner of the bounding box", "mm"),
        Column("is_closed", _BOOL, "no curve of the part is a boundary of it"),
        Column("shape", _I32, "the solid, shell or face in shapes", nullable=True),
    ),
    key=("model_id", "part_id"),
)


def _curve_geometry() -> tuple[Column, ...]:
    """Columns that describe a curve's geometry, for ``curves`` and for basis curves."""
    points = pa.list_(VEC3)
    return (
        Column("type", _STR, "one of " + ", ".join(CURVE_TYPES)),
        Column(
            "location",
            VEC3,
            "origin of the line; centre or vertex of the conic",
            "mm",
            nullable=True,
        ),
        Column("direction", VEC3, "unit direction of the line", nullable=True),
        Column("x_axis", VEC3, "first axis of the conic", nullable=True),
        Column("y_axis", VEC3, "second axis of the conic", nullable=True),
        Column("z_axis", VEC3, "normal axis of the conic", nullable=True),
        Column("radius", _F64, "radius of the circle", "mm", nullable=True),
        Column("x_radius", _F64, "major radius of the ellipse or hyperbola", "mm", nullable=True),
        Column("y_radius", _F64, "minor radius of the ellipse or hyperbola", "mm", nullable=True),
        Column("focal", _F64, "focal length of the parabola", "mm", nullable=True),
        Column("focus1", VEC3, "first focus (the only one of a parabola)", "mm", nullable=True),
        Column("focus2", VEC3, "second focus", "mm", nullable=True),
        Column("degree", _I32, "degree of the B-spline", nullable=True),
        Column("rational", _BOOL, "the B-spline has weights", nullable=True),
        Column("closed", _BOOL, "the geometric curve is closed", nullable=True),
        Column("periodic", _BOOL, "the B-spline is periodic", nullable=True),
        Column("continuity", _I32, "order of continuity of the B-spline; 99 is CN", nullable=True),
        Column("poles", points, "control points of the B-spline", "mm", nullable=True),
        Column(
            "knots",
            pa.list_(_F64),
            "knots, multiplicity expanded (OCCT KnotSequence)",
            nullable=True,
        ),
        Column("weights", pa.list_(_F64), "weights; null if not rational", nullable=True),
        Column("basis_type", _STR, "type of the curve that is offset, for Other", nullable=True),
        Column("offset", _F64, "distance of the offset", "mm", nullable=True),
        Column("offset_direction", VEC3, "its reference direction", nullable=True),
    )


CURVE_GEOMETRY: Final = _curve_geometry()
"""Columns of a curve's geometry: flat in ``curves``, a struct in ``patches.curve``."""

_BASIS = pa.struct([pa.field(c.name, c.type, nullable=c.nullable) for c in CURVE_GEOMETRY])

PATCHES = Table(
    "patches",
    "a B-Rep face",
    (
        _MODEL_ID,
        Column("patch_id", _I32, "index of the patch"),
        Column("part_id", _I32, "first part that holds the patch"),
        Column("type", _STR, "one of " + ", ".join(SURFACE_TYPES)),
        Column("reversed", _BOOL, "outward normal is opposite to dp/du x dp/dv"),
        Column("location", VEC3, "origin of the surface's axes", "mm", nullable=True),
        Column("x_axis", VEC3, "first axis", nullable=True),
        Column("y_axis", VEC3, "second axis", nullable=True),
        Column("z_axis", VEC3, "third axis: normal, or axis of rotation", nullable=True),
        Column("direction", VEC3, "unit direction of the extrusion", nullable=True),
        Column("apex", VEC3, "apex of the cone", "mm", nullable=True),
        Column("radius", _F64, "radius (of the cone: at location)", "mm", nullable=True),
        Column("min_radius", _F64, "minor radius of the torus", "mm", nullable=True),
        Column("max_radius", _F64, "major radius of the torus", "mm", nullable=True),
        Column("angle", _F64, "half angle of the cone, signed as in OCCT", "rad", nullable=True),
        Column(
            "coefficients",
            pa.list_(_F64),
            "4 of the plane, or 10 of the quadric, in the paper's order",
            nullable=True,
        ),
        Column("curve", _BASIS, "curve that is revolved or extruded", nullable=True),
        Column("u_degree", _I32, "degree in u", nullable=True),
        Column("v_degree", _I32, "degree in v", nullable=True),
        Column("u_rational", _BOOL, "rational in u", nullable=True),
        Column("v_rational", _BOOL, "rational in v", nullable=True),
        Column("u_closed", _BOOL, "the surface is closed in u"),
        Column("v_closed", _BOOL, "the surface is closed in v"),
        Column("u_periodic", _BOOL, "the surface is periodic in u"),
        Column("v_periodic", _BOOL, "the surface is periodic in v"),
        Column("continuity", _I32, "order of continuity of the B-spline; 99 is CN", nullable=True),
        Column("poles", pa.list_(pa.list_(VEC3)), "control points, u first", "mm", nullable=True),
        Column("u_knots", pa.list_(_F64), "knots in u, multiplicity expanded", nullable=True),
        Column("v_knots", pa.list_(_F64), "knots in v, multiplicity expanded", nullable=True),
        Column(
            "weights",
            pa.list_(pa.list_(_F64)),
            "weights, u first; null if not rational",
            nullable=True,
        ),
        Column("basis_type", _STR, "type of the surface that is offset, for Other", nullable=True),
        Column("offset", _F64, "distance of the offset along du x dv", "mm", nullable=True),
        Column("u_min", _F64, "least u of the trimmed patch"),
        Column("u_max", _F64, "greatest u of the trimmed patch"),
        Column("v_min", _F64, "least v of the trimmed patch"),
        Column("v_max", _F64, "greatest v of the trimmed patch"),
        Column("area", _F64, "exact area (OCCT BRepGProp)", "mm^2"),
        Column("n_loops", _I32, "number of loops (wires)"),
        Column("tolerance", _F64, "largest tolerance of the patch, its curves and corners", "mm"),
        Column("name", _STR, "name in the file", nullable=True),
        Column("colour", _STR, "sRGB colour as #rrggbb", nullable=True),
        Column("shape", _I32, "the face in shapes", nullable=True),
    ),
    key=("model_id", "patch_id"),
)

CURVES = Table(
    "curves",
    "a B-Rep edge",
    (
        _MODEL_ID,
        Column("curve_id", _I32, "index of the curve"),
        *CURVE_GEOMETRY,
        Column("t_min", _F64, "first parameter", nullable=True),
        Column("t_max", _F64, "last parameter", nullable=True),
        Column("length", _F64, "exact arc length", "mm", nullable=True),
        Column("tolerance", _F64, "tolerance of the edge", "mm"),
        Column("start_corner", _I32, "corner at t_min", nullable=True),
        Column("end_corner", _I32, "corner at t_max", nullable=True),
        Column("left_patch", _I32, "patch whose loop runs along the curve", nullable=True),
        Column("right_patch", _I32, "patch whose loop runs against the curve", nullable=True),
        Column("n_patches", _I32, "number of distinct patches at the curve"),
        Column("kind", _STR, "sharp, smooth, seam, boundary, nonmanifold, degenerate or free"),
        Column(
            "angle_min", _F64, "least angle between the two outward normals", "rad", nullable=True
        ),
        Column(
            "angle_max",
            _F64,
            "greatest angle between the two outward normals",
            "rad",
            nullable=True,
        ),
        Column(
            "convexity",
            _STR,
            "convex, concave or mixed, by where the normals differ by more than 0.5 degrees, of "
            "smooth curves too; null where they nowhere do or the patches' orientations disagree",
            nullable=True,
        ),
        Column(
            "stored_continuity", _STR, "continuity recorded in the file: C0, G1 ...", nullable=True
        ),
        Column("sharp", _BOOL, "sharp by ABC's rule (|n0.n1| <= 0.95 at every sample)"),
        Column("vert_indices", pa.list_(_I32), "mesh vertices along the curve", nullable=True),
        Column("vert_parameters", pa.list_(_F64), "their parameters t", nullable=True),
        Column("shape", _I32, "the edge in shapes", nullable=True),
    ),
    key=("model_id", "curve_id"),
)

COEDGES = Table(
    "coedges",
    "a use of a curve in a patch's loop",
    (
        _MODEL_ID,
        Column("patch_id", _I32, "the patch"),
        Column("loop", _I32, "index of the loop in the patch, 0 is the outer one"),
        Column("place", _I32, "place in the loop"),
        Column("curve_id", _I32, "the curve"),
        Column("reversed", _BOOL, "the loop runs against the curve, patch orientation applied"),
        Column("internal", _BOOL, "lies inside the patch and bounds nothing"),
        Column(
            "pcurve",
            _I32,
            "pcurve_id on the patch; null on planes, where the curve itself is projected",
            nullable=True,
        ),
        Column("t_min", _F64, "first parameter on the pcurve", nullable=True),
        Column("t_max", _F64, "last parameter on the pcurve", nullable=True),
    ),
    key=("model_id", "patch_id", "loop", "place"),
)

CORNERS = Table(
    "corners",
    "a B-Rep vertex",
    (
        _MODEL_ID,
        Column("corner_id", _I32, "index of the corner"),
        Column("point", VEC3, "position", "mm"),
        Column("tolerance", _F64, "tolerance of the vertex", "mm"),
        Column("vertex_id", _I32, "mesh vertex at the corner", nullable=True),
        Column("shape", _I32, "the vertex in shapes", nullable=True),
    ),
    key=("model_id", "corner_id"),
)

VERTICES = Table(
    "vertices",
    "a mesh vertex on one patch",
    (
        _MODEL_ID,
        Column("normal_id", _I32, "index of the row in its model; the vn index of an OBJ"),
        Column("vertex_id", _I32, "mesh vertex; the v index of an OBJ"),
        Column("patch_id", _I32, "the patch"),
        Column("is_primary", _BOOL, "true for exactly one row of each vertex"),
        Column("x", _F64, "position", "mm"),
        Column("y", _F64, "position", "mm"),
        Column("z", _F64, "position", "mm"),
        Column("nx", _F64, "outward unit normal", nullable=True),
        Column("ny", _F64, "outward unit normal", nullable=True),
        Column("nz", _F64, "outward unit normal", nullable=True),
        Column("u", _F64, "parameter on the patch"),
        Column("v", _F64, "parameter on the patch"),
        Column(
            "k_min",
            _F64,
            "least principal curvature, positive towards the normal",
            "1/mm",
            nullable=True,
        ),
        Column("k_max", _F64, "greatest principal curvature", "1/mm", nullable=True),
        Column("d_min", VEC3, "unit direction of k_min", nullable=True),
        Column("d_max", VEC3, "unit direction of k_max", nullable=True),
        Column("curve_id", _I32, "curve on which the vertex lies", nullable=True),
        Column("corner_id", _I32, "corner on which the vertex lies", nullable=True),
        Column("residual", _F64, "distance from (x, y, z) to the surface at (u, v)", "mm"),
    ),
    key=("model_id", "normal_id"),
    row_group=16_384,
)

FACES = Table(
    "faces",
    "a triangle",
    (
        _MODEL_ID,
        Column("face_id", _I32, "index of the triangle"),
        Column("v0", _I32, "first vertex_id, counter-clockwise seen from outside"),
        Column("v1", _I32, "second vertex_id"),
        Column("v2", _I32, "third vertex_id"),
        Column("n0", _I32, "normal_id at v0"),
        Column("n1", _I32, "normal_id at v1"),
        Column("n2", _I32, "normal_id at v2"),
        Column("patch_id", _I32, "the patch"),
    ),
    key=("model_id", "face_id"),
    row_group=16_384,
)

FAILURES = Table(
    "failures",
    "an input, or a stage of one, that failed",
    (
        _MODEL_ID,
        Column("collection", _STR, "as in models"),
        Column("name", _STR, "as in models"),
        Column("path", _STR, "path of the file as it was given"),
        Column(
            "bytes", _I64, "size of the file; null if it could not be read", "byte", nullable=True
        ),
        Column(
            "sha256", _STR, "SHA-256 of the bytes; null if they could not be read", nullable=True
        ),
        Column("stage", _STR, "plan, read, load, brep, import, mesh, truth or write"),
        Column("kind", _STR, "stable code of the failure"),
        Column("message", _STR, "what went wrong and what helps"),
        Column("signal", _I32, "signal that killed the worker", nullable=True),
        Column("seconds", _F64, "wall time until the failure", "s"),
        Column("peak_memory", _I64, "peak resident memory, if known", "byte", nullable=True),
        Column("config_hash", _STR, "hash of the settings that decide the content"),
        Column("fatal", _BOOL, "the input is not in models"),
        Column("attempt", _I8, "which attempt at the model failed, from 0"),
    ),
    key=("model_id", "attempt"),
)

TABLES: Final[dict[str, Table]] = {
    t.name: t
    for t in (
        *(MODELS, PARTS, PATCHES, CURVES, COEDGES, CORNERS),
        *SHAPE_TABLES,
        *(VERTICES, FACES, FAILURES),
    )
}
"""All tables by name."""
