"""Hashes of files: the same from any number of threads, remembered, never trusted too far."""

from __future__ import annotations

import hashlib
import os
import sqlite3
import threading
import time
import zipfile
from pathlib import Path

import pytest

from breplake.ingest import hashing
from breplake.ingest.hashing import Hasher
from breplake.ingest.inputs import find_inputs
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.resolve import Sources
from breplake.ingest.sources.waiting import Waiting

LONG_AGO = time.time() - 3600


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("BREPLAKE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def rested(monkeypatch):
    """Files just made count as old: their change times cannot be set back."""
    monkeypatch.setattr(hashing, "_TICK", -1.0)


@pytest.fixture
def reads(monkeypatch):
    """The names of the files that are read."""
    found: list[str] = []
    add = Hasher._add

    def counted(self, path, digest):
        found.append(path.name)
        return add(self, path, digest)

    monkeypatch.setattr(Hasher, "_add", counted)
    return found


def folder_of(place: Path, count: int) -> Path:
    place.mkdir()
    for i in range(count):
        (place / f"{i:03}.step").write_bytes(b"x" * i)
    return place


def find(*sources, **options):
    with Sources.open(**options) as opened:
        return opened.find(sources)


def test_threads_change_neither_order_nor_hashes(tmp_path):
    found = find_inputs([folder_of(tmp_path / "in", 200)])
    assert [item.name for item in found] == [f"{i:03}" for i in range(200)]
    assert [item.sha256 for item in found] == [
        hashlib.sha256(b"x" * i).hexdigest() for i in range(200)
    ]
    assert [item.bytes for item in found] == list(range(200))
    assert [item.failure and item.failure.kind for item in found] == ["empty-file"] + 199 * [None]


def test_files_are_read_side_by_side_and_given_in_order():
    """The first waits for the others, which one thread alone would never come to."""
    others = threading.Barrier(4, timeout=30)

    def work(number):
        others.wait()
        return number * number

    assert Hasher().over(range(4), work, "", 4) == [0, 1, 4, 9]


def test_the_second_time_nothing_is_read(tmp_path, rested, reads):
    folder = folder_of(tmp_path / "in", 20)
    first = find(folder)
    assert len(reads) == 20
    assert find(folder) == first
    assert len(reads) == 20
    assert find(folder, rehash=True) == first
    assert len(reads) == 40
    (folder / "020.step").write_bytes(b"new")
    assert len(find(folder)) == 21
    assert reads[40:] == ["020.step"]


def test_lists_remember_too(tmp_path, rested, reads):
    folder = folder_of(tmp_path / "in", 5)
    rows = "\n".join(str(path) for path in sorted(folder.iterdir()))
    (tmp_path / "list.csv").write_text(f"path\n{rows}\n")
    first = find(tmp_path / "list.csv")
    assert [item.bytes for item in first] == list(range(5))
    assert find(tmp_path / "list.csv") == first
    assert len(reads) == 5


@pytest.mark.parametrize("how", ["size", "mtime", "same mtime", "other inode"])
def test_a_changed_file_is_read_again(tmp_path, rested, how):
    path = tmp_path / "a.step"
    path.write_bytes(b"old bytes")
    os.utime(path, (LONG_AGO, LONG_AGO))
    (old,) = find(path)
    if how == "other inode":
        (tmp_path / "b").write_bytes(b"new bytes")
        os.replace(tmp_path / "b", path)
    else:
        path.write_bytes(b"new bytes" + b"!" * (how == "size"))
    if how != "mtime":
        os.utime(path, (LONG_AGO, LONG_AGO))  # as `cp -p` and unpackers do
    (new,) = find(path)
    assert new.sha256 == hashlib.sha256(path.read_bytes()).hexdigest() != old.sha256


def test_what_was_written_a_moment_ago_is_not_remembered(tmp_path, reads):
    """Of two writes within one tick of the clock, the second leaves no trace."""
    path = tmp_path / "a.step"
    path.write_bytes(b"x")
    find(path)
    find(path)
    assert reads == ["a.step"] * 2


@pytest.mark.parametrize(("age", "trusted"), [(0, False), (1.9, False), (2.1, True), (-9, False)])
def test_how_long_a_file_must_have_rested(age, trusted):
    began = 1_000_000_000.0
    changed = int((began - age) * 1e9)
    for times in ((changed, int(1e18 - 1e13)), (int(1e18 - 1e13), changed)):
        assert hashing._rested((1, *times, 7), began) is trusted


def test_a_file_that_changes_while_it_is_read_is_not_remembered(tmp_path, rested, monkeypatch):
    path = tmp_path / "a.step"
    path.write_bytes(b"x")
    add = Hasher._add

    def changed(self, path, digest):
        os.utime(path, (LONG_AGO, LONG_AGO))
        return add(self, path, digest)

    with monkeypatch.context() as patch:
        patch.setattr(Hasher, "_add", changed)
        find(path)
    with Ledger.open() as ledger:
        assert ledger.get(hashing._KIND, f'["{path}"]') is None


def test_names_that_are_no_text(tmp_path, rested, reads):
    path = tmp_path / os.fsdecode(b"caf\xe9.step")
    path.write_bytes(b"x")
    assert find(path) == find(path)
    assert len(reads) == 1


def test_progress_is_told(tmp_path):
    told = []
    find(folder_of(tmp_path / "in", 30), tell=lambda *words: told.append(words))
    assert told[-1] == ("reading files, 0.0 GB", 30, 30)


def test_stopping_ends_in_the_middle_of_a_file(tmp_path, monkeypatch):
    """A file without end, say on a disk that crawls, and others that wait behind it."""
    folder = folder_of(tmp_path / "in", 3)
    begun = threading.Event()

    class Endless:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def read(self, _size):
            begun.set()
            time.sleep(0.001)
            return b"x"

    monkeypatch.setattr(Path, "open", lambda *_, **__: Endless())
    begin, threads = time.monotonic(), threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        find_inputs([folder], hasher=Hasher(waiting=Waiting(begun.is_set)))
    assert time.monotonic() - begin < 10
    assert threading.active_count() == threads


def test_stopping_while_folders_are_listed(tmp_path, reads):
    with pytest.raises(KeyboardInterrupt):
        find(folder_of(tmp_path / "in", 3), stop=lambda: True)
    assert reads == []


def test_what_was_hashed_before_the_stop_is_remembered(tmp_path, rested, reads, monkeypatch):
    folder = folder_of(tmp_path / "in", 50)
    monkeypatch.setattr(hashing, "_STEP", 0.001)
    with pytest.raises(KeyboardInterrupt):
        find(folder, stop=lambda: len(reads) > 5)
    before = len(reads)
    assert len(find(folder)) == 50
    assert len(reads) < before + 50, "some were not read again"


def test_an_error_ends_all_threads():
    def work(number):
        if number == 3:
            raise ZeroDivisionError
        return number

    hasher = Hasher()
    with pytest.raises(ZeroDivisionError):
        hasher.over(range(100), work, "")
    assert hasher.over(range(3), work, "") == [0, 1, 2]


def test_a_cache_that_cannot_be_made_is_done_without(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("BREPLAKE_CACHE", str(tmp_path / "file" / "cache"))
    warned = []
    assert len(find(folder_of(tmp_path / "in", 3), warn=warned.append)) == 3
    (text,) = warned
    assert "hashes of files are not remembered" in text
    assert "BREPLAKE_CACHE" in text


@pytest.mark.parametrize("method", ["get", "put_all"])
def test_a_cache_that_fails_in_between_is_done_without(tmp_path, rested, monkeypatch, method):
    def full(*_):
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(Ledger, method, full)
    warned = []
    assert len(find(folder_of(tmp_path / "in", 30), warn=warned.append)) == 30
    (text,) = warned
    assert f"the cache {tmp_path / 'cache'} cannot be used any more" in text
    assert "disk is full" in text


def test_what_cannot_be_looked_at_is_a_failure(tmp_path):
    folder = folder_of(tmp_path / "in", 2)
    (folder / "dir.step").mkdir()
    (folder / "gone.step").symlink_to(folder / "nothing")
    os.mkfifo(folder / "pipe.step")
    found = {item.name: item for item in find(folder)}
    failed = {name: item.failure for name, item in found.items() if item.failure}
    assert {name: failure.kind for name, failure in failed.items()} == {
        "000": "empty-file",
        "dir": "not-a-file",
        "gone": "not-a-file",
        "pipe": "not-a-file",
    }
    assert "this is a folder" in failed["dir"].message
    assert "no regular file" in failed["pipe"].message
    assert found["gone"].sha256 is None


def test_archives_are_files_too(tmp_path, rested, reads):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.step", b"x")
    first = find(path)
    assert [item.name for item in first] == ["a"]
    assert find(path) == first
    assert reads == ["a.zip"]
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("b.step", b"y")
    assert [item.name for item in find(path)] == ["a", "b"]
