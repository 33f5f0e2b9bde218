"""The arrays of a lake: one Zarr v3 group per shard, models one after the other.

Meshes are stored as float32 and int32 arrays, concatenated over the models of a shard; the
offsets of each model are columns of ``models``.  Indices inside the arrays are local to
their model.  The chunks that are compressed hold 4,096 rows, so that one model is read
without its neighbours; 128 of them are one file (Zarr's sharding codec). UV-grids, which an
ingest adds if asked to, have long rows and so fewer in a chunk.
Any reader of Zarr v3 opens them; ours is ``breplake.schema.array_reader``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from breplake.errors import UsageError

__all__ = [
    "ARRAYS",
    "AXES",
    "CHUNK_ROWS",
    "FILE_ROWS",
    "GRID_ARRAYS",
    "MESH_ARRAYS",
    "ArrayShardWriter",
    "ArraySpec",
    "Offsets",
]

CHUNK_ROWS: Final = 4096
"""Rows of a compressed chunk: what a random read decompresses."""

_CHUNKS: Final = 128  # in a file

FILE_ROWS: Final = _CHUNKS * CHUNK_ROWS
"""Rows of a file of a shard's array: at most 6 MB, which a writer holds in memory."""

_GRID_BYTES: Final = 12 * CHUNK_ROWS  # of a chunk of grids, as of one of positions

AXES: Final = ("vertex", "normal", "face", "patch", "curve")
"""What a row of an array may be: a mesh vertex, a (vertex, patch) pair, a triangle; in the
optional grids a patch or a curve."""


@dataclass(frozen=True, slots=True)
class ArraySpec:
    """One array of a shard.

    Parameters
    ----------
    name : str
        Name of the array.
    dtype : str
        NumPy type, little-endian.
    columns : int
        Length of the last axis; 0 for an array of one axis.
    axis : str
        What a row is, a member of `AXES`.
    description : str
        One line for the documentation.
    grid : int
        Number of axes between, all as long as an ingest was asked for.
    """

    name: str
    dtype: str
    columns: int
    axis: str
    description: str
    grid: int = 0

    def shape(self, rows: int, size: int = 0) -> tuple[int, ...]:
        """Return the shape of `rows` rows, where grids are `size` points wide."""
        return (rows, *(size,) * self.grid, *(self.columns,) * (self.columns > 0))

    def chunk_rows(self, size: int = 0) -> int:
        """Return the rows of a compressed chunk, where grids are `size` points wide."""
        row = int(np.prod(self.shape(1, size))) * np.dtype(self.dtype).itemsize
        return max(1, _GRID_BYTES // row) if self.grid else CHUNK_ROWS


ARRAYS: Final[dict[str, ArraySpec]] = {
    spec.name: spec
    for spec in (
        ArraySpec("position", "<f4", 3, "vertex", "position in mm"),
        ArraySpec(
            "feature", "|u1", 0, "vertex", "0 interior, 1 smooth curve, 2 sharp curve, 3 corner"
        ),
        ArraySpec("normal", "<f4", 3, "normal", "outward unit normal; NaN where undefined"),
        ArraySpec("curvature", "<f4", 2, "normal", "k_min and k_max in 1/mm; NaN where undefined"),
        ArraySpec("patch", "<i4", 0, "normal", "patch_id of the (vertex, patch) pair"),
        ArraySpec("triangle", "<i4", 3, "face", "vertex_id of the corners, counter-clockwise"),
        ArraySpec("triangle_normal", "<i4", 3, "face", "normal_id of the corners"),
        ArraySpec("triangle_patch", "<i4", 0, "face", "patch_id of the triangle"),
        ArraySpec(
            "patch_grid",
            "<f4",
            7,
            "patch",
            "points at equal steps of u, then v: position, outward normal, 1 inside the patch or "
            "on its border and 0 outside; NaN where undefined",
            grid=2,
        ),
        ArraySpec(
            "curve_grid",
            "<f4",
            6,
            "curve",
            "points at equal steps of t: position, unit tangent; NaN where undefined",
            grid=1,
        ),
    )
}
"""All arrays by name."""

MESH_ARRAYS: Final = tuple(spec.name for spec in ARRAYS.values() if not spec.grid)
"""Arrays of the meshes."""

GRID_ARRAYS: Final = tuple(spec.name for spec in ARRAYS.values() if spec.grid)
"""UV-grids, which a lake may lack; see ``breplake.schema.uvgrid``."""


@dataclass(frozen=True, slots=True)
class Offsets:
    """First rows of a model in its shard's arrays, as in ``models``; None where it has none."""

    vertex: int | None = None
    normal: int | None = None
    face: int | None = None
    patch: int | None = None
    curve: int | None = None

    def columns(self) -> dict[str, int | None]:
        """Return them as columns of ``models``."""
        return {f"{axis}_offset": getattr(self, axis) for axis in AXES}


class ArrayShardWriter:
    """Write the arrays of a shard model by model; close it, or use it in a ``with``.

    Rows wait in memory until they fill a file, so memory is bounded by `FILE_ROWS`
    rows of each array (about 34 MB) plus one model. The bytes written depend on nothing but the
    rows and their order.

    Parameters
    ----------
    path : pathlib.Path
        The folder to make: ``LakeStore.array_path(shard)``.
    grid : int
        Points along a side of the UV-grids; 0 for a shard without them.

    Raises
    ------
    UsageError
        If it exists.
    """

    def __init__(self, path: Path, grid: int = 0) -> None:
        import zarr
        from zarr.codecs import BloscCodec

        if path.exists():
            raise UsageError(f"{path} exists, and arrays are written once: name a new shard")
        path.parent.mkdir(parents=True, exist_ok=True)
        group = zarr.create_group(str(path), zarr_format=3)
        self._grid = grid
        names = (*MESH_ARRAYS, *GRID_ARRAYS) if grid else MESH_ARRAYS
        self._arrays: dict[str, Any] = {}
        for spec in (ARRAYS[name] for name in names):
            rows = spec.chunk_rows(grid)
            self._arrays[spec.name] = group.create_array(
                spec.name,
                shape=spec.shape(0, grid),
                dtype=spec.dtype,
                chunks=spec.shape(rows, grid),
                shards=spec.shape(_CHUNKS * rows, grid),
                compressors=BloscCodec(cname="lz4", clevel=5, shuffle="shuffle"),
                attributes={"description": spec.description, "axis": spec.axis},
            )
        self._waiting: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in names}
        self._waiting_rows = dict.fromkeys(names, 0)
        self._ends = dict.fromkeys(AXES, 0)

    def append(self, arrays: Mapping[str, npt.ArrayLike]) -> Offsets:
        """Add one model.

        Parameters
        ----------
        arrays : mapping
            All of `MESH_ARRAYS`, or all of `GRID_ARRAYS`, or both, by name; lengths must agree
            along each axis.

        Returns
        -------
        Offsets
            First rows of this model.

        Raises
        ------
        UsageError
            If an array is missing, unknown, or of a wrong type or shape.
        """
        blocks, rows = _checked(arrays, self._grid)
        for name, block in blocks.items():
            self._waiting[name].append(block)
            self._waiting_rows[name] += len(block)
            whole = _CHUNKS * ARRAYS[name].chunk_rows(self._grid)
            if self._waiting_rows[name] >= whole:
                self._flush(name, self._waiting_rows[name] // whole * whole)
        first = Offsets(**{axis: self._ends[axis] for axis in rows})
        for axis, count in rows.items():
            self._ends[axis] += count
        return first

    def _flush(self, name: str, rows: int) -> None:
        block = np.concatenate(self._waiting[name])
        array = self._arrays[name]
        start = array.shape[0]
        array.resize(ARRAYS[name].shape(start + rows, self._grid))
        array[start : start + rows] = block[:rows]
        self._waiting[name] = [block[rows:].copy()]
        self._waiting_rows[name] = len(block) - rows

    def close(self) -> None:
        """Write what waits. The shard is whole only then."""
        for name, rows in self._waiting_rows.items():
            if rows:
                self._flush(name, rows)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()


def _checked(
    arrays: Mapping[str, npt.ArrayLike], grid: int
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, int]]:
    """Return the arrays in storage type, and the rows along each axis."""
    sets = [MESH_ARRAYS, GRID_ARRAYS, MESH_ARRAYS + GRID_ARRAYS][: 3 if grid else 1]
    if not any(arrays.keys() == set(names) for names in sets):
        raise UsageError(
            f"arrays must be exactly {' or '.join(', '.join(names) for names in sets)}; "
            f"got {', '.join(arrays)}"
        )
    blocks: dict[str, npt.NDArray[Any]] = {}
    rows: dict[str, int] = {}
    for name in arrays:
        spec = ARRAYS[name]
        given = np.asarray(arrays[name])
        if not np.can_cast(given.dtype, spec.dtype, "same_kind"):
            raise UsageError(f"array {name} must be {spec.dtype}, got {given.dtype}")
        wanted = spec.shape(0, grid)
        if given.ndim != len(wanted) or given.shape[1:] != wanted[1:]:
            shape = f"(n, {', '.join(map(str, wanted[1:]))})" if wanted[1:] else "(n,)"
            raise UsageError(f"array {name} must be of shape {shape}, got {given.shape}")
        if len(given) != rows.setdefault(spec.axis, len(given)):
            raise UsageError(
                f"array {name} has {len(given)} rows, others of its axis {rows[spec.axis]}"
            )
        blocks[name] = given.astype(spec.dtype, order="C")
        if given.dtype.kind == "i" and not np.array_equal(blocks[name], given):
            raise UsageError(f"array {name} holds numbers beyond {spec.dtype}")
    return blocks, rows
