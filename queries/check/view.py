"""One model's rows as numpy columns, read once and shared by all rules."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from breplake.queries.check.mesh import MeshEdges, Triangles
from breplake.queries.check.truth import CurveTruth, SurfaceTruth
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.tables import TABLES

__all__ = ["MISSING", "ModelView"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

MISSING: Final = -(2**62)
"""Stands for null in integer columns; -1 would hide a wrong id."""


class ModelView:
    """The rows of one model in every table.

    Parameters
    ----------
    row : mapping
        The model's row in ``models``.
    tables : mapping of str to pyarrow.Table
        Rows of the other tables; a missing table has none.
    arrays : mapping of str to numpy.ndarray, optional
        The model's slice of each array; None when the lake has no arrays for it.
    """

    def __init__(
        self,
        row: Mapping[str, Any],
        tables: Mapping[str, pa.Table],
        arrays: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        self.row = dict(row)
        self.tables = dict(tables)
        self.arrays = arrays
        self._columns: dict[tuple[str, str], NDArray[Any]] = {}

    @property
    def name(self) -> str:
        """Collection and name, as the report calls the model."""
        return f"{self.row['collection']}/{self.row['name']}"

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box in mm."""
        return float(self.row["diagonal"])

    @property
    def has_mesh(self) -> bool:
        """Whether the model should have a mesh."""
        return self.row["mesh_kind"] is not None

    def table(self, name: str) -> pa.Table:
        """Return the model's rows of a table."""
        if name not in self.tables:
            self.tables[name] = TABLES[name].empty()
        return self.tables[name]

    def count(self, table: str) -> int:
        """Return the model's number of rows in a table."""
        return int(self.table(table).num_rows)

    def floats(self, table: str, column: str) -> Floats:
        """Return a column as ``(n,)`` float64, null as NaN."""
        return self._cached(table, column, _floats)

    def ints(self, table: str, column: str) -> Ints:
        """Return a column as ``(n,)`` int64, null as `MISSING`."""
        return self._cached(table, column, _ints)

    def flags(self, table: str, column: str) -> Flags:
        """Return a column as ``(n,)`` bool, null as False."""
        return self._cached(table, column, _flags)

    def words(self, table: str, column: str) -> NDArray[np.object_]:
        """Return a column of text as ``(n,)`` objects, null as None."""
        return self._cached(table, column, _words)

    def vectors(self, table: str, column: str) -> Floats:
        """Return a column of vectors as ``(n, 3)`` float64, null as NaN."""
        return self._cached(table, column, _vectors)

    def triples(self, table: str, names: str) -> NDArray[Any]:
        """Return three columns, say ``"x y z"``, side by side as ``(n, 3)``."""
        first = self.table(table).schema.field(names.split()[0]).type
        read = self.ints if pa.types.is_integer(first) else self.floats
        return self._cached(
            table, names, lambda _: np.stack([read(table, c) for c in names.split()], axis=1)
        )

    def lists(self, table: str, column: str) -> tuple[Ints, NDArray[Any]]:
        """Return a list column as ``(n + 1,)`` offsets and the values behind each other."""
        lists = self.table(table).column(column).combine_chunks()
        if isinstance(lists, pa.ChunkedArray):  # combine_chunks keeps the class when empty
            lists = pa.array([], type=lists.type)
        lengths = lists.value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
        offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)  # (n + 1,)
        return offsets, lists.flatten().to_numpy(zero_copy_only=False)

    @cached_property
    def points(self) -> Floats:
        """Position of each vertex row, ``(n, 3)`` mm."""
        return self.triples("vertices", "x y z")

    @cached_property
    def normals(self) -> Floats:
        """Normal of each vertex row, ``(n, 3)``, NaN where null."""
        return self.triples("vertices", "nx ny nz")

    @cached_property
    def primary_points(self) -> Floats:
        """Position of each mesh vertex, ``(n_vertices, 3)`` mm, by vertex_id."""
        primary = self.flags("vertices", "is_primary")
        ids = self.ints("vertices", "vertex_id")[primary]
        points = np.full((len(ids), 3), np.nan)
        points[ids] = self.points[primary]
        return points

    @cached_property
    def triangles(self) -> Triangles:
        """Sides, normals and areas of the mesh's triangles."""
        return Triangles.of(self.primary_points[self.triples("faces", "v0 v1 v2")])

    @cached_property
    def mesh_edges(self) -> MeshEdges:
        """The mesh's edges."""
        return MeshEdges.of(self.triples("faces", "v0 v1 v2"), len(self.primary_points))

    @cached_property
    def surfaces(self) -> SurfaceSet:
        """The closed forms of the patches."""
        return SurfaceSet.from_patches(self.table("patches"))

    @cached_property
    def surface(self) -> SurfaceTruth:
        """The closed forms of the patches at every vertex row."""
        return SurfaceTruth.of(self)

    @cached_property
    def curve(self) -> CurveTruth:
        """The closed forms of the curves at their mesh vertices."""
        return CurveTruth.of(self)

    def _cached(self, table: str, column: str, read: Any) -> NDArray[Any]:
        key = (table, column)
        if key not in self._columns:
            source = None if " " in column else self.table(table).column(column)
            self._columns[key] = read(source)
        return self._columns[key]


def _floats(column: pa.ChunkedArray) -> Floats:
    values = column.to_numpy()  # null becomes NaN
    return np.asarray(values, dtype=np.float64)


def _ints(column: pa.ChunkedArray) -> Ints:
    return np.asarray(column.cast(pa.int64()).fill_null(MISSING).to_numpy(), dtype=np.int64)


def _flags(column: pa.ChunkedArray) -> Flags:
    return np.asarray(column.fill_null(False).to_numpy(), dtype=np.bool_)


def _words(column: pa.ChunkedArray) -> NDArray[np.object_]:
    return np.asarray(column.to_pylist(), dtype=object)


def _vectors(column: pa.ChunkedArray) -> Floats:
    """Flatten a struct column; the validity of the struct decides, not that of its leaves."""
    if not len(column):
        return np.empty((0, 3))
    struct = column.combine_chunks()
    leaves = [struct.field(i).to_numpy(zero_copy_only=False) for i in range(3)]
    vectors = np.stack(leaves, axis=1).astype(np.float64)  # (n, 3)
    vectors[struct.is_null().to_numpy(zero_copy_only=False)] = np.nan
    return vectors
