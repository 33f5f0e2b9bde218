"""Rows of Python and numpy values to Arrow columns, without a Python object for each number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.schema.contract import Table

__all__ = ["column_array", "column_values", "rows_table", "table_rows"]


def rows_table(table: Table, model_id: int, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Return the rows of one model as `table`; a missing key is null.

    Parameters
    ----------
    table : Table
        The table.
    model_id : int
        The model.
    rows : sequence of mapping
        Values by column as `column_array` takes them.

    Raises
    ------
    KeyError
        If a row has a key that is no column.
    """
    known = {column.name for column in table.columns}
    for row in rows:
        if not row.keys() <= known:
            raise KeyError(f"table {table.name} has no column {sorted(row.keys() - known)}")
    columns: dict[str, Any] = {
        name: column_array(column.type, [row.get(name) for row in rows])
        for column in table.columns
        if (name := column.name) != "model_id"
    }
    return table.from_columns({"model_id": np.full(len(rows), model_id), **columns})


def column_array(kind: pa.DataType, values: Sequence[Any]) -> pa.Array:
    """Return `values` as an Arrow array.

    Parameters
    ----------
    kind : pyarrow.DataType
        Type of the column.
    values : sequence
        None is null. A list is a sequence or an array; a struct of one type of leaves
        is a tuple of them, so that a list of points is an array ``(n, 3)``.
    """
    if pa.types.is_list(kind):
        return _lists(kind, values)
    if pa.types.is_struct(kind):
        null = np.fromiter((value is None for value in values), bool, len(values))
        blank = (0,) * kind.num_fields
        leaves = np.array([blank if value is None else value for value in values])
        return _structs(kind, leaves.reshape(-1, kind.num_fields), null)
    return pa.array(values, kind)


def table_rows(table: pa.Table) -> list[dict[str, Any]]:
    """Return the rows of a table with values as `rows_table` takes them."""
    columns = [column_values(table.column(name)) for name in table.column_names]
    return [dict(zip(table.column_names, row, strict=True)) for row in zip(*columns, strict=True)]


def column_values(column: pa.ChunkedArray) -> list[Any]:
    """Return the values of a column, the inverse of `column_array`.

    Structs are tuples; lists are arrays with an axis more for each list or struct in them,
    ``(n, m, 3)`` for a grid of points.
    """
    kind = column.type
    if not (pa.types.is_list(kind) or pa.types.is_struct(kind)):
        values: list[Any] = column.to_pylist()
        return values
    array = column.combine_chunks()
    valid = array.is_valid().to_pylist()
    if pa.types.is_struct(kind):
        return [
            tuple(row) if ok else None
            for row, ok in zip(_leaves(array).tolist(), valid, strict=True)
        ]
    starts, items = array.offsets.to_numpy(), array.values
    ends = list(zip(starts[:-1].tolist(), starts[1:].tolist(), valid, strict=True))
    if not pa.types.is_list(kind.value_type):
        leaves = _leaves(items)
        return [leaves[a:b] if ok else None for a, b, ok in ends]
    inner, leaves = items.offsets.to_numpy(), _leaves(items.values)
    return [
        leaves[inner[a] : inner[b]].reshape(b - a, -1, *leaves.shape[1:]) if ok else None
        for a, b, ok in ends
    ]


def _leaves(array: pa.Array) -> npt.NDArray[Any]:
    """Return numbers ``(n,)``, or structs of them ``(n, fields)``."""
    if pa.types.is_struct(array.type):
        return np.column_stack([leaf.to_numpy(zero_copy_only=False) for leaf in array.flatten()])
    leaves: npt.NDArray[Any] = array.to_numpy(zero_copy_only=False)
    return leaves


def _lists(kind: pa.ListType, values: Sequence[Any]) -> pa.Array:
    null = np.fromiter((value is None for value in values), bool, len(values))
    lengths = [0 if value is None else len(value) for value in values]
    offsets = np.concatenate([[0], np.cumsum(lengths, dtype=np.int32)]).astype(np.int32)
    filled = [value for value in values if value is not None and len(value)]
    return pa.ListArray.from_arrays(
        pa.array(offsets), _inner(kind.value_type, filled), type=kind, mask=pa.array(null)
    )


def _inner(kind: pa.DataType, lists: Sequence[Any]) -> pa.Array:
    """Return the items of all lists, none of which is null."""
    if pa.types.is_list(kind):
        return _lists(kind, [item for items in lists for item in items])
    if not lists:
        return pa.array([], kind)
    items = np.concatenate(lists)
    if pa.types.is_struct(kind):
        return _structs(kind, items.reshape(-1, kind.num_fields), None)
    return pa.array(items, kind)


def _structs(
    kind: pa.StructType, leaves: npt.NDArray[Any], null: npt.NDArray[np.bool_] | None
) -> pa.Array:
    """Return the rows ``(n, fields)`` of `leaves` as structs."""
    arrays = [
        pa.array(np.ascontiguousarray(leaves[:, i]), kind.field(i).type)
        for i in range(kind.num_fields)
    ]
    mask = None if null is None else pa.array(null)
    return pa.StructArray.from_arrays(arrays, fields=list(kind), mask=mask)
