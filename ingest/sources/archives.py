"""Archives as sources: every CAD file in them becomes an input."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Final

from breplake.errors import RefusedSourceError, UsageError
from breplake.ingest.failure import Failure, advise
from breplake.ingest.inputs import Input, cad_format, model_name
from breplake.ingest.printable import printable
from breplake.ingest.sources.abc_names import COLLECTION, abc_key, chunk_of
from breplake.ingest.sources.entry import archive_stem
from breplake.ingest.sources.origin import MemberOrigin
from breplake.ingest.sources.survey import Member, Survey, facts_key
from breplake.schema.identity import model_id

__all__ = ["ARCHIVE", "archive_id", "archive_inputs", "check_metadata"]

ARCHIVE: Final = "archive"
"""Format of the input that an archive itself is where it cannot be read."""


def archive_inputs(
    path: Path, found: Survey, collection: str | None, metadata: Survey | None
) -> Iterator[Input]:
    """Yield the CAD files of an archive as inputs, in its order.

    Names are those of files in a folder: the path in the archive without the extension, for
    ABC's files their ids. An archive that is damaged or refused is itself one more input, which
    failed.

    Parameters
    ----------
    path : Path
        The archive.
    found : Survey
        What it holds.
    collection : str, optional
        Collection of the models; by default the archive's name, and ``abc`` for chunks of ABC.
    metadata : Survey, optional
        Of the archive with ABC's metadata; by default that of `path` itself.
    """
    group = printable(collection or _collection(path))
    source = (metadata or found).sha256 or ""
    used: set[str] = set()
    for member in found.members:
        name = next(name for name in _names(member) if name not in used)
        used.add(name)
        yield _input(path, member, group, printable(name), source)
    if found.damage is not None:
        yield _damaged(path, group, found)


def archive_id(path: Path, collection: str | None) -> int:
    """Return the id of the input that an archive itself is where it is damaged or refused."""
    return model_id(printable(collection or _collection(path)), printable(path.name))


def check_metadata(path: Path, found: Survey) -> None:
    """Make sure that an archive with metadata is whole.

    Raises
    ------
    UsageError
        If it is not: its models would silently lose licence and owner. RefusedSourceError if it
        is not safe.
    """
    if found.damage is not None and found.damage[0] == "refused":
        raise RefusedSourceError(found.damage[1])
    if found.damage is not None:
        raise UsageError(
            f"{path} cannot be read ({advise(*found.damage)}); without it the models have no "
            "owner and no licence: fetch it again, or move it away to do without"
        )


def _names(member: Member) -> Iterator[str]:
    """Yield the names that a member may have, the best first; the last is no other member's."""
    yield model_name(PurePosixPath(member.name))
    yield member.name
    yield f"{member.name}, member {member.place}"


def _collection(path: Path) -> str:
    return COLLECTION if chunk_of(path) else archive_stem(path)


def _input(path: Path, member: Member, group: str, name: str, source: str) -> Input:
    key = abc_key(member.name)
    origin = MemberOrigin(path, member.place, facts_key(source, key) if key else None)
    failure = None
    if member.problem is not None:
        kind, detail = member.problem
        failure = Failure("plan", kind, advise(kind, detail), fatal=True)
    elif member.bytes == 0:
        failure = Failure("plan", "empty-file", advise("empty-file", ""), fatal=True)
    return Input(
        path,
        group,
        name,
        cad_format(member.name) or "step",
        member.bytes,
        member.sha256,
        failure,
        shown=printable(f"{path}!/{member.name}"),
        origin=origin,
    )


def _damaged(path: Path, group: str, found: Survey) -> Input:
    kind, detail = found.damage or ("bad-archive", "")
    if kind != "refused":
        detail += f", after {sum(m.sha256 is not None for m in found.members)} CAD files"
    failure = Failure("plan", kind, advise(kind, detail), fatal=True)
    size = path.stat().st_size if found.sha256 else None
    return Input(path, group, printable(path.name), ARCHIVE, size, found.sha256, failure)
