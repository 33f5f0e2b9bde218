"""Brings the bytes of inputs to files, just before their turn comes."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Final, Protocol

from breplake.errors import InputError
from breplake.ingest.failure import advise
from breplake.ingest.inputs import Input
from breplake.ingest.sources.facts import Facts
from breplake.ingest.sources.feed import ArchiveFeed
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.origin import MemberOrigin, UriOrigin
from breplake.ingest.sources.survey import FACTS

__all__ = ["Fetcher", "Gets"]

_AT_ONCE: Final = 16
"""Inputs that are brought at the same time."""


class Gets(Protocol):
    """Gets the file of an address."""

    def fetch(self, uri: str, sha256: str, target: Path) -> Path:
        """Return a file with the bytes of that hash: one that is kept, or else `target`."""


class Fetcher:
    """Brings inputs that are members of archives or have to be downloaded, until it is closed.

    Parameters
    ----------
    inputs : iterable of Input
        All that may be asked for, so that each archive is read once and no further than needed.
    folder : Path
        Folder for what is unpacked ahead, made if it does not exist; best on the same disk as
        the targets.
    ledger : Ledger
        Has the facts of ABC's models.
    downloads : Gets
        Gets what has an address.
    limits : Limits
        How far archives are trusted.
    """

    def __init__(
        self,
        inputs: Iterable[Input],
        folder: Path,
        ledger: Ledger,
        downloads: Gets,
        limits: Limits,
    ) -> None:
        self._folder, self._ledger, self._downloads = folder, ledger, downloads
        self._limits = limits
        self._wanted: dict[Path, list[int]] = {}
        for item in inputs:
            if isinstance(item.origin, MemberOrigin) and item.failure is None:
                self._wanted.setdefault(item.origin.archive, []).append(item.origin.place)
        self._left = {archive: set(places) for archive, places in self._wanted.items()}
        self._feeds: dict[Path, ArchiveFeed] = {}
        self._numbers = count()
        self._lock = Lock()
        self._pool = ThreadPoolExecutor(_AT_ONCE)

    def close(self) -> None:
        """Stop all that is under way, and remove what was unpacked and not taken."""
        with self._lock:
            feeds, self._feeds = self._feeds, {}
        for feed in feeds.values():
            feed.close()
        self._pool.shutdown(cancel_futures=True)
        shutil.rmtree(self._folder, ignore_errors=True)

    def take(self, item: Input, target: Path) -> Future[Input]:
        """Bring the bytes of an input; asking in the order of `inputs` costs the least disk.

        Parameters
        ----------
        item : Input
            One of the inputs; it has an origin.
        target : Path
            Existing folder for its file.

        Returns
        -------
        Future of Input
            The input with its file and facts. It raises :class:`InputError` if the bytes cannot
            be had or are not those that were planned, and OSError if the disk is full.
        """
        if isinstance(item.origin, MemberOrigin):
            member = self._feed(item.origin.archive).take(item.origin.place)
            return self._pool.submit(self._member, item, item.origin, member, target)
        if isinstance(item.origin, UriOrigin):
            return self._pool.submit(self._address, item, item.origin, target)
        raise AssertionError(f"{item.shown} has no origin, so there is nothing to bring")

    def _feed(self, archive: Path) -> ArchiveFeed:
        with self._lock:
            if archive not in self._feeds:
                folder = self._folder / str(next(self._numbers))
                folder.mkdir(parents=True)
                places = self._wanted[archive]
                self._feeds[archive] = ArchiveFeed(archive, places, folder, self._limits)
            return self._feeds[archive]

    def _settle(self, origin: MemberOrigin) -> None:
        """Note that a member was had, or cannot be; the last one ends the archive's process."""
        with self._lock:
            left = self._left[origin.archive]
            left.discard(origin.place)
            feed = None if left else self._feeds.pop(origin.archive, None)
        if feed is not None:
            feed.close()

    def _member(
        self, item: Input, origin: MemberOrigin, member: Future[tuple[Path, str]], target: Path
    ) -> Input:
        try:
            unpacked, sha256 = member.result()
        finally:
            self._settle(origin)
        if sha256 != item.sha256:
            unpacked.unlink()
            detail = f"{origin.archive} changed since it was planned"
            raise InputError("hash-mismatch", advise("hash-mismatch", detail))
        file = target / _file_name(item)
        shutil.move(unpacked, file)
        known = self._ledger.get(FACTS, origin.facts) if origin.facts else None
        facts = item.facts.over(Facts.of(known)) if known else item.facts
        return replace(item, path=file, facts=facts)

    def _address(self, item: Input, origin: UriOrigin, target: Path) -> Input:
        if item.sha256 is None:
            raise AssertionError(f"{item.shown} was planned without its hash")
        file = self._downloads.fetch(origin.uri, item.sha256, target / _file_name(item))
        size = file.stat().st_size
        if not size:
            raise InputError("empty-file", advise("empty-file", ""))
        return replace(item, path=file, bytes=size)


def _file_name(item: Input) -> str:
    """Return a name for the file of an input, of which the worker reads whether it is packed."""
    packed = item.shown.partition("?")[0].lower().endswith(".gz")
    return f"source.{item.format}{'.gz' if packed else ''}"
