"""Recognise from Gmsh's log that it will not come to an end, and stop it at once.

Gmsh splits edges of the 1D mesh that intersect and tries again, without a limit; where the
intersections are not the edges' fault their number doubles each time, and so does the time.
Where its triangulation of a closed surface folds, it tries a second, slow algorithm, surface by
surface. Both are plain from the log long before a time limit would tell.
"""

from __future__ import annotations

import os
import re
import select
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

__all__ = ["HangDetector", "watched"]

_INTERSECTIONS: Final = re.compile(r"There are (\d+) intersections in the 1D mesh")
_SURFACE: Final = re.compile(r"Meshing surface (\d+) \(\w+, ([\w -]+)\)")
_SLOW: Final = "MeshAdapt"

MOST_DOUBLINGS: Final = 3
"""Times in a row that the intersections of a surface may grow by half and more ..."""

MOST_INTERSECTIONS: Final = 80
"""... before they are this many. The slowest surface that did end had fewer."""

SLOW_SECONDS: Final = 20.0
"""CPU seconds that the second algorithm may take in all."""

_PATIENCE: Final = 1.0
"""Seconds of silence after which the time is looked at again."""


class HangDetector:
    """Judges the lines of a Gmsh log; a pure function of them and their times."""

    def __init__(self) -> None:
        self._surface = ""
        self._slow_since: float | None = None
        self._slow = 0.0
        self._slow_surface = ""
        self._count = 0
        self._growing = 0

    def feed(self, line: str, seconds: float) -> str | None:
        """Take a line and its time; return why Gmsh will not end, if that is plain now.

        Parameters
        ----------
        line : str
            A line of the log.
        seconds : float
            When it came, in CPU seconds.
        """
        if found := _SURFACE.search(line):
            self._finish(seconds)
            self._surface = found.group(1)
            self._slow_since = None
            if found.group(2) == _SLOW:
                self._slow_since, self._slow_surface = seconds, self._surface
            self._count = self._growing = 0
        elif found := _INTERSECTIONS.search(line):
            count = int(found.group(1))
            self._growing = self._growing + 1 if count >= 1.5 * self._count > 0 else 0
            self._count = count
            if self._growing >= MOST_DOUBLINGS and count >= MOST_INTERSECTIONS:
                return f"on surface {self._surface} the 1D mesh intersects itself in {count} places"
        return self.tick(seconds)

    def tick(self, seconds: float) -> str | None:
        """Judge a silence that lasts until `seconds`."""
        since = self._slow_since
        slow = self._slow + (seconds - since if since is not None else 0.0)
        if slow > SLOW_SECONDS:
            return f"{_SLOW} took {slow:.0f} s, last on surface {self._slow_surface}"
        return None

    def _finish(self, seconds: float) -> None:
        if self._slow_since is not None:
            self._slow += seconds - self._slow_since


@contextmanager
def watched(gmsh: Any, hangs: Callable[[str], None]) -> Iterator[None]:
    """Watch Gmsh's log during a block.

    Gmsh can neither be interrupted nor asked from another thread, so it writes its log to the
    standard output, which is a pipe meanwhile; a thread reads that while Gmsh computes.

    Parameters
    ----------
    gmsh : module
        Inside a session.
    hangs : callable
        Called in the reading thread with the reason, at most once. Ending the process is the
        only way to stop Gmsh.
    """
    read, write = os.pipe()
    before = os.dup(1)
    os.dup2(write, 1)
    os.close(write)
    reader = threading.Thread(target=_read, args=(read, hangs), daemon=True)
    reader.start()
    options = {"General.Verbosity": 4, "General.Terminal": 1}
    restore = {name: gmsh.option.getNumber(name) for name in options}
    try:
        for name, value in options.items():
            gmsh.option.setNumber(name, value)
        yield
    finally:
        for name, value in restore.items():
            gmsh.option.setNumber(name, value)
        os.dup2(before, 1)  # the last writing end of the pipe closes, which ends the reader
        os.close(before)
        reader.join()


def _read(pipe: int, hangs: Callable[[str], None]) -> None:
    detector, said, rest = HangDetector(), False, b""
    while True:
        ready, _, _ = select.select([pipe], [], [], _PATIENCE)
        block = os.read(pipe, 2**16) if ready else None
        if block == b"":
            break
        *lines, rest = (rest + (block or b"")).split(b"\n")
        now = time.process_time()  # CPU time: a busy machine is no reason to give up
        reasons = [detector.feed(line.decode(errors="replace"), now) for line in lines]
        reason = next(filter(None, reasons), None) or detector.tick(now)
        if reason and not said:
            said = True
            hangs(reason)
    os.close(pipe)
