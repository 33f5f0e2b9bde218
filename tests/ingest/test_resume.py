"""Runs that are killed, stopped, repeated: the lake is that of one that was left alone."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest

import breplake
from breplake.errors import StorageError, UsageError
from breplake.ingest import shard
from breplake.ingest.plan import Redo
from breplake.ingest.run import ingest
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings
from breplake.ingest.workspace import WORK, running
from breplake.schema.lake import LakeStore

from .lakes import assert_same, contents

NAMES = ["flange_round", "bracket_l", "pipe_tee", "washer", "gear_spur", "torus_chain"]
COARSE = Settings(max_edge=0.1)

RUN = """
import sys
from breplake.ingest import run
from breplake.ingest.settings import Settings
run.SHARD_MODELS = 2
run.ingest([sys.argv[1]], sys.argv[2], settings=Settings(max_edge=0.1), jobs=2, collection="c")
"""


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_samples(folder, names=_some_names())
    return folder


def _some_names():
    from breplake.ingest.samples import PARTS

    wanted = [name for name in NAMES if name in PARTS]
    return wanted + [name for name in PARTS if name not in wanted][: 6 - len(wanted)]


def start(parts, lake):
    return subprocess.Popen(
        [sys.executable, "-c", RUN, str(parts), str(lake)],
        env={**os.environ, "PYTHONSAFEPATH": "1"},
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def wait_for(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


def finished(lake):
    return list(Path(lake).glob(f"{WORK}/*/*/done.json"))


@pytest.fixture(scope="module")
def whole(parts, tmp_path_factory):
    """The lake of a run that nobody disturbed."""
    lake = tmp_path_factory.mktemp("whole") / "lake"
    assert start(parts, lake).wait() == 0
    return contents(lake)


def test_a_killed_run_is_taken_up_where_it_was(parts, whole, tmp_path):
    lake = tmp_path / "lake"
    kills = 0
    for after in (1, 1, 2):
        process = start(parts, lake)
        wait_for(lambda n=after, p=process: p.poll() is not None or len(finished(lake)) >= n)
        if process.poll() is None:
            kills += 1
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert kills, "every run ended before it could be killed"
    done = {path.parent.name for path in finished(lake)}
    summary = ingest_small(parts, lake)
    assert summary.n_resumed == len(done)
    assert_same(contents(lake), whole)
    assert not (lake / WORK).exists()
    assert not LakeStore.open(lake).verify(LakeStore.open(lake).head())


def ingest_small(parts, lake, **more):
    before = shard.SHARD_MODELS
    from breplake.ingest import run

    run.SHARD_MODELS = 2
    try:
        more.setdefault("settings", COARSE)
        return ingest([parts], lake, jobs=2, collection="c", **more)
    finally:
        run.SHARD_MODELS = before


def test_a_worker_does_not_outlive_its_run(parts, tmp_path):
    lake = tmp_path / "lake"
    process = start(parts, lake)
    wait_for(lambda: list(lake.glob(f"{WORK}/*/*/begun")))
    children = [int(pid) for pid in _descendants(process.pid)]
    assert children
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    wait_for(lambda: not any(_alive(pid) for pid in children), 20)


def _descendants(pid):
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it ended meanwhile
        if int(fields[1]) == pid:
            child = int(path.parent.name)
            found += [child, *_descendants(child)]
    return found


def _alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_stopping_commits_what_is_finished(parts, whole, tmp_path):
    lake = tmp_path / "lake"
    done = []
    summary = ingest_small(
        parts, lake, progress=lambda _, s: done.append(s.n_done), stop=lambda: done[-1:] >= [3]
    )
    assert summary.stopped
    assert 3 <= summary.n_models < 6
    assert len(contents(lake)["models"]) == summary.n_models
    rest = ingest_small(parts, lake)
    assert not rest.stopped
    assert rest.n_models == 6 - summary.n_models
    # The shards differ, being cut at other places; the rest does not.
    placed = ["shard", "vertex_offset", "normal_offset", "face_offset"]
    ours, theirs = contents(lake), dict(whole)
    ours["models"], theirs["models"] = ours["models"].drop(placed), whole["models"].drop(placed)
    assert_same(ours, theirs)


def test_changed_files_are_replaced_when_asked(parts, tmp_path):
    folder, lake = tmp_path / "parts", tmp_path / "lake"
    shutil.copytree(parts, folder)
    ingest_small(folder, lake)
    before = contents(lake)
    paths = sorted(folder.iterdir())
    shutil.copy(paths[1], paths[0])  # the first file is now the second part
    idle = ingest_small(folder, lake)
    assert [item.path.name for item in idle.plan.changed] == [paths[0].name]
    assert idle.snapshot is None
    summary = ingest_small(folder, lake, redo=Redo(changed=True))
    assert summary.n_models == 1
    after = contents(lake)
    assert len(after["models"]) == 6
    models = after["models"].sort("name")
    assert models["sha256"][0] == models["sha256"][1] != before["models"].sort("name")["sha256"][0]
    for name in ("patches", "vertices", "faces", "curves"):
        kept = pl.col("model_id").is_in(models["model_id"][2:].to_list())
        assert after[name].filter(kept).equals(before[name].filter(kept)), name
    lake_ = breplake.open(lake)
    for row in models.to_dicts():
        arrays = lake_.arrays(row["shard"])
        rows = after["vertices"].filter(pl.col("model_id") == row["model_id"])
        position = arrays.read(
            "position", row["vertex_offset"], row["vertex_offset"] + row["n_vertices"]
        )
        primary = rows.filter("is_primary").sort("vertex_id")
        assert (position == primary.select("x", "y", "z").to_numpy().astype("f4")).all()
    old = breplake.open(lake, at=1)
    assert old.sql("SELECT count(*) FROM models").fetchall()[0][0] >= 2


def test_failures_are_tried_again_when_asked(parts, tmp_path):
    folder, lake = tmp_path / "parts", tmp_path / "lake"
    shutil.copytree(parts, folder)
    broken = sorted(folder.iterdir())[2]
    text = broken.read_bytes()
    broken.write_bytes(b"")
    assert ingest_small(folder, lake).n_fatal == 1
    again = ingest_small(folder, lake, redo=Redo(failed=True, kinds=("timeout",)))
    assert again.plan.failed
    assert not again.plan.todo
    again = ingest_small(folder, lake, redo=Redo(failed=True, kinds=("empty-file",)))
    assert again.n_fatal == 1
    assert len(contents(lake)["failures"]) == 1
    broken.write_bytes(text)
    assert ingest_small(folder, lake, redo=Redo(changed=True)).n_models == 1
    assert "failures" not in contents(lake), contents(lake)["failures"].rows(named=True)
    assert len(contents(lake)["models"]) == 6


def test_kinds_to_retry_are_checked():
    with pytest.raises(UsageError, match="no failure 'slow'"):
        Redo(failed=True, kinds=("slow",))
    with pytest.raises(UsageError, match="retry-failures"):
        Redo(kinds=("timeout",))


def test_the_log_has_a_line_for_each_event(parts, tmp_path):
    log = tmp_path / "log.jsonl"
    ingest_small(parts, tmp_path / "lake", log=log)
    events = [json.loads(line) for line in log.read_text().splitlines()]
    names = [event["event"] for event in events]
    assert names[0] == "plan"
    assert names[-1] == "end"
    assert names.count("model") == 6
    assert names.count("commit") == 3
    assert all(event["mesh_kind"] for event in events if event["event"] == "model")


def test_a_running_ingest_says_where_it_stands(parts, tmp_path):
    lake = tmp_path / "lake"
    seen = []

    def look(_plan, summary):
        if 0 < summary.n_done < 6:
            seen.extend(running(lake))

    ingest_small(parts, lake, progress=look)
    assert seen
    assert seen[0]["todo"] == 6
    assert seen[0]["pid"] == os.getpid()
    assert all(model["name"] for status in seen for model in status["now"])
    assert not running(lake)


def test_a_lake_that_cannot_be_written_is_a_clear_error(parts, tmp_path, monkeypatch):
    lake = tmp_path / "lake"
    ingest_small(parts, lake)
    head = LakeStore.open(lake).head()
    (tmp_path / "more").mkdir()
    shutil.copy(sorted(parts.iterdir())[0], tmp_path / "more" / "another.step")

    def full(*_args, **_more):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("breplake.ingest.run.write_shard", full)
    with pytest.raises(StorageError, match="disk is full: make room"):
        ingest_small(tmp_path / "more", lake)
    monkeypatch.undo()
    assert LakeStore.open(lake).head().number == head.number
    summary = ingest_small(tmp_path / "more", lake)
    assert summary.n_resumed == 1
