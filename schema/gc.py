"""Garbage: what no kept snapshot names, found and removed without harm to anyone at work.

Kept are the newest snapshot, those that a tag or a subset names, and what the retention asks
for.  Then two kinds of files are garbage:

- files of removed snapshots that no kept one shares;
- orphans, which no snapshot ever named: leftovers of killed writers.  A writer at work has such
  files too.  Ours hold the writer's lock, which the collection waits for; for writers
  elsewhere, files that changed within the grace period are left alone.

Readers are never locked out.  A snapshot that was the newest within the grace period is kept,
since readers that did not ask for a version may be reading it; who reads longer names it by a
tag.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Final, Literal, NamedTuple

from breplake.errors import UsageError
from breplake.schema.files import list_name
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import Header
from breplake.schema.storage import is_staged

__all__ = ["GRACE", "Collection", "Garbage", "Retention", "collect"]

GRACE: Final = timedelta(hours=1)
"""Default grace period: longer than the writing of a shard, and than a query."""


@dataclass(frozen=True, slots=True)
class Retention:
    """Which snapshots to keep, besides the newest and those with a name; by default all.

    A snapshot is removed when every rule that is given allows it.

    Parameters
    ----------
    keep : int, optional
        The newest so many are kept.
    tagged_only : bool
        No others are kept.
    older_than : timedelta, optional
        Those are kept that were the newest within this time.
    """

    keep: int | None = None
    tagged_only: bool = False
    older_than: timedelta | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if self.keep is not None and self.keep < 1:
            raise UsageError(f"at least 1 snapshot is kept, got {self.keep}")
        if self.older_than is not None and self.older_than < timedelta(0):
            raise UsageError(f"an age must not be negative, got {self.older_than}")

    def removable(self, headers: Sequence[Header], now: float) -> set[int]:
        """Return the snapshots that the rules allow to remove; `headers` ascend."""
        if self.keep is None and not self.tagged_only and self.older_than is None:
            return set()
        old = headers[: -self.keep] if self.keep is not None else headers
        if self.older_than is None:
            return {header.number for header in old}
        return {header.number for header in old} & _superseded(headers, now, self.older_than)


class Garbage(NamedTuple):
    """A file, or a folder of arrays, that can go.

    Parameters
    ----------
    path : str
        Relative POSIX path.
    bytes : int
        Size.
    reason : str
        ``removed snapshot``, or ``orphan``.
    """

    path: str
    bytes: int
    reason: Literal["removed snapshot", "orphan"]


@dataclass(slots=True)
class Collection:
    """What a collection removed, or would remove.

    Parameters
    ----------
    snapshots : list of int
        Numbers of removed snapshots.
    garbage : list of Garbage
        Removed files, by path.
    young : list of str
        Paths of orphans that were left because they changed within the grace period.
    foreign : list of str
        Paths in the lake's folders that are no files of a lake; they are left.
    in_grace : list of int
        Snapshots that the rules would remove, kept because they were the newest of late.
    """

    snapshots: list[int] = field(default_factory=list)
    garbage: list[Garbage] = field(default_factory=list)
    young: list[str] = field(default_factory=list)
    foreign: list[str] = field(default_factory=list)
    in_grace: list[int] = field(default_factory=list)

    @property
    def bytes(self) -> int:
        """Size of the removed files."""
        return sum(item.bytes for item in self.garbage)


def collect(
    store: LakeStore,
    retention: Retention | None = None,
    *,
    grace: timedelta = GRACE,
    dry_run: bool = False,
    waiting: Callable[[], None] | None = None,
) -> Collection:
    """Remove what no kept snapshot names, and nothing else.

    Killed at any moment, it leaves a whole lake, and the next collection removes the rest.

    Parameters
    ----------
    store : LakeStore
        The lake.
    retention : Retention, optional
        Which snapshots to keep; all if not given.
    grace : timedelta
        See the module. Zero is right when nobody else uses the lake.
    dry_run : bool
        Only say what would be removed.
    waiting : callable, optional
        Called once if a writer must be waited for.

    Raises
    ------
    LakeFormatError
        If a snapshot cannot be read: then nothing is removed.
    """
    local = store.storage.is_local and not dry_run
    with store.lock(waiting) if local else nullcontext():
        return _collect(store, retention or Retention(), grace, dry_run)


def _collect(store: LakeStore, retention: Retention, grace: timedelta, dry_run: bool) -> Collection:
    now = time.time()
    headers = list(store.headers())
    numbers = {header.number for header in headers}
    safe = store.log.pinned() | set(sorted(numbers)[-1:])
    wanted = retention.removable(headers, now) - safe
    removed = wanted & _superseded(headers, now, grace)
    once_named, kept = _named(store, removed), _named(store, numbers - removed)
    if not dry_run:
        seen = numbers - removed
        removed -= _remove_snapshots(store, removed)
        # others may have come in meanwhile, from writers without the lock
        kept |= _named(store, set(store.numbers()) - seen)
    units, found = _units(store)
    found.snapshots, found.in_grace = sorted(removed), sorted(wanted - removed)
    for path, unit in sorted(units.items()):
        if path in kept:
            continue
        if path in once_named:
            found.garbage.append(Garbage(path, unit.bytes, "removed snapshot"))
        elif unit.modified <= now - grace.total_seconds():
            found.garbage.append(Garbage(path, unit.bytes, "orphan"))
        else:
            found.young.append(path)
    if not dry_run:
        for item in found.garbage:
            for path in units[item.path].places:
                store.storage.remove(path)
    return found


def _superseded(headers: Sequence[Header], now: float, ago: timedelta) -> set[int]:
    """Return the snapshots that have not been the newest since `ago`."""
    limit = now - ago.total_seconds()
    return {
        before.number
        for before, after in itertools.pairwise(headers)
        if datetime.fromisoformat(after.time).timestamp() <= limit
    }


def _named(store: LakeStore, numbers: Iterable[int]) -> set[str]:
    """Return the paths of all files that snapshots name."""
    return {entry.path for number in numbers for entry in store.snapshot(number).files}


def _remove_snapshots(store: LakeStore, numbers: set[int]) -> set[int]:
    """Remove the documents of snapshots; return those that got a name at the same time.

    Who names looks for the document after making the name (`VersionLog.confirm`), and we for new
    names after removing it: either that fails, or the document is put back before any of its
    files is gone.
    """
    if not numbers:
        return set()
    store.log.hint(max(store.numbers()))
    documents = {number: store.log.remove(number) for number in sorted(numbers)}
    tagged = numbers & store.log.pinned()
    for number in tagged:
        store.log.restore(number, documents[number])
    return tagged


class _Unit(NamedTuple):
    """What is removed as one: a table's file, or a folder of arrays with its list."""

    bytes: int
    modified: float
    places: frozenset[str]


def _units(store: LakeStore) -> tuple[dict[str, _Unit], Collection]:
    """Return what lies in a lake's folders by the path that a snapshot would name."""
    units: dict[str, _Unit] = {}
    found = Collection()
    for folder in ("tables", "arrays", "snapshots", "tags", "subsets"):
        folders = store.storage.folders(folder) if folder == "arrays" else ()
        for file in (*folders, *store.storage.files(folder)):
            place = _unit_of(file.path)
            if place is None:
                found.foreign.append(file.path)
            elif place:
                path, root = place
                unit = units.get(path, _Unit(0, 0.0, frozenset()))
                size, modified = unit.bytes + file.bytes, max(unit.modified, file.modified)
                units[path] = _Unit(size, modified, unit.places | {root})
    found.foreign.sort()
    return units, found


def _unit_of(path: str) -> tuple[str, str] | tuple[()] | None:
    """Return the unit that a file belongs to and what to remove; () for documents in use.

    None stands for a file that is not a lake's.
    """
    match path.split("/"):
        case ["arrays", folder, *_] if folder.endswith(".zarr"):
            return f"arrays/{folder}", f"arrays/{folder}"
        case _ if is_staged(path):
            return path, path
        case ["tables", _, name] if name.endswith(".parquet"):
            return path, path
        case ["arrays", name] if name.endswith(list_name(".zarr")):
            return f"arrays/{name.removesuffix(list_name(''))}", path
        case ["snapshots" | "tags", name] if name.endswith(".json"):
            return ()
        case ["subsets", name] if name.endswith(".parquet"):
            return ()
    return None
