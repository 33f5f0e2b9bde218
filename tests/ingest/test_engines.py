"""Lakes that are elsewhere, and clusters: the same content as on one machine."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import threading
import time
from pathlib import Path

import polars as pl
import pytest
from typer.testing import CliRunner

pytest.importorskip("OCP")

import breplake
from breplake.cli import app
from breplake.errors import MissingExtraError, StorageError, UsageError
from breplake.ingest import run
from breplake.ingest.failure import Failure
from breplake.ingest.inputs import find_inputs
from breplake.ingest.plan import Redo
from breplake.ingest.pool import Result
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings
from breplake.ingest.shard import write_shard
from breplake.ingest.spool import Spool
from breplake.schema.lake import LakeStore

from .lakes import assert_same, contents

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of botocore and moto

COARSE = Settings(max_edge=0.1)


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_samples(folder, names=["ball_half", "ring_o"])
    paths = sorted(folder.iterdir())
    for number in range(3):
        shutil.copy(paths[0], folder / f"copy_{number}.step")
    (folder / "broken.step").write_bytes(b"ISO-10303-21;\n")
    return folder


@pytest.fixture(autouse=True)
def small_shards(monkeypatch, tmp_path):
    monkeypatch.setattr(run, "SHARD_MODELS", 2)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def whole(parts, tmp_path_factory):
    """What a lake holds that was ingested on this machine."""
    lake = tmp_path_factory.mktemp("whole") / "lake"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "SHARD_MODELS", 2)
        run.ingest([parts], lake, settings=COARSE, jobs=2, collection="c")
    return contents(lake)


def left_over(folder):
    """The files in a cache, but for the ledger of what was found out."""
    files = (path for path in Path(folder).rglob("*") if path.is_file())
    return [path for path in files if path.name != "sources.sqlite"]


def test_a_lake_in_object_storage(parts, whole, bucket, tmp_path):
    summary = run.ingest([parts], bucket, settings=COARSE, jobs=2, collection="c")
    assert (summary.n_models, summary.n_fatal, summary.snapshot.number) == (5, 1, 3)
    lake = breplake.open(bucket)
    assert_same(contents(bucket), whole)
    assert lake.store.verify(lake.snapshot) == []
    assert not left_over(tmp_path / "cache")
    again = CliRunner().invoke(app, ["ingest", str(parts), "--lake", bucket, "--max-edge", "0.1"])
    assert again.exit_code == 0, again.output
    assert run.ingest([parts], bucket, settings=COARSE, collection="c").plan.todo == []
    status = CliRunner().invoke(app, ["ingest", "--status", "--lake", bucket])
    assert status.stdout.startswith("no ingest runs")


def test_models_replaced_in_object_storage(parts, bucket, tmp_path):
    run.ingest([parts], bucket, settings=COARSE, jobs=2, collection="c")
    finer = Settings(max_edge=0.05)
    (one,) = find_inputs([parts / "ring_o.step"], "c")
    run.ingest([one.path], bucket, settings=finer, jobs=1, collection="c", redo=Redo(changed=True))
    lake = breplake.open(bucket)
    assert lake.store.verify(lake.snapshot) == []
    hashes = dict(lake.sql("SELECT name, config_hash FROM models").fetchall())
    assert len(hashes) == 5
    assert {name for name, used in hashes.items() if used == finer.config_hash} == {"ring_o"}
    shards = lake.sql("SELECT name, shard FROM models").fetchall()
    assert all(lake.arrays(shard).rows("position") for _, shard in shards)


def test_a_killed_run_goes_on_in_object_storage(parts, whole, bucket, monkeypatch):
    """The second shard is being sent when the run ends; its bytes are put there again."""
    before, sent = LakeStore.send, []

    def send(store, files):
        sent.append(before(store, files))
        if len(sent) == 2:
            raise KeyboardInterrupt
        return sent[-1]

    monkeypatch.setattr(LakeStore, "send", send)
    with pytest.raises(KeyboardInterrupt):
        run.ingest([parts], bucket, settings=COARSE, jobs=1, collection="c")
    monkeypatch.setattr(LakeStore, "send", before)
    assert breplake.open(bucket).snapshot.number == 1
    summary = run.ingest([parts], bucket, settings=COARSE, jobs=1, collection="c")
    assert summary.n_resumed >= 2
    assert_same(contents(bucket), whole)


def failed(folder, parts, seconds):
    """Return results without any model, told apart by `seconds`."""
    failure = Failure("read", "read-failed", "m", fatal=True, seconds=seconds)
    return [Result(item, Spool(folder), [failure]) for item in find_inputs([parts], "c")]


def test_two_writers_of_the_same_inputs(parts, bucket, tmp_path):
    """Neither touches the other's files, and one of them is told."""
    LakeStore.create(bucket)
    files = []
    for number in range(2):
        store = LakeStore.open(bucket).at_desk(tmp_path / str(number))
        files.append(write_shard(store, failed(tmp_path, parts, float(number)), "h"))
    (first,), (second,) = files
    assert second.path == first.path.replace(".parquet", "-2.parquet")
    store = LakeStore.open(bucket)
    meta = {"message": "m", "tools": {}, "config_hash": "h"}
    store.commit([second], **meta)
    with pytest.raises(breplake.errors.CommitConflictError):
        LakeStore.open(bucket).commit([first], **meta)
    assert store.verify(store.head()) == []
    same = LakeStore.open(bucket).at_desk(tmp_path / "same")
    assert write_shard(same, failed(tmp_path, parts, 0.0), "h") == [first]


def test_two_writers_at_once(parts, bucket, tmp_path):
    """Each brings its own models to one lake; no commit is lost."""
    folders = [tmp_path / "a", tmp_path / "b"]
    names = sorted(path.name for path in parts.iterdir())
    for folder, chosen in zip(folders, (names[:3], names[3:]), strict=True):
        folder.mkdir()
        for name in chosen:
            shutil.copy(parts / name, folder)
    errors = []

    def work(folder):
        try:
            run.ingest([folder], bucket, settings=COARSE, jobs=1, work=tmp_path / "work")
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=work, args=[folder]) for folder in folders]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    lake = breplake.open(bucket)
    names = lake.sql("FROM (SELECT name FROM models UNION ALL SELECT name FROM failures)")
    assert len(names.fetchall()) == 6
    assert lake.snapshot.number == 4
    assert lake.store.verify(lake.snapshot) == []


def test_an_unreachable_lake(parts, bucket, monkeypatch):
    with pytest.raises(StorageError, match="check its address"):
        run.ingest([parts], "s3://no-such-bucket-here/lake", settings=COARSE)


def test_an_address_without_ray(parts, tmp_path):
    with pytest.raises(UsageError, match="--engine ray"):
        run.ingest([parts], tmp_path / "lake", address="auto")


def test_ray_is_an_extra(parts, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"breplake\[ray\]"):
        run.ingest([parts], tmp_path / "lake", settings=COARSE, engine="ray")


@pytest.fixture
def cluster():
    """A Ray cluster of two nodes that are processes of this machine."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    made.nodes = [made.add_node(num_cpus=1), made.add_node(num_cpus=1)]
    ray.init(address=made.address, log_to_driver=False)
    yield made
    ray.shutdown()
    with contextlib.suppress(Exception):  # the test has killed a part of it
        made.shutdown()


def same_but_shard(a, b):
    assert_same(*({n: f.drop("shard", strict=False) for n, f in x.items()} for x in (a, b)))


@pytest.mark.filterwarnings("ignore")  # of ray's own
def test_a_cluster_that_loses_a_node(parts, whole, cluster, tmp_path):
    lake = tmp_path / "lake"
    log = tmp_path / "log"
    done, killed, seen = threading.Event(), threading.Event(), set()

    def kill():
        """Kill a node once both are at work, and see who works."""
        while not done.is_set():
            folders = os.walk(tmp_path / "work")  # which overlooks what vanishes meanwhile
            begun = {Path(top).parent.name for top, _, names in folders if "begun" in names}
            seen.update(begun)
            if len(begun) == 2 and not killed.is_set():
                killed.set()
                cluster.remove_node(cluster.nodes[0], allow_graceful=False)
            time.sleep(0.02)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        summary = run.ingest(
            [parts], lake, settings=COARSE, collection="c", engine="ray", log=log,
            work=tmp_path / "work",
        )  # fmt: skip
    finally:
        done.set()
        killer.join()
    assert killed.is_set()
    assert len(seen) == 4, f"three shards, and one of them again, not {seen}"
    assert (summary.n_models, summary.n_fatal, summary.stopped) == (5, 1, False)
    assert (summary.n_meshed, summary.plan.new) == (5, summary.plan.inputs)
    found = breplake.open(lake)
    same_but_shard(contents(lake), whole)
    assert found.store.verify(found.snapshot) == []
    events = pl.read_ndjson(log, infer_schema_length=None)["event"].to_list()
    assert (events.count("model"), events.count("failed"), events.count("commit")) == (5, 1, 3)


@pytest.mark.filterwarnings("ignore")  # of ray's own
def test_a_cluster_and_object_storage(parts, whole, bucket, cluster, tmp_path):
    run.ingest([parts], bucket, settings=COARSE, collection="c", engine="ray", jobs=1)
    assert_same(contents(bucket), whole)
    assert not left_over(tmp_path / "cache")
    (tmp_path / "none").mkdir()
    run.ingest([tmp_path / "none"], tmp_path / "other", engine="ray")
    with pytest.raises(UsageError, match="lower --jobs"):
        run.ingest([parts], bucket, engine="ray", jobs=2, collection="d")
    counts = []
    stopped = run.ingest(
        [parts], tmp_path / "lake", settings=COARSE, collection="c", engine="ray", jobs=1,
        progress=lambda _, summary: counts.append(summary.n_done), stop=lambda: sum(counts) > 0,
    )  # fmt: skip
    assert stopped.stopped
    assert 2 <= stopped.n_done < 6
    rest = run.ingest([parts], tmp_path / "lake", settings=COARSE, jobs=1, collection="c")
    assert rest.n_done == 6 - stopped.n_done
    same_but_shard(contents(tmp_path / "lake"), whole)
