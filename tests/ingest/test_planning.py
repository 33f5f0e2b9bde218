"""Planning as one meets it on the command line: shown, stopped, asked for anew."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("OCP")

from rich.console import Console
from typer.testing import CliRunner

from breplake.cli import app
from breplake.commands.ingest import _Bar
from breplake.ingest import hashing
from breplake.ingest.plan import Plan
from breplake.ingest.run import Summary

COMMAND = (sys.executable, "-P", "-m", "breplake", "ingest")


def opens(pid: int, name: str) -> bool:
    """Whether a process has a file of that name open."""
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            if os.readlink(link).endswith(name):
                return True
        except FileNotFoundError:  # closed while we look
            continue
    return False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_ends_planning_at_once(tmp_path, number):
    """The file has a tebibyte of nothing: hashing it takes an hour."""
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "endless.step").touch()
    os.truncate(folder / "endless.step", 2**40)
    lake = tmp_path / "lake"
    command = [*COMMAND, str(folder), "--lake", str(lake)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        end = time.monotonic() + 60
        while not opens(process.pid, "endless.step"):
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < end
            time.sleep(0.05)
        begin = time.monotonic()
        process.send_signal(number)
        said = process.communicate(timeout=60)[1]
    assert time.monotonic() - begin < 30
    assert process.returncode == 130
    assert "nothing was ingested" in said
    assert "the same command goes on from here" in said
    assert "Traceback" not in said
    assert not lake.exists()


def test_the_bar_shows_planning_and_then_the_run():
    console = Console(file=io.StringIO(), force_terminal=True)
    with _Bar(console) as bar:
        bar.tell("reading [files]", 30, 40)
        (task,) = bar.bar.tasks
        assert (task.description, task.completed, task.total) == ("plan", 30, 40)
        began = task.start_time
        summary = Summary(plan=Plan([], [], [], []))
        bar.update(summary.plan, summary)
        (task,) = bar.bar.tasks
        assert (task.description, task.completed, task.total) == ("ingest", 0, 0)
        assert task.start_time > began, "the rate is that of the run alone"
        assert not bar.is_planning


def test_files_are_read_again_when_asked_to(tmp_path, monkeypatch):
    read = []
    add = hashing.Hasher._add

    def counted(self, path, digest):
        read.append(path.name)
        return add(self, path, digest)

    monkeypatch.setattr(hashing.Hasher, "_add", counted)
    monkeypatch.setattr(hashing, "_TICK", -1.0)  # files just made count as old
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "empty.step").touch()
    command = ["ingest", str(tmp_path / "in"), "--lake", str(tmp_path / "lake")]
    for more, times in ((), 1), ((), 1), (("--rehash",), 2), ((), 2):
        assert CliRunner().invoke(app, [*command, *more]).exit_code == 0
        assert len(read) == times
