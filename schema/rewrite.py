"""A shard written again with some of its models."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from breplake.schema.array_reader import ArrayShardReader
from breplake.schema.arrays import ARRAYS, ArrayShardWriter
from breplake.schema.lake import LakeStore
from breplake.schema.older import conform
from breplake.schema.shard_writer import write_table
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry
from breplake.schema.tables import MODELS, TABLES

__all__ = ["Chosen", "rewrite_shard"]

_COUNTS: Final = {
    "vertex": "n_vertices",
    "normal": "n_normals",
    "face": "n_faces",
    "patch": "n_patches",
    "curve": "n_curves",
}
"""Column of ``models`` that counts a model's rows along an axis of the arrays."""

Chosen = Callable[[pa.ChunkedArray], pa.ChunkedArray]
"""From ids of models to whether they are wanted."""


def rewrite_shard(
    root: Path, files: Sequence[FileEntry], target: LakeStore, name: str, chosen: Chosen
) -> list[FileEntry]:
    """Write the chosen models of a shard as a new shard.

    Equal rows and an equal name give equal bytes.

    Parameters
    ----------
    root : pathlib.Path
        Folder of the lake that holds the shard.
    files : sequence of FileEntry
        The shard's files.
    target : LakeStore
        The lake at whose desk it is written, its writer's lock held.
    name : str
        Name of the new shard.
    chosen : callable
        From ids of models to whether their rows are written.

    Returns
    -------
    list of FileEntry
        The new files, registered; none if no row was chosen.
    """
    paths = {entry.table: root / entry.path for entry in files}
    for table in TABLES.values():
        if table.name not in paths:
            continue
        parts = _chosen_rows(paths[table.name], table.schema, chosen)
        if table.name == MODELS.name:
            parts = _placed(parts, name, paths.get(ARRAYS_TABLE), target)
        write_table(target, name, table, parts)
    return target.register_shard(name)


def _chosen_rows(path: Path, schema: pa.Schema, chosen: Chosen) -> Iterator[pa.Table]:
    """Yield the chosen rows, one row group at a time."""
    with pq.ParquetFile(path) as file:
        for number in range(file.num_row_groups):
            group = file.read_row_group(number)
            rows = group.filter(chosen(group["model_id"]))
            if rows.num_rows:
                yield conform(rows, schema)


def _placed(
    parts: Iterator[pa.Table], name: str, arrays: Path | None, target: LakeStore
) -> Iterator[pa.Table]:
    """Give the rows of ``models`` their new shard and places in its arrays."""
    rows = [row | {"shard": name} for part in parts for row in part.to_pylist()]
    if arrays is not None and any(_stored(row) for row in rows):
        _copy_arrays(rows, arrays, target.array_path(name))
    if rows:
        yield MODELS.from_rows(rows)


def _stored(row: dict[str, Any]) -> list[str]:
    """Return the arrays that a model has."""
    return [n for n, spec in ARRAYS.items() if row[f"{spec.axis}_offset"] is not None]


def _copy_arrays(rows: list[dict[str, Any]], source: Path, path: Path) -> None:
    reader = ArrayShardReader(source)
    with ArrayShardWriter(path, reader.grid) as writer:
        for row in rows:
            blocks = {}
            for name in _stored(row):
                axis = ARRAYS[name].axis
                start = row[f"{axis}_offset"]
                blocks[name] = reader.read(name, start, start + row[_COUNTS[axis]])
            if blocks:
                row |= writer.append(blocks).columns()
