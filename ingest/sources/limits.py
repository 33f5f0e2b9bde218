"""How far an archive is trusted: names that stay inside, and sizes that are sane."""

from __future__ import annotations

import posixpath
import re
from dataclasses import dataclass
from typing import Final

from breplake.errors import RefusedSourceError, UsageError

__all__ = ["DEFAULT_LIMITS", "Limits", "Meter", "hostile_link", "hostile_name"]

_HARMLESS: Final = 2**20
"""Bytes that any archive may unpack to, whatever its size."""

_DRIVE: Final = re.compile(r"[A-Za-z]:")


@dataclass(frozen=True, slots=True)
class Limits:
    """What an archive may cost.

    Parameters
    ----------
    expansion : float
        How many times its own size it may unpack to. Real STEP files compress 5 to 15 times;
        zip bombs, about 1000 times and more.
    member : int
        Bytes that a member may unpack to.
    members : int
        Number of members.

    Raises
    ------
    UsageError
        If the expansion is below 1.
    """

    expansion: float = 250.0
    member: int = 4 * 2**30
    members: int = 2_000_000

    def __post_init__(self) -> None:
        """Check the expansion."""
        if not self.expansion >= 1:
            raise UsageError(f"an archive must be allowed to expand; got {self.expansion} times")


DEFAULT_LIMITS: Final = Limits()
"""What every archive may cost."""


class Meter:
    """Counts what an archive unpacks to, and refuses it when that is too much.

    Parameters
    ----------
    packed : int
        Size of the archive in bytes.
    limits : Limits
        What is allowed.

    Attributes
    ----------
    produced : int
        Bytes that were unpacked so far.
    largest : int
        Bytes that it unpacks to, as far as is known.
    """

    def __init__(self, packed: int, limits: Limits) -> None:
        self.limits = limits
        self.packed = max(packed, 1)
        self.produced = 0
        self.largest = 0

    @property
    def expansion(self) -> float:
        """How many times its own size the archive unpacks to, as far as is known."""
        return self.largest / self.packed

    @property
    def allowed(self) -> int:
        """Bytes that the archive may unpack to."""
        return max(_HARMLESS, int(self.packed * self.limits.expansion))

    def declare(self, size: int, members: int) -> None:
        """Judge the totals that the archive itself states.

        Raises
        ------
        RefusedSourceError
            If they are too large.
        """
        if members > self.limits.members:
            raise RefusedSourceError(
                f"it holds {members} members, more than {self.limits.members}; split it"
            )
        self._judge(size)

    def add(self, size: int) -> None:
        """Count `size` more bytes.

        Raises
        ------
        RefusedSourceError
            If it is too much.
        """
        self.produced += size
        self._judge(self.produced)

    def _judge(self, size: int) -> None:
        self.largest = max(self.largest, size)
        if size > self.allowed:
            raise self.bomb(size)

    def bomb(self, size: int) -> RefusedSourceError:
        """Return the error of an archive that unpacks to `size` bytes or more."""
        return RefusedSourceError(
            f"it unpacks to {size / self.packed:.0f} times its own size and more, which looks like "
            f"a decompression bomb; {self.limits.expansion:g} times are allowed, and if you trust "
            "it, --max-expansion allows more"
        )


def hostile_name(name: str) -> str | None:
    """Tell how a member's name would lead out of a folder; None if it would not.

    Parameters
    ----------
    name : str
        As the archive has it, with slashes or backslashes.
    """
    if "\0" in name:
        return "holds a zero byte"
    if name.startswith(("/", "\\")):
        return "is absolute"
    if _DRIVE.match(name):
        return "names a drive"
    if ".." in re.split(r"[/\\]", name):
        return "leads out of the archive by '..'"
    return None


def hostile_link(name: str, target: str, *, hard: bool) -> str | None:
    """Tell how a link would lead out of a folder; None if it would not.

    Parameters
    ----------
    name : str
        Name of the link, which is not hostile.
    target : str
        What it points to.
    hard : bool
        A hard link counts from the root of the archive, a symbolic one from its own folder.
    """
    base = "" if hard else posixpath.dirname(name)
    if target.startswith(("/", "\\")) or _DRIVE.match(target):
        return "is a link to an absolute path"
    place = posixpath.normpath(posixpath.join(base, target.replace("\\", "/")))
    return "is a link that leads out of the archive" if place.split("/")[0] == ".." else None
