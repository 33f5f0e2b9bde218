"""Columns of Arrow tables as flat numpy buffers, a null being NaN or an empty list."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from breplake.errors import UsageError
from breplake.schema.contract import VEC2, VEC3
from breplake.schema.namespace import Bools, Floats, Ints

__all__ = [
    "Ragged",
    "codes",
    "flags",
    "grids",
    "identifiers",
    "integers",
    "lists",
    "scalars",
    "struct",
    "vectors",
]


@dataclass(frozen=True, slots=True)
class Ragged:
    """Lists of numbers or of points, end to end.

    Attributes
    ----------
    values : numpy.ndarray
        ``(total,)`` or ``(dim, total)`` float64.
    length : numpy.ndarray
        ``(n,)`` int64, number of values of each row.
    """

    values: Floats
    length: Ints

    @property
    def start(self) -> Ints:
        """Index of each row's first value, ``(n,)``."""
        return np.cumsum(self.length) - self.length

    @property
    def owner(self) -> Ints:
        """Row of each value, ``(total,)``."""
        return np.repeat(np.arange(len(self.length)), self.length)


def _column(table: pa.Table, name: str, kind: pa.DataType) -> pa.Array:
    """Return a column as one array; nulls of type `kind` where the table lacks it."""
    if name not in table.column_names:
        return pa.nulls(table.num_rows, kind)
    array = table.column(name).combine_chunks()
    return pa.nulls(len(array), kind) if pa.types.is_null(array.type) else array


def _numbers(array: pa.Array) -> Floats:
    """Return float64, NaN for null."""
    return np.asarray(array.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)


def _lengths(array: pa.Array) -> Ints:
    counts = pc.fill_null(pc.list_value_length(array), 0)
    return np.asarray(counts.to_numpy(zero_copy_only=False), dtype=np.int64)


def _points(array: pa.Array) -> Floats:
    """Turn an array of x, y, z (or u, v) structs into ``(dim, n)``, NaN for null."""
    return np.stack([_numbers(leaf) for leaf in array.flatten()])


def codes(table: pa.Table, name: str, names: Sequence[str]) -> Ints:
    """Return the place of each row's string in `names`, ``(n,)``; -1 where it is none.

    Raises
    ------
    UsageError
        If the table has no such column.
    """
    if name not in table.column_names:
        raise UsageError(f"the table needs the column {name!r}; it has {table.column_names}")
    strings = _column(table, name, pa.string()).cast(pa.string())
    places = pc.fill_null(pc.index_in(strings, value_set=pa.array(names, pa.string())), -1)
    return np.asarray(places.to_numpy(zero_copy_only=False), dtype=np.int64)


def scalars(table: pa.Table, name: str) -> Floats:
    """Return a column of numbers, ``(n,)`` float64, NaN for null."""
    return _numbers(_column(table, name, pa.float64()))


def integers(table: pa.Table, name: str) -> Ints:
    """Return a column of integers, ``(n,)`` int64, 0 for null."""
    return np.nan_to_num(scalars(table, name)).astype(np.int64)


def identifiers(table: pa.Table, name: str) -> Ints:
    """Return a column of ids, ``(n,)`` int64 to the last of their 63 bits; -1 for null."""
    values = pc.fill_null(_column(table, name, pa.int64()).cast(pa.int64()), -1)
    return np.asarray(values.to_numpy(zero_copy_only=False), dtype=np.int64)


def flags(table: pa.Table, name: str) -> Bools:
    """Return a column of booleans, ``(n,)``, False for null."""
    values = pc.fill_null(_column(table, name, pa.bool_()), False)
    return np.asarray(values.to_numpy(zero_copy_only=False), dtype=bool)


def vectors(table: pa.Table, name: str, dim: int = 3) -> Floats:
    """Return a column of x, y, z (or u, v) structs as ``(dim, n)`` float64, NaN for null."""
    return _points(_column(table, name, VEC3 if dim == 3 else VEC2))


def struct(table: pa.Table, name: str) -> pa.Table:
    """Return a column of structs as a table of its fields, null where the struct is."""
    if name not in table.column_names:
        return pa.table({"type": pa.nulls(table.num_rows, pa.string())})
    array = table.column(name).combine_chunks()
    return pa.Table.from_arrays(array.flatten(), names=[field.name for field in array.type])


def lists(table: pa.Table, name: str) -> Ragged:
    """Return a column of lists of numbers, or of lists of points."""
    array = _column(table, name, pa.list_(pa.float64()))
    flat = array.flatten()
    values = _points(flat) if pa.types.is_struct(flat.type) else _numbers(flat)
    return Ragged(values, _lengths(array))


def grids(table: pa.Table, name: str) -> tuple[Ragged, Ints]:
    """Return a column of lists of equally long lists, and the number of its outer lists.

    Returns
    -------
    values : Ragged
        All values of a row, the inner index running fastest. A row whose inner lists
        differ in length is emptied of meaning: its count is -1.
    outer : numpy.ndarray
        ``(n,)`` int64.
    """
    array = _column(table, name, pa.list_(pa.list_(pa.float64())))
    outer, rows = _lengths(array), array.flatten()
    inner = _lengths(rows)  # (all outer lists,)
    flat = rows.flatten()
    values = _points(flat) if pa.types.is_struct(flat.type) else _numbers(flat)
    owner = np.repeat(np.arange(len(outer)), outer)
    total = np.bincount(owner, inner, minlength=len(outer)).astype(np.int64)
    even = np.bincount(owner, inner * outer[owner] != total[owner], minlength=len(outer)) == 0
    return Ragged(values, total), np.where(even, outer, -1)
