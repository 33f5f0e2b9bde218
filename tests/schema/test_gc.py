"""Collecting garbage: nothing that anyone may need is lost, whoever is at work meanwhile."""

from __future__ import annotations

import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from breplake.errors import LakeFormatError, NameNotFoundError, UsageError
from breplake.schema.gc import Retention, collect
from breplake.schema.lake import LakeStore
from breplake.schema.subset import Subset, subset_path

META = {"message": "m", "tools": {}, "config_hash": "c"}
NONE = timedelta(0)
LAST = Retention(keep=1)


def contents(root: Path) -> set[str]:
    return {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}


@pytest.fixture
def replaced(own_lake, new_shard):
    """A lake of three snapshots, the last of which supersedes shard s0."""
    store = LakeStore.open(own_lake)
    old = [entry.path for entry in store.head().files if entry.shard == "s0"]
    new_shard(store, "s2", {"small": (2, 2, 2), "long/flat": (9, 2, 1)})
    store.commit(store.register_shard("s2"), replaces=old, **META)
    return store


def test_without_a_rule_only_orphans_go(replaced):
    before = contents(replaced.root)
    (replaced.root / "tables/faces/dead.parquet").write_bytes(b"half")
    (replaced.root / "snapshots/00000004.json#1").write_bytes(b"{")
    (replaced.root / "arrays/empty.zarr").mkdir()
    found = collect(replaced, grace=NONE)
    assert [(item.path, item.bytes, item.reason) for item in found.garbage] == [
        ("arrays/empty.zarr", 0, "orphan"),
        ("snapshots/00000004.json#1", 1, "orphan"),
        ("tables/faces/dead.parquet", 4, "orphan"),
    ]
    assert found.bytes == 5
    assert contents(replaced.root) == before | {"writer.lock"}
    assert not (replaced.root / "arrays/empty.zarr").exists()
    assert collect(replaced, grace=NONE).garbage == []


def test_what_is_new_is_left_alone(replaced):
    path = replaced.root / "tables/faces/at_work.parquet"
    path.write_bytes(b"half")
    found = collect(replaced, LAST)
    assert found.young == ["tables/faces/at_work.parquet"]
    assert found.in_grace == [1, 2]  # they were the newest a moment ago
    assert (found.snapshots, found.garbage) == ([], [])
    assert path.exists()


def test_a_removed_snapshot_takes_its_own_files_along(replaced):
    named = {entry.path for entry in replaced.snapshot(3).files}
    gone = {entry.path for entry in replaced.snapshot(1).files}
    found = collect(replaced, LAST, grace=NONE)
    assert found.snapshots == [1, 2]
    assert {item.path for item in found.garbage} == gone
    assert {item.reason for item in found.garbage} == {"removed snapshot"}
    assert not named & gone
    assert replaced.verify(replaced.snapshot()) == []
    with pytest.raises(NameNotFoundError, match="snapshots are 3, tags none"):
        replaced.snapshot(1)
    assert replaced.commit([], **META).number == 4  # numbers are never given twice


def test_rules(replaced):
    def would_go(*rules, tags=()):
        return collect(replaced, Retention(*rules), grace=NONE, dry_run=True).snapshots

    week = timedelta(days=7)
    replaced.commit([], time=datetime.now(UTC) - week, **META)  # 3 was superseded a week ago
    assert would_go() == []
    assert would_go(2) == [1, 2]
    assert would_go(None, True) == [1, 2, 3]
    assert would_go(None, False, timedelta(days=6)) == [3]
    assert would_go(None, True, timedelta(days=6)) == [3]
    assert would_go(2, False, timedelta(days=6)) == []
    assert would_go(None, False, timedelta(days=8)) == []
    replaced.tag("paper", 3)
    assert would_go(1) == [1, 2]
    for rule in ((0,), (None, False, timedelta(-1))):
        with pytest.raises(UsageError):
            Retention(*rule)


def test_a_subset_keeps_its_snapshot(replaced):
    ids = np.array([1], np.int64)
    subset = Subset(
        "mine", "", replaced.lake_id, 1, {"all": 1.0}, 0, None, ids, np.zeros(1, np.int16), ""
    )
    replaced.storage.create(subset_path("mine"), subset.to_bytes())
    assert collect(replaced, LAST, grace=NONE).snapshots == [2]
    assert replaced.verify(replaced.snapshot(1)) == []


def test_folders_of_others_in_a_lake_are_left_alone(replaced):
    """The spool of an ingest that was stopped, and copies for SQL, are no garbage."""
    for place in ("work/run/model/done.json", "consolidated/models-0.parquet"):
        path = replaced.root / place
        path.parent.mkdir(parents=True)
        path.write_bytes(b"in use")
    before = contents(replaced.root)
    for dry_run in (True, False):
        found = collect(replaced, grace=NONE, dry_run=dry_run)
        assert (found.garbage, found.young, found.foreign) == ([], [], [])
    assert contents(replaced.root) == before | {"writer.lock"}


def test_a_snapshot_that_is_tagged_meanwhile_stays(replaced, monkeypatch):
    other = LakeStore.open(replaced.root)
    remove = replaced.log.remove

    def tag_first(number):
        if number == 1:
            other.tag("late", 1)  # after the tags were read
        return remove(number)

    monkeypatch.setattr(replaced.log, "remove", tag_first)
    before = replaced.snapshot(1)
    assert collect(replaced, LAST, grace=NONE).snapshots == [2]
    assert replaced.snapshot("late") == before
    assert replaced.verify(before) == []


def test_a_tag_that_comes_too_late_fails(replaced, monkeypatch):
    other = LakeStore.open(replaced.root)
    create = other.storage.create

    def collect_first(path, data):
        collect(replaced, LAST, grace=NONE)
        return create(path, data)

    monkeypatch.setattr(other.storage, "create", collect_first)
    with pytest.raises(NameNotFoundError, match="removed meanwhile"):
        other.tag("late", 1)
    assert replaced.tags() == {}


def test_what_a_writer_without_the_lock_commits_meanwhile_stays(replaced, new_shard, monkeypatch):
    other = LakeStore.open(replaced.root)
    new_shard(other, "s3", {"fresh": (1, 1, 1)})
    entries = other.register_shard("s3")
    hint = replaced.log.hint

    def commit_first(number):
        other.commit(entries, **META)
        hint(number)

    monkeypatch.setattr(replaced.log, "hint", commit_first)
    assert collect(replaced, LAST, grace=NONE).snapshots == [1, 2]
    assert replaced.head().number == 4
    assert replaced.verify(replaced.head()) == []


def test_it_waits_for_a_writer(replaced):
    (replaced.root / "tables/faces/at_work.parquet").write_bytes(b"half")
    told, done = threading.Event(), threading.Event()

    def run():
        collect(LakeStore.open(replaced.root), grace=NONE, waiting=told.set)
        done.set()

    with replaced.lock():
        thread = threading.Thread(target=run)
        thread.start()
        assert told.wait(10)
        assert not done.wait(0.1)
        assert (replaced.root / "tables/faces/at_work.parquet").exists()
    thread.join(10)
    assert done.is_set()
    assert not (replaced.root / "tables/faces/at_work.parquet").exists()


def test_nothing_goes_while_a_snapshot_cannot_be_read(replaced):
    (replaced.root / "tables/faces/dead.parquet").write_bytes(b"half")
    path = replaced.root / "snapshots/00000002.json"
    path.write_text(path.read_text().replace('"schema_version":1', '"schema_version":99'))
    before = contents(replaced.root) | {"writer.lock"}
    with pytest.raises(LakeFormatError, match="schema version 99"):
        collect(LakeStore.open(replaced.root), grace=NONE)
    assert contents(replaced.root) == before


class Killed(BaseException):
    """Stands for SIGKILL: nothing is cleaned up after it."""


def test_killed_at_any_moment_it_leaves_a_whole_lake(replaced, monkeypatch):
    (replaced.root / "tables/faces/dead.parquet").write_bytes(b"half")
    last = replaced.head()
    kills = 0
    for moment in range(100):
        store, left = LakeStore.open(replaced.root), moment % 4

        def remove(path, store=store, real=store.storage.remove):
            nonlocal left
            if left == 0:
                raise Killed
            left -= 1
            real(path)

        monkeypatch.setattr(store.storage, "remove", remove)
        try:
            collect(store, LAST, grace=NONE)
            break
        except Killed:
            kills += 1
        again = LakeStore.open(replaced.root)
        for number in again.numbers():  # also the older ones are whole as long as they are there
            assert again.verify(again.snapshot(number)) == []
    assert kills >= 6
    assert replaced.numbers() == [3]
    assert replaced.verify(last) == []
    named = {entry.path for entry in last.files}
    assert {p for p in contents(replaced.root) if p.startswith("tables/")} <= named
    assert {p.parent.name for p in replaced.root.glob("arrays/*/zarr.json")} == {
        "s1.zarr",
        "s2.zarr",
    }
