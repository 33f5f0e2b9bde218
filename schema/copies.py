"""Files of a lake brought from one place to another, each proved by its hash."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from breplake.errors import LakeFormatError
from breplake.schema.files import list_name
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry
from breplake.schema.storage import PART, Storage, file_hash

__all__ = ["Copied", "claim", "copy_files"]

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


def copy_files(
    source: Storage,
    target: Storage,
    files: Sequence[FileEntry],
    progress: Callable[[int], None] | None = None,
    *,
    trusting: bool = True,
) -> Copied:
    """Copy files of a snapshot; those that are there with the right hash are left.

    Parameters
    ----------
    source, target : Storage
        At least one of them local.
    files : sequence of FileEntry
        What to copy.
    progress : callable, optional
        Called with numbers of bytes that have been dealt with, from several threads.
    trusting : bool
        Whether a file in object storage is the right one if its size is right.

    Raises
    ------
    LakeFormatError
        If a file of the source is missing or damaged.
    """
    done, guard = Copied(), threading.Lock()
    tell = progress or (lambda _: None)

    def work(member: _Member) -> None:
        size, copied = _copy(source, target, member, trusting)
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


def _copy(source: Storage, target: Storage, member: _Member, trusting: bool) -> tuple[int, bool]:
    """Copy a file unless it is there; return its size and whether it was copied."""
    if target.is_local:
        return _download(source, target.path(member.path), member)
    local = source.path(member.path)
    if not local.is_file() or file_hash(local) != member.sha256:
        raise LakeFormatError(_damaged(source, member.path, "missing, or with another hash"))
    size = local.stat().st_size
    if trusting and target.size(member.path) == size:  # uploads appear whole or not at all
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


def claim(source: Storage, target: Storage, files: Sequence[FileEntry]) -> bool:
    """Put the files of a shard that decide whose its name is; the others may then be copied.

    Parameters
    ----------
    source : Storage
        A local place that holds the files.
    target : Storage
        Where other writers may be about to put other files of the same name.
    files : sequence of FileEntry
        Of one shard; every shard has models or failures.

    Returns
    -------
    bool
        False if the name is another's: nothing of it was touched.
    """
    for entry in files:
        if entry.table not in ("models", "failures"):
            continue
        data = source.path(entry.path).read_bytes()
        if target.create(entry.path, data):
            continue
        if target.size(entry.path) != entry.bytes or target.hash(entry.path) != entry.sha256:
            return False
        # ours, of a run that was killed: made young, that no collection of garbage takes it
        target.overwrite(entry.path, data)
    return True
