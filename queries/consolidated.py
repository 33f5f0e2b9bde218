"""One file of a table for SQL to read, instead of one for each shard.

A lake has a file of every table for each shard of some hundred models. That suits writers, and
readers of single models; SQL over a million models opens thousands of files, and most of its time
goes into that. A consolidated copy holds the same rows in one file with full row groups. Its name
is a hash of the files it is made from, so it is used at exactly the snapshots that have these.
It is no part of any snapshot and may be deleted whenever no session reads it.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from breplake.errors import NameNotFoundError, StorageError, UsageError
from breplake.schema.contract import Table
from breplake.schema.snapshot import FileEntry
from breplake.schema.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

    from breplake.queries.session import Lake

__all__ = ["FOLDER", "consolidate", "consolidated_path"]

FOLDER: Final = "consolidated"
"""Folder in the lake that holds the copies."""


def consolidated_path(root: Path, table: str, files: Sequence[FileEntry]) -> Path:
    """Return where the copy of a table is, or would be.

    Parameters
    ----------
    root : pathlib.Path
        The lake's folder.
    table : str
        Its name.
    files : sequence of FileEntry
        Its files at a snapshot.
    """
    digest = hashlib.sha256()
    for entry in sorted(files):
        digest.update(f"{entry.path} {entry.sha256}\n".encode())
    return root / FOLDER / f"{table}-{digest.hexdigest()[:32]}.parquet"


def consolidate(
    lake: Lake, tables: Sequence[str] = ("models",), tell: Callable[[str], object] = lambda _: None
) -> list[Path]:
    """Write copies of tables for SQL; `lake.sql`, `lake.query` and `lake.scan` then read these.

    Sessions that are open already go on reading what they read, shards or copies: of the copies
    of the same tables, only those are deleted that fit no snapshot any more.

    Parameters
    ----------
    lake : Lake
        The lake at the snapshot whose rows are copied.
    tables : sequence of str
        Names of tables; ``models`` is small and asked most.
    tell : callable
        Is called with the name of each table before it is copied.

    Returns
    -------
    list of pathlib.Path
        The copies.

    Raises
    ------
    NameNotFoundError
        If there is no such table.
    UsageError
        If a table has no file.
    StorageError
        If the lake's folder cannot be written.
    """
    made = []
    for name in tables:
        entries = lake.snapshot.table_files(name) if lake.files(name) else []
        if not entries:
            raise UsageError(f"table {name} has no rows at snapshot {lake.snapshot.number}")
        path = consolidated_path(lake.root, name, entries)
        if not path.exists():
            tell(name)
            try:
                _write(path, TABLES[name], lake.files(name))
            except OSError as error:
                raise StorageError(f"cannot write {path}: {error.strerror or error}") from error
        made.append(path)
    _remove_outlived(lake, tables, made)
    return made


def _remove_outlived(lake: Lake, tables: Sequence[str], made: Sequence[Path]) -> None:
    """Delete the copies of tables that fit no snapshot: sessions may read all others."""
    # copies are listed first, so that the snapshot of each is committed when snapshots are read
    found = {copy for table in tables for copy in (lake.root / FOLDER).glob(f"{table}-*.parquet")}
    outlived = found - set(made)
    for number in lake.store.numbers() if outlived else ():
        try:
            snapshot = lake.store.snapshot(number)
        except NameNotFoundError:  # collected meanwhile
            continue
        for table in tables:
            outlived.discard(consolidated_path(lake.root, table, snapshot.table_files(table)))
    for copy in outlived:
        copy.unlink(missing_ok=True)


def _write(path: Path, table: Table, files: Sequence[str]) -> None:
    """Write the rows of files as one, which is there only when it is complete."""
    import pyarrow.parquet as pq

    path.parent.mkdir(exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with pq.ParquetWriter(part, table.schema, compression="zstd") as writer:
            for rows in _row_groups(table, files):
                writer.write_table(rows, row_group_size=table.row_group)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _row_groups(table: Table, files: Sequence[str]) -> Iterator[pa.Table]:
    """Yield the rows of files in their order, gathered into full row groups."""
    import pyarrow as pa
    import pyarrow.dataset

    dataset = pyarrow.dataset.dataset(list(files), schema=table.schema, format="parquet")
    waiting: list[pa.RecordBatch] = []
    for batch in dataset.to_batches(batch_readahead=4, fragment_readahead=4):
        waiting.append(batch)
        if sum(part.num_rows for part in waiting) >= table.row_group:
            rows = pa.Table.from_batches(waiting, table.schema)
            full = rows.num_rows - rows.num_rows % table.row_group
            yield rows.slice(0, full)
            waiting = rows.slice(full).to_batches()
    if waiting:
        yield pa.Table.from_batches(waiting, table.schema)
