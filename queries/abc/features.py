"""The features of a model, curves and patches, as the published YAML files hold them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.schema.abc import CONTINUITY_CODES, CURVE_KEYS, SURFACE_KEYS
from breplake.schema.tables import CURVE_GEOMETRY, PATCHES

__all__ = ["features"]

_CODES: Final = {order: code for code, order in CONTINUITY_CODES.items()}

_NOT_GEOMETRY: Final = frozenset(
    (
        *("model_id", "patch_id", "part_id", "type", "shape", "name", "colour", "reversed"),
        *("u_min", "u_max", "v_min", "v_max", "area", "n_loops", "tolerance"),
        *("u_closed", "v_closed", "u_periodic", "v_periodic"),
    )
)
"""Columns of patches that do not describe the surface of one of type Other."""


def features(
    curves: pa.Table, patches: pa.Table, vertices: pa.Table, faces: pa.Table
) -> dict[str, Any]:
    """Return the content of a features file.

    Parameters
    ----------
    curves, patches, vertices, faces : pyarrow.Table
        One model's rows of those tables, in order of their ids.

    Returns
    -------
    dict
        Lists ``curves`` and ``surfaces``. What goes beyond the paper's keys: ``part`` of a
        surface, ``location`` and the paper's ``x_radius`` and ``y_radius`` of an ellipse beside
        the files' ``maj_radius`` and ``min_radius``, and ``other`` with the true type and all
        parameters of what the paper calls Other.
    """
    return {
        "curves": [_curve(row) for row in curves.to_pylist()],
        "surfaces": _surfaces(patches, vertices, faces),
    }


def _curve(row: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **_curve_geometry(row),
        "sharp": row["sharp"],
        "vert_indices": row["vert_indices"] or [],
        "vert_parameters": row["vert_parameters"] or [],
    }


def _curve_geometry(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return type and parameters of a curve, or of one that is revolved or extruded."""
    kind = row["type"]
    if kind not in CURVE_KEYS or kind == "Other":
        return {"type": "Other"} | _other(row, [column.name for column in CURVE_GEOMETRY])
    found = {"type": kind} | {key: _plain(row[key]) for key in CURVE_KEYS[kind]}
    if kind == "Ellipse":
        # the published files name them so, and have no centre
        found |= {"maj_radius": row["x_radius"], "min_radius": row["y_radius"]}
        found["location"] = _plain(row["location"])
    if kind == "BSpline":
        found["continuity"] = _CODES.get(row["continuity"])
        found["weights"] = row["weights"] or [1.0] * len(row["poles"])
    return found


def _surfaces(patches: pa.Table, vertices: pa.Table, faces: pa.Table) -> list[dict[str, Any]]:
    rows = patches.to_pylist()
    vertex = np.asarray(vertices.column("vertex_id").to_numpy())
    uv = np.column_stack([vertices.column(name).to_numpy() for name in "uv"])
    of_patch = _groups(vertices, len(rows))
    triangles = _groups(faces, len(rows))
    return [
        {
            **_surface_geometry(row),
            "part": row["part_id"],
            "vert_indices": vertex[mine].tolist(),
            "vert_parameters": uv[mine].tolist(),
            "face_indices": own.tolist(),
        }
        for row, mine, own in zip(rows, of_patch, triangles, strict=True)
    ]


def _groups(table: pa.Table, count: int) -> list[npt.NDArray[np.int64]]:
    """Return the rows of each of `count` patches."""
    patch = table.column("patch_id").to_numpy()
    order = np.argsort(patch, kind="stable")
    return np.split(order, np.searchsorted(patch[order], np.arange(1, count))) if count else []


def _surface_geometry(row: Mapping[str, Any]) -> dict[str, Any]:
    kind = row["type"]
    if kind not in SURFACE_KEYS or kind == "Other":
        names = [c.name for c in PATCHES.columns if c.name not in _NOT_GEOMETRY]
        return {"type": "Other"} | _other(row, names)
    found = {"type": kind} | {key: _plain(row[key]) for key in SURFACE_KEYS[kind]}
    if "curve" in found:
        found["curve"] = _curve_geometry(row["curve"])
    if kind == "BSpline":
        found["continuity"] = _CODES.get(row["continuity"])
        if row["weights"] is None:
            found["weights"] = [[1.0] * len(line) for line in row["poles"]]
    return found


def _other(row: Mapping[str, Any], names: list[str]) -> dict[str, Any]:
    """Return what is known of a curve or surface that the paper has no type for."""
    known = {name: _plain(row[name]) for name in names if row[name] is not None}
    known["type"] = row["type"]
    return {"other": known} if len(known) > 1 else {}


def _plain(value: Any) -> Any:
    """Return points as lists of their coordinates."""
    if isinstance(value, dict):
        if value.keys() <= {"x", "y", "z"}:
            return [value["x"], value["y"], value["z"]]
        return {key: _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value
