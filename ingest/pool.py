"""Run models in processes of their own, and survive whatever happens there."""

from __future__ import annotations

import concurrent.futures
import errno
import os
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from breplake.errors import InputError
from breplake.ingest.failure import CHANGED, Failure, advise
from breplake.ingest.inputs import Input
from breplake.ingest.processes import Ended, Processes
from breplake.ingest.settings import RUNGS, Settings
from breplake.ingest.sources.fetch import Fetcher
from breplake.ingest.spool import HANG_EXIT, Spool

__all__ = ["Result", "discard", "run_models"]

_BEFORE: Final = ("plan", "fetch", "read")
"""Stages in which the bytes of an input are got."""


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
    """

    input: Input
    spool: Spool
    failures: list[Failure] = field(default_factory=list)
    is_resumed: bool = False

    @property
    def recorded(self) -> bool:
        """Whether the input becomes a row of ``models``."""
        return self.spool.has_record

    @property
    def is_unread(self) -> bool:
        """Whether it failed before its file was read, which says nothing about the model."""
        return not self.recorded and any(f.fatal and f.stage in _BEFORE for f in self.failures)

    @property
    def is_changed(self) -> bool:
        """Whether its files were no longer those that were planned when they were read."""
        return not self.recorded and any((f.stage, f.kind) == CHANGED for f in self.failures)


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
    MissingExtraError, KernelUnavailableError
        If no worker can start.
    """
    waiting = list(reversed(inputs))
    fetching: dict[concurrent.futures.Future[Input], Result] = {}
    with Processes[Result](jobs, settings.memory, settings.timeout, "breplake ingest") as processes:
        while (waiting or processes or fetching) and not stop():
            while waiting and processes.has_room(len(fetching)):
                item = waiting.pop()
                result = Result(item, spools(item), [item.failure] if item.failure else [])
                result.spool.folder.mkdir()
                if result.failures:
                    yield result
                elif fetcher is not None and item.origin is not None:
                    fetching[fetcher.take(item, result.spool.folder)] = result
                else:
                    _attempt(processes, result, settings, 0)
            processes.wait(fetching)
            for future in [future for future in fetching if future.done()]:
                result = fetching.pop(future)
                if isinstance(future.exception(), KeyboardInterrupt):
                    return  # a download that saw `stop` before we did: all in work is given up
                if _fetched(future, result):
                    _attempt(processes, result, settings, 0)
                else:
                    yield result
            for ended in processes.ended():
                result = ended.key
                again = _take(ended, settings)
                if again is not None:
                    _attempt(processes, result, settings, again)
                else:
                    _drop_fetched(result)
                    yield result


def _attempt(processes: Processes[Result], result: Result, settings: Settings, rung: int) -> None:
    """Give a model to a process, at a rung of the mesh ladder."""
    result.spool.start()
    processes.begin(result, _call, result.input, settings, result.spool, rung)


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


def _call(item: Input, settings: Settings, spool: Spool, rung: int) -> list[Failure]:
    from breplake.ingest.worker import Task, work

    return work(Task(item, settings, spool, rung))


def _take(ended: Ended[Result], settings: Settings) -> int | None:
    """Add a finished attempt to its result; return the rung to try next, if any."""
    result = ended.key
    if ended.killed:
        return _killed(ended, settings)
    result.failures += ended.value
    if any(failure.kind == "disk-full" for failure in result.failures):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(result.spool.folder))
    return None


def _killed(ended: Ended[Result], settings: Settings) -> int | None:
    """Attribute a killed attempt; return the rung to try next, if any."""
    result, spool = ended.key, ended.key.spool
    stage, detail = spool.stage
    where = f"{stage} {detail}".strip()
    result.failures += [Failure(**noted) for noted in spool.take_notes()]
    if ended.killed == "time":
        message = advise("timeout", f"{where} ran into the limit of {settings.timeout:g} s")
        killed = Failure(stage, "timeout", message, fatal=False)
    elif ended.killed == "memory":
        message = advise("memory", f"{where} passed {settings.memory:g} GiB")
        killed = Failure(stage, "memory", message, fatal=False)
    else:
        killed = _crash(stage, where, ended.exitcode, spool.hang_reason)
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
