"""What stays of a shard when some of its models are replaced."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from breplake.schema.copies import copy_files
from breplake.schema.lake import LakeStore
from breplake.schema.rewrite import Chosen, rewrite_shard
from breplake.schema.shard_writer import fresh_name
from breplake.schema.snapshot import FileEntry, Snapshot
from breplake.schema.storage import Storage

__all__ = ["remainder"]


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
    gone = pa.array(sorted(ids), pa.int64())

    def stays(models: pa.ChunkedArray) -> pa.ChunkedArray:
        return pc.invert(pc.is_in(models, value_set=gone))

    for shard in _shards(store, head, set(ids)):
        entries = [entry for entry in head.files if entry.shard == shard]
        digest = hashlib.sha256(f"{shard} without {sorted(ids)}".encode()).hexdigest()[:16]
        with _here(store, entries) as root:
            files += _rewritten(store, root, entries, digest, stays)
        replaced += [entry.path for entry in entries]
    return files, replaced


def _rewritten(
    store: LakeStore, root: Path, entries: list[FileEntry], name: str, stays: Chosen
) -> list[FileEntry]:
    taken: set[str] = set()
    while True:
        fresh = fresh_name(store, name, taken)
        files = rewrite_shard(root, entries, store, fresh, stays)
        if store.send(files):
            return files
        taken.add(fresh)


@contextmanager
def _here(store: LakeStore, entries: list[FileEntry]) -> Iterator[Path]:
    """Yield a folder that holds files of the lake, a copy where the lake is elsewhere."""
    if store.storage.is_local:
        yield store.root
        return
    with tempfile.TemporaryDirectory(dir=store.desk.root) as folder:
        copy_files(store.storage, Storage(folder), entries)
        yield Path(folder)


def _shards(store: LakeStore, head: Snapshot, ids: set[int]) -> list[str]:
    """Return the shards in which a model or failure of `ids` is."""
    found = set()
    for name in ("models", "failures"):
        for entry in head.table_files(name):
            file = store.storage.reader(entry.path)
            column = pq.read_table(file, columns=["model_id"])["model_id"]
            if not ids.isdisjoint(column.to_pylist()):
                found.add(entry.shard)
    return sorted(found)
