"""Copy a snapshot of a lake to another place, where it is the same snapshot of the same lake.

Files that are there with the right hash are not copied again, so a copy that was interrupted, or
one of a later snapshot, goes on where the last one ended.  The snapshot's document comes last:
whoever reads the place sees all of it or nothing.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from breplake.errors import LakeFormatError, LakeNotFoundError, UsageError
from breplake.schema.files import list_name
from breplake.schema.lake import MARKER, LakeStore
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry, Snapshot
from breplake.schema.storage import PART, Storage, file_hash, local_folder
from breplake.schema.subset import Subset, subset_names, subset_path
from breplake.schema.versions import snapshot_path

__all__ = ["Copied", "copy_files", "mirror"]

_THREADS: Final = 8
"""Files in flight: most of the time is spent waiting for a disk or a network."""

_TRIES: Final = 3


@dataclass(slots=True)
class Copied:
    """What a copy did.

    Parameters
    ----------
    files, bytes : int
        Files that were copied, and their size.
    skipped : int
        Files that were there already.
    """

    files: int = 0
    bytes: int = 0
    skipped: int = 0


class _Member(NamedTuple):
    """A file to copy: a table's, or one in a folder of arrays."""

    path: str
    sha256: str


def mirror(
    source: LakeStore,
    place: str | Path,
    snapshot: Snapshot,
    *,
    tag: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> Copied:
    """Copy a snapshot with all its files, its tags and its subsets.

    One of both places must be a local folder.

    Parameters
    ----------
    source : LakeStore
        The lake.
    place : path or str
        Folder or URL, new or a copy of the same lake.
    snapshot : Snapshot
        What to copy.
    tag : str, optional
        A tag to copy, where the source's cannot be listed.
    progress : callable, optional
        Called with numbers of bytes that have been dealt with, from several threads.

    Raises
    ------
    UsageError
        If the place holds another lake, or another snapshot under the same number or tag.
    LakeFormatError
        If a file of the source is not what the snapshot says.
    """
    target = _target(source, place)
    document = source.storage.read(snapshot_path(snapshot.number))
    _check_history(source, target, snapshot.number, document)
    labels = _labels(source, snapshot.number, tag)
    with target.lock() if target.storage.is_local else nullcontext():
        done = copy_files(source.storage, target.storage, snapshot.files, progress)
        target.log.restore(snapshot.number, document)
        target.log.hint(max(target.numbers()))
    for path, data in labels.items():
        if not target.storage.create(path, data) and not _same_label(target, path, data):
            raise UsageError(f"{target.storage.name} has another {path}: remove it there first")
    return done


def _target(source: LakeStore, place: str | Path) -> LakeStore:
    """Open the copy of a lake in a place, or begin it."""
    marker = source.storage.read(MARKER)
    try:
        target = LakeStore.open(place)
    except LakeNotFoundError:
        if (folder := local_folder(place)) is not None:
            target = LakeStore.create(folder, source.lake_id)
        else:
            Storage(place).create(MARKER, marker)
            target = LakeStore.open(place)
    if target.lake_id != source.lake_id:
        raise UsageError(
            f"{target.storage.name} holds another lake (id {target.lake_id[:8]}, not "
            f"{source.lake_id[:8]}): name a new place"
        )
    if not (source.storage.is_local or target.storage.is_local):
        raise UsageError(
            f"neither {source.storage.name} nor {target.storage.name} is a local folder: "
            "copy by way of one"
        )
    return target


def _check_history(source: LakeStore, target: LakeStore, number: int, document: bytes) -> None:
    """Check that both lakes agree on the snapshot and on the newest of the target."""
    wanted = {number: document}
    newest = max(target.numbers(), default=number)
    if newest != number and source.storage.has(snapshot_path(newest)):
        wanted[newest] = source.storage.read(snapshot_path(newest))
    for at, data in wanted.items():
        if target.storage.has(snapshot_path(at)) and (
            target.storage.read(snapshot_path(at)) != data
        ):
            raise UsageError(
                f"snapshot {at} of {target.storage.name} is not that of {source.storage.name}: "
                "commits were made to both; copy to a new place"
            )


def _labels(source: LakeStore, number: int, tag: str | None) -> dict[str, bytes]:
    """Return the documents that name a snapshot: tags and subsets."""
    storage = source.storage
    if storage.can_list:
        tags = [name for name, tagged in source.tags().items() if tagged == number]
        subsets = [subset_path(name) for name in subset_names(storage)]
    else:
        tags, subsets = [tag] if tag else [], []
    found = {path: storage.read(path) for path in (f"tags/{name}.json" for name in tags)}
    for path in subsets:
        data = storage.read(path)
        if Subset.from_bytes(data, path).snapshot == number:
            found[path] = data
    return found


def _same_label(target: LakeStore, path: str, data: bytes) -> bool:
    there = target.storage.read(path)
    if path.startswith("tags/"):
        return bool(json.loads(there) == json.loads(data))
    old, new = Subset.from_bytes(there, path), Subset.from_bytes(data, path)
    return (old.hash, old.snapshot) == (new.hash, new.snapshot)


def copy_files(
    source: Storage,
    target: Storage,
    files: Sequence[FileEntry],
    progress: Callable[[int], None] | None = None,
) -> Copied:
    """Copy files of a snapshot; those that are there with the right hash are left.

    Parameters
    ----------
    source, target : Storage
        At least one of them local.
    files : sequence of FileEntry
        What to copy.
    progress : callable, optional
        As for `mirror`.

    Raises
    ------
    LakeFormatError
        If a file of the source is missing or damaged.
    """
    done, guard = Copied(), threading.Lock()
    tell = progress or (lambda _: None)

    def work(member: _Member) -> None:
        size, copied = _copy(source, target, member)
        with guard:
            done.files += copied
            done.skipped += not copied
            done.bytes += size if copied else 0
        tell(size)

    with ThreadPoolExecutor(_THREADS) as pool:
        running = [
            pool.submit(work, member) for entry in files for member in _members(source, entry)
        ]
        try:
            for future in running:
                future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return done


def _members(source: Storage, entry: FileEntry) -> Iterator[_Member]:
    """Yield the files of an entry, the list of a folder last."""
    if entry.table != ARRAYS_TABLE:
        yield _Member(entry.path, entry.sha256)
        return
    path = list_name(entry.path)
    try:
        lines = source.read(path)
    except FileNotFoundError:
        raise LakeFormatError(_damaged(source, path, "it is not there")) from None
    if hashlib.sha256(lines).hexdigest() != entry.sha256:
        raise LakeFormatError(_damaged(source, path, "it has another hash than the snapshot says"))
    for line in lines.decode().splitlines():
        digest, name = line.split("  ", 1)
        yield _Member(f"{entry.path}/{name}", digest)
    yield _Member(path, entry.sha256)


def _copy(source: Storage, target: Storage, member: _Member) -> tuple[int, bool]:
    """Copy a file unless it is there; return its size and whether it was copied."""
    if target.is_local:
        return _download(source, target.path(member.path), member)
    local = source.path(member.path)
    if not local.is_file() or file_hash(local) != member.sha256:
        raise LakeFormatError(_damaged(source, member.path, "missing, or with another hash"))
    size = local.stat().st_size
    if target.size(member.path) == size:  # uploads appear whole or not at all
        return size, False
    target.upload(local, member.path)
    return size, True


def _download(source: Storage, path: Path, member: _Member) -> tuple[int, bool]:
    if path.is_file() and file_hash(path) == member.sha256:
        return path.stat().st_size, False
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + PART)
    for _ in range(_TRIES):
        digest = hashlib.sha256()
        try:
            with part.open("wb") as file:
                for block in source.stream(member.path):
                    digest.update(block)
                    file.write(block)
        except FileNotFoundError:
            part.unlink(missing_ok=True)
            raise LakeFormatError(_damaged(source, member.path, "it is not there")) from None
        if digest.hexdigest() == member.sha256:
            part.replace(path)
            return path.stat().st_size, True
    part.unlink()
    raise LakeFormatError(_damaged(source, member.path, "its hash is not that of the snapshot"))


def _damaged(source: Storage, path: str, why: str) -> str:
    return f"{source.name}/{path}: {why}; run breplake verify there"
