"""Chunks of ABC from archive to lake: complete, equal twice, resumable; refused when hostile."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("OCP")
pytest.importorskip("pebble")
pytest.importorskip("py7zr")

from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.ingest import run as runs
from breplake.ingest.cluster import ShardTask, run_shard
from breplake.ingest.plan import Redo
from breplake.ingest.run import ingest
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings
from breplake.ingest.sources.resolve import Sources
from breplake.schema.lake import LakeStore

from ..lakes import assert_same, contents

COARSE = Settings(max_edge=0.2, timeout=120)
SAMPLES = ("base_plate_mm", "duct_surface", "hinge", "ring_o")
CORPUS = Path(__file__).parents[4] / "shared" / "corpus"
FROM_CORPUS = (
    "abc_skoch9/simple__Sphere.step",
    "abc_skoch9/simple__Cone.step",
    "abc_skoch9/simple__Cylinder_Hole.step",
    "abc_skoch9/simple__Cylinder_Wedge.step",
    "abc_skoch9/simple__Box.step",
    "abc_skoch9/test__cusp.step",
    "foxtrot/examples__cube_hole.step",
    "analysissitus_tx/cad__wavy-cube.stp",
    "freecad_library/Mechanical_Parts__Fasteners__Washers__Metric__DIN93_M5TabWasher.step",
    "geouned/Torus__torus.stp",
)


def key(number):
    """Number and document of a model, as in the names of ABC."""
    return f"{number:08d}_{number * 0x9E3779B97F4A7C15:024x}"[:33]


def summary(number):
    document = key(number)[9:]
    return json.dumps(
        {
            "createdAt": f"2015-0{number % 9 + 1}-19T22:01:17.637+0000",
            "href": f"https://cad.onshape.com/api/documents/{document}",
            "id": document,
            "name": f"Document {number}",
            "owner": {"id": "1" * 24, "name": f"Owner {number}"},
            "public": True,
        }
    ).encode()  # JSON is YAML


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    folder = tmp_path_factory.mktemp("samples")
    write_samples(folder, SAMPLES)
    return [(folder / f"{name}.step").read_bytes() for name in SAMPLES]


@pytest.fixture(params=["samples", "corpus"])
def models(request, samples):
    if request.param == "samples":
        return samples
    if not CORPUS.is_dir():
        pytest.skip("needs ../shared/corpus")
    return [(CORPUS / name).read_bytes() for name in FROM_CORPUS]


def original_layout(folder, models, pack_7z):
    """Write a chunk as ABC does, with two blocks, and the chunk of metadata that goes with it."""
    steps = {
        f"{key(n)[:8]}/{key(n)}_step_000.step": data for n, data in enumerate(models, start=50)
    }
    metadata = {
        f"{key(n)[:8]}/{key(n)}_metadata_000.yml": summary(n) for n in range(50, 49 + len(models))
    }  # the last has none
    half = len(steps) // 2
    blocks = dict(list(steps.items())[:half]), dict(list(steps.items())[half:])
    pack_7z(folder / "abc_0000_meta_v00.7z", metadata)
    return pack_7z(folder / "abc_0000_step_v00.7z", *blocks), steps


def accounted(lake):
    """The path of every row of ``models`` and every fatal one of ``failures``, with its count."""
    query = """
        SELECT path, count(*) FROM
            (SELECT path FROM models UNION ALL SELECT path FROM failures WHERE fatal)
        GROUP BY path ORDER BY path"""
    return dict(breplake.open(lake).sql(query).fetchall())


def test_a_chunk_in_the_original_layout(tmp_path, models, pack_7z):
    chunk, steps = original_layout(tmp_path, [*models, b"", b"ISO-10303-21;\n"], pack_7z)
    lakes = tmp_path / "one", tmp_path / "two"
    for jobs, lake in enumerate(lakes, start=1):
        done = ingest([chunk], lake, settings=COARSE, jobs=jobs)
        assert (done.n_models, done.n_fatal) == (len(models), 2)
        assert accounted(lake) == {f"{chunk}!/{name}": 1 for name in steps}
    rows = breplake.open(lakes[0]).sql(
        "SELECT collection, name, licence, owner, source_url, metadata['document'], bytes "
        "FROM models ORDER BY name"
    )
    assert rows.fetchall() == [
        (
            "abc",
            f"{key(n)}_000",
            "LicenseRef-Onshape-ToU-1.g.ii",
            f"Owner {n}",
            f"https://cad.onshape.com/documents/{key(n)[9:]}",
            f"Document {n}",
            len(data),
        )
        for n, data in enumerate(models, start=50)
    ]
    assert_same(*map(contents, lakes))
    files = [breplake.open(lake).snapshot.table_files("vertices") for lake in lakes]
    assert [entry.sha256 for entry in files[0]] == [entry.sha256 for entry in files[1]]
    for lake in lakes:
        assert not LakeStore.open(lake).verify(LakeStore.open(lake).head())
    again = ingest([chunk], lakes[0], settings=COARSE, jobs=1)
    assert (again.plan.todo, again.snapshot) == ([], None)


def test_hostile_archives_are_rows_and_a_clear_error(tmp_path, samples, pack):
    good = pack(tmp_path / "good.zip", {"ring.step": samples[3]})
    files = {f"{key(1)[:8]}/{key(1)}_step_000.step": samples[3], "../../up.step": b"x"}
    evil = pack(tmp_path / "evil.tar.gz", files)
    bomb = pack(tmp_path / "bomb.zip", {"a.step": samples[3], "b.step": bytes(20_000_000)})
    assert bomb.stat().st_size < 20_000_000 / 500
    lake = tmp_path / "lake"
    command = ["ingest", str(evil), str(good), str(bomb), "--lake", str(lake), "--max-edge", "0.2"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 2
    said = done.stderr.replace("\n", " ")
    assert f"{evil} is refused: its member '../../up.step' leads out of the archive" in said
    assert f"{bomb} is refused: it unpacks to" in said
    assert "--max-expansion" in said
    assert accounted(lake) == {
        str(bomb): 1,
        f"{bomb}!/a.step": 1,
        f"{bomb}!/b.step": 1,
        str(evil): 1,
        f"{evil}!/{key(1)[:8]}/{key(1)}_step_000.step": 1,
        f"{evil}!/../../up.step": 1,
        f"{good}!/ring.step": 1,
    }
    opened = breplake.open(lake)
    assert opened.sql("SELECT DISTINCT kind, stage FROM failures").fetchall() == [
        ("refused", "plan")
    ]
    assert opened.sql("SELECT path FROM models").fetchall() == [(f"{good}!/ring.step",)]
    assert not list(tmp_path.parent.glob("up.step"))
    again = CliRunner().invoke(app, command)
    assert again.exit_code == 2, "it is told every time"
    assert opened.snapshot.number == breplake.open(lake).snapshot.number


def test_what_was_refused_or_damaged_is_taken_up_when_it_is_whole(tmp_path, samples, pack):
    lake, path = tmp_path / "lake", tmp_path / "a.tar"
    ring, duct = samples[3], samples[1]
    pack(path, {"duct.step": duct, "ring.step": ring, "../x.step": b"x"})
    first = ingest([path], lake, settings=COARSE, jobs=1)
    assert (first.n_models, first.n_fatal, len(first.refused)) == (0, 4, 1)
    pack(path, {"duct.step": duct, "ring.step": ring})
    data = path.read_bytes()
    path.write_bytes(data[: data.index(ring) + len(ring) // 2])
    damaged = ingest([path], lake, settings=COARSE, jobs=1, redo=Redo(failed=True))
    assert (damaged.n_models, damaged.n_fatal) == (1, 2)
    assert accounted(lake) == {
        str(path): 1, f"{path}!/duct.step": 1, f"{path}!/ring.step": 1, f"{path}!/../x.step": 1
    }  # fmt: skip
    pack(path, {"duct.step": duct, "ring.step": ring})
    whole = ingest([path], lake, settings=COARSE, jobs=1, redo=Redo(failed=True))
    assert (whole.n_models, whole.n_fatal) == (1, 0)
    paths = [f"{path}!/{name}.step" for name in ("../x", "duct", "ring")]
    assert accounted(lake) == dict.fromkeys(paths, 1), "the archive itself failed no longer"
    assert breplake.open(lake).sql("SELECT count(*) FROM models").fetchall() == [(2,)]


def test_changed_members_are_replaced_when_asked(tmp_path, samples, pack):
    lake, path = tmp_path / "lake", tmp_path / "a.zip"
    ring, duct = samples[3], samples[1]
    pack(path, {"b/duct.step": duct, "ring.step": ring})
    ingest([path], lake, settings=COARSE, jobs=1)
    before = contents(lake)
    pack(path, {"b/duct.step": duct, "ring.step": ring + b"/* changed */\n"})
    idle = ingest([path], lake, settings=COARSE, jobs=1)
    assert ([item.name for item in idle.plan.changed], idle.snapshot) == (["ring"], None)
    done = ingest([path], lake, settings=COARSE, jobs=1, redo=Redo(changed=True))
    assert (done.n_models, len(done.plan.unchanged)) == (1, 1)
    after = contents(lake)
    assert after["models"]["name"].sort().to_list() == ["b/duct", "ring"]
    assert (after["models"].sort("name")["bytes"] - before["models"].sort("name")["bytes"]).to_list(
    ) == [0, len("/* changed */\n")]  # fmt: skip
    assert after["vertices"].equals(before["vertices"])
    assert breplake.open(lake, at=1).sql("SELECT count(*) FROM models").fetchall() == [(2,)]


RUN = """
import sys
from breplake.ingest import run
from breplake.ingest.settings import Settings
from breplake.ingest.sources.resolve import Sources
run.SHARD_MODELS = 2
if __name__ == "__main__":
    run.ingest([sys.argv[1]], sys.argv[2], settings=Settings(max_edge=0.2, timeout=120), jobs=2)
"""


def test_a_killed_run_of_an_archive_is_taken_up(tmp_path, samples, pack_7z, monkeypatch):
    chunk, steps = original_layout(tmp_path, samples, pack_7z)
    lake = tmp_path / "lake"
    monkeypatch.setattr(runs, "SHARD_MODELS", 2)
    ingest([chunk], tmp_path / "whole", settings=COARSE, jobs=2)
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, str(chunk), str(lake)],
        env={**os.environ, "PYTHONSAFEPATH": "1"},
        start_new_session=True,
    )
    end = time.monotonic() + 120
    while process.poll() is None and not list(lake.glob("work/*/*/done.json")):
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)
    assert process.poll() is None, "it ended before it could be killed"
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    rest = ingest([chunk], lake, settings=COARSE, jobs=2)
    assert rest.n_resumed >= 1
    assert_same(contents(lake), contents(tmp_path / "whole"))
    assert accounted(lake) == {f"{chunk}!/{name}": 1 for name in steps}
    assert not (lake / "work").exists()
    shutil.rmtree(tmp_path / "whole")


def test_a_node_of_a_cluster_reads_the_archive_itself(tmp_path, samples, pack_7z, monkeypatch):
    """Its cache is another: what the metadata say of the models comes with the task."""
    chunk, _ = original_layout(tmp_path, samples[1::2], pack_7z)
    store = LakeStore.open_or_create(tmp_path / "lake")
    with Sources.open() as opened:
        inputs = tuple(opened.told(opened.find([chunk])))
    monkeypatch.setenv("BREPLAKE_CACHE", str(tmp_path / "cache of the node"))
    task = ShardTask(
        str(tmp_path / "lake"), store.lake_id, os.getcwd(), inputs, COARSE, 2, work=str(tmp_path)
    )
    done = run_shard(task)
    assert (done.tally.n_models, done.tally.n_fatal) == (2, 0)
    store.commit(done.files, message="m", tools={}, config_hash=COARSE.config_hash)
    query = "SELECT name, owner FROM models ORDER BY name"
    rows = breplake.open(tmp_path / "lake").sql(query).fetchall()
    assert rows == [(f"{key(50)}_000", "Owner 50"), (f"{key(51)}_000", None)]
