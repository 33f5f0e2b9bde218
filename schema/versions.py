"""The documents that make a lake's history: snapshots, tags, and a hint to the newest."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from breplake.errors import LakeFormatError, NameNotFoundError, UsageError
from breplake.schema.files import checked_name
from breplake.schema.snapshot import Header, Snapshot, read_header
from breplake.schema.storage import Storage
from breplake.schema.subset import pinned_snapshots

__all__ = ["VersionLog", "ranges", "snapshot_path"]

_HINT = "snapshots/newest.json"


def snapshot_path(number: int) -> str:
    """Return the path of a snapshot's document."""
    return f"snapshots/{number:08d}.json"


class VersionLog:
    """Read and create the snapshots and tags of a lake.

    Snapshots are immutable, so the one that was read last is kept in memory.

    Parameters
    ----------
    storage : Storage
        The lake.
    """

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self._last: Snapshot | None = None

    def numbers(self) -> list[int]:
        """Return the numbers of all snapshots, ascending.

        Raises
        ------
        UsageError
            If the lake is where names cannot be listed.
        """
        if not self._storage.can_list:
            raise UsageError(
                f"the snapshots in {self._storage.name} cannot be listed: name one by --at"
            )
        names = self._storage.names("snapshots")
        return [int(n[:-5]) for n in names if n.endswith(".json") and n[:-5].isdigit()]

    def newest(self) -> int | None:
        """Return the number of the newest snapshot, or None before the first commit."""
        if self._storage.can_list:
            return max(self.numbers(), default=None)
        return self._probe()

    def _probe(self) -> int | None:
        """Find the newest snapshot where names cannot be listed.

        From the hint on (or from 1, if nothing ever left a gap) numbers are consecutive: double
        the stride until one is missing, then halve it.
        """
        try:
            low = int(json.loads(self._storage.read(_HINT))["snapshot"])
        except FileNotFoundError:
            low = 0
        stride = 1
        while self._storage.has(snapshot_path(low + stride)):
            low += stride
            stride *= 2
        while stride > 1:
            stride //= 2
            if self._storage.has(snapshot_path(low + stride)):
                low += stride
        return low or None

    def hint(self, number: int) -> None:
        """Say that `number` exists, for readers who cannot list.

        Whoever leaves a gap in the numbers must say so before: after the hint there is none.
        """
        self._storage.overwrite(_HINT, (json.dumps({"snapshot": number}) + "\n").encode())

    def headers(self) -> Iterator[Header]:
        """Yield what every snapshot says of itself, ascending."""
        for number in self.numbers():
            path = snapshot_path(number)
            yield read_header(self._storage.read_line(path), path)

    def read(self, number: int) -> Snapshot:
        """Return a snapshot.

        Raises
        ------
        FileNotFoundError
            If there is none of that number.
        LakeFormatError
            If its document cannot be read.
        """
        last = self._last
        if last is None or last.number != number:
            path = snapshot_path(number)
            last = self._last = Snapshot.from_json(self._storage.read(path), path)
        return last

    def create(self, snapshot: Snapshot) -> bool:
        """Create a snapshot's document unless its number is taken; that is the commit.

        A store may keep the document while its answer is lost, and say to the client's second
        try that there is one: so it is read, and equal bytes are ours.
        """
        path, data = snapshot_path(snapshot.number), snapshot.to_json()
        if not self._storage.create(path, data) and not self._is_there(path, data):
            return False
        self._last = snapshot
        return True

    def _is_there(self, path: str, data: bytes) -> bool:
        try:
            return self._storage.size(path) == len(data) and self._storage.read(path) == data
        except FileNotFoundError:
            return False  # removed by a collection of garbage, which keeps the newest

    def remove(self, number: int) -> bytes:
        """Remove a snapshot's document and return it; `hint` must have been given before."""
        path = snapshot_path(number)
        data = self._storage.read(path)
        self._storage.remove(path)
        self._last = None
        return data

    def restore(self, number: int, data: bytes) -> None:
        """Put a document back that `remove` returned."""
        self._storage.create(snapshot_path(number), data)

    def pinned(self) -> set[int]:
        """Return the snapshots that must not be removed: a tag or a subset names them."""
        return {*self.tags().values(), *pinned_snapshots(self._storage).values()}

    def tags(self) -> dict[str, int]:
        """Return the snapshot number of every tag, sorted by name."""
        if not self._storage.can_list:
            raise UsageError(f"the tags in {self._storage.name} cannot be listed: name one by --at")
        names = [
            n.removesuffix(".json") for n in self._storage.names("tags") if n.endswith(".json")
        ]
        found = {name: self.tagged(name) for name in names}
        return {name: number for name, number in found.items() if number is not None}

    def tagged(self, name: str) -> int | None:
        """Return the number that a tag names, or None if there is no such tag."""
        path = f"tags/{checked_name(name, 'tag')}.json"
        try:
            return int(json.loads(self._storage.read(path))["snapshot"])
        except FileNotFoundError:
            return None
        except (KeyError, TypeError, ValueError) as error:
            raise LakeFormatError(f"{path} is not a tag: {error!r}") from error

    def tag(self, name: str, number: int) -> None:
        """Name a snapshot for good.

        Raises
        ------
        UsageError
            If the tag names another snapshot.
        NameNotFoundError
            If the snapshot was removed meanwhile.
        """
        path = f"tags/{name}.json"
        data = (json.dumps({"name": name, "snapshot": number}, sort_keys=True) + "\n").encode()
        created = self._storage.create(path, data)
        other = number if created else self.tagged(name)
        if other != number:
            raise UsageError(f"tag {name} names snapshot {other} for good: use a new name")
        try:
            self.confirm(number)
        except NameNotFoundError:
            if created:
                self._storage.remove(path)
            raise

    def confirm(self, number: int) -> None:
        """Check, after something was made that pins a snapshot, that the snapshot is still there.

        Who collects garbage removes documents first and looks for new pins then, so that one of
        the two sees the other.

        Raises
        ------
        NameNotFoundError
            If it is not: what was made must be taken back.
        """
        if not self._storage.has(snapshot_path(number)):
            raise NameNotFoundError(f"snapshot {number} was removed meanwhile{self.known()}")

    def known(self) -> str:
        """Return which snapshots and tags there are, as the end of a message."""
        if not self._storage.can_list:
            return ""
        numbers, tags = ranges(self.numbers()) or "none", ", ".join(self.tags()) or "none"
        return f": snapshots are {numbers}, tags {tags}"


def ranges(numbers: Sequence[int]) -> str:
    """Return ascending numbers as text: ``1, 4 to 7``."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and runs[-1][1] == number - 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in runs)
