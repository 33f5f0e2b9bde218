"""What an archive holds: its CAD files with their hashes, found out once for all runs."""

from __future__ import annotations

import json
import platform
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

from breplake.errors import InputError, RefusedSourceError
from breplake.ingest.failure import detail_of
from breplake.ingest.hashing import Hasher
from breplake.ingest.sources.entry import Damage
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.limits import Limits, Meter
from breplake.ingest.sources.reader import ArchiveReader
from breplake.ingest.sources.unpack import Request
from breplake.ingest.sources.waiting import Waiting

__all__ = ["FACTS", "Member", "Survey", "facts_key", "survey"]

_KIND: Final = "archive-1"
"""Kind of the ledger's entries; another number where they change their meaning."""

_LASTING: Final = ("bad-archive", "encrypted")
"""Damage that lies in the bytes, or in the software that reads them; other may pass."""

_PASSING: Final = "unreadable"
"""Problem of a member that lies in the disk or the network, not in the bytes."""

FACTS: Final = "facts-1"
"""Kind of the entries with the facts of ABC models, by `facts_key`."""


@dataclass(slots=True)
class Member:
    """A CAD file in an archive.

    Parameters
    ----------
    place : int
        Its position among all members.
    name : str
        As the archive has it.
    bytes : int, optional
        Size; None if it cannot be read.
    sha256 : str, optional
        Hash of its bytes; None if they cannot be read.
    problem : tuple of (str, str), optional
        Kind and detail of why it cannot be read.
    """

    place: int
    name: str
    bytes: int | None = None
    sha256: str | None = None
    problem: tuple[str, str] | None = None


@dataclass(slots=True)
class Survey:
    """What an archive holds.

    Parameters
    ----------
    sha256 : str, optional
        Hash of the archive itself; None if it cannot be opened.
    members : list of Member
        CAD files, in the order of the archive.
    n_facts : int
        ABC models of which it holds metadata.
    damage : tuple of (str, str), optional
        Kind and detail of why it could not be read to its end; ``refused`` if it is not safe.
    expansion : float
        How many times its own size it unpacks to.
    """

    sha256: str | None
    members: list[Member] = field(default_factory=list)
    n_facts: int = 0
    damage: tuple[str, str] | None = None
    expansion: float = 0.0

    @property
    def has_problems(self) -> bool:
        """Whether the archive or a member cannot be read, which other software may be able to."""
        return self.damage is not None or any(member.problem for member in self.members)

    def document(self) -> dict[str, Any]:
        """Return it as what the ledger keeps."""
        rows = [[m.place, m.name, m.bytes, m.sha256, m.problem] for m in self.members]
        return {
            "members": rows,
            "n_facts": self.n_facts,
            "damage": self.damage,
            "expansion": self.expansion,
        }

    @classmethod
    def of(cls, sha256: str, document: dict[str, Any]) -> Survey:
        """Return the survey of which :meth:`document` made `document`."""
        members = [
            Member(place, name, size, digest, tuple(problem) if problem else None)
            for place, name, size, digest, problem in document["members"]
        ]
        damage = tuple(document["damage"]) if document["damage"] else None
        return cls(sha256, members, document["n_facts"], damage, document["expansion"])


def facts_key(archive: str, model: str) -> str:
    """Return the ledger's key of the facts of an ABC model in the archive of that hash."""
    return f"{archive}/{model}"


def survey(path: Path, ledger: Ledger, limits: Limits, waiting: Waiting, hasher: Hasher) -> Survey:
    """Find out what the archive at `path` holds; its bytes decide whether that is known already.

    Parameters
    ----------
    path : Path
        An archive.
    ledger : Ledger
        Knows archives that were read before.
    limits : Limits
        How far it is trusted.
    waiting : Waiting
        Asked often whether to go on.
    hasher : Hasher
        Reads it for its hash, unless that is remembered.
    """
    try:
        before = _state(path)
        digest = hasher.digest([path]).sha256
    except OSError as error:
        return Survey(None, damage=("unreadable", error.strerror or str(error)))
    except InputError as error:
        return Survey(None, damage=(error.kind, detail_of(error.kind, str(error))))
    key = f"{digest}/{limits.member}"
    of_readers = f"{key}/{_readers()}"
    known = ledger.get(_KIND, of_readers)
    if known is None:
        known = ledger.get(_KIND, key)
        if known is not None and Survey.of(digest, known).has_problems:
            known = None  # earlier versions kept these whatever read them
    if known is not None:
        return _judged(Survey.of(digest, known), before[0], limits)
    found, facts = _read(path, digest, limits, waiting)
    if _lasts(found) and _state(path) == before:  # else the hash may be that of other bytes
        ledger.put_all(FACTS, {facts_key(digest, key): value for key, value in facts.items()})
        ledger.put(_KIND, of_readers if found.has_problems else key, found.document())
    return found


def _readers() -> str:
    """Return the versions of what reads archives."""
    found = {"python": platform.python_version()}
    for package in ("breplake", "py7zr", "pyarrow"):
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return json.dumps(found)


def _lasts(found: Survey) -> bool:
    """Whether the bytes of an archive, and the software here, alone decide what was found."""
    if found.damage is not None and found.damage[0] not in _LASTING:
        return False
    return all(member.problem is None or member.problem[0] != _PASSING for member in found.members)


def _judged(found: Survey, packed: int, limits: Limits) -> Survey:
    """Judge again an archive of `packed` bytes, which was read when other limits held."""
    try:
        Meter(packed, limits).declare(round(found.expansion * packed), 0)
    except RefusedSourceError as error:
        return _refused(found, error)
    return found


def _refused(found: Survey, error: RefusedSourceError) -> Survey:
    """Return what is left of an archive that is not safe: the names of its CAD files."""
    damage = ("refused", str(error))
    members = [Member(member.place, member.name, problem=damage) for member in found.members]
    return replace(found, members=members, damage=damage)


def _state(path: Path) -> tuple[int, int]:
    """Return what changes when a file is written; zeros once it is gone."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return 0, 0
    return status.st_size, status.st_mtime_ns


def _read(
    path: Path, digest: str, limits: Limits, waiting: Waiting
) -> tuple[Survey, dict[str, Any]]:
    found = Survey(digest)
    facts: dict[str, Any] = {}
    by_place: dict[int, Member] = {}
    refusal: RefusedSourceError | None = None
    with closing(ArchiveReader(Request(str(path), limits))) as reader:
        try:
            for word, values in reader.events():
                waiting.check()
                if word == "member":
                    place, name = values
                    by_place[place] = Member(place, name)
                elif word == "done":
                    place, size, sha256 = values
                    by_place[place].bytes, by_place[place].sha256 = size, sha256
                elif word == "bad":
                    place, kind, detail = values
                    by_place[place].problem = (kind, detail)
                elif word == "facts":
                    key, columns = values
                    facts[key] = columns
        except Damage as damage:
            found.damage = (damage.kind, damage.detail)
        except RefusedSourceError as error:
            refusal = error
        found.expansion = reader.expansion
    found.members = [by_place[place] for place in sorted(by_place)]
    found.n_facts = len(facts)
    for member in found.members:
        if member.sha256 is None and member.problem is None:
            member.problem = found.damage
    return (found, facts) if refusal is None else (_refused(found, refusal), {})
