"""Shards ingested by the nodes of a cluster: the engine ``ray``.

A task is a shard: its node runs the same isolated workers as one machine does, writes the files
and puts them into the lake, which all nodes must reach, in a shared folder or in object storage.
Only their names come back; the run that planned them commits. When a node dies, Ray gives its
shards to others. Should a node that was taken for dead go on, both put a shard there, under names
of their own, and one of them is committed.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from breplake.errors import BreplakeError, MissingExtraError, StorageError, UsageError
from breplake.ingest.inputs import Input
from breplake.ingest.journal import Entry, entry_of
from breplake.ingest.settings import Settings
from breplake.ingest.shard import write_shard
from breplake.ingest.sources.limits import DEFAULT_LIMITS, Limits
from breplake.ingest.sources.origin import MemberOrigin
from breplake.ingest.sources.resolve import Sources
from breplake.ingest.tally import Tally
from breplake.ingest.workspace import Workspace, finished_first, work_root
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import FileEntry

__all__ = ["ShardDone", "ShardTask", "run_shard", "run_shards"]

_RETRIES: Final = 3
"""Nodes that a shard may lose before it is given up."""

_PAUSE: Final = 0.5
"""Seconds after which a quiet cluster looks whether it is to stop."""


@dataclass(frozen=True, slots=True)
class ShardTask:
    """What a node is asked to do.

    Parameters
    ----------
    lake, lake_id : str
        Absolute path or URL of the lake, and its id.
    folder : str
        Folder against which the paths of the inputs count.
    inputs : tuple of Input
        Of one shard, in order.
    settings : Settings
        What to do to each model.
    jobs : int
        Number of worker processes.
    limits : Limits
        How far archives are trusted.
    work : str, optional
        Folder for what is in the making.
    models : frozenset of int
        Those of the inputs that are models of the lake, which stay if they cannot be read.
    retried : frozenset of int
        Those of which no earlier failure counts.
    """

    lake: str
    lake_id: str
    folder: str
    inputs: tuple[Input, ...]
    settings: Settings
    jobs: int
    limits: Limits = DEFAULT_LIMITS
    work: str | None = None
    models: frozenset[int] = frozenset()
    retried: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class ShardDone:
    """What a node did.

    Parameters
    ----------
    inputs : tuple of Input
        Those of the task that are in the files.
    files : list of FileEntry
        The shard's files, which are in the lake.
    tally : Tally
        How the inputs ended.
    events : list of Entry
        The same, for the journal.
    """

    inputs: tuple[Input, ...]
    files: list[FileEntry]
    tally: Tally
    events: list[Entry]


def run_shard(task: ShardTask) -> ShardDone:
    """Ingest a shard on this machine and put its files into the lake.

    Raises
    ------
    UsageError
        If this machine does not see the lake or the inputs.
    """
    store = _lake(task)
    root = work_root(store.storage, Path(task.work) if task.work else None, here=True)
    tally, events = Tally(), []
    with (
        Workspace.open(root, task.settings, task.inputs, task.retried) as workspace,
        Sources.open(task.limits) as sources,
    ):
        results = []
        for result in finished_first(workspace, task.inputs, task.settings, task.jobs, sources):
            is_kept = result.is_unread and result.input.model_id in task.models
            tally.add(result, is_kept=is_kept)
            events.append(entry_of(result))
            if not is_kept:
                results.append(result)
        place = {item.model_id: i for i, item in enumerate(task.inputs)}
        results.sort(key=lambda result: place[result.input.model_id])
        desk = store.at_desk(workspace.folder / "desk")
        files = write_shard(desk, results, task.settings.config_hash) if results else []
    return ShardDone(tuple(result.input for result in results), files, tally, events)


def _lake(task: ShardTask) -> LakeStore:
    """Open the lake of a task, and see that this machine has what it takes."""
    if os.path.isdir(task.folder):
        os.chdir(task.folder)
    try:
        store = LakeStore.open(task.lake)
        lake_id = store.lake_id
    except FileNotFoundError:
        lake_id = ""
    if lake_id != task.lake_id:
        raise UsageError(
            f"the node {platform.node()} does not see the lake {task.lake}: it must be in object "
            "storage, or in a folder that all nodes share"
        )
    for path in _files(task.inputs):
        if not path.exists():
            raise UsageError(
                f"the node {platform.node()} does not see {path}: sources must be in a folder "
                "that all nodes share, and stay there"
            )
    return store


def _files(inputs: Sequence[Input]) -> list[Path]:
    """Return the files in which the bytes of inputs are; those of an address are in none."""
    found: dict[Path, None] = {}
    for item in inputs:
        if item.sha256 is None:
            continue
        if item.origin is None:
            found[item.path] = None
        elif isinstance(item.origin, MemberOrigin):
            found[item.origin.archive] = None
    return list(found)


def run_shards(
    store: LakeStore,
    groups: Sequence[Sequence[Input]],
    settings: Settings,
    sources: Sources,
    address: str | None,
    jobs: int | None,
    stop: Callable[[], bool],
    work: Path | None,
    models: frozenset[int] = frozenset(),
    retried: frozenset[int] = frozenset(),
) -> Iterator[ShardDone]:
    """Ingest shards on a cluster and yield them as they are done.

    Parameters
    ----------
    store : LakeStore
        The lake.
    groups : sequence of sequence of Input
        What belongs to each shard, in order.
    settings : Settings
        What to do to each model.
    sources : Sources
        Where the inputs were found.
    address : str, optional
        Of the cluster, as ``ray.init`` takes it. A cluster that this process is connected to is
        used as it is.
    jobs : int, optional
        Worker processes of a shard; by default as many as the smallest node has processors.
    stop : callable
        Asked about twice a second; once it returns True the shards in work are given up.
    work : Path, optional
        Folder for what is in the making, on each node.
    models : frozenset of int
        Those of the inputs that are models of the lake, which stay if they cannot be read.
    retried : frozenset of int
        Those of which no earlier failure counts.

    Raises
    ------
    MissingExtraError
        If Ray is not installed.
    UsageError
        If a node does not see the lake or the inputs.
    StorageError
        If shards were lost with their nodes time and again; all others are done by then.
    """
    with _connected(address) as ray:
        jobs = _jobs_of_a_shard(ray, jobs)
        tasks = [
            ShardTask(
                lake=store.storage.name,
                lake_id=store.lake_id,
                folder=os.getcwd(),
                inputs=tuple(sources.told(group)),
                settings=settings,
                jobs=jobs,
                limits=sources.limits,
                work=None if work is None else str(work.absolute()),
                models=models & {item.model_id for item in group},
                retried=retried & {item.model_id for item in group},
            )
            for group in groups
        ]
        yield from _scheduled(ray, tasks, jobs, stop)


@contextmanager
def _connected(address: str | None) -> Iterator[Any]:
    """Give the module ``ray``, connected to a cluster; a connection that was there stays."""
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("ray", "breplake ingest --engine ray") from error
    if ray.is_initialized():
        yield ray
        return
    ray.init(address=address, log_to_driver=False)
    try:
        yield ray
    finally:
        ray.shutdown()


def _jobs_of_a_shard(ray: Any, jobs: int | None) -> int:
    """Return how many worker processes a shard gets, which is no more than some node has room for.

    Raises
    ------
    UsageError
        If no node has room for `jobs`.
    """
    sizes = _node_sizes(ray)
    jobs = jobs or min(sizes)
    if jobs > max(sizes):
        raise UsageError(
            f"no node of the cluster has {jobs} processors, the largest has {max(sizes)}: "
            "lower --jobs"
        )
    return jobs


def _node_sizes(ray: Any) -> list[int]:
    """Return the number of processors of each node that has some."""
    sizes = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
    return [size for size in sizes if size] or [1]


def _scheduled(
    ray: Any, tasks: Sequence[ShardTask], jobs: int, stop: Callable[[], bool]
) -> Iterator[ShardDone]:
    remote = ray.remote(run_shard).options(num_cpus=jobs, max_retries=_RETRIES)
    waiting = list(reversed(tasks))
    running: dict[Any, ShardTask] = {}
    lost: list[BaseException] = []
    try:
        while (waiting or running) and not stop():
            # some more than there is room for, so that no node waits for the next
            room = 2 * int(ray.cluster_resources().get("CPU", 1) // jobs) + 2
            while waiting and len(running) < room:
                task = waiting.pop()
                running[remote.remote(task)] = task
            done, _ = ray.wait(list(running), num_returns=1, timeout=_PAUSE)
            for reference in done:
                del running[reference]
                try:
                    yield ray.get(reference)
                except ray.exceptions.RayTaskError as error:
                    if isinstance(error.cause, BreplakeError | OSError):
                        raise error.cause from error
                    raise
                except ray.exceptions.RayError as error:
                    lost.append(error)
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
    if lost:
        raise StorageError(
            f"{len(lost)} shards were lost with their nodes {_RETRIES + 1} times and are not in "
            f"the lake, the others are: run the same command again ({lost[0]})"
        ) from lost[0]
