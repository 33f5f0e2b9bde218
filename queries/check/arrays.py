"""Rules on the Zarr arrays: the same rows as the tables, at the models' offsets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from breplake.errors import BreplakeError
from breplake.queries.check.files import LakeView
from breplake.queries.check.ids import n_vertices
from breplake.queries.check.rules import Measure, lake_rule, model_rule, place
from breplake.queries.check.view import MISSING, ModelView
from breplake.schema.array_reader import ArrayShardReader
from breplake.schema.arrays import ARRAYS, GRID_ARRAYS, MESH_ARRAYS
from breplake.schema.snapshot import ARRAYS_TABLE
from breplake.schema.uvgrid import uv_grids

__all__ = ["model_arrays"]

_OFFSETS: Final = {
    "vertex": "n_vertices",
    "normal": "n_normals",
    "face": "n_faces",
    "patch": "n_patches",
    "curve": "n_curves",
}
"""Axis of an array to the column of ``models`` with its rows."""

_GRID_AXES: Final = ("patch", "curve")
_ROUNDING: Final = 1e-5  # of a coordinate: twice float32's, for another version's last bits

_FROM_TABLES: Final[dict[str, Callable[[ModelView], NDArray[Any]]]] = {
    "position": lambda view: view.primary_points,
    "feature": lambda view: features(view),
    "normal": lambda view: view.normals,
    "curvature": lambda view: view.triples("vertices", "k_min k_max"),
    "patch": lambda view: view.ints("vertices", "patch_id"),
    "triangle": lambda view: view.triples("faces", "v0 v1 v2"),
    "triangle_normal": lambda view: view.triples("faces", "n0 n1 n2"),
    "triangle_patch": lambda view: view.ints("faces", "patch_id"),
}
"""What each array must hold, from the tables."""


def model_arrays(reader: ArrayShardReader, row: dict[str, Any]) -> dict[str, NDArray[Any]] | None:
    """Read a model's slice of every array that it has; None if that cannot be done.

    The arrays of the mesh must be there, UV-grids need not.
    """
    arrays = {}
    for name, spec in ARRAYS.items():
        start, rows = row[f"{spec.axis}_offset"], row[_OFFSETS[spec.axis]]
        if start is None and spec.grid:
            continue
        if start is None or rows is None:
            return None
        try:
            arrays[name] = reader.read(name, start, start + rows)
        except BreplakeError:
            return None
    return arrays


def features(view: ModelView) -> NDArray[np.uint8]:
    """Return the feature code of each mesh vertex, ``(n_vertices,)``.

    3 at a corner, else 2 on a sharp curve, else 1 on another curve, else 0.
    """
    code = np.zeros(n_vertices(view), dtype=np.uint8)
    offsets, vertices = view.lists("curves", "vert_indices")
    sharp = np.repeat(view.flags("curves", "sharp"), np.diff(offsets))
    code[vertices] = 1
    code[vertices[sharp]] = 2
    corners = view.ints("corners", "vertex_id")
    code[corners[corners != MISSING]] = 3
    return code


@model_rule(
    "arrays",
    "Zarr arrays hold the tables' values as float32 and int32",
    needs=("ids-dense", "references", "primary"),
)
def arrays(view: ModelView) -> Iterator[Measure]:
    """Measure each row of each array."""
    if not view.has_mesh:
        return
    if view.arrays is None:
        yield Measure.of_truth([False], lambda _: "the arrays cannot be read at these offsets")
        return
    for name in MESH_ARRAYS:
        spec = ARRAYS[name]
        found = view.arrays[name].reshape(-1, spec.columns or 1)
        with np.errstate(over="ignore"):
            wanted = _FROM_TABLES[name](view).astype(spec.dtype).reshape(-1, spec.columns or 1)
        if found.shape != wanted.shape:
            words = f"{name}: shape {found.shape} instead of {wanted.shape}"
            yield Measure.of_truth([False], place(words))
            continue
        same = found == wanted
        if found.dtype.kind == "f":
            same |= np.isnan(found) & np.isnan(wanted)
        yield Measure.of_truth(same.all(axis=1), place("{n} row {i}", n=name))


@model_rule(
    "uv-grids",
    "UV-grids hold points, normals and masks of the patches, points and tangents of the curves",
    needs=("ids-dense",),
)
def grids(view: ModelView) -> Iterator[Measure]:
    """Measure each number of the UV-grids against the closed forms, in float32."""
    stored = {} if view.arrays is None else view.arrays
    for name, found in stored.items():
        if name in GRID_ARRAYS:
            wanted = uv_grids(view.tables, found.shape[1])[name]
            if found.shape != wanted.shape:
                words = f"{name}: shape {found.shape} instead of {wanted.shape}"
                yield Measure.of_truth([False], place(words))
                continue
            same = np.isclose(found, wanted, rtol=_ROUNDING, atol=_ROUNDING, equal_nan=True)
            whole = same.reshape(len(same), -1).all(axis=1)
            yield Measure.of_truth(whole, place("{n} row {i}", n=name))


@lake_rule("offsets", "models lie in a shard's arrays one behind the other, without gaps")
def offsets(view: LakeView) -> Iterator[Measure]:
    """Measure each model's offsets, and the lengths of the arrays."""
    columns = ["collection", "name", *_OFFSETS.values(), *(f"{a}_offset" for a in _OFFSETS)]
    rows = view.read("models", columns).to_pylist()
    for shard in sorted({e.shard for e in view.tables}):
        models = [r for r in rows if r["file_shard"] == shard]
        ends = dict.fromkeys(_OFFSETS, 0)
        for row in models:
            for axis, count in _OFFSETS.items():
                start = row[f"{axis}_offset"]
                # a model may have no mesh, and a lake no UV-grids
                if start is None and (axis in _GRID_AXES or row["n_vertices"] is None):
                    continue
                words = f"{axis}_offset {start} instead of {ends[axis]}"
                name = f"{row['collection']}/{row['name']}"
                yield Measure.of_truth([start == ends[axis]], place(words), name)
                ends[axis] = (ends[axis] if start is None else start) + (row[count] or 0)
        yield from _lengths(view, shard, ends)


def _lengths(view: LakeView, shard: str, ends: dict[str, int]) -> Iterator[Measure]:
    """Measure the length of each array of a shard."""
    entry = next((e for e in view.entries if (e.shard, e.table) == (shard, ARRAYS_TABLE)), None)
    if entry is None:
        words = f"no arrays for {ends['vertex']} mesh vertices"
        yield Measure.of_truth([ends["vertex"] == 0], place(words), f"shard {shard}")
        return
    reader = ArrayShardReader(view.path(entry))
    for name in (*MESH_ARRAYS, *(GRID_ARRAYS if reader.grid else ())):
        spec = ARRAYS[name]
        try:
            rows = reader.rows(name)
        except BreplakeError as error:
            yield Measure.of_truth([False], place("{e}", e=error), entry.path)
            continue
        words = f"{name} has {rows} rows, the models {ends[spec.axis]}"
        yield Measure.of_truth([rows == ends[spec.axis]], place(words), entry.path)
