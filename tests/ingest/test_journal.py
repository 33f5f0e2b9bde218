"""The log of a run: a disk that is full costs the log, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("OCP")

from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.errors import UsageError
from breplake.ingest.journal import Journal
from breplake.ingest.run import ingest

FULL = Path("/dev/full")

needs_full = pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")


@pytest.fixture
def source(tmp_path):
    """A folder whose only file fails: no kernel is needed."""
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "empty.step").touch()
    return folder


def events(path):
    return [json.loads(line)["event"] for line in path.read_text().splitlines()]


def test_events_are_lines(tmp_path):
    path = tmp_path / "log"
    with Journal.open(path) as journal:
        journal.write("plan", todo=3)
        assert events(path) == ["plan"], "there at once"
        journal.write("end", name="é")
    assert events(path) == ["plan", "end"]
    with Journal.open(path) as journal:
        journal.write("plan")
    assert len(events(path)) == 3
    with Journal.open(None) as journal:
        journal.write("plan")


@needs_full
def test_a_full_disk_is_told_once_and_the_log_given_up():
    warned = []
    with Journal.open(FULL, warned.append) as journal:
        for _ in range(3):
            journal.write("plan")
    (text,) = warned
    assert text.startswith("the log /dev/full cannot be written any more (No space left on device)")
    assert "the run goes on without it" in text


def test_a_line_written_in_part_is_the_last(tmp_path):
    """As a disk does that has room for some bytes more."""

    class Filling:
        name, left, closed = "log", 10, False

        def write(self, data):
            if not self.left:
                raise OSError(28, "No space left on device")
            taken, self.left = min(self.left, len(data)), 0
            return taken

        def close(self):
            self.closed = True
            raise OSError(28, "No space left on device")

    file, warned = Filling(), []
    journal = Journal(file, warned.append)
    journal.write("plan")
    journal.write("end")
    assert len(warned) == 1
    assert file.closed


def test_a_line_that_was_cut_short_spoils_no_other(tmp_path):
    path = tmp_path / "log"
    path.write_text('{"event": "plan"}\n{"event": "mod')
    with Journal.open(path) as journal:
        journal.write("end")
    first, cut, last = path.read_text().splitlines()
    assert (first, cut) == ('{"event": "plan"}', '{"event": "mod')
    assert json.loads(last)["event"] == "end"


def test_a_log_that_cannot_be_opened_is_an_error(tmp_path):
    with pytest.raises(UsageError, match="cannot write the log"), Journal.open(tmp_path):
        pass


@needs_full
def test_the_run_goes_on_without_its_log(source, tmp_path):
    lake = tmp_path / "lake"
    command = ["ingest", str(source), "--lake", str(lake), "--log", str(FULL)]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.stderr
    assert result.stderr.count("the log /dev/full cannot be written any more") == 1
    assert "the lake" not in result.stderr.partition("cannot be written")[0]
    assert breplake.open(lake).sql("SELECT name, kind FROM failures").fetchall() == [
        ("empty", "empty-file")
    ]


@needs_full
def test_programs_are_warned(source, tmp_path):
    with pytest.warns(RuntimeWarning, match="the log /dev/full cannot be written any more"):
        ingest([source], tmp_path / "lake", log=FULL)
