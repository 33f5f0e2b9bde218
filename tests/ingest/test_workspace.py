"""Workspaces of many runs in one folder: none is harmed, and none takes what another needs."""

from __future__ import annotations

import multiprocessing
import os
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest

pytest.importorskip("OCP")

from breplake.errors import UsageError
from breplake.ingest.cluster import ShardTask, _lake
from breplake.ingest.failure import Failure
from breplake.ingest.inputs import Input
from breplake.ingest.settings import Settings
from breplake.ingest.sources.origin import MemberOrigin, UriOrigin
from breplake.ingest.workspace import WORK, Workspace, running, work_root
from breplake.schema.lake import LakeStore
from breplake.schema.storage import Storage

SETTINGS = Settings()
OTHER = replace(SETTINGS, max_edge=0.2)
TIMEOUT = Failure("load", "timeout", "too slow", fatal=True)


class KilledError(Exception):
    """Stands for the end of a run that left its folder."""


def item(name):
    return Input(Path(f"{name}.step"), "c", name, "step", 3, name * 64)


A, B = item("a"), item("b")


def killed(root, items, failures=(), settings=SETTINGS, mesh_kind="uniform"):
    """Leave finished records, as a run that was killed does."""
    with suppress(KilledError), Workspace.open(root, settings, items) as workspace:
        for each in items:
            _finish(workspace, each, failures, mesh_kind)
        raise KilledError


def _finish(workspace, each, failures, mesh_kind):
    spool = workspace.spool(each)
    spool.folder.mkdir()
    if not failures:
        tables = {"patches": pa.table({"id": list(range(1000))})}
        spool.write("mesh", tables, lambda: {"mesh_kind": mesh_kind})
    workspace.close(each, list(failures))


def loop(root, seconds, errors):
    end = time.monotonic() + seconds
    try:
        while time.monotonic() < end:
            with Workspace.open(root, SETTINGS, [A]) as workspace:
                workspace.write_status(started=0)
                running(root)
    except BaseException as error:
        errors.put(repr(error))
        raise


def test_runs_that_come_and_go_do_not_harm_each_other(tmp_path):
    context = multiprocessing.get_context("fork")
    errors = context.Queue()
    processes = [context.Process(target=loop, args=(tmp_path, 1.5, errors)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60)
    assert [process.exitcode for process in processes] == [0, 0], errors.get(timeout=1)
    assert not (tmp_path / WORK).exists()


@pytest.mark.parametrize(("items", "settings"), [([B], SETTINGS), ([A], OTHER), ([], SETTINGS)])
def test_other_runs_leave_what_a_killed_run_finished(tmp_path, items, settings):
    killed(tmp_path, [A])
    with Workspace.open(tmp_path, settings, items) as workspace:
        assert not any(workspace.finished(each) for each in items)
    with Workspace.open(tmp_path, SETTINGS, [A]) as workspace:
        assert workspace.finished(A) == []
        assert workspace.spool(A).has_record
    assert not (tmp_path / WORK).exists()


def test_records_that_nobody_came_for_are_removed(tmp_path):
    killed(tmp_path, [A, B])
    for path in (tmp_path / WORK).glob("*/*a*/done.json"):
        os.utime(path, (0, 0))
    with Workspace.open(tmp_path, SETTINGS):
        assert len(list((tmp_path / WORK).glob("*/*/done.json"))) == 1
    with Workspace.open(tmp_path, SETTINGS, settled=[B]):
        assert not list((tmp_path / WORK).glob("*/*/done.json"))
    assert not (tmp_path / WORK).exists()


@pytest.mark.parametrize("is_retried", [False, True])
def test_a_failure_that_is_tried_again_is_not_finished(tmp_path, is_retried):
    killed(tmp_path, [A], [TIMEOUT])
    retried = {A.model_id} if is_retried else ()
    with Workspace.open(tmp_path, SETTINGS, [A], retried) as workspace:
        assert workspace.finished(A) == (None if is_retried else [TIMEOUT])
        assert workspace.spool(A).folder.exists() != is_retried


@pytest.mark.parametrize("file", ["mesh/patches.arrow", "mesh/model.json", "done.json"])
def test_a_record_that_a_power_cut_damaged_is_made_again(tmp_path, file):
    killed(tmp_path, [A])
    (path,) = (tmp_path / WORK).glob(f"*/*/{file}")
    path.write_bytes(bytes(path.stat().st_size))
    with Workspace.open(tmp_path, SETTINGS, [A]) as workspace:
        assert workspace.finished(A) is None
        assert not workspace.spool(A).folder.exists()


def test_the_cache_is_named_by_one_variable(tmp_path, monkeypatch):
    monkeypatch.setenv("BREPLAKE_CACHE", str(tmp_path / "mine"))
    assert work_root(Storage(tmp_path), here=True).parent == tmp_path / "mine"


def test_a_node_is_asked_only_for_files_it_has_to_read(tmp_path, monkeypatch):
    store = LakeStore.open_or_create(tmp_path / "lake")
    archive = tmp_path / "a.zip"
    of_address = replace(A, origin=UriOrigin("https://example.com/a.step"))
    of_archive = replace(B, origin=MemberOrigin(archive, 0))

    def seen(*inputs):
        return _lake(
            ShardTask(store.storage.name, store.lake_id, str(tmp_path), inputs, SETTINGS, 1)
        )

    monkeypatch.chdir(tmp_path)
    seen(of_address)
    for lacking, path in ((A, A.path), (of_archive, archive)):
        with pytest.raises(UsageError, match=f"does not see .*{path.name}"):
            seen(lacking)
    archive.touch()
    seen(of_archive)
