"""The other end of :mod:`breplake.ingest.sources.unpack`: an archive read in its own process."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from breplake.errors import MissingExtraError, RefusedSourceError
from breplake.ingest.printable import printable
from breplake.ingest.sources.entry import Damage, archive_format
from breplake.ingest.sources.sevens import need_py7zr
from breplake.ingest.sources.unpack import Request

__all__ = ["ArchiveReader"]

_COMMAND = (sys.executable, "-P", "-m", "breplake.ingest.sources.unpack")


class ArchiveReader:
    """A process that reads one archive. Closing it ends the process.

    Parameters
    ----------
    request : Request
        What is to be read.

    Raises
    ------
    MissingExtraError
        If reading archives of this kind needs a package that is not installed.

    Attributes
    ----------
    expansion : float
        How many times its own size the archive unpacks to, once all was read.
    """

    def __init__(self, request: Request) -> None:
        self.path = Path(request.archive)
        self.expansion = 0.0
        if archive_format(self.path) == "7z":
            need_py7zr()
        self._process = subprocess.Popen(
            _COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            encoding="utf-8",
        )
        self._send(request.line())

    def allow(self, count: int) -> None:
        """Let it write `count` files in all."""
        self._send(f"{count}\n")

    def _send(self, line: str) -> None:
        pipe = self._process.stdin
        if pipe is None:
            raise AssertionError("the process was started with a pipe")
        try:
            pipe.write(line)
            pipe.flush()
        except (BrokenPipeError, ValueError):
            return  # it has ended or was closed: `events` tells how

    def events(self) -> Iterator[tuple[str, list[Any]]]:
        """Yield what it finds, as word and values, until the archive is read.

        Raises
        ------
        RefusedSourceError
            If the archive is not safe.
        MissingExtraError
            If reading a member needs a package that is not installed.
        Damage
            If it cannot be read, or not further; also when the process crashes on it.
        """
        pipe = self._process.stdout
        if pipe is None:
            raise AssertionError("the process was started with a pipe")
        for line in pipe:
            word, *values = json.loads(line)
            if word == "end":
                self.expansion = float(values[0])
                return
            if word == "missing":
                raise MissingExtraError(*values)
            if word == "refused":
                raise RefusedSourceError(f"{printable(self.path)} is refused: {values[0]}")
            if word == "damaged":
                raise Damage(*values)
            yield word, values
        raise Damage("worker-died", self._death())

    def _death(self) -> str:
        code = self._process.wait()
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"the process that reads the archive ended with {how}"

    def stop(self) -> None:
        """End the process, whatever it is doing; `events` then comes to its end."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the process and give up its pipes, from which no other thread may read now."""
        self.stop()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):  # of a last permit that nobody took
                    pipe.close()
