"""Files that an older breplake wrote: a column that they lack is null.

Columns and tables are added without a new version of the schema, since older readers do not miss
them. A snapshot says of every shard by which contract it was written, a `contract_hash`: files of
one table and one contract have the same columns, so readers look into one of them, and into none
of today's contract. Only the first snapshots did not say it; their files are all looked into.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from breplake.schema.contract import Table
from breplake.schema.tables import TABLES

__all__ = ["CONTRACT", "TableFile", "by_schema", "conform", "contract_hash", "is_older"]

_THREADS: Final = 16
"""Footers that are read at the same time: over a network each one is a wait."""


def contract_hash(tables: Mapping[str, Table]) -> str:
    """Return 16 hexadecimal digits that change with the columns of any table, or their types."""
    lines = (
        f"{table.name} {field.name} {field.type} {field.nullable}\n"
        for table in tables.values()
        for field in table.schema
    )
    return hashlib.sha256("".join(lines).encode()).hexdigest()[:16]


CONTRACT: Final = contract_hash(TABLES)
"""Hash of the tables that this breplake writes."""


def conform(rows: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return rows with exactly the columns of `schema`, nulls where they lack one.

    Members that a structure lacks are null too; columns that `schema` has not are left out.

    Raises
    ------
    pyarrow.ArrowInvalid
        If a value does not fit its column.
    """
    if rows.schema.equals(schema):
        return rows
    columns = [
        rows.column(field.name).cast(field.type)
        if field.name in rows.schema.names
        else pa.nulls(rows.num_rows, field.type)
        for field in schema
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def is_older(have: pa.Field, want: pa.Field) -> bool:
    """Return whether `conform` makes `want` of `have`: it lacks nothing but what can be null."""
    if pa.types.is_struct(have.type) and pa.types.is_struct(want.type):
        there = {field.name: field for field in have.type}
        return there.keys() <= {field.name for field in want.type} and all(
            is_older(there[field.name], field) if field.name in there else field.nullable
            for field in want.type
        )
    if pa.types.is_list(have.type) and pa.types.is_list(want.type):
        return is_older(have.type.value_field, want.type.value_field)
    return bool(have.type.equals(want.type))


class TableFile(NamedTuple):
    """A Parquet file of a table.

    Parameters
    ----------
    path : str
        Where it is.
    contract : str
        By which contract it was written; empty where that is not known.
    """

    path: str
    contract: str


def by_schema(
    table: Table, files: Iterable[TableFile], opened: Callable[[str], Any] = str
) -> list[tuple[pa.Schema, list[str]]]:
    """Group files of a table by their columns, from as few footers as possible.

    Parameters
    ----------
    table : Table
        Of today's contract.
    files : iterable of TableFile
        The files.
    opened : callable, optional
        Returns what pyarrow reads a file from, given its path.

    Returns
    -------
    list of tuple
        Schema, and the paths of the files that have it, in their order.

    Raises
    ------
    OSError, pyarrow.ArrowInvalid
        If a file cannot be read.
    """
    alike: dict[str, list[str]] = {}
    for path, contract in files:
        alike.setdefault(contract or f"of {path} alone", []).append(path)

    def schema(contract: str) -> pa.Schema:
        if contract == CONTRACT:
            return table.schema.remove_metadata()
        return pq.read_schema(opened(alike[contract][0])).remove_metadata()

    groups: dict[Sequence[tuple[str, str]], tuple[pa.Schema, list[str]]] = {}
    with ThreadPoolExecutor(_THREADS) as pool:
        for found, paths in zip(pool.map(schema, alike), alike.values(), strict=True):
            key = tuple((field.name, str(field.type)) for field in found)
            groups.setdefault(key, (found, []))[1].extend(paths)
    return list(groups.values())
