"""Any history of commits, replacements, tags, collections and damage, against a simple model."""

from __future__ import annotations

import hashlib
import itertools
import os
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from breplake.errors import CommitConflictError, NameNotFoundError, UsageError
from breplake.schema.files import list_name
from breplake.schema.gc import Retention, collect
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry
from breplake.schema.storage import folder_hash, folder_list

META = {"message": "m", "tools": {}, "config_hash": "c"}
START = datetime.now(UTC) - timedelta(hours=10_000)  # commits are an hour apart from then on
OLD = time.time() - 7200
HOUR = timedelta(hours=1)


def write_entry(root: Path, shard: str, *, arrays: bool) -> FileEntry:
    """Write a file (commits do not look into those of corners) or a folder, and describe it."""
    data = f"content of {shard}".encode()
    if not arrays:
        digest = hashlib.sha256(data).hexdigest()
        entry = FileEntry("corners", shard, 1, len(data), digest, 1, 2)
        (root / entry.path).parent.mkdir(parents=True, exist_ok=True)
        (root / entry.path).write_bytes(data)
        return entry
    folder = root / f"arrays/{shard}.zarr"
    (folder / "position/c").mkdir(parents=True)
    (folder / "zarr.json").write_bytes(data)
    (folder / "position/c/0").write_bytes(data)
    (root / list_name(f"arrays/{shard}.zarr")).write_text(folder_list(folder))
    return FileEntry(ARRAYS_TABLE, shard, 1, 2 * len(data), folder_hash(folder), 1, 2)


def files_on_disk(root: Path) -> set[str]:
    """What lies in the lake's folders, a folder of arrays as one."""
    tables = {p.relative_to(root).as_posix() for p in root.glob("tables/*/*")}
    return tables | {p.relative_to(root).as_posix() for p in root.glob("arrays/*.zarr")}


class History(RuleBasedStateMachine):
    """The model: files of each snapshot, tags, and what lies around besides."""

    @initialize()
    def make(self):
        self.folder = tempfile.TemporaryDirectory()
        self.root = Path(self.folder.name) / "lake"
        self.store = LakeStore.create(self.root)
        self.snapshots: dict[int, set[FileEntry]] = {}
        self.commits = 0
        self.tags: dict[str, int] = {}
        self.unnamed: set[str] = set()  # files of no snapshot that are old
        self.young: set[str] = set()
        self.foreign: set[str] = set()
        self.damaged: set[str] = set()
        self.shards = 0

    def teardown(self):
        self.folder.cleanup()

    @property
    def head(self) -> set[FileEntry]:
        return self.snapshots[max(self.snapshots)] if self.snapshots else set()

    def fresh(self, *, arrays: bool) -> FileEntry:
        self.shards += 1
        return write_entry(self.root, f"s{self.shards}", arrays=arrays)

    def commit(self, new: list[FileEntry], replaced: set[FileEntry]) -> None:
        self.commits += 1
        made = self.store.commit(
            new,
            replaces=[entry.path for entry in replaced],
            time=START + self.commits * HOUR,
            **META,
        )
        assert made.number == self.commits
        self.snapshots[made.number] = (self.head - replaced) | set(new)

    @rule(kinds=st.lists(st.booleans(), max_size=3))
    def add(self, kinds):
        self.commit([self.fresh(arrays=kind) for kind in kinds], set())

    @precondition(lambda self: self.head)
    @rule(data=st.data(), arrays=st.booleans())
    def replace(self, data, arrays):
        replaced = data.draw(st.sets(st.sampled_from(sorted(self.head)), min_size=1, max_size=3))
        self.commit([self.fresh(arrays=arrays)], replaced)

    @precondition(lambda self: self.head)
    @rule(data=st.data())
    def conflicts(self, data):
        there = data.draw(st.sampled_from(sorted(self.head)))
        with pytest.raises(CommitConflictError, match="in the lake already"):
            self.store.commit([there], **META)
        with pytest.raises(CommitConflictError, match="not in the newest"):
            self.store.commit([], replaces=["tables/corners/never.parquet"], **META)

    @rule(name=st.sampled_from(["v1", "v2", "paper"]), number=st.integers(1, 6))
    def tag(self, name, number):
        if number not in self.snapshots:
            with pytest.raises(NameNotFoundError):
                self.store.tag(name, number)
        elif self.tags.get(name, number) != number:
            with pytest.raises(UsageError, match="for good"):
                self.store.tag(name, number)
        else:
            self.store.tag(name, number)
            self.tags[name] = number

    @rule(arrays=st.booleans(), is_old=st.booleans())
    def leave_orphan(self, arrays, is_old):
        """What a killed writer leaves, or one at work has."""
        path = self.fresh(arrays=arrays).path
        if is_old:
            for top, _, names in os.walk(self.root / path):
                for name in (top, *(os.path.join(top, name) for name in names)):
                    os.utime(name, (OLD, OLD))
            for place in (path, list_name(path)) if arrays else (path,):
                os.utime(self.root / place, (OLD, OLD))
        (self.unnamed if is_old else self.young).add(path)

    @rule(table=st.sampled_from(["corners", "notes"]))
    def leave_foreign(self, table):
        path = f"tables/{table}/README.md"
        (self.root / path).parent.mkdir(parents=True, exist_ok=True)
        (self.root / path).write_text("mine")
        os.utime(self.root / path, (OLD, OLD))
        self.foreign.add(path)

    @precondition(lambda self: self.head)
    @rule(data=st.data())
    def damage(self, data):
        entry = data.draw(st.sampled_from(sorted(self.head)))
        path = self.root / entry.path
        path = path / "zarr.json" if entry.table == ARRAYS_TABLE else path
        path.write_bytes(path.read_bytes()[::-1] + b"!")
        self.damaged.add(entry.path)

    @rule(
        keep=st.none() | st.integers(1, 4),
        tagged_only=st.booleans(),
        hours=st.none() | st.integers(0, 4),
        grace=st.sampled_from([timedelta(0), HOUR]),
        dry_run=st.booleans(),
    )
    def gc(self, keep, tagged_only, hours, grace, dry_run):
        age = None if hours is None else datetime.now(UTC) - START - (self.commits - hours) * HOUR
        retention = Retention(keep, tagged_only, age)
        numbers = sorted(self.snapshots)
        removed: set[int] = set()
        if keep or tagged_only or age is not None:
            removed = set(numbers[:-keep] if keep else numbers)
            if hours is not None:  # the newest of `hours` ago is the last with an older successor
                removed &= {
                    before
                    for before, after in itertools.pairwise(numbers)
                    if after <= self.commits - hours
                }
            removed -= {numbers[-1] if numbers else 0, *self.tags.values()}
        before = files_on_disk(self.root)
        named = {e.path for n, files in self.snapshots.items() if n not in removed for e in files}
        gone = before - named - self.foreign - (self.young if grace else set())
        found = collect(self.store, retention, grace=grace, dry_run=dry_run)
        assert found.snapshots == sorted(removed)
        assert {item.path for item in found.garbage} == gone
        assert found.foreign == sorted(self.foreign)
        assert set(found.young) == (self.young if grace else set())
        if dry_run:
            assert files_on_disk(self.root) == before
            return
        assert files_on_disk(self.root) == before - gone
        assert not any((self.root / list_name(path)).exists() for path in gone)
        self.snapshots = {n: f for n, f in self.snapshots.items() if n not in removed}
        self.unnamed -= gone
        self.young -= gone
        self.damaged -= gone

    @rule()
    def open_again(self):
        self.store = LakeStore.open(self.root)

    @rule()
    def move(self):
        other = self.root.with_name("lake" if self.root.name == "else where" else "else where")
        self.root.rename(other)
        self.root = other
        self.store = LakeStore.open(self.root)

    @invariant()
    def history_is_whole(self):
        if not hasattr(self, "store"):
            return
        assert self.store.numbers() == sorted(self.snapshots)
        assert [header.number for header in self.store.headers()] == sorted(self.snapshots)
        assert self.store.tags() == dict(sorted(self.tags.items()))
        for number, files in self.snapshots.items():
            assert set(self.store.snapshot(number).files) == files
        assert set(self.tags.values()) <= set(self.snapshots)

    @invariant()
    def verify_finds_damage_alone(self):
        if not hasattr(self, "store"):
            return
        for number, files in self.snapshots.items():
            found = {problem.path for problem in self.store.verify(self.store.snapshot(number))}
            assert found == self.damaged & {entry.path for entry in files}


History.TestCase.settings = settings(
    max_examples=40,
    stateful_step_count=25,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
test_history = History.TestCase
