"""How the tables of a shard are written: a name that is free, and Parquet files."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from breplake.schema.contract import Table
from breplake.schema.lake import LakeStore
from breplake.schema.tables import TABLES

__all__ = ["fresh_name", "write_table"]


def fresh_name(store: LakeStore, name: str, taken: Collection[str] = ()) -> str:
    """Return `name`, or `name` with a number if a snapshot has files of that name already.

    Files that no snapshot names are what an interrupted run left; at the desk they make room.

    Parameters
    ----------
    store : LakeStore
        The lake.
    name : str
        What the shard is to be called.
    taken : collection of str
        Names that `LakeStore.send` refused.
    """
    for number in itertools.count(1):
        candidate = name if number == 1 else f"{name}-{number}"
        if candidate in taken:
            continue
        paths = [f"tables/{table}/{candidate}.parquet" for table in TABLES]
        paths.append(f"arrays/{candidate}.zarr")
        there = {path for path in paths if store.desk.path(path).exists()}
        if store.desk is not store.storage:
            # what is in the lake is not ours to remove: a writer elsewhere may be at it
            claims = {f"tables/{table}/{candidate}.parquet" for table in ("models", "failures")}
            there |= {path for path in claims if store.storage.has(path)}
        if not there:
            return candidate
        named = {f.path for n in store.numbers() for f in store.snapshot(n).files}
        if not there & named:
            for path in there:
                store.desk.remove(path)
            return candidate
    raise AssertionError("unreachable: count() does not end")


def write_table(store: LakeStore, shard: str, table: Table, parts: Iterable[pa.Table]) -> None:
    """Write tables as one Parquet file, gathering them into full row groups.

    Parameters
    ----------
    store : LakeStore
        The lake.
    shard : str
        Name of the shard.
    table : Table
        Its contract.
    parts : iterable of pyarrow.Table
        In order; without a part no file is written.
    """
    writer: pq.ParquetWriter | None = None
    waiting: list[pa.Table] = []
    n_waiting = 0
    path = store.table_path(table.name, shard)

    def flush() -> None:
        nonlocal writer, n_waiting
        if writer is None:
            writer = pq.ParquetWriter(path, table.schema, **_options(table))
        writer.write_table(pa.concat_tables(waiting), row_group_size=table.row_group)
        waiting.clear()
        n_waiting = 0

    for part in parts:
        waiting.append(part)
        n_waiting += part.num_rows
        if n_waiting >= table.row_group:
            flush()
    if waiting and (n_waiting or writer is None):
        flush()
    if writer is not None:
        writer.close()


def _options(table: Table) -> dict[str, Any]:
    """Return how the columns of a table are encoded.

    Ids are nearly sorted, so their differences are small; floating-point columns have
    no repeated values for a dictionary to find.
    """
    integers = [c.name for c in table.columns if pa.types.is_integer(c.type)]
    strings = [c.name for c in table.columns if pa.types.is_string(c.type)]
    return {
        "compression": "zstd",
        "compression_level": 3,
        "use_dictionary": strings or False,
        "column_encoding": dict.fromkeys(integers, "DELTA_BINARY_PACKED"),
        "write_page_index": True,
    }
