"""Many models against their sources, each in a process of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from breplake.ingest.lossless.compare import Comparison, compare_model
from breplake.ingest.lossless.rebuild import ModelTables
from breplake.ingest.processes import Ended, Processes

__all__ = ["compare_models"]


def compare_models(
    lake: ModelTables,
    models: Mapping[int, str],
    *,
    jobs: int,
    timeout: float = 300.0,
    memory: float = 8.0,
    through_step: bool = False,
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
    through_step : bool
        As of `compare_model`.

    Raises
    ------
    MissingExtraError, KernelUnavailableError
        If no worker can start.
    """
    tasks = (
        ((model_id, name), (lake, model_id, through_step)) for model_id, name in models.items()
    )
    need = "breplake rebuild --compare"
    with Processes[tuple[int, str]](jobs, memory, timeout, need) as processes:
        for ended in processes.each(compare_model, tasks):
            yield _result(ended, timeout=timeout, memory=memory)


def _result(ended: Ended[tuple[int, str]], *, timeout: float, memory: float) -> Comparison:
    """Return what became of a model."""
    if not ended.killed:
        result: Comparison = ended.value
        return result
    reason = {
        "time": f"it took longer than {timeout:g} s; more time is given by --timeout",
        "memory": f"it needs more than {memory:g} GiB of memory",
        "death": f"the CAD kernel crashed (exit code {ended.exitcode})",
    }[ended.killed]
    return Comparison(*ended.key, "failed", [reason])
