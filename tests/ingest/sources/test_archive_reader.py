"""The process that reads an archive: what it says, and how it ends."""

from __future__ import annotations

import errno
import io
import json
import os
import subprocess
import sys
import tarfile
import zipfile

import pytest

pytest.importorskip("py7zr")

from breplake.ingest.sources import reader, zips
from breplake.ingest.sources import survey as surveys
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.unpack import Request, read_archive

from .archives import CAD, FILES
from .found import find, kinds


def answers(path):
    """What the process that reads an archive would say."""
    said = io.StringIO()
    read_archive(Request(str(path), Limits()), io.StringIO(), said)
    return [json.loads(line) for line in said.getvalue().splitlines()]


def test_no_flipped_byte_of_a_zip_ends_the_reader(tmp_path, pack):
    """Of names, extra fields, methods and offsets, each with its own error in zipfile."""
    path = pack(tmp_path / "a.zip", {"grün.step": b"abc" * 9, "b.step": b"def" * 9})
    whole = path.read_bytes()
    lasts = set()
    for place in range(len(whole)):
        for mask in (0xFF, 0x80, 0x08, 0x01):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ mask]) + whole[place + 1 :])
            lasts.add(answers(path)[-1][0])
    assert lasts == {"end", "damaged", "refused"}


def test_an_error_that_nobody_expects_leaves_what_was_read(tmp_path, pack, monkeypatch):
    path = pack(tmp_path / "a.zip", {"a.step": b"abc", "b.step": b"def"})

    def read(file, entry, info, taker, meter):
        if entry.place:
            raise ZeroDivisionError("of a parser")
        taker.done(entry)

    monkeypatch.setattr(zips, "_read", read)
    said = answers(path)
    assert [words[:2] for words in said if words[0] == "done"] == [["done", 0]]
    assert said[-1] == ["damaged", "bad-archive", "ZeroDivisionError: of a parser"]


@pytest.mark.parametrize("ending", [".zip", ".tar", ".tar.gz"])
def test_a_failing_disk_is_no_fault_of_the_archive(tmp_path, ending, pack, monkeypatch):
    path = pack(tmp_path / f"a{ending}", {"a.step": b"abc"})

    def read(*_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    for reads in (zipfile.ZipExtFile, tarfile.ExFileObject):
        monkeypatch.setattr(reads, "read", read)
    assert ["bad", 0, "unreadable", "Input/output error"] in answers(path)


def test_what_a_failing_disk_hides_is_looked_up_again(tmp_path, monkeypatch, pack):
    path = pack(tmp_path / "a.zip", {"a.step": b"abc"})

    class Failing(surveys.ArchiveReader):
        def events(self):
            yield "member", [0, "a.step"]
            yield "bad", [0, "unreadable", "Input/output error"]

    with monkeypatch.context() as patch:
        patch.setattr(surveys, "ArchiveReader", Failing)
        (item,) = find(path)
        assert item.failure.kind == "unreadable"
    (item,) = find(path)
    assert item.failure is None


def test_a_crash_of_the_reader_is_one_failure(tmp_path, monkeypatch, pack):
    path = pack(tmp_path / "a.zip", FILES)
    crash = 'import os, sys; sys.stdin.readline(); print(\'["member", 0, "a.step"]\', flush=True);'
    crash += "os.kill(os.getpid(), 11)"
    with monkeypatch.context() as patch:
        patch.setattr(reader, "_COMMAND", (sys.executable, "-c", crash))
        found = find(path)
    assert kinds(found) == {"a": "worker-died", "a.zip": "worker-died"}
    assert "SIGSEGV" in found[0].failure.message
    assert len(find(path)) == len(CAD), "a crash is not remembered"


def test_the_reader_ends_with_the_one_who_asked(tmp_path, pack):
    path = pack(tmp_path / "a.zip", {"a.step": b"1", "b.step": b"2"})
    request = Request(str(path), Limits(), [0, 1], str(tmp_path))
    process = subprocess.Popen(
        reader._COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with process:
        process.stdin.write(request.line() + "1\n")
        process.stdin.flush()
        word, place, *_ = json.loads(process.stdout.readline())
        assert (word, place) == ("done", 0)
        assert process.poll() is None, "it waits for leave to write the second file"
        process.stdin.close()
        assert process.wait(20) == 1
    assert not (tmp_path / "1").exists()
