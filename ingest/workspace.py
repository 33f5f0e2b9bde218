"""Records of an ingest in the making, kept inside the lake until their shard is committed.

::

    LAKE/work/<run>/lock                       held as long as the run lives
    LAKE/work/<run>/desk/                      the shard in the making, if it is to be sent
    LAKE/work/<run>/status.json                where it stands, for ``ingest --status``
    LAKE/work/<run>/<model>-<bytes>-<settings>/  spool of one input; done.json closes it

A run that was killed leaves its folder with the lock open. The next one takes over the finished
records of the same bytes, settings and versions, and removes the rest.

Of a lake in object storage, and on the nodes of a cluster, they are in a folder of the machine
(`work_root`) instead.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import shutil
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from breplake.ingest.failure import Failure
from breplake.ingest.inputs import Input
from breplake.ingest.pool import Result, run_models
from breplake.ingest.settings import Settings
from breplake.ingest.sources.resolve import Sources
from breplake.ingest.spool import Spool
from breplake.ingest.versions import versions
from breplake.schema.storage import Storage

__all__ = ["WORK", "Workspace", "finished_first", "running", "work_root"]

WORK: Final = "work"
"""Folder of the lake that holds the workspaces."""

_DONE: Final = "done.json"
_STATUS: Final = "status.json"
_UNLOCKED: Final = ".new-"
_STALE: Final = 3600.0  # seconds after which a folder that never got its lock is rubbish


class Workspace:
    """The folder of one run.

    Make one with :meth:`open`.

    Parameters
    ----------
    folder : Path
        Existing folder of this run alone.
    settings : Settings
        Of the run: records made with others are of no use to it.
    """

    def __init__(self, folder: Path, settings: Settings) -> None:
        self.folder = folder
        self._config = settings.config_hash
        self._versions = versions()

    @classmethod
    @contextmanager
    def open(cls, root: Path, settings: Settings) -> Iterator[Workspace]:
        """Make a workspace in the lake `root`, and take over what dead runs have finished.

        It is removed when the block ends well; else what is finished stays for the next run.
        """
        home = root / WORK
        home.mkdir(parents=True, exist_ok=True)
        name = uuid.uuid4().hex[:12]
        new = home / f"{_UNLOCKED}{name}"
        new.mkdir()
        with (new / "lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            # It gets its name with the lock held: no other run ever sees it free.
            folder = new.rename(home / name)
            workspace = cls(folder, settings)
            workspace._adopt(home)
            yield workspace
            shutil.rmtree(folder)
        with os.scandir(home) as entries:
            empty = next(entries, None) is None
        if empty:
            home.rmdir()

    def spool(self, item: Input) -> Spool:
        """Return the spool of an input; its folder need not exist."""
        bytes_ = (item.sha256 or "unreadable")[:16]
        return Spool(self.folder / f"{item.model_id:016x}-{bytes_}-{self._config}")

    def close(self, item: Input, failures: list[Failure]) -> None:
        """Note that an input is finished, and how; a resumed run then takes it as it is."""
        folder = self.spool(item).folder
        folder.mkdir(exist_ok=True)
        document = {"versions": self._versions, "failures": [asdict(f) for f in failures]}
        _write(folder / _DONE, document)

    def finished(self, item: Input) -> list[Failure] | None:
        """Return the failures of an input that is finished; None if it is not."""
        path = self.spool(item).folder / _DONE
        if not path.exists():
            return None
        return [Failure(**row) for row in json.loads(path.read_text())["failures"]]

    def write_status(self, **facts: Any) -> None:
        """Tell the world where the run stands."""
        _write(self.folder / _STATUS, facts)

    def _adopt(self, home: Path) -> None:
        for other in sorted(home.iterdir()):
            if other == self.folder:
                continue
            if other.name.startswith(_UNLOCKED):
                if time.time() - other.stat().st_mtime > _STALE:
                    shutil.rmtree(other, ignore_errors=True)
                continue
            with (other / "lock").open("a") as lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                for path in sorted(other.glob(f"*-{self._config}/{_DONE}")):
                    if json.loads(path.read_text())["versions"] == self._versions:
                        path.parent.rename(self.folder / path.parent.name)
                shutil.rmtree(other)


def work_root(storage: Storage, work: Path | None = None, *, here: bool = False) -> Path:
    """Return the folder below which the workspaces of a lake are.

    Parameters
    ----------
    storage : Storage
        The lake's.
    work : Path, optional
        The folder that was asked for; a lake has one of its own in it.
    here : bool
        On this machine, even if the lake's folder could be used.
    """
    if work is None and storage.is_local and not here:
        return storage.root
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "breplake"
    name = hashlib.sha256(storage.name.encode()).hexdigest()[:16]
    # locks need not reach across the machines that share a home
    return (work or cache) / f"{name}-{platform.node()}"


def finished_first(
    workspace: Workspace,
    inputs: Sequence[Input],
    settings: Settings,
    jobs: int,
    sources: Sources,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[Result]:
    """Yield every finished input: first what an earlier run left, then the others, run now.

    Parameters
    ----------
    workspace : Workspace
        Of this run.
    inputs : sequence of Input
        What is to be finished, in order.
    settings : Settings
        What to do to each model.
    jobs : int
        Number of worker processes.
    sources : Sources
        Brings the bytes that are in no file yet.
    stop : callable
        Asked often; once it returns True the models in work are given up.
    """
    rest: list[Input] = []
    for item in inputs:
        failures = workspace.finished(item)
        if failures is None:
            rest.append(item)
        else:
            yield Result(item, workspace.spool(item), failures, is_resumed=True)
    with sources.fetcher(rest, workspace.folder / "unpacked") as fetcher:
        for result in run_models(rest, settings, jobs, workspace.spool, stop, fetcher):
            workspace.close(result.input, result.failures)
            yield result


def running(root: Path) -> list[dict[str, Any]]:
    """Return the status of every ingest that runs on the lake `root`, oldest first.

    Returns
    -------
    list of dict
        What :meth:`Workspace.write_status` was given, and under ``now`` the models in work:
        name, stage and seconds.
    """
    found = []
    for path in (root / WORK).glob(f"[!.]*/{_STATUS}"):
        with (path.parent / "lock").open() as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                found.append(json.loads(path.read_text()) | {"now": _now(path.parent)})
    return sorted(found, key=lambda status: status["started"])


def _now(folder: Path) -> list[dict[str, Any]]:
    """Return the models in work in a workspace, the longest first."""
    found = []
    for path in folder.glob("*/begun"):
        spool = Spool(path.parent)
        if not (path.parent / _DONE).exists():
            stage, detail = spool.stage
            facts = {"stage": stage, "detail": detail, "seconds": spool.age()}
            found.append(facts | {"name": spool.begun or ""})
    return sorted(found, key=lambda model: -model["seconds"])


def _write(path: Path, document: dict[str, Any]) -> None:
    """Write JSON in one step, so that a kill leaves the whole document or none."""
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(document))
    os.replace(partial, path)
