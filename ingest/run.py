"""Ingest sources into a lake: plan, run, write shards, commit."""

from __future__ import annotations

import errno
import os
import platform
import re
import time
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Literal, NamedTuple

import pyarrow as pa
from obstore.exceptions import BaseError

from breplake.errors import BreplakeError, StorageError, UsageError
from breplake.ingest.inputs import Input
from breplake.ingest.journal import Journal
from breplake.ingest.plan import Plan, Redo, plan
from breplake.ingest.pool import Result, discard
from breplake.ingest.replace import remainder
from breplake.ingest.settings import Settings
from breplake.ingest.shard import SHARD_MODELS, write_shard
from breplake.ingest.sources.archives import ARCHIVE
from breplake.ingest.sources.ledger import cache_folder
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.onshape import SEARCH
from breplake.ingest.sources.resolve import Sources
from breplake.ingest.sources.waiting import Tell, silent
from breplake.ingest.tally import Tally
from breplake.ingest.versions import versions
from breplake.ingest.workspace import Workspace, finished_first, work_root
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import FileEntry, Snapshot
from breplake.schema.storage import local_folder

__all__ = ["Engine", "Summary", "ingest"]


Engine = Literal["local", "ray"]
"""Where models are ingested: on this machine, or on a cluster that Ray runs."""


@dataclass(slots=True, kw_only=True)
class Summary(Tally):
    """How an ingest ended: the counts of a `Tally`, and more.

    Parameters
    ----------
    plan : Plan
        What it set out to do.
    seconds : float
        Wall time of the run.
    snapshot : Snapshot, optional
        The last commit; None if there was nothing to commit.
    stopped : bool
        It was asked to stop before the end.
    """

    plan: Plan
    seconds: float = 0.0
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
    def unanswered(self) -> list[Input]:
        """Searches among the inputs that failed, so that documents may be missing."""
        return [item for item in self.plan.inputs if item.format == SEARCH and item.failure]


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
    engine: Engine = "local",
    address: str | None = None,
    work: Path | None = None,
    limits: Limits | None = None,
    tell: Tell = silent,
    warn: Callable[[str], None] | None = None,
    rehash: bool = False,
) -> Summary:
    """Ingest CAD files into a lake, which is made if it does not exist.

    Every input becomes one row of ``models`` or one fatal row of ``failures``; a shard is
    committed as soon as its inputs are done. A run that is killed loses the models in work: the
    same call again takes up all that was finished and ends with the same lake.

    Parameters
    ----------
    sources : sequence of path
        Files, folders, archives, lists (``.csv``, ``.parquet``) and ``onshape:`` addresses.
    lake : path or str
        The lake's folder, or its URL in object storage (``s3://…``): shards are then written on
        this machine and sent.
    settings : Settings, optional
        What to do to each model.
    collection : str, optional
        Collection of the models; by default named after each source folder.
    jobs : int, optional
        Number of worker processes; by default one for each processor. With Ray, of each shard in
        work; by default as many as the smallest node has processors.
    message : str, optional
        Message of the snapshots.
    redo : Redo, optional
        What of the lake's content is ingested again and replaced; by default nothing.
    progress : callable, optional
        Called with the plan and the summary so far, at the start and after each input.
    stop : callable, optional
        Asked often; once it returns True the models in work are given up and what is finished
        is committed. While sources are looked through there is nothing to commit yet: then the
        call ends by KeyboardInterrupt.
    log : path, optional
        File to which a line of JSON is appended for each event; when it cannot be written any
        more, the run goes on without it.
    engine : {"local", "ray"}
        Where models are ingested. Both do the same to each model and make the same shards.
    address : str, optional
        Of the Ray cluster; by default that of ``RAY_ADDRESS``, else one is started here.
    work : Path, optional
        Folder for what is in the making, on each machine. By default it is in the lake, if that
        is in a folder of this machine, else in the user's cache.
    limits : Limits, optional
        How far archives are trusted.
    tell : Tell, optional
        Called while sources are looked through, which may take long, with what is being done,
        how much of it is done, and of how much; None while that is unknown.
    warn : callable, optional
        Called with a line of text when something is lost without which the run goes on; by
        default that is a `RuntimeWarning`.
    rehash : bool
        Read every file for its hash, also those that look as they did when they were hashed by
        an earlier run.

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
    MissingExtraError
        If the engine is not installed.
    """
    settings = settings or Settings()
    if jobs is not None and jobs < 1:
        raise UsageError(f"jobs must be at least 1; got {jobs}")
    if address is not None and engine != "ray":
        raise UsageError(f"an address is that of a Ray cluster: give --engine ray, not {engine}")
    text = message or f"ingest {', '.join(str(source) for source in sources)}"
    stop, warn = stop or (lambda: False), warn or _warn
    with ExitStack() as stack:
        opened = stack.enter_context(Sources.open(limits, tell, stop, warn, rehash=rehash))
        inputs = opened.find(sources, collection)
        stack.enter_context(_writable(lake, work))
        journal = stack.enter_context(Journal.open(log, warn))
        store = LakeStore.open_or_create(lake)
        todo = plan(store, inputs, settings, redo, opened.whole)
        with Workspace.open(
            work_root(store.storage, work), settings, todo.todo, todo.retry, todo.done
        ) as workspace:
            if not store.storage.is_local:
                store = store.at_desk(workspace.folder / "desk")
            run = _Run(store, todo, settings, workspace, journal, opened, text)
            run.report = progress or run.report
            if engine == "ray":
                return run(run.on_cluster(address, jobs, stop, work))
            return run(run.here(jobs, stop))


def _warn(text: str) -> None:
    warnings.warn(text, RuntimeWarning, stacklevel=2)


_HELP: Final = {
    errno.ENOSPC: "its disk is full: make room",
    errno.EDQUOT: "the quota of its disk is used up: make room",
    errno.EROFS: "its disk is read-only: give another --lake",
    errno.EACCES: "permission is denied: check the owner of the folder",
    errno.EPERM: "permission is denied: check the owner of the folder",
}
"""What helps when the file system refuses to write."""


@contextmanager
def _writable(lake: str | Path, work: Path | None = None) -> Iterator[None]:
    """Turn the file system's refusals in a block into clear errors, each about its place."""
    try:
        yield
    except (BaseError, OSError) as error:
        help_ = _HELP.get(_number(error) or 0)
        if help_ is None and isinstance(error, BaseError):
            help_ = "or not be reached: check its address, the credentials and the network"
        if help_ is None or isinstance(error, BreplakeError):
            raise
        what = _culprit(error, lake, work)
        raise StorageError(
            f"{what} cannot be written, {help_} and run the same command "
            f"again; what is committed is whole ({error})"
        ) from error


def _culprit(error: Exception, lake: str | Path, work: Path | None) -> str:
    """Return what an error is about: the lake, unless it names a file elsewhere."""
    name = error.filename if isinstance(error, OSError) else None
    folder = local_folder(lake)
    if not isinstance(name, str) or not Path(name).is_absolute():
        return f"the lake {lake}"
    path = Path(name).resolve()
    if folder is not None and path.is_relative_to(folder.resolve()):
        return f"the lake {lake}"
    for place, what in ((work, "--work"), (cache_folder(), "the cache")):
        if place is not None and path.is_relative_to(place.resolve()):
            return f"{what} {place}"
    return name


def _number(error: Exception) -> int | None:
    """Return the system's number of an error; obstore only has it in its text."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    found = re.search(r"os error (\d+)", str(error))
    return int(found[1]) if found else None


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
        self.summary = Summary(plan=todo)
        self.started = time.time()
        self.report: Callable[[Plan, Summary], None] = lambda _plan, _summary: None

    def __call__(self, shards: Generator[_Shard]) -> Summary:
        """Commit every shard as it comes."""
        begin = time.monotonic()
        self.journal.write("plan", todo=len(self.plan.todo), inputs=len(self.plan.inputs))
        self._tell()
        with closing(shards):  # workers end with the run, also if a commit fails
            for shard in shards:
                self._commit(shard)
        self.summary.stopped = self.summary.stopped or self.summary.n_done < len(self.plan.todo)
        if not self.summary.stopped:
            self._settle()
        self.summary.seconds = time.monotonic() - begin
        self.journal.write("end", stopped=self.summary.stopped, seconds=self.summary.seconds)
        return self.summary

    def here(self, jobs: int | None, stop: Callable[[], bool]) -> Generator[_Shard]:
        """Yield shards that this machine ingests; the last may be cut short."""
        jobs = jobs or len(os.sched_getaffinity(0))
        shards = _Shards(self.plan)
        todo, settings = self.plan.todo, self.settings
        for result in finished_first(self.workspace, todo, settings, jobs, self.sources, stop):
            self.summary.add(result, is_kept=self._is_kept(result))
            self.journal.result(result)
            self._tell()
            shard = shards.add(result)
            if shard:
                yield self._written_here(shard)
        rest = shards.rest()
        if rest:
            self.summary.stopped = True
            yield self._written_here(rest)

    def _written_here(self, results: list[Result]) -> _Shard:
        written = [result for result in results if not self._is_kept(result)]

        def write() -> list[FileEntry]:
            return write_shard(self.store, written, self.settings.config_hash)

        def clear() -> None:
            for result in results:
                discard(result)

        return _Shard([result.input for result in written], write, clear)

    def _is_kept(self, result: Result) -> bool:
        """Return whether the lake's model stays: it could not be read, and may be next time."""
        return result.is_unread and result.input.model_id in self.plan.models

    def on_cluster(
        self, address: str | None, jobs: int | None, stop: Callable[[], bool], work: Path | None
    ) -> Generator[_Shard]:
        """Yield shards that the nodes of a cluster ingest and put into the lake."""
        from breplake.ingest.cluster import run_shards

        groups = _Shards(self.plan).inputs()
        done_shards = run_shards(
            self.store,
            groups,
            self.settings,
            self.sources,
            address,
            jobs,
            stop,
            work,
            self.plan.models,
            self.plan.retry,
        )
        for done in done_shards:
            self.summary.merge(done.tally)
            for entry in done.events:
                self.journal.add(entry)
            self._tell()
            yield _Shard(done.inputs, partial(list, done.files), lambda: None)

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

    def _commit(self, shard: _Shard) -> None:
        if shard.inputs:
            redone = self.plan.redone & {item.model_id for item in shard.inputs}
            snapshot = self._replace(redone, shard.files)
            self.journal.write("commit", snapshot=snapshot.number, models=len(shard.inputs))
        shard.clear()

    def _settle(self) -> None:
        """Take out the failures that hold no more."""
        if self.plan.settled:
            self._replace(self.plan.settled, list)

    def _replace(self, ids: Collection[int], files: Callable[[], list[FileEntry]]) -> Snapshot:
        """Commit new files in place of the models and failures `ids`."""
        with self.store.lock():
            kept, replaced = remainder(self.store, ids)
            self.summary.snapshot = self.store.commit(
                [*kept, *files()],
                message=self.message,
                tools=_tools(),
                config_hash=self.settings.config_hash,
                replaces=replaced,
            )
        self.store.clear_desk()
        return self.summary.snapshot


class _Shard(NamedTuple):
    """Inputs to commit, how their files get into the lake, and what to do once they are there."""

    inputs: Sequence[Input]
    files: Callable[[], list[FileEntry]]
    clear: Callable[[], None]


class _Shards:
    """Groups results into shards of consecutive inputs, whatever order they finish in.

    The groups are those of all inputs, not of what is left to do: a resumed run writes the
    same shards as one that was never killed.
    """

    def __init__(self, plan: Plan) -> None:
        self._place = {item.model_id: i for i, item in enumerate(plan.inputs)}
        self._todo = plan.todo
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

    def inputs(self) -> list[list[Input]]:
        """Return what is left to do of each shard."""
        groups: dict[int, list[Input]] = {}
        for item in sorted(self._todo, key=lambda item: self._place[item.model_id]):
            groups.setdefault(self._group(item), []).append(item)
        return list(groups.values())

    def rest(self) -> list[Result]:
        """Return what shards that never became complete hold."""
        return self._sorted([result for shard in self._open.values() for result in shard])

    def _sorted(self, shard: Iterable[Result]) -> list[Result]:
        return sorted(shard, key=lambda result: self._place[result.input.model_id])


def _tools() -> dict[str, str]:
    return versions() | {"python": platform.python_version(), "pyarrow": pa.__version__}
