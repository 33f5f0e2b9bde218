"""Hashes of many files: read in a few threads, and remembered from run to run.

A file whose path, size, inode and times are those of a file that was hashed before is that file,
so it is not read again. There is one gap: what is written twice within one tick of the clock of
its file system has one time. So a hash is remembered only if the file had been left alone for
two seconds, longer than any tick, before it was read.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import sqlite3
import stat
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from breplake.errors import InputError
from breplake.ingest.failure import advise
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.waiting import Tell, Waiting, silent

__all__ = ["Digest", "Hasher"]

_KIND: Final = "file-1"
"""Kind of the ledger's entries; another number where they change their meaning."""

_THREADS: Final = 8
"""Files that are read at the same time: a disk on a network answers slowly, but many at once."""

_BLOCK: Final = 2**20
_STEP: Final = 0.2
"""Seconds between two looks whether to stop, and between two reports."""

_TICK: Final = 2.0
"""Seconds of the coarsest clock of a file system (FAT)."""

_AT_ONCE: Final = 2000
"""Hashes that are put into the ledger together: each time costs the disk a flush."""

_PAUSE: Final = 10.0
"""Seconds after which they are put there though they are fewer."""

Item = TypeVar("Item")
Found = TypeVar("Found")


@dataclass(frozen=True, slots=True)
class Digest:
    """What was read of some files.

    Parameters
    ----------
    bytes : int
        Size of all.
    sha256 : str
        Hash of their bytes, one file after the other.
    has_empty : bool
        Whether one of them has no bytes.
    """

    bytes: int
    sha256: str
    has_empty: bool


_State = tuple[int, int, int, int]
"""Size, times of the last change of content and of anything, in ns, and inode."""


class Hasher:
    """Reads files for their hashes; safe to share between threads.

    Parameters
    ----------
    ledger : Ledger, optional
        Remembers hashes; without one every file is read.
    waiting : Waiting, optional
        Says when to stop.
    tell : Tell, optional
        Takes the progress.
    warn : callable, optional
        Takes what the user should know though the run goes on.
    rehash : bool
        Read also the files whose hash is remembered.
    """

    def __init__(
        self,
        ledger: Ledger | None = None,
        waiting: Waiting | None = None,
        tell: Tell = silent,
        warn: Callable[[str], None] = lambda _text: None,
        *,
        rehash: bool = False,
    ) -> None:
        self._ledger, self._tell, self._warn, self._rehash = ledger, tell, warn, rehash
        self._waiting = waiting or Waiting()
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._fresh: dict[str, list[Any]] = {}
        self._kept = self._told = time.monotonic()
        self._read = 0  # bytes

    def look(self, text: str) -> None:
        """Tell now and then what is done, and go on unless the run is to stop.

        Raises
        ------
        KeyboardInterrupt
            If it is.
        """
        self._waiting.check()
        if time.monotonic() - self._told > _STEP:
            self._told = time.monotonic()
            self._tell(text, 0, None)

    def over(
        self,
        items: Sequence[Item],
        work: Callable[[Item], Found],
        text: str,
        threads: int = _THREADS,
    ) -> list[Found]:
        """Return what `work` gives for each item, in their order; it is done in threads.

        Parameters
        ----------
        items : sequence
            What is worked on.
        work : callable
            Is called with each item, in some thread; it may call :meth:`digest`.
        text : str
            What is told to be done.
        threads : int
            How many items at the same time.

        Raises
        ------
        KeyboardInterrupt
            If the run is to stop; what was hashed so far is remembered.
        """
        found: dict[int, Found] = {}
        left = iter(range(len(items)))

        def drain() -> None:
            while not self._ended.is_set():
                with self._lock:
                    number = next(left, None)
                if number is None:
                    return
                found[number] = work(items[number])

        try:
            with ThreadPoolExecutor(threads) as pool:
                tasks = {pool.submit(drain) for _ in range(min(threads, len(items)))}
                try:
                    while tasks:
                        ended, tasks = wait(tasks, _STEP, FIRST_EXCEPTION)
                        for task in ended:
                            task.result()
                        self._waiting.check()
                        self._tell(f"{text}, {self._read / 1e9:.1f} GB", len(found), len(items))
                finally:
                    self._ended.set()  # the other threads' sign to end, in the middle of a file
        finally:
            self._ended.clear()
            self._keep(0)
        return [found[number] for number in range(len(items))]

    def digest(self, paths: Sequence[Path]) -> Digest:
        """Return size and hash of files, one after the other.

        Raises
        ------
        InputError
            ``not-a-file`` or ``unreadable``.
        """
        before = [_state(path) for path in paths]
        key = json.dumps([os.path.abspath(path) for path in paths])
        sha256 = self._remembered(key, before)
        if sha256 is not None:
            return Digest(sum(state[0] for state in before), sha256, not all(s[0] for s in before))
        began = time.time()
        digest = hashlib.sha256()
        read = [self._add(path, digest) for path in paths]
        if read == before and all(_rested(state, began) for state in before):
            self._note(key, [digest.hexdigest(), *before])
        return Digest(sum(s[0] for s in read), digest.hexdigest(), not all(s[0] for s in read))

    def _add(self, path: Path, digest: hashlib._Hash) -> _State:
        """Add the bytes of a file to a hash; return their number and the times of the file."""
        size = 0
        try:
            with path.open("rb", buffering=0) as file:
                while block := file.read(_BLOCK):
                    if self._ended.is_set():
                        raise _Stopped
                    digest.update(block)
                    size += len(block)
                status = os.fstat(file.fileno())
        except OSError as error:
            raise _unreadable(error) from error
        with self._lock:
            self._read += size
        return size, *_times(status)

    def _remembered(self, key: str, states: Sequence[_State]) -> str | None:
        if self._ledger is None or self._rehash:
            return None
        try:
            known = self._ledger.get(_KIND, key)
        except sqlite3.Error as error:
            self._forget(error)
            return None
        return known[0] if known and known[1:] == [list(state) for state in states] else None

    def _note(self, key: str, value: list[Any]) -> None:
        if self._ledger is not None:
            with self._lock:
                self._fresh[key] = value
            self._keep(_AT_ONCE)

    def _keep(self, least: int) -> None:
        """Put what was found into the ledger, unless it is less than `least` and fresh."""
        with self._lock:
            is_late = time.monotonic() - self._kept > _PAUSE
            if not self._fresh or (len(self._fresh) < least and not is_late):
                return
            fresh, self._fresh, self._kept = self._fresh, {}, time.monotonic()
        ledger = self._ledger
        if ledger is not None:
            try:
                ledger.put_all(_KIND, fresh)
            except sqlite3.Error as error:
                self._forget(error)

    def _forget(self, error: sqlite3.Error) -> None:
        """Go on without the ledger, which saves time only."""
        with self._lock:
            ledger, self._ledger = self._ledger, None
        if ledger is not None:
            self._warn(
                f"the cache {ledger.folder} cannot be used any more ({error}): hashes of files are "
                "not remembered, so the next run reads them again"
            )


class _Stopped(Exception):
    """The run ends, or another file ended it: what this thread reads is of no use."""


def _state(path: Path) -> _State:
    """Return size and times of a file.

    Raises
    ------
    InputError
        If it is none, or cannot be looked at.
    """
    try:
        status = path.stat()
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ENOTDIR, errno.ELOOP):
            raise _no_file("this is no regular file") from error
        raise _unreadable(error) from error
    if stat.S_ISDIR(status.st_mode):
        raise _no_file("this is a folder")
    if not stat.S_ISREG(status.st_mode):
        raise _no_file("this is no regular file")
    return status.st_size, *_times(status)


def _times(status: os.stat_result) -> tuple[int, int, int]:
    return status.st_mtime_ns, status.st_ctime_ns, status.st_ino


def _rested(state: _State, began: float) -> bool:
    """Return whether a file had been left alone for a while when its reading began."""
    return began - max(state[1:3]) / 1e9 > _TICK


def _no_file(what: str) -> InputError:
    return InputError("not-a-file", advise("not-a-file", what))


def _unreadable(error: OSError) -> InputError:
    detail = error.strerror or type(error).__name__
    return InputError("unreadable", advise("unreadable", detail))
