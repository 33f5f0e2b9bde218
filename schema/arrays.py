"""The arrays of a lake: one Zarr v3 group per shard, models one after the other.

Meshes are stored as float32 and int32 arrays, concatenated over the models of a shard; the
offsets of each model are columns of ``models``.  Indices inside the arrays are local to
their model.  The chunks that are compressed hold 4,096 rows, so that one model is read
without its neighbours; 128 of them are one file (Zarr's sharding codec).
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

__all__ = ["ARRAYS", "AXES", "CHUNK_ROWS", "FILE_ROWS", "ArrayShardWriter", "ArraySpec", "Offsets"]

CHUNK_ROWS: Final = 4096
"""Rows of a compressed chunk: what a random read decompresses."""

FILE_ROWS: Final = 128 * CHUNK_ROWS
"""Rows of a file of a shard's array: at most 6 MB, which a writer holds in memory."""

AXES: Final = ("vertex", "normal", "face")
"""What a row of an array may be: a mesh vertex, a (vertex, patch) pair, a triangle."""


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
        Length of the second axis; 0 for an array of one axis.
    axis : str
        What a row is: ``vertex``, ``normal`` (a vertex on one patch) or ``face``.
    description : str
        One line for the documentation.
    """

    name: str
    dtype: str
    columns: int
    axis: str
    description: str

    def shape(self, rows: int) -> tuple[int, ...]:
        """Return the shape of `rows` rows."""
        return (rows, self.columns) if self.columns else (rows,)


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
    )
}
"""All arrays by name."""


@dataclass(frozen=True, slots=True)
class Offsets:
    """First rows of a model in the arrays of its shard, as in ``models``."""

    vertex: int
    normal: int
    face: int


class ArrayShardWriter:
    """Write the arrays of a shard model by model; close it, or use it in a ``with``.

    Rows wait in memory until they fill a file, so memory is bounded by `FILE_ROWS`
    rows of each array (about 34 MB) plus one model. The bytes written depend on nothing but the
    rows and their order.

    Parameters
    ----------
    path : pathlib.Path
        The folder to make: ``LakeStore.array_path(shard)``.

    Raises
    ------
    UsageError
        If it exists.
    """

    def __init__(self, path: Path) -> None:
        import zarr
        from zarr.codecs import BloscCodec

        if path.exists():
            raise UsageError(f"{path} exists, and arrays are written once: name a new shard")
        path.parent.mkdir(parents=True, exist_ok=True)
        group = zarr.create_group(str(path), zarr_format=3)
        self._arrays: dict[str, Any] = {
            spec.name: group.create_array(
                spec.name,
                shape=spec.shape(0),
                dtype=spec.dtype,
                chunks=spec.shape(CHUNK_ROWS),
                shards=spec.shape(FILE_ROWS),
                compressors=BloscCodec(cname="lz4", clevel=5, shuffle="shuffle"),
                attributes={"description": spec.description, "axis": spec.axis},
            )
            for spec in ARRAYS.values()
        }
        self._waiting: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in ARRAYS}
        self._waiting_rows = dict.fromkeys(ARRAYS, 0)
        self._offsets = Offsets(0, 0, 0)

    def append(self, arrays: Mapping[str, npt.ArrayLike]) -> Offsets:
        """Add one model.

        Parameters
        ----------
        arrays : mapping
            Every array of `ARRAYS` by name; lengths must agree along each axis.

        Returns
        -------
        Offsets
            First rows of this model.

        Raises
        ------
        UsageError
            If an array is missing, unknown, or of a wrong type or shape.
        """
        blocks, rows = _checked(arrays)
        for name, block in blocks.items():
            self._waiting[name].append(block)
            self._waiting_rows[name] += len(block)
            if self._waiting_rows[name] >= FILE_ROWS:
                self._flush(name, self._waiting_rows[name] // FILE_ROWS * FILE_ROWS)
        first = self._offsets
        self._offsets = Offsets(
            first.vertex + rows["vertex"], first.normal + rows["normal"], first.face + rows["face"]
        )
        return first

    def _flush(self, name: str, rows: int) -> None:
        block = np.concatenate(self._waiting[name])
        array = self._arrays[name]
        start = array.shape[0]
        array.resize(ARRAYS[name].shape(start + rows))
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
    arrays: Mapping[str, npt.ArrayLike],
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, int]]:
    """Return the arrays in storage type, and the rows along each axis."""
    if different := arrays.keys() ^ ARRAYS.keys():
        raise UsageError(
            f"arrays must be exactly {', '.join(ARRAYS)}; differs: {sorted(different)}"
        )
    blocks: dict[str, npt.NDArray[Any]] = {}
    rows: dict[str, int] = {}
    for name, spec in ARRAYS.items():
        given = np.asarray(arrays[name])
        if not np.can_cast(given.dtype, spec.dtype, "same_kind"):
            raise UsageError(f"array {name} must be {spec.dtype}, got {given.dtype}")
        if given.ndim != len(spec.shape(0)) or given.shape[1:] != spec.shape(0)[1:]:
            shape = f"(n, {spec.columns})" if spec.columns else "(n,)"
            raise UsageError(f"array {name} must be of shape {shape}, got {given.shape}")
        if len(given) != rows.setdefault(spec.axis, len(given)):
            raise UsageError(
                f"array {name} has {len(given)} rows, others of its axis {rows[spec.axis]}"
            )
        blocks[name] = given.astype(spec.dtype, order="C")
        if given.dtype.kind == "i" and not np.array_equal(blocks[name], given):
            raise UsageError(f"array {name} holds numbers beyond {spec.dtype}")
    return blocks, rows
