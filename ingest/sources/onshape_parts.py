"""Public Onshape documents: their parts, translated to STEP and downloaded."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from breplake.errors import InputError, UsageError
from breplake.ingest.failure import advise
from breplake.ingest.sources.abc_names import document_facts
from breplake.ingest.sources.downloads import Download, Downloads
from breplake.ingest.sources.facts import Facts
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.onshape_api import OnshapeApi

__all__ = ["PREFIX", "Document", "Onshape", "Part"]

PREFIX: Final = "onshape:"
"""Beginning of the sources that are Onshape's, and of the addresses of their files."""

_DOCUMENT: Final = "onshape-document-1"
_PART: Final = "onshape-part-1"
"""Kinds of the ledger's entries; other numbers where they change their meaning."""

_PATH: Final = re.compile(
    r"/documents/([0-9a-f]{24})(?:/([wvm])/([0-9a-f]{24})(?:/e/([0-9a-f]{24}))?)?/?"
)

_BODIES: Final = ("solid", "sheet")
"""Kinds of body that have patches."""

_PUBLIC: Final = 4
"""Filter of the API's list of documents: public ones."""

_PAGE: Final = 20  # most documents in one answer of the list
_STEP_VERSION: Final = "AP242"

_FIRST_LOOK: Final = 2.0
_LAST_LOOK: Final = 60.0
"""Seconds between two looks at a translation, at first and at most: every look is a call."""

_PATIENCE: Final = 1800.0
"""Seconds in which a translation has to be done."""


@dataclass(frozen=True, slots=True)
class Document:
    """A document, or a Part Studio in it.

    Parameters
    ----------
    id : str
        Of the document.
    kind : {"w", "v"}, optional
        Whether `version` is a workspace, which changes, or a version, which does not. None for
        the workspace that the document opens with.
    version : str, optional
        Id of that.
    element : str, optional
        The only Part Studio that is wanted.
    """

    id: str
    kind: str | None = None
    version: str | None = None
    element: str | None = None

    @classmethod
    def parse(cls, address: str, base: str) -> Document:
        """Return the document of an address, as a browser shows it.

        Raises
        ------
        UsageError
            If it is none of a document on the server `base`.
        """
        parts, home = urlsplit(address), urlsplit(base)
        match = _PATH.fullmatch(parts.path)
        if match is None or (parts.scheme, parts.netloc) != (home.scheme, home.netloc):
            raise UsageError(
                f"{address} is no document of {base}: its address looks like "
                f"{base}/documents/<id>/w/<workspace>, and ONSHAPE_URL names another server"
            )
        if match[2] == "m":
            raise UsageError(
                f"{address} is a microversion, which Onshape does not translate: give the "
                "version (/v/) or workspace (/w/) it is from"
            )
        return cls(match[1], match[2], match[3], match[4])


@dataclass(frozen=True, slots=True)
class Part:
    """What becomes one STEP file: a part, or all parts of a Part Studio.

    Parameters
    ----------
    document : Document
        Where it is, with workspace or version.
    element : str
        Its Part Studio.
    ids : tuple of str
        Its parts.
    microversion : str
        State of the Part Studio: the same as long as nothing in it changes.
    name : str
        What its author calls it.
    facts : Facts
        What the document says of it.
    whole : bool
        Whether it stands for its Part Studio, whatever parts that has.
    """

    document: Document
    element: str
    ids: tuple[str, ...]
    microversion: str
    name: str
    facts: Facts
    whole: bool

    @property
    def path(self) -> str:
        """Name of the model: ids that stay the same when parts are renamed or added."""
        place = f"{self.document.id}/{self.element}"
        return place if self.whole else f"{place}/{self.ids[0]}"

    @property
    def key(self) -> str:
        """What decides the content of its STEP file."""
        ids = ",".join(self.ids)
        return f"{self.document.id}/{self.element}/{ids}@{self.microversion}/{_STEP_VERSION}"


class Onshape:
    """Reads documents with as few calls as possible: a plan may allow only some thousand a year.

    Parameters
    ----------
    api : OnshapeApi
        Makes the calls.
    ledger : Ledger
        Remembers the parts of versions, and how far each translation is.
    downloads : Downloads
        Keeps the files.
    limits : Limits
        How large a file may be.
    wait : callable
        Waits some seconds.
    """

    def __init__(
        self,
        api: OnshapeApi,
        ledger: Ledger,
        downloads: Downloads,
        limits: Limits,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self._api, self._ledger, self._downloads = api, ledger, downloads
        self._limits, self._wait = limits, wait

    def public(self, text: str, limit: int) -> Iterator[Document]:
        """Yield the first `limit` public documents whose name holds `text`.

        Raises
        ------
        InputError
            If the list cannot be had.
        """
        offset = 0
        while offset < limit:
            page = _document(
                self._api.get(
                    "/documents", {"filter": _PUBLIC, "q": text, "offset": offset, "limit": _PAGE}
                )
            )
            items = page.get("items") or []
            for item in items[: limit - offset]:
                identity = _needed(item, "id")
                workspace = (item.get("defaultWorkspace") or {}).get("id")
                yield Document(identity, "w" if workspace else None, workspace)
            offset += len(items)
            if not items or not page.get("next"):
                return

    def parts(self, document: Document, *, by_studio: bool) -> list[Part]:
        """List the parts of a document, in the order of the document.

        Parameters
        ----------
        document : Document
            Where to look.
        by_studio : bool
            All parts of a Part Studio in one file, not each in its own.

        Raises
        ------
        InputError
            If the document cannot be read.
        """
        summary: dict[str, Any] | None = None
        if document.kind is None:
            summary = _document(self._api.get(f"/documents/{document.id}"))
            workspace = summary.get("defaultWorkspace") or {}
            if not workspace.get("id"):
                detail = f"Onshape document {document.id} has no workspace to read"
                raise InputError("download-failed", advise("download-failed", detail))
            document = Document(document.id, "w", workspace["id"], document.element)
        place = f"/d/{document.id}/{document.kind}/{document.version}"
        state = document.version
        if document.kind == "w":
            answer = self._api.get(f"/documents{place}/currentmicroversion")
            state = _needed(answer, "microversion")
        key = f"{place}@{state}"
        known = self._ledger.get(_DOCUMENT, key)
        if known is None:
            known = {
                "facts": document_facts(
                    summary or _document(self._api.get(f"/documents/{document.id}"))
                ).columns(),
                "parts": [_kept(part) for part in _array(self._api.get(f"/parts{place}"))],
            }
            self._ledger.put(_DOCUMENT, key, known)
        found = [
            part
            for part in known["parts"]
            if part["bodyType"] in _BODIES and document.element in (None, part["elementId"])
        ]
        facts = Facts.of(known["facts"])
        groups = _by_studio(found) if by_studio else [[part] for part in found]
        return [_part(document, group, facts, self._api.base, by_studio) for group in groups]

    def fetch(self, part: Part) -> tuple[Download, str]:
        """Translate a part and download the STEP file, as far as that has not been done before.

        Returns
        -------
        tuple of (Download, str)
            The file, and the address that :meth:`fetch_again` knows.

        Raises
        ------
        InputError
            ``translation-failed``, ``download-failed`` or ``too-large``.
        """
        state: dict[str, Any] = self._ledger.get(_PART, part.key) or {}
        for _ in range(2):  # the second time for a file that is gone from the server
            if "sha256" not in state:
                state = self._translated(part, state)
            path = f"/documents/d/{part.document.id}/externaldata/{state['data']}"
            address = f"{PREFIX}{path}#{part.key}"
            if "sha256" in state:
                return Download(state["sha256"], state["bytes"]), address
            with self._downloads.staged() as file:
                if self._api.download(path, file, self._limits.member):
                    download = self._downloads.keep(file)
                    done = {"sha256": download.sha256, "bytes": download.bytes}
                    self._ledger.put(_PART, part.key, state | done)
                    return download, address
            state = {}
            self._ledger.drop(_PART, part.key)
        detail = f"Onshape part {part.name!r}: the translation was gone before it was downloaded"
        raise InputError("download-failed", advise("download-failed", detail))

    def fetch_again(self, address: str, into: Path) -> None:
        """Write a STEP file that was downloaded before and is not kept any more.

        Parameters
        ----------
        address : str
            What :meth:`fetch` gave.
        into : Path
            The file.

        Raises
        ------
        InputError
            If the server does not have it any more either; it is translated anew next time.
        """
        path, _, key = address.removeprefix(PREFIX).partition("#")
        if not self._api.download(path, into, self._limits.member):
            self._ledger.drop(_PART, key)
            detail = "Onshape has the translation no more"
            raise InputError("download-failed", advise("download-failed", detail))

    def _translated(self, part: Part, state: dict[str, Any]) -> dict[str, Any]:
        """Bring a translation to its end, from wherever it stands."""
        if "data" in state:
            return state
        answer = self._looked_up(state["translation"]) if "translation" in state else None
        if answer is None:
            answer = self._started(part)
            self._ledger.put(_PART, part.key, {"translation": _needed(answer, "id")})
        translation = _needed(answer, "id")
        pause, waited = _FIRST_LOOK, 0.0
        while _needed(answer, "requestState") == "ACTIVE":
            if waited >= _PATIENCE:
                detail = f"Onshape part {part.name!r} is not translated after {waited:.0f} s"
                raise InputError("download-failed", advise("download-failed", detail))
            self._wait(pause)
            waited += pause
            pause = min(2 * pause, _LAST_LOOK)
            answer = self._looked_up(translation) or {"requestState": "FAILED"}
        data = answer.get("resultExternalDataIds") or []
        if answer["requestState"] != "DONE" or len(data) != 1:
            self._ledger.drop(_PART, part.key)
            detail = answer.get("failureReason") or f"it gave {len(data)} files"
            message = f"Onshape part {part.name!r}: {detail}"
            raise InputError("translation-failed", advise("translation-failed", message))
        state = {"data": data[0]}
        self._ledger.put(_PART, part.key, state)
        return state

    def _started(self, part: Part) -> dict[str, Any]:
        where = part.document
        answer: dict[str, Any] = self._api.post(
            f"/partstudios/d/{where.id}/{where.kind}/{where.version}/e/{part.element}/translations",
            {
                "formatName": "STEP",
                "stepVersionString": _STEP_VERSION,
                "partIds": ",".join(part.ids),
                "storeInDocument": False,
                "translate": True,
            },
        )
        return answer

    def _looked_up(self, translation: str) -> dict[str, Any] | None:
        answer: dict[str, Any] | None = self._api.find(f"/translations/{translation}")
        return answer


def _kept(part: dict[str, Any]) -> dict[str, Any]:
    """Return what matters of the API's description of a part."""
    names = ("partId", "elementId", "bodyType", "microversionId")
    return {name: _needed(part, name) for name in names} | {"name": part.get("name") or ""}


def _needed(answer: Any, key: str) -> str:
    """Return the text of a key without which an answer is of no use.

    Raises
    ------
    InputError
        ``download-failed`` if it is not there.
    """
    value = _document(answer).get(key)
    if isinstance(value, str) and value:
        return value
    raise _useless(f"lacks {key!r}")


def _document(answer: Any) -> dict[str, Any]:
    if isinstance(answer, dict):
        return answer
    raise _useless(f"is {type(answer).__name__} and no object")


def _array(answer: Any) -> list[Any]:
    if isinstance(answer, list):
        return answer
    raise _useless(f"is {type(answer).__name__} and no array")


def _useless(why: str) -> InputError:
    return InputError("download-failed", advise("download-failed", f"Onshape's answer {why}"))


def _by_studio(parts: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    studios: dict[str, list[dict[str, Any]]] = {}
    for part in parts:
        studios.setdefault(part["elementId"], []).append(part)
    return list(studios.values())


def _part(
    document: Document, group: list[dict[str, Any]], facts: Facts, base: str, whole: bool
) -> Part:
    first = group[0]
    place = f"{base}/documents/{document.id}/{document.kind}/{document.version}"
    name = ", ".join(str(part["name"]) for part in group)
    own = Facts(source_url=f"{place}/e/{first['elementId']}", metadata=(("part", name),))
    return Part(
        document,
        first["elementId"],
        tuple(part["partId"] for part in group),
        str(first["microversionId"]),
        name,
        own.over(facts),
        whole,
    )
