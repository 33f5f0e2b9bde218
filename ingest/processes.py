"""Tasks in processes of their own: whatever happens there happens to one task."""

from __future__ import annotations

import concurrent.futures
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from multiprocessing.context import ForkServerContext, ForkServerProcess
from multiprocessing.popen_forkserver import Popen
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Generic, Literal, TypeVar

from breplake.errors import KernelUnavailableError, MissingExtraError
from breplake.ingest.orphans import die_with_parent

__all__ = ["Ended", "Processes"]

Key = TypeVar("Key")

_AHEAD: Final = 4
"""Tasks waiting for each process: enough to keep it busy, few enough to stop quickly."""

_BREAKS: Final = 4
"""Pools that may break with a task in work before the task is to blame."""

_PAUSE: Final = 0.5
"""Seconds after which a quiet pool lets its owner look whether to stop."""

_SERVER_DIED: Final = 255
"""Exit code that `multiprocessing` makes up where the fork server died with its workers."""


@dataclass(frozen=True, slots=True)
class Ended(Generic[Key]):
    """How a task ended.

    Parameters
    ----------
    key
        What it was begun as.
    value
        What the function returned, if it did.
    killed : {"time", "memory", "death"}, optional
        What ended it instead: its time or memory ran out, or its process died.
    exitcode : int
        Of a process that died; negative for a signal.
    """

    key: Key
    value: Any = None
    killed: Literal["time", "memory", "death"] | None = None
    exitcode: int = 0


@dataclass(slots=True)
class _Task(Generic[Key]):
    key: Key
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    pool: int = 0
    breaks: int = 0


class Processes(Generic[Key]):
    """Runs each task in a fresh, silent process with limited time and memory.

    The pool of processes is ``pebble``'s. It gives up, with all its tasks, when a process dies
    before it has said which task it took, and when the fork server dies. That is rare and no
    task's fault, so the tasks are then given to a new pool.

    Parameters
    ----------
    jobs : int
        Number of processes.
    memory : float
        Address space that each may take, GiB.
    timeout : float
        Seconds for a task.
    need : str
        What wants them, for the message of an error.

    Raises
    ------
    MissingExtraError
        If pebble is not installed.
    """

    def __init__(self, jobs: int, memory: float, timeout: float, need: str) -> None:
        self._jobs, self._memory, self._timeout, self._need = jobs, memory, timeout, need
        self._running: dict[Any, _Task[Key]] = {}
        self._number = 0
        self._pool = self._new_pool()

    def __enter__(self) -> Processes[Key]:
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:
        self._stop()

    def __len__(self) -> int:
        """Return how many tasks were begun and have not been seen to end."""
        return len(self._running)

    def has_room(self, beside: int = 0) -> bool:
        """Return whether another task, `beside` others on their way, may be begun now."""
        return len(self._running) + beside < self._jobs * _AHEAD

    def begin(self, key: Key, function: Callable[..., Any], *arguments: Any) -> None:
        """Have a process call a function of a module; the user's script is not at hand there.

        Parameters
        ----------
        key
            Tells the task from the others.
        function : callable
            What to call; if a pool breaks it is called again.
        *arguments
            What to call it with.

        Raises
        ------
        KernelUnavailableError
            If no process can start.
        ValueError
            If the function is defined in the script that runs.
        """
        if function.__module__ == "__main__":
            raise ValueError(f"{function.__qualname__} is in no module; import it from one")
        self._give(_Task(key, function, arguments))

    def each(
        self, function: Callable[..., Any], tasks: Iterable[tuple[Key, tuple[Any, ...]]]
    ) -> Iterator[Ended[Key]]:
        """Call a function for each of many tasks; yield them as they end.

        Parameters
        ----------
        function : callable
            What to call, as of `begin`.
        tasks : iterable of tuple
            Key and arguments of each, taken as there is room.

        Raises
        ------
        KernelUnavailableError
            If no process can start.
        """
        waiting = iter(tasks)
        has_more = True
        while has_more or self:
            while has_more and self.has_room():
                task = next(waiting, None)
                if task is None:
                    has_more = False
                else:
                    self.begin(task[0], function, *task[1])
            self.wait()
            yield from self.ended()

    def wait(self, also: Iterable[concurrent.futures.Future[Any]] = ()) -> None:
        """Wait until a task, or one of the futures `also`, ends; half a second at most."""
        waited = [*self._running, *also]
        concurrent.futures.wait(waited, _PAUSE, return_when="FIRST_COMPLETED")

    def ended(self) -> Iterator[Ended[Key]]:
        """Yield the tasks that have ended, each once.

        Raises
        ------
        KernelUnavailableError
            If no process can start any more.
        """
        for future in [future for future in self._running if future.done()]:
            task = self._running.pop(future)
            if not _is_broken(future):
                yield _ending(task.key, future)
                continue
            task.breaks += 1
            if task.pool == self._number:
                self._renew()
            if task.breaks < _BREAKS:
                self._give(task)
            else:
                yield Ended(task.key, killed="death", exitcode=_SERVER_DIED)
        self._take_over()

    def _give(self, task: _Task[Key]) -> None:
        try:
            future = self._schedule(task)
        except RuntimeError:  # the pool broke and nobody knows yet
            self._renew()
            try:
                future = self._schedule(task)
            except BrokenExecutor as error:
                raise KernelUnavailableError(
                    f"no worker process can be started ({error.__cause__ or error}): see that "
                    f"{tempfile.gettempdir()} has a short path and room, and that more processes "
                    "are allowed"
                ) from error
        task.pool = self._number
        self._running[future] = task

    def _schedule(self, task: _Task[Key]) -> Any:
        return self._pool.schedule(task.function, args=task.arguments, timeout=self._timeout)

    def _renew(self) -> None:
        if error := _kernels_unavailable():
            raise error
        self._stop()
        self._number += 1
        self._pool = self._new_pool()

    def _take_over(self) -> None:
        """Give on what a pool that is no more was given and said nothing about."""
        for future, task in list(self._running.items()):
            if task.pool != self._number and not future.done():
                future.cancel()
                del self._running[future]
                self._give(task)

    def _new_pool(self) -> Any:
        try:
            from pebble import ProcessPool
        except ImportError as error:
            raise MissingExtraError("ingest", self._need) from error
        context = _Context()
        context.set_forkserver_preload(["breplake.ingest.preload"])
        return ProcessPool(
            max_workers=self._jobs,
            max_tasks=1,
            context=context,
            initializer=_confine,
            initargs=[int(self._memory * 2**30)],
        )

    def _stop(self) -> None:
        self._pool.stop()
        self._pool.join()


def _is_broken(future: Any) -> bool:
    """Return whether a future, which is done, ended with its pool or with the fork server."""
    from pebble import ProcessExpired

    if future.cancelled():
        return True
    error = future.exception()
    if isinstance(error, ProcessExpired):
        return bool(error.exitcode == _SERVER_DIED)
    return isinstance(error, BrokenExecutor)


def _ending(key: Key, future: Any) -> Ended[Key]:
    """Return how a task ended in a whole pool; an error that the function raised is raised."""
    from pebble import ProcessExpired

    try:
        return Ended(key, future.result())
    except concurrent.futures.TimeoutError:
        return Ended(key, killed="time")
    except MemoryError:
        return Ended(key, killed="memory")
    except ProcessExpired as error:
        return Ended(key, killed="death", exitcode=error.exitcode)


def _confine(limit: int) -> None:
    """Limit the address space of this process to `limit` bytes above what it starts with."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    total = pages * resource.getpagesize() + limit
    resource.setrlimit(resource.RLIMIT_AS, (total, total))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    die_with_parent()
    # Ctrl-C goes to the whole group; the parent alone decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Some of OCCT's messages go past its messenger, straight to the standard output.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    from breplake.ingest.worker import silence

    silence()


def _kernels_unavailable() -> KernelUnavailableError | None:
    """Find out why no process can start; None if one can."""
    command = [sys.executable, "-P", "-c", "import breplake.ingest.preload"]
    probe = subprocess.run(command, capture_output=True, text=True, check=False)
    if not probe.returncode:
        return None
    lines = probe.stderr.strip().splitlines() or ["the workers died without a word"]
    return KernelUnavailableError(
        f"Open CASCADE or Gmsh cannot be loaded: {lines[-1]}. On Debian and Ubuntu: "
        "apt-get install libgl1 libglu1-mesa libxcursor1 libxft2 libxinerama1 libfontconfig1"
    )


class _Popen(Popen):
    """Starts a process that does not run the user's script again.

    Else a script that calls ingest at its top level would start itself in each of its workers.
    """

    _lock: Final = threading.Lock()

    def _launch(self, process_obj: BaseProcess) -> None:
        main = sys.modules["__main__"]
        with self._lock:
            spec = main.__spec__
            main.__spec__ = ModuleSpec("__main__", None)  # which a new process leaves alone
            try:
                super()._launch(process_obj)  # type: ignore[misc]
            finally:
                main.__spec__ = spec


class _Process(ForkServerProcess):
    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Popen:
        return _Popen(process_obj)


class _Context(ForkServerContext):
    Process = _Process
