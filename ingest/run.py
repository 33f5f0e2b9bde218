"""Ingest sources into a lake: plan, run, write shards, commit."""

from __future__ import annotations

import errno
import os
import platform
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import pyarrow as pa

from breplake.errors import BreplakeError, StorageError, UsageError
from breplake.ingest.inputs import Input
from breplake.ingest.journal import Journal
from breplake.ingest.plan import Plan, Redo, plan
from breplake.ingest.pool import Result, discard, run_models
from breplake.ingest.replace import remainder
from breplake.ingest.settings import Settings
from breplake.ingest.shard import SHARD_MODELS, write_shard
from breplake.ingest.sources.archives import ARCHIVE
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.resolve import Sources
from breplake.ingest.versions import versions
from breplake.ingest.workspace import Workspace
from breplake.schema.lake import LakeStore
from breplake.schema.lock import writer_lock
from breplake.schema.snapshot import Snapshot

__all__ = ["Summary", "ingest"]


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
    n_resumed : int
        Inputs that an earlier run had finished but not committed.
    kinds : Counter
        Failures by (stage, kind), fatal or not.
    seconds, cpu_seconds : float
        Wall time of the run, CPU time of the models.
    snapshot : Snapshot, optional
        The last commit; None if there was nothing to commit.
    stopped : bool
        It was asked to stop before the end.
    """

    plan: Plan
    n_models: int = 0
    n_meshed: int = 0
    n_fatal: int = 0
    n_resumed: int = 0
    kinds: Counter[tuple[str, str]] = field(default_factory=Counter)
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    snapshot: Snapshot | None = None
    stopped: bool = False

    @property
    def refused(self) -> list[Input]:
        """Archives among the inputs that are not safe, so that nothing of them was read."""
        return [
            item
            for item in self.plan.inputs
            if item.format == ARCHIVE and item.failure and item.failure.kind == "refused"
        ]

    @property
    def n_done(self) -> int:
        """Inputs that are finished."""
        return self.n_models + self.n_fatal

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


def ingest(
    sources: Sequence[str | Path],
    lake: str | Path,
    *,
    settings: Settings | None = None,
    collection: str | None = None,
    jobs: int | None = None,
    message: str | None = None,
    redo: Redo | None = None,
    progress: Callable[[Plan, Summary], None] | None = None,
    stop: Callable[[], bool] | None = None,
    log: Path | None = None,
    limits: Limits | None = None,
    tell: Callable[[str], None] | None = None,
) -> Summary:
    """Ingest CAD files into a lake, which is made if it does not exist.

    Every input becomes one row of ``models`` or one fatal row of ``failures``; a shard is
    committed as soon as its inputs are done. A run that is killed loses the models in work: the
    same call again takes up all that was finished and ends with the same lake.

    Parameters
    ----------
    sources : sequence of path
        Files, folders, archives, lists (``.csv``, ``.parquet``) and ``onshape:`` addresses.
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
    redo : Redo, optional
        What of the lake's content is ingested again and replaced; by default nothing.
    progress : callable, optional
        Called with the plan and the summary so far, at the start and after each input.
    stop : callable, optional
        Asked often; once it returns True the models in work are given up and what is finished
        is committed.
    log : path, optional
        File to which a line of JSON is appended for each event.
    limits : Limits, optional
        How far archives are trusted.
    tell : callable, optional
        Called with a line of text while sources are looked through, which may take long.

    Raises
    ------
    UsageError
        If a source or setting breaks a rule. An archive that is not safe is a failure, as all
        members of it that are known.
    CommitConflictError
        If another writer added or replaced the same models meanwhile.
    StorageError
        If the lake cannot be written, for want of space or permission; it is whole all the
        same, and the same call goes on where this one ended.
    """
    settings = settings or Settings()
    jobs = jobs or len(os.sched_getaffinity(0))
    if jobs < 1:
        raise UsageError(f"jobs must be at least 1; got {jobs}")
    text = message or f"ingest {', '.join(str(source) for source in sources)}"
    with Sources.open(limits, tell, stop) as opened:
        inputs = opened.find(sources, collection)
        with _writable(lake), Journal.open(log) as journal:
            store = LakeStore.open_or_create(lake)
            todo = plan(store, inputs, settings, redo, opened.whole)
            with Workspace.open(store.root, settings) as workspace:
                run = _Run(store, todo, settings, workspace, journal, opened, text)
                run.report = progress or run.report
                return run(jobs, stop or (lambda: False))


_HELP: Final = {
    errno.ENOSPC: "its disk is full: make room",
    errno.EDQUOT: "the quota of its disk is used up: make room",
    errno.EROFS: "its disk is read-only: give another --lake",
    errno.EACCES: "permission is denied: check the owner of the folder",
    errno.EPERM: "permission is denied: check the owner of the folder",
}
"""What helps when the file system refuses to write."""


@contextmanager
def _writable(lake: str | Path) -> Iterator[None]:
    """Turn the file system's refusals in a block into clear errors about the lake."""
    try:
        yield
    except OSError as error:
        if isinstance(error, BreplakeError) or error.errno not in _HELP:
            raise
        raise StorageError(
            f"the lake {lake} cannot be written, {_HELP[error.errno]} and run the same command "
            f"again; what is committed is whole ({error})"
        ) from error


class _Run:
    """One ingest under way."""

    def __init__(
        self,
        store: LakeStore,
        todo: Plan,
        settings: Settings,
        workspace: Workspace,
        journal: Journal,
        sources: Sources,
        message: str,
    ) -> None:
        self.store, self.plan, self.settings = store, todo, settings
        self.workspace, self.journal, self.message = workspace, journal, message
        self.sources = sources
        self.summary = Summary(todo)
        self.started = time.time()
        self.report: Callable[[Plan, Summary], None] = lambda _plan, _summary: None

    def __call__(self, jobs: int, stop: Callable[[], bool]) -> Summary:
        begin = time.monotonic()
        self.journal.write("plan", todo=len(self.plan.todo), inputs=len(self.plan.inputs))
        self._tell()
        shards = _Shards(self.plan)
        for result in self._results(jobs, stop):
            shard = shards.add(result)
            if shard:
                self._commit(shard)
        rest = shards.rest()
        if rest:
            self.summary.stopped = True
            self._commit(rest)
        elif self.summary.n_done < len(self.plan.todo):
            self.summary.stopped = True
        else:
            self._settle()
        self.summary.seconds = time.monotonic() - begin
        self.journal.write("end", stopped=self.summary.stopped, seconds=self.summary.seconds)
        return self.summary

    def _results(self, jobs: int, stop: Callable[[], bool]) -> Iterator[Result]:
        """Yield every finished input: first what an earlier run left, then the others."""
        rest: list[Input] = []
        for item in self.plan.todo:
            failures = self.workspace.finished(item)
            if failures is None:
                rest.append(item)
                continue
            self.summary.n_resumed += 1
            yield self._counted(Result(item, self.workspace.spool(item), failures))
        with self.sources.fetcher(rest, self.workspace.folder / "unpacked") as fetcher:
            models = run_models(rest, self.settings, jobs, self.workspace.spool, stop, fetcher)
            for result in models:
                self.workspace.close(result.input, result.failures)
                yield self._counted(result)

    def _counted(self, result: Result) -> Result:
        self.summary.add(result)
        self.journal.result(result)
        self._tell()
        return result

    def _tell(self) -> None:
        summary = self.summary
        self.report(self.plan, summary)
        self.workspace.write_status(
            pid=os.getpid(),
            host=platform.node(),
            message=self.message,
            started=self.started,
            updated=time.time(),
            todo=len(self.plan.todo),
            done=summary.n_done,
            failed=summary.n_fatal,
        )

    def _settle(self) -> None:
        """Take out the failures that hold no more."""
        if not self.plan.settled:
            return
        with writer_lock(self.store.root):
            kept, replaced = remainder(self.store, self.plan.settled)
            if replaced:
                self.summary.snapshot = self.store.commit(
                    kept,
                    message=self.message,
                    tools=_tools(),
                    config_hash=self.settings.config_hash,
                    replaces=replaced,
                )

    def _commit(self, shard: Sequence[Result]) -> None:
        redone = self.plan.redone & {result.input.model_id for result in shard}
        with writer_lock(self.store.root):
            kept, replaced = remainder(self.store, redone)
            files = write_shard(self.store, shard, self.settings.config_hash)
            snapshot = self.store.commit(
                [*kept, *files],
                message=self.message,
                tools=_tools(),
                config_hash=self.settings.config_hash,
                replaces=replaced,
            )
        self.summary.snapshot = snapshot
        self.journal.write("commit", snapshot=snapshot.number, models=len(shard))
        for result in shard:
            discard(result)


class _Shards:
    """Groups results into shards of consecutive inputs, whatever order they finish in.

    The groups are those of all inputs, not of what is left to do: a resumed run writes the
    same shards as one that was never killed.
    """

    def __init__(self, plan: Plan) -> None:
        self._place = {item.model_id: i for i, item in enumerate(plan.inputs)}
        self._size = Counter(self._group(item) for item in plan.todo)
        self._open: dict[int, list[Result]] = {}

    def _group(self, item: Input) -> int:
        return self._place[item.model_id] // SHARD_MODELS

    def add(self, result: Result) -> list[Result] | None:
        """Take a result; return its shard if that is complete now."""
        group = self._group(result.input)
        shard = self._open.setdefault(group, [])
        shard.append(result)
        if len(shard) < self._size[group]:
            return None
        return self._sorted(self._open.pop(group))

    def rest(self) -> list[Result]:
        """Return what shards that never became complete hold."""
        return self._sorted([result for shard in self._open.values() for result in shard])

    def _sorted(self, shard: Iterable[Result]) -> list[Result]:
        return sorted(shard, key=lambda result: self._place[result.input.model_id])


def _tools() -> dict[str, str]:
    return versions() | {"python": platform.python_version(), "pyarrow": pa.__version__}
