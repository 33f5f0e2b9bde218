"""Where the bytes of an input are, when they are not in a file of their own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["MemberOrigin", "Origin", "UriOrigin"]


@dataclass(frozen=True, slots=True)
class MemberOrigin:
    """A member of an archive.

    Parameters
    ----------
    archive : Path
        The archive.
    place : int
        The member's position in it.
    facts : str, optional
        The ledger's key of what ABC's metadata says of it.
    """

    archive: Path
    place: int
    facts: str | None = None


@dataclass(frozen=True, slots=True)
class UriOrigin:
    """A file that has to be downloaded.

    Parameters
    ----------
    uri : str
        Address that :class:`breplake.ingest.sources.downloads.Downloads` knows to get.
    """

    uri: str


Origin = MemberOrigin | UriOrigin
