"""Copy a snapshot of a lake to another place, where it is the same snapshot of the same lake.

Files that are there with the right hash are not copied again, so a copy that was interrupted, or
one of a later snapshot, goes on where the last one ended.  The snapshot's document comes last:
whoever reads the place sees all of it or nothing.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from breplake.errors import LakeNotFoundError, UsageError
from breplake.schema.copies import Copied, copy_files
from breplake.schema.lake import MARKER, LakeStore
from breplake.schema.snapshot import Snapshot
from breplake.schema.storage import Storage, local_folder
from breplake.schema.subset import Subset, subset_names, subset_path
from breplake.schema.versions import snapshot_path

__all__ = ["Mirrored", "mirror"]


@dataclass(slots=True)
class Mirrored(Copied):
    """What a copy of a snapshot did.

    Parameters
    ----------
    left_out : dict
        Tags and subsets that the copy lacks, each with its snapshot: ``{"subset big": 1}``.
    is_listed : bool
        Whether the source tells which tags and subsets it has; if not, `left_out` is empty.
    """

    left_out: dict[str, int] = field(default_factory=dict)
    is_listed: bool = True


def mirror(
    source: LakeStore,
    place: str | Path,
    snapshot: Snapshot,
    *,
    tag: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> Mirrored:
    """Copy a snapshot with all its files, and the tags and subsets that name it.

    One of both places must be a local folder. Where the source's names cannot be listed, no
    subset is copied, and no tag but `tag`.

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
    labels = _labels(source, tag)
    with target.lock() if target.storage.is_local else nullcontext():
        done = copy_files(source.storage, target.storage, snapshot.files, progress)
        target.log.restore(snapshot.number, document)
        target.log.hint(max(target.numbers()))
    left: dict[str, int] = {}
    for path, label in labels.items():
        if label.snapshot != snapshot.number:
            if not target.storage.has(path):
                left[label.name] = label.snapshot
            continue
        if not target.storage.create(path, label.data) and not _same_label(
            target, path, label.data
        ):
            raise UsageError(f"{target.storage.name} has another {path}: remove it there first")
    return Mirrored(done.files, done.bytes, done.skipped, left, source.storage.can_list)


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


class _Label(NamedTuple):
    """A document that names a snapshot."""

    name: str
    snapshot: int
    data: bytes


def _labels(source: LakeStore, tag: str | None) -> dict[str, _Label]:
    """Return the tags and subsets of the source by path, as far as it tells them."""
    storage = source.storage
    if storage.can_list:
        tags = source.tags()
        subsets = {subset_path(name): name for name in subset_names(storage)}
    else:
        tags, subsets = {tag: source.snapshot(tag).number} if tag else {}, {}
    found = {
        path: _Label(f"tag {name}", number, storage.read(path))
        for name, number in tags.items()
        for path in [f"tags/{name}.json"]
    }
    for path, name in subsets.items():
        data = storage.read(path)
        found[path] = _Label(f"subset {name}", Subset.from_bytes(data, path).snapshot, data)
    return found


def _same_label(target: LakeStore, path: str, data: bytes) -> bool:
    there = target.storage.read(path)
    if path.startswith("tags/"):
        return bool(json.loads(there) == json.loads(data))
    old, new = Subset.from_bytes(there, path), Subset.from_bytes(data, path)
    return (old.hash, old.snapshot) == (new.hash, new.snapshot)
