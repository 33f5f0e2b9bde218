"""Files while they are read: what is their fault, what the disk's, and what changes meanwhile."""

from __future__ import annotations

import errno
import gzip
import io
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("OCP")

import breplake
from breplake.errors import InputError
from breplake.ingest import pool, run, unchanged, worker
from breplake.ingest import unpack as packing
from breplake.ingest.clock import StageClock
from breplake.ingest.inputs import find_inputs
from breplake.ingest.plan import Redo
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings
from breplake.ingest.sources.origin import UriOrigin
from breplake.ingest.spool import Spool
from breplake.ingest.unpack import unpacked
from breplake.ingest.worker import Task, work
from breplake.ingest.workspace import Workspace

COARSE = Settings(max_edge=0.1)


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_samples(folder, names=["ball_half", "ring_o"])
    return folder


@pytest.fixture
def step(parts, tmp_path):
    return Path(shutil.copy(parts / "ring_o.step", tmp_path / "part.step"))


def ingested(path, folder, before=lambda: None):
    """What the worker says of one file, to which something happens after it was planned."""
    (item,) = find_inputs([path])
    before()
    folder.mkdir()
    spool = Spool(folder)
    return work(Task(item, COARSE, spool)), spool


def refuse(monkeypatch, method, names, code):
    """Have files of these names refuse to be written."""
    whole = getattr(Path, method)

    def refusing(path, *args, **options):
        if path.name in names and (method != "open" or args[:1] == ("wb",)):
            raise OSError(code, os.strerror(code), str(path))
        return whole(path, *args, **options)

    monkeypatch.setattr(Path, method, refusing)


class Full(io.BytesIO):
    def write(self, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def packed(step):
    path = step.with_name("part.step.gz")
    path.write_bytes(gzip.compress(step.read_bytes()))
    return path


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_no_room_to_unpack_is_no_fault_of_the_file(step, tmp_path, monkeypatch, code):
    refuse(monkeypatch, "open", {"unpacked.step"}, code)
    ((failure,), _) = ingested(packed(step), tmp_path / "spool")
    assert (failure.stage, failure.kind) == ("read", "disk-full")


def test_no_room_for_the_last_bytes_is_no_fault_of_the_file(step, tmp_path, monkeypatch):
    whole = Path.open

    def full(path, mode="r", **options):
        return Full() if path.name == "unpacked.step" else whole(path, mode, **options)

    monkeypatch.setattr(Path, "open", full)
    ((failure,), _) = ingested(packed(step), tmp_path / "spool")
    assert (failure.stage, failure.kind) == ("read", "disk-full")


def test_a_disk_that_cannot_write_is_no_bad_archive(step, tmp_path, monkeypatch):
    refuse(monkeypatch, "open", {"unpacked.step"}, errno.EIO)
    with pytest.raises(OSError, match="Input/output"):
        unpacked(packed(step), "step", tmp_path)


@pytest.mark.parametrize("cut", [5, -9])
def test_bytes_that_are_wrong_are_a_bad_archive(step, tmp_path, cut):
    path = packed(step)
    path.write_bytes(path.read_bytes()[:cut] if cut < 0 else b"other" + path.read_bytes())
    with pytest.raises(InputError) as caught:
        unpacked(path, "step", tmp_path)
    assert caught.value.kind == "bad-archive"


def test_what_unpacks_to_too_much_is_a_bad_archive(step, tmp_path, monkeypatch):
    monkeypatch.setattr(packing, "MAX_UNPACKED", 1000)
    with pytest.raises(InputError, match="more than 1000 bytes") as caught:
        unpacked(packed(step), "step", tmp_path)
    assert caught.value.kind == "bad-archive"


def test_no_room_for_what_gmsh_reads_is_no_mismatch(step, tmp_path, monkeypatch):
    for method in ("write_bytes", "write_text"):
        refuse(monkeypatch, method, {"model.brep"}, errno.ENOSPC)
    failures, spool = ingested(step, tmp_path / "spool")
    assert [failure.kind for failure in failures] == ["disk-full"]
    assert "mesh_kind" not in spool.read_model()
    ended = pool.Ended(pool.Result(find_inputs([step])[0], spool), failures)
    with pytest.raises(OSError, match="No space"):  # which ends the run: no model is committed so
        pool._take(ended, COARSE)


@pytest.mark.parametrize("is_packed", [False, True])
def test_a_file_that_changed_after_planning(step, parts, tmp_path, is_packed):
    path = packed(step) if is_packed else step
    other = (parts / "ball_half.step").read_bytes()

    def change():
        path.write_bytes(gzip.compress(other) if is_packed else other)

    ((failure,), spool) = ingested(path, tmp_path / "spool", change)
    assert (failure.stage, failure.kind, failure.fatal) == ("read", "hash-mismatch", True)
    assert f"{path} changed after it was planned, so run the same command" in failure.message
    assert not spool.has_record


def test_a_file_that_is_gone_after_planning(step, tmp_path):
    ((failure,), _) = ingested(step, tmp_path / "spool", step.unlink)
    assert (failure.stage, failure.kind, failure.fatal) == ("read", "unreadable", True)


@pytest.mark.parametrize("text", ["", None])
def test_a_file_that_changes_while_it_is_loaded(step, parts, tmp_path, monkeypatch, text):
    """Half a file is no broken file, and other bytes are no model of the planned hash."""
    whole = worker.load

    def load(path, format):
        step.write_text((parts / "ball_half.step").read_text() if text is None else text)
        return whole(path, format)

    monkeypatch.setattr(worker, "load", load)
    ((failure,), spool) = ingested(step, tmp_path / "spool")
    assert (failure.stage, failure.kind, failure.fatal) == ("read", "hash-mismatch", True)
    assert not spool.has_record


def test_links_and_replaced_equals_are_the_file_that_was_planned(step, tmp_path):
    link = tmp_path / "link.step"
    link.symlink_to(step)

    def replace_by_equal():
        copy = step.with_name("copy")
        copy.write_bytes(step.read_bytes())
        copy.replace(step)

    failures, spool = ingested(link, tmp_path / "spool", replace_by_equal)
    assert failures == []
    assert spool.has_record


def failed(lake):
    query = "SELECT name, stage, kind, sha256 FROM failures WHERE fatal"
    return breplake.open(lake).sql(query).fetchall()


def named(lake):
    query = "SELECT name, sha256 FROM models ORDER BY name"
    return dict(breplake.open(lake).sql(query).fetchall())


def test_a_changed_file_has_its_turn_in_the_next_run(parts, tmp_path):
    """A model of the lake stays; a failure gives way to the model without being asked to."""
    files, lake = tmp_path / "files", tmp_path / "lake"
    shutil.copytree(parts, files)
    new, old = files / "ball_half.step", files / "ring_o.step"
    run.ingest([old], lake, settings=COARSE, jobs=1, collection="c")
    before = named(lake)
    old.write_bytes(old.read_bytes() + b"\n")

    def change(_plan, summary):
        if not summary.n_done:
            for path in (old, new):
                path.write_bytes(path.read_bytes() + b"\n")

    def again(**options):
        more = {"settings": COARSE, "jobs": 1, "collection": "c", "redo": Redo(changed=True)}
        return run.ingest([files], lake, **more | options)

    summary = again(progress=change)
    assert dict(summary.kinds) == {("read", "hash-mismatch"): 2}
    assert named(lake) == before
    assert failed(lake) == [("ball_half", "read", "hash-mismatch", None)]
    new.write_bytes((parts / new.name).read_bytes())  # as it was planned
    assert again(redo=None).n_models == 1
    assert named(lake).keys() == {"ball_half", "ring_o"}
    assert failed(lake) == []


def test_a_resumed_run_reads_a_changed_file_again(step, tmp_path):
    (item,) = find_inputs([step])
    step.write_bytes(step.read_bytes() + b"\n")
    with Workspace.open(tmp_path, COARSE, [item]) as workspace:
        spool = workspace.spool(item)
        spool.folder.mkdir()
        (failure,) = work(Task(item, COARSE, spool))
        workspace.close(item, [failure])
        assert workspace.finished(item) is None
        spool.folder.mkdir()
        workspace.close(item, [replace(failure, stage="load", kind="read-failed")])
        assert workspace.finished(item) is not None, "what is the file's fault stays"


def test_what_was_brought_is_not_hashed_twice(step, tmp_path, monkeypatch):
    def never():
        raise AssertionError("it was hashed on its way")

    monkeypatch.setattr(unchanged, "Hasher", never)
    with pytest.raises(AssertionError), unchanged.unchanged(*planned(step, None)):
        pass
    with unchanged.unchanged(*planned(step, UriOrigin("http://x/part.step"))):
        pass


def planned(step, origin):
    (item,) = find_inputs([step])
    return replace(item, origin=origin), StageClock(lambda _stage: None)


@pytest.mark.parametrize(("error", "kind"), [(ValueError, "areas-failed"), (MemoryError, "memory")])
def test_areas_that_cannot_be_derived_cost_no_model(step, tmp_path, monkeypatch, error, kind):
    def fail(_tables):
        raise error("no area")

    monkeypatch.setattr(worker, "swept_areas", fail)
    ((failure,), spool) = ingested(step, tmp_path / "spool")
    assert (failure.stage, failure.kind, failure.fatal) == ("brep", kind, False)
    row = spool.read_model()
    assert row["mesh_kind"]
    assert row["area"] > 0
