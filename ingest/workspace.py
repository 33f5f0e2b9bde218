"""Records of an ingest in the making, kept inside the lake until their shard is committed.

::

    LAKE/work/.lock                            held while folders are made, taken over, removed
    LAKE/work/<run>/lock                       held as long as the run lives
    LAKE/work/<run>/desk/                      the shard in the making, if it is to be sent
    LAKE/work/<run>/status.json                where it stands, for ``ingest --status``
    LAKE/work/<run>/<model>-<bytes>-<settings>/  spool of one input; done.json closes it

A run that was killed leaves its folder with the lock open. The next one takes over the finished
records of its own inputs with the same bytes, settings and versions. Finished records of other
inputs or settings are left for their run for seven days; the rest is removed.

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
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence, Set
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, Final

from breplake.ingest.failure import Failure
from breplake.ingest.inputs import Input
from breplake.ingest.pool import Result, run_models
from breplake.ingest.settings import Settings
from breplake.ingest.sources.ledger import cache_folder
from breplake.ingest.sources.resolve import Sources
from breplake.ingest.spool import Spool
from breplake.ingest.versions import versions
from breplake.schema.storage import Storage

__all__ = ["WORK", "Workspace", "finished_first", "running", "work_root"]

WORK: Final = "work"
"""Folder of the lake that holds the workspaces."""

_DONE: Final = "done.json"
_STATUS: Final = "status.json"
_LOCK: Final = ".lock"
_KEPT: Final = 7 * 86400.0  # seconds that a finished record waits for the run that needs it


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
        self._retried: frozenset[int] = frozenset()

    @classmethod
    @contextmanager
    def open(
        cls,
        root: Path,
        settings: Settings,
        todo: Iterable[Input] = (),
        retried: Collection[int] = (),
        settled: Iterable[Input] = (),
    ) -> Iterator[Workspace]:
        """Make a workspace in the lake `root`, and take over what dead runs have finished.

        It is removed when the block ends well; else what is finished stays for the next run.

        Parameters
        ----------
        root : Path
            Folder below which the workspaces of the lake are.
        settings : Settings
            Of the run.
        todo : iterable of Input
            What is taken over, if it is finished; other records are left for their own runs.
        retried : collection of int
            Model ids of those that are to be tried again if they failed.
        settled : iterable of Input
            Inputs that are in the lake with their bytes and these settings: records of them are
            of no use to any run.
        """
        home = root / WORK
        folder = home / uuid.uuid4().hex[:12]
        with ExitStack() as stack:
            # The home's lock is held while the folder is made and gets its own, so that no
            # other run ever sees it free, and while others' records are moved here.
            with _locked(home):
                folder.mkdir()
                lock = stack.enter_context((folder / "lock").open("a"))
                fcntl.flock(lock, fcntl.LOCK_EX)
                workspace = cls(folder, settings)
                workspace._retried = frozenset(retried)
                wanted = {workspace.spool(item).folder.name for item in todo}
                useless = {workspace.spool(item).folder.name for item in settled}
                for other in sorted(home.iterdir()):
                    if other.is_dir() and other != folder:
                        workspace._adopt(other, wanted, useless)
            yield workspace
            with _locked(home):
                shutil.rmtree(folder)

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
        """Return the failures of an input that is finished; None if it is not.

        A record that cannot be read, as a power cut leaves it, is removed; so is a failure that
        is to be tried again, and one of files that changed while the run went on.
        """
        spool = self.spool(item)
        if not (spool.folder / _DONE).exists():
            return None
        try:
            rows = json.loads((spool.folder / _DONE).read_text())["failures"]
            failures = [Failure(**row) for row in rows]
            # files that had changed may be as they were planned by now
            is_whole = spool.is_whole() and not Result(item, spool, failures).is_changed
        except (ValueError, KeyError, TypeError):
            is_whole = False
        if is_whole:
            lacks = not spool.has_record or not spool.read_model().get("mesh_kind")
            if not (lacks and item.model_id in self._retried):
                return failures
        shutil.rmtree(spool.folder)
        return None

    def write_status(self, **facts: Any) -> None:
        """Tell the world where the run stands."""
        _write(self.folder / _STATUS, facts)

    def _adopt(self, other: Path, wanted: Set[str], useless: Set[str]) -> None:
        """Take the `wanted` records out of the folder of a dead run, and remove what is waste."""
        try:
            lock = (other / "lock").open("r+")
        except FileNotFoundError:
            # The home's lock is ours, so nobody is making it: its run died at the start or end.
            shutil.rmtree(other, ignore_errors=True)
            return
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return
            left = 0
            for path in sorted(other.glob(f"*/{_DONE}")):
                name = path.parent.name
                if name in wanted and self._is_ours(path):
                    if not (self.folder / name).exists():
                        path.parent.rename(self.folder / name)
                elif name in wanted or name in useless or _age(path) > _KEPT:
                    shutil.rmtree(path.parent)
                else:
                    left += 1
            if not left:
                shutil.rmtree(other)
                return
            for path in other.iterdir():  # what is not finished is of no use to anyone
                if path.is_dir() and not (path / _DONE).exists():
                    shutil.rmtree(path)

    def _is_ours(self, done: Path) -> bool:
        """Return whether a record was made by these versions."""
        try:
            return bool(json.loads(done.read_text())["versions"] == self._versions)
        except (ValueError, KeyError, TypeError):
            return False  # cut short by a power cut


@contextmanager
def _locked(home: Path) -> Iterator[None]:
    """Hold the lock of the folder of all workspaces, which is made, and removed if it is empty."""
    path = home / _LOCK
    while True:
        try:
            home.mkdir(parents=True, exist_ok=True)
            file = path.open("a")
        except (FileExistsError, FileNotFoundError):
            if home.exists() and not home.is_dir():
                raise
            continue  # another run has just removed it
        with file:
            fcntl.flock(file, fcntl.LOCK_EX)
            if not _is_file(file, path):
                continue  # it was removed while we waited: this lock binds nobody
            try:
                yield
            finally:
                if [entry.name for entry in home.iterdir()] == [_LOCK]:
                    path.unlink()
                    # A file system over a network keeps removed files that are open in the
                    # folder, and a run that waits may have made the lock again: then it stays.
                    with suppress(OSError):
                        home.rmdir()
            return


def _is_file(file: IO[str], path: Path) -> bool:
    """Return whether `path` is still the open file."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


def _age(path: Path) -> float:
    return time.time() - path.stat().st_mtime


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
    name = hashlib.sha256(storage.name.encode()).hexdigest()[:16]
    # locks need not reach across the machines that share a home
    return (work or cache_folder()) / f"{name}-{platform.node()}"


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
        # A run may end, and its folder vanish, while we look.
        with suppress(FileNotFoundError), (path.parent / "lock").open() as lock:
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
        with suppress(FileNotFoundError):  # it ends while we look
            if (path.parent / _DONE).exists():
                continue
            stage, detail = spool.stage
            facts = {"stage": stage, "detail": detail, "seconds": spool.age()}
            found.append(facts | {"name": spool.begun or ""})
    return sorted(found, key=lambda model: -model["seconds"])


def _write(path: Path, document: dict[str, Any]) -> None:
    """Write JSON in one step, so that a kill leaves the whole document or none."""
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(document))
    os.replace(partial, path)
