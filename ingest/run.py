"""Ingest sources into a lake: plan, run, write shards, commit."""

from __future__ import annotations

import fcntl
import os
import platform
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from breplake.errors import UsageError
from breplake.ingest.inputs import Input, find_inputs
from breplake.ingest.pool import Result, discard, run_models
from breplake.ingest.settings import Settings
from breplake.ingest.shard import SHARD_MODELS, write_shard
from breplake.ingest.versions import versions
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import Snapshot

__all__ = ["Plan", "Summary", "ingest", "plan"]


@dataclass(frozen=True, slots=True)
class Plan:
    """What an ingest will do.

    Parameters
    ----------
    new : list of Input
        To be ingested.
    unchanged : list of Input
        In the lake already, with the same bytes and settings.
    changed : list of Input
        In the lake with other bytes or settings.
    n_failed_before : int
        How many of `unchanged` are failures, or models without mesh.
    """

    new: list[Input]
    unchanged: list[Input]
    changed: list[Input]
    n_failed_before: int = 0


@dataclass(slots=True)
class Summary:
    """How an ingest ended.

    Parameters
    ----------
    plan : Plan
        What it set out to do.
    n_models : int
        New rows of ``models``.
    n_meshed : int
        Those of them that have mesh and ground truth.
    n_fatal : int
        Inputs that are rows of ``failures`` only.
    kinds : Counter
        Failures by (stage, kind), fatal or not.
    seconds, cpu_seconds : float
        Wall time of the run, CPU time of the models.
    snapshot : Snapshot, optional
        The last commit; None if there was nothing to commit.
    """

    plan: Plan
    n_models: int = 0
    n_meshed: int = 0
    n_fatal: int = 0
    kinds: Counter[tuple[str, str]] = field(default_factory=Counter)
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    snapshot: Snapshot | None = None

    def add(self, result: Result) -> None:
        """Count one finished input."""
        self.kinds.update((failure.stage, failure.kind) for failure in result.failures)
        if not result.recorded:
            self.n_fatal += 1
            return
        row = result.spool.read_model()
        self.n_models += 1
        self.n_meshed += bool(row.get("mesh_kind"))
        self.cpu_seconds += row["cpu_total"]


def plan(store: LakeStore, inputs: Sequence[Input], settings: Settings) -> Plan:
    """Compare `inputs` with what the lake's newest snapshot holds."""
    known = _known(store)
    new: list[Input] = []
    unchanged: list[Input] = []
    changed: list[Input] = []
    failed = 0
    for item in inputs:
        if item.model_id not in known:
            new.append(item)
            continue
        sha256, config_hash, is_complete = known[item.model_id]
        if (sha256, config_hash) == (item.sha256, settings.config_hash):
            unchanged.append(item)
            failed += not is_complete
        else:
            changed.append(item)
    return Plan(new, unchanged, changed, failed)


def _known(store: LakeStore) -> dict[int, tuple[str | None, str, bool]]:
    """Return hash, settings and success of all inputs in the lake by model_id."""
    head = store.head()
    known: dict[int, tuple[str | None, str, bool]] = {}
    columns = ["model_id", "sha256", "config_hash"]
    for name, more in (("failures", []), ("models", ["mesh_kind"])):
        for entry in head.table_files(name) if head else ():
            table: pa.Table = pq.read_table(store.root / entry.path, columns=columns + more)
            for row in table.to_pylist():
                is_complete = row.get("mesh_kind") is not None
                known[row["model_id"]] = row["sha256"], row["config_hash"], is_complete
    return known


def ingest(
    sources: Sequence[str | Path],
    lake: str | Path,
    *,
    settings: Settings | None = None,
    collection: str | None = None,
    jobs: int | None = None,
    message: str | None = None,
    progress: Callable[[Plan, Summary], None] | None = None,
) -> Summary:
    """Ingest CAD files into a lake, which is made if it does not exist.

    Every input becomes one row of ``models`` or one fatal row of ``failures``; a shard is
    committed as soon as its inputs are done, so an interrupted run loses at most the shards
    in the making.

    Parameters
    ----------
    sources : sequence of path
        Files and folders.
    lake : path
        The lake's folder.
    settings : Settings, optional
        What to do to each model.
    collection : str, optional
        Collection of the models; by default named after each source folder.
    jobs : int, optional
        Number of worker processes; by default one for each processor.
    message : str, optional
        Message of the snapshots.
    progress : callable, optional
        Called with the plan and the summary so far, at the start and after each input.

    Raises
    ------
    UsageError
        If a source or setting breaks a rule.
    CommitConflictError
        If another writer added the same models meanwhile.
    """
    settings = settings or Settings()
    jobs = jobs or len(os.sched_getaffinity(0))
    if jobs < 1:
        raise UsageError(f"jobs must be at least 1; got {jobs}")
    started = time.monotonic()
    tools = _tools()
    inputs = find_inputs([Path(source) for source in sources], collection)
    store = LakeStore.open_or_create(lake)
    todo = plan(store, inputs, settings)
    summary = Summary(todo)
    report = progress or (lambda _plan, _summary: None)
    report(todo, summary)
    text = message or f"ingest {', '.join(str(source) for source in sources)}"
    with tempfile.TemporaryDirectory(prefix="breplake-") as folder:
        results = run_models(todo.new, settings, jobs, Path(folder))

        def counted() -> Iterator[Result]:
            for result in results:
                summary.add(result)
                report(todo, summary)
                yield result

        for shard in _shards(todo.new, counted()):
            with _writing(store.root):
                files = write_shard(store, shard, settings.config_hash)
                summary.snapshot = store.commit(
                    files, message=text, tools=tools, config_hash=settings.config_hash
                )
            for result in shard:
                discard(result)
    summary.seconds = time.monotonic() - started
    return summary


@contextmanager
def _writing(root: Path) -> Iterator[None]:
    """Keep other ingests from writing shards until this one is committed.

    Files that no snapshot names are taken for what an interrupted run left; those of a
    running one look the same. The system drops the lock when the process dies.
    """
    with (root / "writer.lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _shards(inputs: Sequence[Input], results: Iterable[Result]) -> Iterator[list[Result]]:
    """Group results into shards of consecutive inputs, whatever order they finish in."""
    place = {item.model_id: i for i, item in enumerate(inputs)}
    open_shards: dict[int, list[Result]] = {}
    for result in results:
        number = place[result.input.model_id] // SHARD_MODELS
        shard = open_shards.setdefault(number, [])
        shard.append(result)
        size = min(SHARD_MODELS, len(inputs) - number * SHARD_MODELS)
        if len(shard) == size:
            shard = open_shards.pop(number)
            yield sorted(shard, key=lambda r: place[r.input.model_id])


def _tools() -> dict[str, str]:
    return versions() | {"python": platform.python_version(), "pyarrow": pa.__version__}
