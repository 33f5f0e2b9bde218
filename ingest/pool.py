"""Run models in processes of their own, and survive whatever happens there."""

from __future__ import annotations

import concurrent.futures
import errno
import multiprocessing
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from breplake.errors import InputError, KernelUnavailableError, MissingExtraError
from breplake.ingest.failure import Failure, advise
from breplake.ingest.inputs import Input
from breplake.ingest.orphans import die_with_parent
from breplake.ingest.settings import RUNGS, Settings
from breplake.ingest.sources.fetch import Fetcher
from breplake.ingest.spool import HANG_EXIT, Spool

__all__ = ["Result", "discard", "isolated_pool", "kernels_unavailable", "run_models"]

_AHEAD: Final = 4
"""Tasks waiting for each worker: enough to keep it busy, few enough to stop quickly."""

_BEFORE: Final = ("plan", "fetch", "read")
"""Stages in which the bytes of an input are got."""

_BREAKS: Final = 4
"""Pools that may break with a model in work before it is to blame."""

_PAUSE: Final = 0.5
"""Seconds after which a quiet pool looks whether it is to stop."""


@dataclass(slots=True)
class Result:
    """How one input ended.

    Parameters
    ----------
    input : Input
        The file.
    spool : Spool
        Where its record lies, if `recorded`.
    failures : list of Failure
        In order of attempts; the last is fatal if there is no record.
    is_resumed : bool
        Whether an earlier run had finished it.
    pool : int
        Number of the pool that it was last given to.
    breaks : int
        How many pools broke while they had it.
    """

    input: Input
    spool: Spool
    failures: list[Failure] = field(default_factory=list)
    is_resumed: bool = False
    pool: int = 0
    breaks: int = 0

    @property
    def recorded(self) -> bool:
        """Whether the input becomes a row of ``models``."""
        return self.spool.has_record

    @property
    def is_unread(self) -> bool:
        """Whether it failed before its file was read, which says nothing about the model."""
        return not self.recorded and any(f.fatal and f.stage in _BEFORE for f in self.failures)


def run_models(
    inputs: Sequence[Input],
    settings: Settings,
    jobs: int,
    spools: Callable[[Input], Spool],
    stop: Callable[[], bool] = lambda: False,
    fetcher: Fetcher | None = None,
) -> Iterator[Result]:
    """Ingest every input in an isolated process and yield the results as they come.

    A worker that crashes, hangs or runs out of memory costs its model one attempt. If it was
    meshing, the next rung of the mesh ladder gets the next attempt; otherwise the model keeps
    what it had handed over.

    Parameters
    ----------
    inputs : sequence of Input
        What to ingest.
    settings : Settings
        Limits and mesh.
    jobs : int
        Number of processes.
    spools : callable
        Gives the spool of an input, whose folder does not exist; it is the caller's to delete.
    stop : callable
        Asked about twice a second; once it returns True the models in work are given up.
    fetcher : Fetcher, optional
        Brings the bytes of the inputs that are in no file yet.

    Raises
    ------
    OSError
        With ``ENOSPC`` if a worker finds the disk full: no model is to blame for that.
    """
    waiting = list(reversed(inputs))
    running: dict[Any, Result] = {}
    fetching: dict[concurrent.futures.Future[Input], Result] = {}
    workers = _Workers(jobs, settings)
    try:
        while (waiting or running or fetching) and not stop():
            while waiting and len(running) + len(fetching) < jobs * _AHEAD:
                item = waiting.pop()
                result = Result(item, spools(item), [item.failure] if item.failure else [])
                result.spool.folder.mkdir()
                if result.failures:
                    yield result
                elif fetcher is not None and item.origin is not None:
                    fetching[fetcher.take(item, result.spool.folder)] = result
                else:
                    running[workers.submit(result, 0)] = result
            done, _ = concurrent.futures.wait(
                [*running, *fetching], _PAUSE, return_when="FIRST_COMPLETED"
            )
            for future in done & fetching.keys():
                result = fetching.pop(future)
                if _fetched(future, result):
                    running[workers.submit(result, 0)] = result
                else:
                    yield result
            for future in done & running.keys():
                result = running.pop(future)
                again = workers.recover(result) if _is_broken(future) else None
                if again is None:
                    again = _take(future, result, settings)
                if again is not None:
                    running[workers.submit(result, again)] = result
                else:
                    _drop_fetched(result)
                    yield result
            workers.take_over(running)
    finally:
        workers.stop()


class _Workers:
    """A pool of processes, and the next one if it breaks.

    ``pebble`` gives up a pool, and all its tasks, when a process dies before it has said which
    task it took. That is rare and no model's fault, so the tasks are given to a new pool.
    """

    def __init__(self, jobs: int, settings: Settings) -> None:
        self._jobs, self._settings = jobs, settings
        self._number = 0
        self._pool = isolated_pool(jobs, settings.memory, "breplake ingest")

    def submit(self, result: Result, rung: int) -> Any:
        """Give a model to a process; return its future."""
        result.spool.start()
        arguments = [result.input, self._settings, result.spool, rung]
        try:
            future = self._pool.schedule(_call, args=arguments, timeout=self._settings.timeout)
        except RuntimeError:  # the pool broke and nobody knows yet
            self._renew()
            try:
                future = self._pool.schedule(_call, args=arguments, timeout=self._settings.timeout)
            except BrokenExecutor as error:
                raise KernelUnavailableError(
                    f"no worker process can be started ({error.__cause__ or error}): see that "
                    f"{tempfile.gettempdir()} has a short path and room, and that more processes "
                    "are allowed"
                ) from error
        result.pool = self._number
        return future

    def recover(self, result: Result) -> int | None:
        """Return the rung to try after a pool broke; None if it broke too often with a model.

        Raises
        ------
        KernelUnavailableError
            If no process can start at all.
        """
        if result.pool == self._number:
            self._renew()
        result.breaks += 1
        return 0 if result.breaks < _BREAKS else None

    def _renew(self) -> None:
        if error := kernels_unavailable():
            raise error
        self.stop()
        self._number += 1
        self._pool = isolated_pool(self._jobs, self._settings.memory, "breplake ingest")

    def take_over(self, running: dict[Any, Result]) -> None:
        """Take what was given to a pool that is no more, and that it said nothing about."""
        for future, result in list(running.items()):
            if result.pool != self._number and not future.done():
                future.cancel()
                del running[future]
                running[self.submit(result, 0)] = result

    def stop(self) -> None:
        """End all processes; what they have in work is lost."""
        self._pool.stop()
        self._pool.join()


def _is_broken(future: Any) -> bool:
    """Return whether a future, which is done, ended with its pool."""
    return future.cancelled() or isinstance(future.exception(), BrokenExecutor)


def _fetched(future: concurrent.futures.Future[Input], result: Result) -> bool:
    """Give a result its fetched input, or the failure to fetch it; return whether it is there."""
    try:
        result.input = future.result()
    except InputError as error:
        result.failures.append(Failure("fetch", error.kind, str(error), fatal=True))
        return False
    return True


def _drop_fetched(result: Result) -> None:
    """Delete the bytes that were brought for a model: its shard may be far from complete."""
    path = result.input.path
    if result.input.origin is not None and path.parent == result.spool.folder:
        path.unlink(missing_ok=True)


def isolated_pool(jobs: int, memory: float, need: str) -> Any:
    """Return a ``pebble.ProcessPool`` with a fresh, silent process for each task.

    Parameters
    ----------
    jobs : int
        Number of processes.
    memory : float
        Address space each may take, GiB.
    need : str
        What wants it, for the message of an error.

    Raises
    ------
    MissingExtraError
        If pebble is not installed.
    """
    try:
        from pebble import ProcessPool
    except ImportError as error:
        raise MissingExtraError("ingest", need) from error
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["breplake.ingest.preload"])
    limit = int(memory * 2**30)
    return ProcessPool(
        max_workers=jobs, max_tasks=1, context=context, initializer=_confine, initargs=[limit]
    )


def _confine(limit: int) -> None:
    """Limit the address space of this worker to `limit` bytes above what it starts with."""
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


def _call(item: Input, settings: Settings, spool: Spool, rung: int) -> list[Failure]:
    from breplake.ingest.worker import Task, work

    return work(Task(item, settings, spool, rung))


def _take(future: Any, result: Result, settings: Settings) -> int | None:
    """Add a finished attempt to its result; return the rung to try next, if any."""
    from pebble import ProcessExpired

    try:
        result.failures += future.result()
    except (BrokenExecutor, concurrent.futures.CancelledError):
        broke = ProcessExpired("the pool broke", code=1)  # type: ignore[no-untyped-call]
        return _killed(broke, result, settings)
    except (concurrent.futures.TimeoutError, ProcessExpired, MemoryError) as error:
        return _killed(error, result, settings)
    if any(failure.kind == "disk-full" for failure in result.failures):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(result.spool.folder))
    return None


def _killed(error: BaseException, result: Result, settings: Settings) -> int | None:
    """Attribute a killed attempt; return the rung to try next, if any."""
    from pebble import ProcessExpired

    spool = result.spool
    stage, detail = spool.stage
    where = f"{stage} {detail}".strip()
    result.failures += [Failure(**noted) for noted in spool.take_notes()]
    if isinstance(error, concurrent.futures.TimeoutError):
        message = advise("timeout", f"{where} ran into the limit of {settings.timeout:g} s")
        killed = Failure(stage, "timeout", message, fatal=False)
    elif isinstance(error, ProcessExpired):
        killed = _crash(stage, where, error.exitcode, spool.hang_reason)
    else:
        message = advise("memory", f"{where} passed {settings.memory:g} GiB")
        killed = Failure(stage, "memory", message, fatal=False)
    killed = replace(killed, seconds=spool.age())
    ladder = RUNGS[settings.mesh]
    if stage in ("mesh", "truth") and detail in ladder[:-1]:
        result.failures.append(killed)
        return ladder.index(detail) + 1
    if stage == "import":
        # The rung below the ladder does without Gmsh.
        result.failures.append(killed)
        return len(ladder)
    result.failures.append(replace(killed, fatal=not result.recorded))
    return None


def kernels_unavailable() -> KernelUnavailableError | None:
    """Find out why no worker can start; None if one can."""
    command = [sys.executable, "-P", "-c", "import breplake.ingest.preload"]
    probe = subprocess.run(command, capture_output=True, text=True, check=False)
    if not probe.returncode:
        return None
    lines = probe.stderr.strip().splitlines() or ["the workers died without a word"]
    return KernelUnavailableError(
        f"Open CASCADE or Gmsh cannot be loaded: {lines[-1]}. On Debian and Ubuntu: "
        "apt-get install libgl1 libglu1-mesa libxcursor1 libxft2 libxinerama1 libfontconfig1"
    )


def _crash(stage: str, where: str, exitcode: int, hang_reason: str) -> Failure:
    if exitcode == HANG_EXIT and hang_reason:
        message = advise("mesh-hang", f"{where}: {hang_reason}")
        return Failure(stage, "mesh-hang", message, fatal=False)
    if exitcode < 0:
        name = signal.Signals(-exitcode).name
        message = advise("killed-signal", f"{where} ended with {name}")
        return Failure(stage, "killed-signal", message, fatal=False, signal=-exitcode)
    message = advise("worker-died", f"{where} ended with exit code {exitcode}")
    return Failure(stage, "worker-died", message, fatal=False)


def discard(result: Result) -> None:
    """Delete what a result left on disk."""
    shutil.rmtree(result.spool.folder, ignore_errors=True)
