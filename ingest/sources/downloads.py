"""Files from addresses: ``http``, ``https`` and object storage."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, Final
from urllib.parse import unquote, urlsplit

import obstore
from obstore.exceptions import BaseError, NotModifiedError
from obstore.store import from_url

from breplake.errors import InputError
from breplake.ingest.failure import advise
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.waiting import Waiting
from breplake.ingest.sources.web import Web, download_failed, public_address

__all__ = ["SCHEMES", "Download", "Downloads"]

SCHEMES: Final = ("http", "https", "s3", "gs", "az")
"""Addresses that can be downloaded."""

_KIND: Final = "uri-1"
"""Kind of the ledger's entries; another number where they change their meaning."""

_BLOCK: Final = 2**20


@dataclass(frozen=True, slots=True)
class Download:
    """What an address gives.

    Parameters
    ----------
    sha256 : str
        Hash of its bytes.
    bytes : int
        Their number.
    """

    sha256: str
    bytes: int


class Downloads:
    """Downloaded files, kept by their hash; safe to share between threads.

    The folder may be emptied whenever no run uses it: what is needed is downloaded again.

    Parameters
    ----------
    ledger : Ledger
        Remembers what an address gave, and in which version.
    limits : Limits
        How large a file may be.
    more : mapping
        Getters for addresses of other schemes: each writes what an address gives to a file.
    waiting : Waiting
        Ends long waits.
    backoff : float
        See :class:`Web`.
    """

    def __init__(
        self,
        ledger: Ledger,
        limits: Limits,
        more: Mapping[str, Callable[[str, Path], None]] | None = None,
        waiting: Waiting | None = None,
        backoff: float = 1.0,
    ) -> None:
        self._ledger, self._limits, self._backoff = ledger, limits, backoff
        self._waiting = waiting or Waiting()
        self._more = more or {}
        self._folder = ledger.folder / "downloads"
        self._lock = Lock()
        self._web: Web | None = None
        self._stores: dict[str, Any] = {}

    def close(self) -> None:
        """Close all connections."""
        if self._web is not None:
            self._web.close()

    def kept(self, sha256: str) -> Path | None:
        """Return the file with these bytes, if it was downloaded and kept."""
        path = self._place(sha256)
        return path if path.exists() else None

    def find_out(self, uri: str) -> Download:
        """Find out what an address gives; what changed since the last time is downloaded.

        Raises
        ------
        InputError
            ``download-failed`` or ``too-large``.
        """
        self._waiting.check()
        key = hashlib.sha256(uri.encode()).hexdigest()  # an address may hold a secret
        known = self._ledger.get(_KIND, key)
        with self.staged() as path:
            version = self._get(uri, path, known["version"] if known else {})
            if version is None and known is not None:
                return Download(known["sha256"], known["bytes"])
            download = _hashed(path)
            self._keep(path, download.sha256)
        if version:
            entry = {"version": version, "sha256": download.sha256, "bytes": download.bytes}
            self._ledger.put(_KIND, key, entry)
        return download

    def fetch(self, uri: str, sha256: str, target: Path) -> Path:
        """Return a file with the bytes of the given hash: a kept one, or else `target`.

        A kept file that has other bytes by now, after a power cut say, is removed.

        Raises
        ------
        InputError
            ``download-failed``, ``too-large``, or ``hash-mismatch`` if the address gives others.
        """
        kept = self.kept(sha256)
        if kept is not None and _has(kept, sha256):
            return kept
        self._get(uri, target, {})
        found = _hashed(target).sha256
        if found != sha256:
            target.unlink()
            detail = f"{public_address(uri)} gives {found[:12]}…, not {sha256[:12]}…"
            raise InputError("hash-mismatch", advise("hash-mismatch", detail))
        return target

    def keep(self, path: Path) -> Download:
        """Take over a file, which is gone from its place then."""
        download = _hashed(path)
        self._keep(path, download.sha256)
        return download

    def _place(self, sha256: str) -> Path:
        return self._folder / sha256[:2] / sha256

    def _keep(self, path: Path, sha256: str) -> None:
        place = self._place(sha256)
        place.parent.mkdir(parents=True, exist_ok=True)
        with path.open("rb") as file:
            os.fsync(file.fileno())  # else a power cut may leave the name without the bytes
        os.replace(path, place)

    @contextmanager
    def staged(self) -> Iterator[Path]:
        """Give a place for a file to be kept; what still lies there in the end is removed."""
        self._folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".new-", dir=self._folder)
        os.close(handle)
        path = Path(name)
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    def _get(self, uri: str, into: Path, version: dict[str, str]) -> dict[str, str] | None:
        """Write what `uri` gives; return its version, or None if that is the one given."""
        scheme = urlsplit(uri).scheme
        if scheme in self._more:
            self._more[scheme](uri, into)
            return {}
        if scheme in ("http", "https"):
            return self._get_web(uri, into, version)
        return self._get_object(uri, into, version)

    def _get_web(self, uri: str, into: Path, version: dict[str, str]) -> dict[str, str] | None:
        names = {"etag": "If-None-Match", "last-modified": "If-Modified-Since"}
        headers = {names[name]: value for name, value in version.items()}
        answer = self._client().ask(
            "GET", uri, headers=headers, into=into, most=self._limits.member
        )
        if answer.status == 304 and version:
            return None
        if answer.status != 200:
            raise download_failed(uri, f"the server answers {answer.status}")
        return {name: value for name in names if (value := answer.headers.get(name))}

    def _client(self) -> Web:
        with self._lock:
            self._web = self._web or Web(self._backoff, self._waiting.wait, self._waiting.check)
            return self._web

    def _get_object(self, uri: str, into: Path, version: dict[str, str]) -> dict[str, str] | None:
        parts = urlsplit(uri)
        key = unquote(parts.path.lstrip("/"))
        try:
            store = self._store(f"{parts.scheme}://{parts.netloc}")
            options: Any = {"if_none_match": version["etag"]} if version else None
            result = obstore.get(store, key, options=options)
            if result.meta["size"] > self._limits.member:
                detail = f"{public_address(uri)} has {result.meta['size']} bytes"
                raise InputError("too-large", advise("too-large", detail))
            with into.open("wb") as file:
                for block in result.stream(min_chunk_size=_BLOCK):
                    file.write(block)
        except NotModifiedError:
            return None
        except (BaseError, FileNotFoundError, PermissionError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise download_failed(
                uri, next(iter(str(error).splitlines()), type(error).__name__)
            ) from error
        etag = result.meta["e_tag"]
        return {"etag": etag} if etag else {}

    def _store(self, bucket: str) -> Any:
        with self._lock:
            if bucket not in self._stores:
                self._stores[bucket] = from_url(bucket)
            return self._stores[bucket]


def _has(kept: Path, sha256: str) -> bool:
    """Whether a kept file has the bytes that its name says; one with others is removed."""
    try:
        is_sound = _hashed(kept).sha256 == sha256
    except OSError:  # a disk that cannot give it back: the address still can
        return False
    if not is_sound:
        kept.unlink(missing_ok=True)
    return is_sound


def _hashed(path: Path) -> Download:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return Download(digest, file.tell())
