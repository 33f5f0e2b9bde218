"""Disks that fill up, or may not be written any more: a clear error, and a whole lake."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time

import pytest
from typer.testing import CliRunner

pytest.importorskip("OCP")

import breplake
from breplake.cli import app
from breplake.errors import LakeNotFoundError, NameNotFoundError, StorageError
from breplake.ingest import run
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings
from breplake.ingest.workspace import WORK

COARSE = Settings(max_edge=0.1)

RUN = """
import sys
from breplake.ingest import run
from breplake.ingest.settings import Settings
run.SHARD_MODELS = 1
run.ingest([sys.argv[1]], sys.argv[2], settings=Settings(max_edge=0.1), jobs=1)
"""


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_samples(folder, names=["ball_half", "ring_o", "washer_spring"])
    return folder


@pytest.fixture(autouse=True)
def small_shards(monkeypatch):
    monkeypatch.setattr(run, "SHARD_MODELS", 1)


@pytest.fixture
def disk(tmp_path):
    """A disk of 128 kB in memory, and the function that mounts it again with other options."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", str(folder)]
    try:
        allowed = subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        allowed = False
    if not allowed:
        pytest.skip("mounting a disk in memory is not allowed here")

    def again(options):
        subprocess.run(["mount", "-o", f"remount,{options}", str(folder)], check=True)

    yield folder, again
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def committed(lake):
    """Return how many models a lake has, all of whose files are whole."""
    try:
        opened = breplake.open(lake)
    except (LakeNotFoundError, NameNotFoundError):
        return 0
    assert opened.store.verify(opened.snapshot) == []
    return opened.sql("SELECT count(*) FROM models").fetchall()[0][0]


def refusal(parts, lake):
    """Ingest, and return why that was refused; None if it was not."""
    try:
        run.ingest([parts], lake, settings=COARSE, jobs=1)
    except StorageError as error:
        return str(error)
    return None


def test_a_disk_that_fills_up(parts, disk):
    """It grows bit by bit: every run goes further, until the last one is done."""
    folder, again = disk
    lake = folder / "lake"
    kilobytes, counts = 128, []
    while (said := refusal(parts, lake)) is not None:
        assert "disk is full: make room and run the same command" in said
        counts.append(committed(lake))
        kilobytes = kilobytes * 3 // 2
        assert kilobytes < 64_000
        again(f"size={kilobytes}k")
    assert counts, "the disk was never full"
    assert counts == sorted(counts)
    assert 0 < max(counts) < 3, "it was never full after a commit"
    assert committed(lake) == 3
    assert not (lake / WORK).exists()
    opened = breplake.open(lake)
    assert opened.sql("SELECT count(*) FROM failures").fetchall() == [(0,)]


def test_a_lake_on_a_disk_that_may_not_be_written(parts, disk):
    folder, again = disk
    again("size=64m")
    lake = folder / "lake"
    first = sorted(parts.iterdir())[0]
    run.ingest([first], lake, settings=COARSE, jobs=1)
    again("ro")
    result = CliRunner().invoke(app, ["ingest", str(parts), "--lake", str(lake)])
    assert result.exit_code == 2
    assert "its disk is read-only: give another --lake" in result.stderr
    assert committed(lake) == 1


def test_permission_lost_in_mid_run(parts, tmp_path):
    lake = tmp_path / "lake"
    command = [sys.executable, "-c", RUN, str(parts), str(lake)]
    if os.geteuid() == 0:  # whom permissions do not bind, unless these rights are given up
        if shutil.which("setpriv") is None:
            pytest.skip("root loses no permission without setpriv")
        command = ["setpriv", "--bounding-set=-dac_override,-dac_read_search", *command]
    environment = {**os.environ, "PYTHONSAFEPATH": "1"}
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 120
    while not list(lake.glob("snapshots/*.json")):
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end, "nothing was committed"
        time.sleep(0.01)
    closed = [path for path in (lake / "tables").iterdir() if path.is_dir()]
    for folder in closed:
        folder.chmod(0o500)
    said = process.communicate(timeout=120)[1]
    for folder in closed:
        folder.chmod(0o755)
    assert process.returncode == 1
    assert "permission is denied: check the owner of the folder and run the same" in said
    before = committed(lake)
    assert 1 <= before < 3
    summary = run.ingest([parts], lake, settings=COARSE, jobs=1)
    assert summary.n_done == 3 - before
    assert summary.n_resumed >= 1
    assert committed(lake) == 3
    assert not (lake / WORK).exists()


@pytest.mark.parametrize(
    ("file", "named"),
    [
        ("lake/work/x/desk", "the lake "),
        ("cache/downloads/x", "the cache "),
        ("work/x/desk", "--work "),
        ("elsewhere/part.step", "elsewhere/part.step cannot"),
        (None, "the lake "),
    ],
)
def test_the_place_that_refuses_is_named(tmp_path, monkeypatch, file, named):
    monkeypatch.setenv("BREPLAKE_CACHE", str(tmp_path / "cache"))
    name = str(tmp_path / file) if file else None
    with (
        pytest.raises(StorageError, match="disk is full") as caught,
        run._writable(tmp_path / "lake", tmp_path / "work"),
    ):
        raise OSError(28, "No space left on device", name)
    said = str(caught.value).partition(", its disk")[0]
    assert named in said
    assert ("the lake" in said) == (named == "the lake ")
