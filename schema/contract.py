"""Columns and tables as data: the vocabulary in which ``schema.tables`` is written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

__all__ = ["VEC2", "VEC3", "Column", "Table", "vec3_array"]

VEC3 = pa.struct([pa.field(axis, pa.float64(), nullable=False) for axis in "xyz"])
"""A point or direction in space. Structs keep min/max statistics for each coordinate."""

VEC2 = pa.struct([pa.field(axis, pa.float64(), nullable=False) for axis in "uv"])
"""A point in the parameter plane of a patch."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table.

    Parameters
    ----------
    name : str
        Column name, snake case.
    type : pyarrow.DataType
        Storage type.
    description : str
        One line for the data dictionary.
    unit : str
        ``mm``, ``mm^2``, ``rad``, ``1/mm``, ``s``, ``byte`` or empty for a pure number.
    nullable : bool
        Whether the quantity may be undefined for a row.
    """

    name: str
    type: pa.DataType
    description: str
    unit: str = ""
    nullable: bool = False

    def field(self) -> pa.Field:
        """Return the Arrow field, unit and description in its metadata."""
        metadata = {"description": self.description}
        if self.unit:
            metadata["unit"] = self.unit
        return pa.field(self.name, self.type, nullable=self.nullable, metadata=metadata)


@dataclass(frozen=True, slots=True)
class Table:
    """One table of a lake.

    Parameters
    ----------
    name : str
        Table name, the folder of its Parquet files.
    row : str
        What one row is.
    columns : tuple of Column
        In storage order.
    key : tuple of str
        Columns that identify a row and by which the rows of a file are sorted.
    row_group : int
        Rows in a row group: large for tables that are scanned, small for those read by model.
    """

    name: str
    row: str
    columns: tuple[Column, ...]
    key: tuple[str, ...]
    row_group: int = 131_072

    @property
    def schema(self) -> pa.Schema:
        """The Arrow schema of the table's files."""
        return pa.schema([column.field() for column in self.columns])

    def column(self, name: str) -> Column:
        """Return the column called `name`.

        Raises
        ------
        KeyError
            If the table has no such column.
        """
        for column in self.columns:
            if column.name == name:
                return column
        raise KeyError(f"table {self.name} has no column {name}")

    def empty(self) -> pa.Table:
        """Return a table of this schema without rows."""
        return self.schema.empty_table()

    def from_rows(self, rows: Iterable[Mapping[str, Any]]) -> pa.Table:
        """Build a table from dictionaries; a missing key is null.

        Raises
        ------
        KeyError
            If a row has a key that is no column: a misspelt key must not become a null.
        pyarrow.ArrowInvalid
            If a column that is not nullable misses a value.
        """
        rows = list(rows)
        known = {column.name for column in self.columns}
        for row in rows:
            if unknown := row.keys() - known:
                raise KeyError(f"table {self.name} has no column {sorted(unknown)}")
        return self.checked(pa.Table.from_pylist(rows, schema=self.schema))

    def from_columns(self, columns: Mapping[str, Any]) -> pa.Table:
        """Build a table from whole columns (numpy or Arrow arrays); a missing one is null.

        Raises
        ------
        KeyError
            If a name is no column of this table.
        pyarrow.ArrowInvalid
            If a column that is not nullable misses a value.
        """
        known = {column.name for column in self.columns}
        if unknown := columns.keys() - known:
            raise KeyError(f"table {self.name} has no column {sorted(unknown)}")
        length = len(next(iter(columns.values()))) if columns else 0
        arrays = []
        for column in self.columns:
            value = columns.get(column.name)
            if value is None:
                arrays.append(pa.nulls(length, column.type))
            else:
                arrays.append(
                    value if isinstance(value, pa.Array) else pa.array(value, column.type)
                )
        return self.checked(pa.Table.from_arrays(arrays, schema=self.schema))

    def checked(self, table: pa.Table) -> pa.Table:
        """Return `table` if it keeps the rules of nullability.

        Raises
        ------
        pyarrow.ArrowInvalid
            If a column that is not nullable holds a null.
        """
        for column in self.columns:
            if not column.nullable and table.column(column.name).null_count:
                raise pa.ArrowInvalid(f"{self.name}.{column.name} must not be null")
        return table


def vec3_array(points: Any, mask: Any = None) -> pa.Array:
    """Turn ``(n, 3)`` float64 into an Arrow array of ``VEC3``.

    Parameters
    ----------
    points : numpy.ndarray
        ``(n, 3)`` float64.
    mask : numpy.ndarray, optional
        ``(n,)`` bool, True where the row is null.
    """
    import numpy as np

    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)  # (n, 3)
    leaves = [pa.array(np.ascontiguousarray(points[:, i])) for i in range(3)]
    null = None if mask is None else pa.array(np.asarray(mask, dtype=bool))
    return pa.StructArray.from_arrays(leaves, fields=list(VEC3), mask=null)
