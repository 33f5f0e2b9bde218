"""What stays of a shard when some of its models are replaced."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from breplake.ingest.shard import fresh_name, write_table
from breplake.schema.array_reader import ArrayShardReader
from breplake.schema.arrays import ARRAYS, ArrayShardWriter
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry, Snapshot
from breplake.schema.tables import MODELS, TABLES

__all__ = ["remainder"]

_COUNTS = {"vertex": "n_vertices", "normal": "n_normals", "face": "n_faces"}
"""Column of ``models`` that counts a model's rows along an axis of the arrays."""


def remainder(store: LakeStore, ids: Collection[int]) -> tuple[list[FileEntry], list[str]]:
    """Write again, without some models and failures, the shards of the head that hold them.

    Parameters
    ----------
    store : LakeStore
        The lake, its writer's lock held.
    ids : collection of int
        Models to leave out.

    Returns
    -------
    files : list of FileEntry
        The new files, registered.
    replaced : list of str
        Paths of the files that they supersede.
    """
    head = store.head()
    files: list[FileEntry] = []
    replaced: list[str] = []
    if head is None or not ids:
        return files, replaced
    for shard in _shards(store, head, set(ids)):
        files += _Rewrite(store, head, shard, sorted(ids)).write()
        replaced += [entry.path for entry in head.files if entry.shard == shard]
    return files, replaced


def _shards(store: LakeStore, head: Snapshot, ids: set[int]) -> list[str]:
    """Return the shards in which a model or failure of `ids` is."""
    found = set()
    for name in ("models", "failures"):
        for entry in head.table_files(name):
            column = pq.read_table(store.root / entry.path, columns=["model_id"])["model_id"]
            if not ids.isdisjoint(column.to_pylist()):
                found.add(entry.shard)
    return sorted(found)


class _Rewrite:
    """One shard, written again without some of its models."""

    def __init__(self, store: LakeStore, head: Snapshot, shard: str, ids: list[int]) -> None:
        self.store, self.shard = store, shard
        self.entries = {entry.table: entry for entry in head.files if entry.shard == shard}
        self.gone = pa.array(ids, pa.int64())
        digest = hashlib.sha256(f"{shard} without {ids}".encode()).hexdigest()[:16]
        self.name = fresh_name(store, digest)

    def write(self) -> list[FileEntry]:
        """Write all files of the new shard; none if nothing stays."""
        for name, table in TABLES.items():
            if name in self.entries:
                parts = self._kept(name)
                write_table(self.store, self.name, table, self._placed(parts, name))
        return self.store.register_shard(self.name)

    def _kept(self, name: str) -> Iterator[pa.Table]:
        """Yield the rows that stay, one row group at a time."""
        with pq.ParquetFile(self.store.root / self.entries[name].path) as file:
            for number in range(file.num_row_groups):
                group = file.read_row_group(number)
                gone = pc.is_in(group["model_id"], value_set=self.gone)
                kept = group.filter(pc.invert(gone))
                if kept.num_rows:
                    yield kept

    def _placed(self, parts: Iterator[pa.Table], name: str) -> Iterator[pa.Table]:
        """Give the rows of ``models`` their new shard and places in its arrays."""
        if name != MODELS.name:
            yield from parts
            return
        rows = [row | {"shard": self.name} for part in parts for row in part.to_pylist()]
        if any(row["vertex_offset"] is not None for row in rows):
            self._copy_arrays(rows)
        if rows:
            yield MODELS.from_rows(rows)

    def _copy_arrays(self, rows: list[dict[str, Any]]) -> None:
        reader = ArrayShardReader(self.store.root / self.entries[ARRAYS_TABLE].path)
        with ArrayShardWriter(self.store.array_path(self.name)) as writer:
            for row in rows:
                if row["vertex_offset"] is None:
                    continue
                blocks = {}
                for name, spec in ARRAYS.items():
                    start = row[f"{spec.axis}_offset"]
                    blocks[name] = reader.read(name, start, start + row[_COUNTS[spec.axis]])
                offsets = writer.append(blocks)
                row |= {f"{axis}_offset": getattr(offsets, axis) for axis in _COUNTS}
