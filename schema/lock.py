"""The lock that keeps writers of one lake from mistaking each other's files for leftovers."""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["writer_lock"]


@contextmanager
def writer_lock(root: Path, waiting: Callable[[], None] | None = None) -> Iterator[None]:
    """Hold the writer's lock of the lake in `root`, waiting for whoever holds it.

    Files that no snapshot names are taken for what an interrupted writer left; those of a
    running one look the same. The system drops the lock when the process dies. It binds
    processes of one machine, and those of several where the file system carries locks over.

    Parameters
    ----------
    root : pathlib.Path
        The lake's folder.
    waiting : callable, optional
        Called once if another process holds the lock.
    """
    with (root / "writer.lock").open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if waiting is not None:
                waiting()
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
