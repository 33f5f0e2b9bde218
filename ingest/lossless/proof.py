"""Many models against their sources, each in a process of its own."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Iterator, Mapping
from typing import Any, Final

from breplake.errors import KernelUnavailableError
from breplake.ingest.lossless.compare import Comparison, compare_model
from breplake.ingest.lossless.rebuild import ModelTables
from breplake.ingest.pool import isolated_pool, kernels_unavailable

__all__ = ["compare_models"]

_AHEAD: Final = 4
"""Tasks waiting for each worker."""


def compare_models(
    lake: ModelTables,
    models: Mapping[int, str],
    *,
    jobs: int,
    timeout: float = 300.0,
    memory: float = 8.0,
) -> Iterator[Comparison]:
    """Compare models with their sources and yield the results as they come.

    A process that crashes, hangs or runs out of memory costs its model the comparison, and
    says so.

    Parameters
    ----------
    lake : breplake.queries.session.Lake
        The lake.
    models : mapping
        Names by model_id.
    jobs : int
        Number of processes.
    timeout : float
        Seconds for a model.
    memory : float
        Address space for a model, GiB.

    Raises
    ------
    MissingExtraError, KernelUnavailableError
        If no worker can start.
    """
    waiting = list(models.items())[::-1]
    running: dict[Any, tuple[int, str]] = {}
    pool = isolated_pool(jobs, memory, "breplake rebuild --compare")
    try:
        while waiting or running:
            while waiting and len(running) < jobs * _AHEAD:
                model_id, name = waiting.pop()
                task = pool.schedule(compare_model, args=[lake, model_id], timeout=timeout)
                running[task] = (model_id, name)
            done, _ = concurrent.futures.wait(running, return_when="FIRST_COMPLETED")
            for future in done:
                yield _result(future, *running.pop(future), timeout=timeout, memory=memory)
    except concurrent.futures.BrokenExecutor as error:
        broke = KernelUnavailableError("the worker processes broke: run the same command again")
        raise (kernels_unavailable() or broke) from error
    finally:
        pool.stop()
        pool.join()


def _result(future: Any, model_id: int, name: str, *, timeout: float, memory: float) -> Comparison:
    """Return what became of a model."""
    from pebble import ProcessExpired

    try:
        result: Comparison = future.result()
    except concurrent.futures.TimeoutError:
        reason = f"it took longer than {timeout:g} s; more time is given by --timeout"
    except MemoryError:
        reason = f"it needs more than {memory:g} GiB of memory"
    except ProcessExpired as error:
        reason = f"the CAD kernel crashed (exit code {error.exitcode})"
    else:
        return result
    return Comparison(model_id, name, "failed", [reason])
