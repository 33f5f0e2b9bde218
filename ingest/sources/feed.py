"""Gives the members of one archive as files, while it is read once from beginning to end."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Final

from breplake.errors import BreplakeError, InputError, RefusedSourceError
from breplake.ingest.failure import advise
from breplake.ingest.sources.entry import Damage
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.reader import ArchiveReader
from breplake.ingest.sources.unpack import Request

__all__ = ["ArchiveFeed"]

_AHEAD: Final = 8
"""Members that are unpacked before they are asked for."""


class ArchiveFeed:
    """Unpacks some members of an archive, a few ahead of those that are taken.

    However the members are asked for, the archive is read once and in its order. Members that
    are asked for in that order keep the number of files on disk small; asking for a later one
    unpacks all before it.

    Parameters
    ----------
    archive : Path
        The archive.
    places : sequence of int
        The members that will be asked for.
    folder : Path
        Existing folder for them, of this feed alone.
    limits : Limits
        How far the archive is trusted.
    """

    def __init__(self, archive: Path, places: Sequence[int], folder: Path, limits: Limits) -> None:
        self._archive, self._folder = archive, folder
        ordered = sorted(set(places))
        self._rank = {place: rank for rank, place in enumerate(ordered)}
        self._futures: dict[int, Future[tuple[Path, str]]] = {p: Future() for p in ordered}
        self._allowed = 0
        self._reader = ArchiveReader(Request(str(archive), limits, ordered, str(folder)))
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def take(self, place: int) -> Future[tuple[Path, str]]:
        """Ask for a member.

        Returns
        -------
        Future of (Path, str)
            Its file, which is the caller's, and the SHA-256 of its bytes. It raises
            :class:`InputError` if the member cannot be read, and OSError if the disk is full.
        """
        wanted = min(self._rank[place] + 1 + _AHEAD, len(self._rank))
        if wanted > self._allowed:
            self._allowed = wanted
            self._reader.allow(wanted)
        return self._futures[place]

    def close(self) -> None:
        """End the reading. What was asked for and has not come raises an error."""
        self._reader.stop()
        self._thread.join()
        self._reader.close()

    def _listen(self) -> None:
        try:
            for word, (place, *values) in self._reader.events():
                if word == "done":
                    self._futures[place].set_result((self._folder / str(place), values[1]))
                elif word == "bad":
                    kind, detail = values
                    self._futures[place].set_exception(InputError(kind, advise(kind, detail)))
        except Damage as damage:
            self._fail_rest(damage.kind, damage.detail)
        except RefusedSourceError as error:
            self._fail_rest("refused", str(error))
        except BreplakeError as error:
            self._fail_rest("bad-archive", str(error))
        except Exception as error:  # whoever waits for a member would wait for ever
            self._fail_rest("error", f"{type(error).__name__}: {error}")
        else:
            self._fail_rest("bad-archive", "the archive lacks this member")

    def _fail_rest(self, kind: str, detail: str) -> None:
        full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._folder))
        for future in self._futures.values():
            if not future.done():
                message = advise(kind, f"{self._archive}: {detail}")
                future.set_exception(full if kind == "disk-full" else InputError(kind, message))
