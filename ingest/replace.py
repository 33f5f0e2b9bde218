"""What stays of a shard when some of its models are replaced."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from breplake.schema.copies import copy_files
from breplake.schema.lake import LakeStore
from breplake.schema.rewrite import Chosen, rewrite_shard
from breplake.schema.shard_writer import fresh_name
from breplake.schema.snapshot import FileEntry
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

    shards: dict[str, list[FileEntry]] = {shard: [] for shard in store.shards_of(head, ids)}
    for entry in head.files:
        if entry.shard in shards:
            shards[entry.shard].append(entry)
    for shard, entries in shards.items():
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
