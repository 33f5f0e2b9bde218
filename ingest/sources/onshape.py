"""Onshape as a source: ``onshape:`` and the address of a document, or a search for public ones.

====================================================  ========================================
``onshape:https://cad.onshape.com/documents/d/w/e``   parts of a document, or of a Part Studio
``onshape:public?q=gear&limit=50``                    of public documents with that in the name
``…?by=studio`` or ``…&by=studio``                    one model per Part Studio, not per part
====================================================  ========================================
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs, urlencode, urlsplit

from breplake.errors import InputError, UsageError
from breplake.ingest.failure import Failure, advise, detail_of
from breplake.ingest.inputs import Input
from breplake.ingest.printable import printable
from breplake.ingest.sources.facts import NO_FACTS, Facts
from breplake.ingest.sources.onshape_api import base_address
from breplake.ingest.sources.onshape_parts import PREFIX, Document, Onshape, Part
from breplake.ingest.sources.origin import UriOrigin
from breplake.ingest.sources.waiting import Tell, silent
from breplake.schema.identity import model_id

__all__ = ["PREFIX", "SEARCH", "Query", "documents_in", "is_onshape", "onshape_inputs"]

SEARCH: Final = "search"
"""Format of the input that stands for a search that failed."""

COLLECTION: Final = "onshape"
"""Collection of the models, if none is given: names hold ids, which are unique."""

_AT_ONCE: Final = 4
"""Translations under way at the same time."""

_NOWHERE: Final = Path()
"""File of an input that has none before it is fetched."""

_DOCUMENTS: Final = 20
"""Public documents that are read if no limit is given."""


def is_onshape(source: str) -> bool:
    """Whether a source is Onshape's."""
    return source.startswith(PREFIX)


@dataclass(frozen=True, slots=True)
class Query:
    """What of Onshape is to be read.

    Parameters
    ----------
    document : Document, optional
        One document; None for a search.
    text : str
        What the names of public documents hold.
    limit : int
        How many documents.
    by_studio : bool
        One model per Part Studio.
    """

    document: Document | None = None
    text: str = ""
    limit: int = _DOCUMENTS
    by_studio: bool = False

    @classmethod
    def parse(cls, source: str) -> Query:
        """Return the query of a source.

        Raises
        ------
        UsageError
            If it is none.
        """
        try:
            parts = urlsplit(source.removeprefix(PREFIX))
        except ValueError as error:
            raise UsageError(
                f"the address behind {PREFIX} cannot be understood ({error}); "
                "copy it from a browser"
            ) from error
        options = {name: values[-1] for name, values in parse_qs(parts.query).items()}
        by_studio = options.pop("by", "part")
        if by_studio not in ("part", "studio"):
            raise UsageError(f"{source}: by must be part or studio, got {by_studio!r}")
        grouped = by_studio == "studio"
        if parts.path != "public":
            plain = parts._replace(query="", fragment="").geturl()
            cls._check(source, options, ())
            return cls(Document.parse(plain, base_address()), by_studio=grouped)
        cls._check(source, options, ("q", "limit"))
        limit = options.get("limit", str(_DOCUMENTS))
        if not limit.isdecimal() or int(limit) < 1:
            raise UsageError(f"{source}: limit must be a number of documents, got {limit!r}")
        return cls(None, options.get("q", ""), int(limit), grouped)

    @property
    def name(self) -> str:
        """What identifies a search: its source without the prefix, however it was written."""
        more = "&by=studio" if self.by_studio else ""
        return f"public?{urlencode({'q': self.text, 'limit': self.limit})}{more}"

    @staticmethod
    def _check(source: str, options: dict[str, str], known: tuple[str, ...]) -> None:
        other = sorted(set(options) - set(known))
        if other:
            names = ", ".join((*known, "by"))
            raise UsageError(f"{source}: there is no option {other[0]!r}, only {names}")


def onshape_inputs(
    query: Query,
    onshape: Onshape,
    collection: str | None,
    whole: set[int],
    facts: Facts = NO_FACTS,
    tell: Tell = silent,
) -> list[Input]:
    """Return the parts that a query finds as inputs; those not known yet are translated now.

    A search, document or part that cannot be had is an input that failed.

    Parameters
    ----------
    query : Query
        What is to be read.
    onshape : Onshape
        Reads it.
    collection : str, optional
        Collection of the models; ``onshape`` by default.
    whole : set of int
        Takes the ids that searches and documents have as inputs where they cannot be had, of
        those that can.
    facts : Facts
        What is known of all these models besides.
    tell : Tell
        Takes the progress now and then.
    """
    group = printable(collection or COLLECTION)
    documents, inputs = _documents(query, onshape, group, whole)
    parts: list[Part] = []
    for number, document in enumerate(documents, 1):
        try:
            parts += onshape.parts(document, by_studio=query.by_studio)
            whole.add(model_id(group, document.id))
        except InputError as error:
            inputs.append(_failed(PREFIX + document.id, group, document.id, error))
        tell(f"Onshape: documents listed, {len(parts)} models", number, len(documents))
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        fetched = pool.map(lambda part: _input(part, onshape, group), parts)
        for number, item in enumerate(fetched, 1):
            inputs.append(replace(item, facts=facts.over(item.facts)))
            tell("Onshape: models translated and downloaded", number, len(parts))
    return inputs


def _documents(
    query: Query, onshape: Onshape, group: str, whole: set[int]
) -> tuple[list[Document], list[Input]]:
    """Return the documents of a query, and the failure of a search that did not come to its end.

    What it had found until then is read.
    """
    if query.document is not None:
        return [query.document], []
    found: list[Document] = []
    name = printable(query.name)
    try:
        for document in onshape.public(query.text, query.limit):
            found.append(document)  # noqa: PERF402 -- those before an error are kept
    except InputError as error:
        detail = f"{PREFIX}{name}: {detail_of(error.kind, str(error))}"
        failed = InputError("search-failed", advise("search-failed", detail))
        return found, [_failed(PREFIX + name, group, name, failed, SEARCH)]
    whole.add(model_id(group, name))
    return found, []


def _input(part: Part, onshape: Onshape, group: str) -> Input:
    shown = f"{part.facts.source_url}?partId={','.join(part.ids)}"
    try:
        download, address = onshape.fetch(part)
    except InputError as error:
        return _failed(shown, group, part.path, error)
    return Input(
        _NOWHERE,
        group,
        part.path,
        "step",
        download.bytes,
        download.sha256,
        shown=shown,
        origin=UriOrigin(address),
        facts=part.facts,
    )


def _failed(shown: str, group: str, name: str, error: InputError, format: str = "step") -> Input:
    failure = Failure("fetch", error.kind, str(error), fatal=True)
    return Input(_NOWHERE, group, name, format, failure=failure, shown=shown)


def documents_in(address: str) -> bool:
    """Whether an address in a list is one of an Onshape document, with or without the prefix."""
    if is_onshape(address):
        return True
    try:
        parts = urlsplit(address)
    except ValueError:  # no address at all
        return False
    same = parts.netloc == urlsplit(base_address()).netloc
    return same and parts.path.startswith("/documents/")
