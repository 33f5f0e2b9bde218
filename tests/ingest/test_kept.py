"""Models of a lake outlive inputs that cannot be read any more."""

from __future__ import annotations

import zipfile

import pytest

pytest.importorskip("OCP")
pytest.importorskip("pebble")

import breplake
from breplake.ingest.plan import Redo
from breplake.ingest.run import ingest
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings

COARSE = Settings(max_edge=0.1)
AGAIN = Redo(changed=True, failed=True)


@pytest.fixture
def ring(tmp_path, monkeypatch):
    """A folder of one part, and the lake that has it."""
    monkeypatch.setenv("BREPLAKE_CACHE", str(tmp_path / "cache"))
    (path,) = write_samples(tmp_path / "in", ["ring_o"])
    return path


def rows(lake):
    opened = breplake.open(lake)
    return (
        opened.sql("SELECT name FROM models").fetchall(),
        opened.sql("SELECT kind FROM failures").fetchall(),
    )


def ingest_all(source, lake, **more):
    return ingest([source], lake, settings=COARSE, jobs=1, collection="c", **more)


def spoil_folder(path):
    path.unlink()
    path.mkdir()


def spoil_empty(path):
    path.write_bytes(b"")


@pytest.mark.parametrize("spoil", [spoil_folder, spoil_empty])
def test_a_file_that_cannot_be_read_now_costs_no_model(ring, tmp_path, spoil):
    lake = tmp_path / "lake"
    ingest_all(ring.parent, lake)
    spoil(ring)
    summary = ingest_all(ring.parent, lake, redo=AGAIN)
    assert rows(lake) == ([("ring_o",)], [])
    assert [item.name for item in summary.plan.unread] == ["ring_o"]
    assert not summary.plan.todo
    assert not summary.plan.changed


def test_a_damaged_archive_costs_no_model(ring, tmp_path):
    lake, packed = tmp_path / "lake", tmp_path / "parts.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        archive.write(ring, "ring_o.step")
    ingest_all(packed, lake)
    data = bytearray(packed.read_bytes())
    data[200:400] = bytes(200)  # within the member: its checksum fails
    packed.write_bytes(data)
    ingest_all(packed, lake, redo=AGAIN)
    assert rows(lake)[0] == [("ring_o",)]


def test_an_archive_lost_while_it_is_ingested_costs_no_model(ring, tmp_path):
    lake, packed = tmp_path / "lake", tmp_path / "parts.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        archive.write(ring, "ring_o.step")
    ingest_all(packed, lake)

    def spoil(_plan, summary):
        if not summary.n_done:
            packed.write_bytes(packed.read_bytes()[:300])

    summary = ingest(
        [packed], lake, settings=Settings(max_edge=0.2), jobs=1, collection="c",
        redo=AGAIN, progress=spoil,
    )  # fmt: skip
    assert (summary.n_kept, summary.n_fatal, summary.stopped) == (1, 0, False)
    assert rows(lake) == ([("ring_o",)], [])


def test_the_command_says_which_models_are_kept(ring, tmp_path):
    from typer.testing import CliRunner

    from breplake.cli import app

    lake = tmp_path / "lake"
    ingest_all(ring.parent, lake)
    spoil_empty(ring)
    command = ["ingest", str(ring.parent), "--lake", str(lake), "--collection", "c", "--replace"]
    result = CliRunner().invoke(app, command, env={"COLUMNS": "200"})
    assert "cannot be read now, so the lake's models are kept (ring_o)" in result.output
