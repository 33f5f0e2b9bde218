"""Members of archives as files: in any order, a few ahead, and when the archive changes."""

from __future__ import annotations

import os
from concurrent.futures import wait
from pathlib import Path

import pytest

pytest.importorskip("py7zr")

from breplake.errors import InputError
from breplake.ingest.sources import reader
from breplake.ingest.sources.feed import ArchiveFeed
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.resolve import Sources

from .archives import FILES, MANY, by_member, noise
from .found import find


@pytest.mark.parametrize("ending", [".zip", ".tar.gz", ".7z"])
@pytest.mark.parametrize("order", ["forwards", "backwards", "some"])
def test_members_may_be_asked_for_in_any_order(tmp_path, ending, order, pack):
    found = find(pack(tmp_path / f"a{ending}", MANY))
    assert [item.origin.place for item in found] == sorted(item.origin.place for item in found)
    asked = {"forwards": found, "backwards": found[::-1], "some": found[7::13]}[order]
    with Sources.open() as sources, sources.fetcher(asked, tmp_path / "ahead") as fetcher:
        for item in asked:
            (tmp_path / item.name).mkdir()
            got = fetcher.take(item, tmp_path / item.name).result(60)
            assert got.path.read_bytes() == MANY[f"{item.name}.step"]


def test_only_a_few_members_are_unpacked_ahead(tmp_path, pack):
    found = find(pack(tmp_path / "a.7z", MANY))
    with Sources.open() as sources, sources.fetcher(found, tmp_path / "ahead") as fetcher:
        (tmp_path / "t").mkdir()
        futures = [fetcher.take(item, tmp_path / "t") for item in found[:3]]
        assert not wait(futures, 60).not_done
        ahead = list((tmp_path / "ahead").rglob("*.step")) + list((tmp_path / "ahead/0").iterdir())
        assert len(ahead) <= 8


def test_an_archive_is_closed_behind_its_last_member(tmp_path, pack):
    paths = [pack(tmp_path / f"{n}.zip", {"a.step": b"a", "b.step": b"b"}) for n in "xy"]
    (tmp_path / "out").mkdir()
    children = Path(f"/proc/self/task/{os.getpid()}/children")
    with Sources.open() as opened:
        items = opened.find(paths)
        before = children.read_text().split()
        with opened.fetcher(items, tmp_path / "ahead") as fetcher:
            for number, item in enumerate(items, 1):
                got = fetcher.take(item, tmp_path / "out").result(60)
                assert got.path.read_bytes() == item.name.encode()
                open_now = set(children.read_text().split()) - set(before)
                assert len(open_now) == number % 2


def test_nobody_waits_for_a_reader_that_talks_nonsense(tmp_path, pack, monkeypatch):
    path = pack(tmp_path / "a.zip", {"a.step": b"a"})
    (tmp_path / "out").mkdir()

    def events(_self):
        yield "done", []

    monkeypatch.setattr(reader.ArchiveReader, "events", events)
    feed = ArchiveFeed(path, [0], tmp_path / "out", Limits())
    with pytest.raises(InputError, match="ValueError") as caught:
        feed.take(0).result(10)
    feed.close()
    assert caught.value.kind == "error"


def test_an_archive_that_changed_meanwhile_is_noticed(tmp_path, pack):
    path = pack(tmp_path / "a.zip", FILES)
    found = by_member(find(path))
    pack(path, FILES | {"parts/b.step": b"other bytes"})
    item = found["parts/b.step"]
    with Sources.open() as sources, sources.fetcher(found.values(), tmp_path / "x") as fetcher:
        with pytest.raises(InputError, match="changed since it was planned") as caught:
            fetcher.take(item, tmp_path).result(60)
        assert caught.value.kind == "hash-mismatch"


def test_an_archive_that_is_gone_meanwhile_is_noticed(tmp_path, pack):
    path = pack(tmp_path / "a.zip", FILES)
    found = by_member(find(path))
    path.unlink()
    with Sources.open() as sources, sources.fetcher(found.values(), tmp_path / "x") as fetcher:
        future = fetcher.take(found["parts/b.step"], tmp_path)
        with pytest.raises(InputError) as caught:
            future.result(60)
        assert caught.value.kind == "unreadable"


def test_a_full_disk_is_no_fault_of_the_archive(tmp_path, pack):
    path = pack(tmp_path / "a.zip", {"a.step": noise(1, 500_000)})
    folder = tmp_path / "ahead"
    folder.mkdir()
    (folder / "0").symlink_to("/dev/full")
    feed = ArchiveFeed(path, [0], folder, Limits())
    try:
        with pytest.raises(OSError, match="No space left"):
            feed.take(0).result(60)
    finally:
        feed.close()
