"""A model's tables, from its B-Rep, mesh and ground truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.ingest.brep import Brep
from breplake.ingest.geometry import Row
from breplake.ingest.measures import is_single_primitive
from breplake.ingest.mesh import Mesh
from breplake.ingest.quality import measure
from breplake.ingest.truth import Truth
from breplake.schema.contract import vec3_array
from breplake.schema.tables import COEDGES, CORNERS, CURVES, FACES, PARTS, PATCHES, VERTICES
from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES, count_column

__all__ = ["brep_columns", "brep_tables", "mesh_columns", "mesh_tables", "shape_columns"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]


def brep_tables(model_id: int, brep: Brep) -> dict[str, pa.Table]:
    """Return the tables that need no mesh."""
    identity = {"model_id": model_id}
    coedges = [
        {
            "patch_id": use.patch_id,
            "loop": use.loop,
            "place": use.place,
            "curve_id": use.curve_id,
            "reversed": use.reversed,
            "internal": use.internal,
            "pcurve": use.pcurve.pcurve,
            "t_min": use.pcurve.t_min,
            "t_max": use.pcurve.t_max,
        }
        for use in brep.coedges
    ]
    rows = (
        (PARTS, brep.parts),
        (CURVES, brep.curves),
        (COEDGES, coedges),
        (CORNERS, brep.corners),
    )
    tables = {table.name: table.from_rows(identity | row for row in found) for table, found in rows}
    identities = pa.array(np.full(brep.patch_table.num_rows, model_id))
    tables[PATCHES.name] = _replaced(brep.patch_table, {"model_id": identities})
    return tables | brep.graph.tables(model_id)


def brep_columns(brep: Brep) -> Row:
    """Return the columns of ``models`` that need no mesh."""
    shape = shape_columns(brep.parts, brep.patches, brep.curves, len(brep.corners), brep.bounds())
    return shape | {"n_shells": brep.canonical.n_shells}


def shape_columns(
    parts: Sequence[Row],
    patches: Sequence[Row],
    curves: Sequence[Row],
    n_corners: int,
    bounds: tuple[_Floats, _Floats],
) -> Row:
    """Return what ``models`` sums up of the rows of other tables; bounds are ``(3,)`` mm."""
    of_patch = Counter(row["type"] for row in patches)
    of_curve = Counter(row["type"] for row in curves)
    solids = [part for part in parts if part["kind"] == "solid"]
    volume = sum(part["volume"] for part in solids) if solids else None
    low, high = bounds
    kinds = {row["kind"] for row in curves}
    return {
        "n_parts": len(parts),
        "n_solids": len(solids),
        "n_patches": len(patches),
        "n_curves": len(curves),
        "n_corners": n_corners,
        **{count_column(t): of_patch[t] for t in SURFACE_TYPES},
        **{count_column(t, curve=True): of_curve[t] for t in CURVE_TYPES},
        "n_sharp_curves": sum(row["sharp"] for row in curves),
        "bbox_min": dict(zip("xyz", low.tolist(), strict=True)),
        "bbox_max": dict(zip("xyz", high.tolist(), strict=True)),
        "diagonal": float(np.linalg.norm(high - low)),
        "area": sum(row["area"] for row in patches),
        "volume": volume,
        "is_closed": bool(patches) and "boundary" not in kinds,
        "is_single_primitive": "free" not in kinds
        and is_single_primitive(len(parts), patches, n_corners, len(curves)),
    }


def mesh_tables(
    model_id: int, tables: Mapping[str, pa.Table], mesh: Mesh, truth: Truth
) -> dict[str, pa.Table]:
    """Return the tables that need the mesh, and ``curves`` and ``corners`` completed by it."""
    n, f = len(mesh.pair_vertex), len(mesh.triangles)
    vertex = mesh.pair_vertex
    first = np.empty(len(mesh.points), dtype=np.int64)
    first[vertex[::-1]] = np.arange(n)[::-1]  # of a vertex' pairs the last to be set stays
    primary = first[vertex] == np.arange(n)
    point = mesh.points.take(vertex, 0)  # (m, 3)
    columns: dict[str, Any] = {
        "model_id": np.full(n, model_id),
        "normal_id": np.arange(n, dtype=np.int32),
        "vertex_id": vertex.astype(np.int32),
        "patch_id": mesh.pair_patch.astype(np.int32),
        "is_primary": primary,
        **{axis: point[:, i].copy() for i, axis in enumerate("xyz")},
        **{f"n{axis}": _nullable(truth.normal[:, i]) for i, axis in enumerate("xyz")},
        "u": mesh.uv[:, 0].copy(),
        "v": mesh.uv[:, 1].copy(),
        "k_min": _nullable(truth.curvature.k_min),
        "k_max": _nullable(truth.curvature.k_max),
        "d_min": _nullable_vectors(truth.curvature.d_min),
        "d_max": _nullable_vectors(truth.curvature.d_max),
        "curve_id": _nullable_ids(mesh.curve_of_vertex()[vertex]),
        "corner_id": _nullable_ids(mesh.corner[vertex]),
        "residual": truth.residual,
    }
    normals = mesh.pairs(np.repeat(mesh.patch, 3), mesh.triangles.ravel()).reshape(-1, 3)
    faces: dict[str, Any] = {
        "model_id": np.full(f, model_id),
        "face_id": np.arange(f, dtype=np.int32),
        **{f"v{i}": mesh.triangles[:, i].astype(np.int32) for i in range(3)},
        **{f"n{i}": normals[:, i].astype(np.int32) for i in range(3)},
        "patch_id": mesh.patch.astype(np.int32),
    }
    return {
        "vertices": VERTICES.from_columns(columns),
        "faces": FACES.from_columns(faces),
        "curves": _curves_with_vertices(tables["curves"], mesh),
        "corners": _corners_with_vertices(tables["corners"], mesh),
    }


def mesh_columns(mesh: Mesh) -> Row:
    """Return the columns of ``models`` that describe the mesh itself."""
    quality = measure(mesh.points, mesh.triangles)
    return {
        "n_vertices": len(mesh.points),
        "n_normals": len(mesh.pair_vertex),
        "n_faces": len(mesh.triangles),
        "max_edge": quality.max_edge,
        "min_angle": quality.min_angle,
        "regular_angles": quality.regular_angles,
        "is_watertight": quality.is_watertight,
        "n_boundary_edges": quality.n_boundary_edges,
        "n_nonmanifold_edges": quality.n_nonmanifold_edges,
    }


def _nullable(values: _Floats) -> pa.Array:
    return pa.array(np.ascontiguousarray(values), mask=np.isnan(values))


def _nullable_vectors(values: _Floats) -> pa.Array:
    return vec3_array(values, mask=np.isnan(values).any(axis=1))


def _nullable_ids(values: _Ints) -> pa.Array:
    return pa.array(values.astype(np.int32), mask=values < 0)


def _curves_with_vertices(curves: pa.Table, mesh: Mesh) -> pa.Table:
    along = [mesh.curves.get(i) for i in range(curves.num_rows)]
    filled = {
        "vert_indices": [None if nodes is None else nodes.vertices for nodes in along],
        "vert_parameters": [None if nodes is None else nodes.t for nodes in along],
    }
    return _replaced(curves, filled)


def _corners_with_vertices(corners: pa.Table, mesh: Mesh) -> pa.Table:
    vertex = np.full(corners.num_rows, -1, dtype=np.int64)
    used = np.flatnonzero(mesh.corner >= 0)
    vertex[mesh.corner[used]] = used
    return _replaced(corners, {"vertex_id": _nullable_ids(vertex)})


def _replaced(table: pa.Table, columns: Mapping[str, Any]) -> pa.Table:
    for name, values in columns.items():
        index = table.schema.get_field_index(name)
        field = table.schema.field(index)
        array = values if isinstance(values, pa.Array) else pa.array(values, field.type)
        table = table.set_column(index, field, array)
    return table
