"""Members of archives, and what takes them."""

from __future__ import annotations

import errno
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, Protocol

__all__ = ["ARCHIVES", "Damage", "Entry", "Taker", "archive_format", "archive_stem", "damage_of"]

ARCHIVES: Final[dict[str, str]] = {
    ".zip": "zip",
    ".tar": "tar",
    ".tar.gz": "tar",
    ".tgz": "tar",
    ".tar.bz2": "tar",
    ".tbz2": "tar",
    ".tar.xz": "tar",
    ".txz": "tar",
    ".tar.zst": "tar",
    ".tzst": "tar",
    ".7z": "7z",
}
"""Format by ending of the name, upper or lower case."""


def archive_format(path: Path) -> str | None:
    """Return ``zip``, ``tar`` or ``7z`` by the name of a file; None if it is no archive."""
    ending = _ending(path)
    return ARCHIVES[ending] if ending else None


def archive_stem(path: Path) -> str:
    """Return the name of an archive without its ending."""
    return path.name[: len(path.name) - len(_ending(path) or path.suffix)]


def _ending(path: Path) -> str | None:
    name = path.name.lower()
    fits = [ending for ending in ARCHIVES if name.endswith(ending) and name != ending]
    return max(fits, key=len, default=None)


@dataclass(frozen=True, slots=True)
class Entry:
    """A member of an archive.

    Parameters
    ----------
    place : int
        Its position among all members.
    name : str
        As the archive has it.
    kind : {"file", "folder", "link", "special"}
        What it is; ``special`` are devices, pipes and sockets.
    danger : str, optional
        How it leads out of the archive, beside by its name.
    """

    place: int
    name: str
    kind: Literal["file", "folder", "link", "special"] = "file"
    danger: str | None = None


class Damage(Exception):
    """An archive that cannot be read, or not further.

    Parameters
    ----------
    kind : str
        A key of ``breplake.ingest.failure.KINDS``.
    detail : str
        What is wrong.
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(detail)
        self.kind = kind
        self.detail = detail


_OF_BYTES: Final = (None, errno.EINVAL, errno.EOVERFLOW)
"""Codes of errors that wrong bytes cause: offsets to where no file has anything, say."""


def damage_of(error: Exception) -> Damage:
    """Return what an error while an archive is read says of it: its bytes are bad, or the disk is.

    Parameters
    ----------
    error : Exception
        Of the parser, or of the file below it.
    """
    if isinstance(error, OSError) and error.errno not in _OF_BYTES:
        return Damage("unreadable", error.strerror or str(error))
    return Damage("bad-archive", str(error) or type(error).__name__)


class Taker(Protocol):
    """Takes the members of an archive while it is read from beginning to end.

    :meth:`wants` is asked once for every member, in any order before its bytes come; after the
    last of them, and where the archive has a directory before any bytes, :meth:`listed` is called.
    The bytes of the wanted ones come one member after the other, each ended by :meth:`done` or
    :meth:`failed`.
    """

    def wants(self, entry: Entry) -> bool:
        """Whether the bytes of a member are wanted."""

    def listed(self) -> None:
        """Learn that all members are known.

        Raises
        ------
        RefusedSourceError
            If one of them is not safe.
        """

    def more(self) -> bool:
        """Whether anything is wanted that has not come yet."""

    def write(self, entry: Entry, data: bytes) -> None:
        """Take the next bytes of a member."""

    def done(self, entry: Entry) -> None:
        """Learn that a member is complete, and its checksum right if it has one."""

    def failed(self, entry: Entry, kind: str, detail: str) -> None:
        """Learn that a member cannot be read, though others may."""
