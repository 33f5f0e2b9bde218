"""Lakes: commits lose nothing, conflicts are refused, damage is found, lakes can be moved."""

from __future__ import annotations

import dataclasses
import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from breplake.errors import (
    CommitConflictError,
    LakeFormatError,
    LakeNotFoundError,
    NameNotFoundError,
    UsageError,
)
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import FileEntry, Snapshot
from breplake.schema.storage import Storage

META = {"message": "m", "tools": {}, "config_hash": "c"}


def dummy(name: str) -> FileEntry:
    """An entry whose file does not exist: commit reads only files of models and failures."""
    return FileEntry("corners", name, 1, 1, "0", 1, 2)


def test_empty_lake(tmp_path):
    store = LakeStore.create(tmp_path / "new" / "lake")
    assert store.head() is None
    assert store.tags() == {}
    with pytest.raises(NameNotFoundError, match="no snapshot yet"):
        store.snapshot()
    assert LakeStore.open(tmp_path / "new" / "lake").lake_id == store.lake_id
    assert LakeStore.open_or_create(tmp_path / "new" / "lake").lake_id == store.lake_id


def test_where_a_lake_is_not_made(tmp_path):
    with pytest.raises(LakeNotFoundError, match="no lake"):
        LakeStore.open(tmp_path)
    (tmp_path / "thesis.txt").write_text("precious")
    with pytest.raises(UsageError, match="other files"):
        LakeStore.open_or_create(tmp_path)
    with pytest.raises(UsageError, match="is a file"):
        LakeStore.create(tmp_path / "thesis.txt")
    LakeStore.create(tmp_path / "lake")
    with pytest.raises(UsageError, match="already"):
        LakeStore.create(tmp_path / "lake")


def test_a_kill_while_the_marker_is_staged_is_no_obstacle(tmp_path):
    (tmp_path / "breplake.json#1").write_text("{")
    LakeStore.open_or_create(tmp_path)


def test_snapshots_of_a_lake(tiny_lake):
    store = LakeStore.open(tiny_lake)
    assert store.numbers() == [1, 2]
    first, head = store.snapshot(1), store.snapshot()
    assert (first.number, first.parent, head.number, head.parent) == (1, None, 2, 1)
    assert store.snapshot("2") == head == store.head()
    assert set(first.files) < set(head.files)
    assert [e.rows for e in head.table_files("models")] == [2, 3]
    assert [e.shard for e in head.table_files("arrays")] == ["s0", "s1"]
    assert head.file("faces", "s1").rows == 24
    assert head.file("failures", "s0") is None
    with pytest.raises(NameNotFoundError, match="1 to 2"):
        store.snapshot(3)
    assert store.verify(head) == []


def test_paths_are_relative_and_documents_stable(tiny_lake):
    store = LakeStore.open(tiny_lake)
    data = (tiny_lake / "snapshots/00000002.json").read_bytes()
    assert str(tiny_lake).encode() not in data
    assert Snapshot.from_json(data, "x").to_json() == data == store.snapshot(2).to_json()
    document = json.loads(data)
    assert list(document["shards"]) == ["s0", "s1"]
    header = store.snapshot(2).header
    assert document["snapshot"] == dataclasses.asdict(header)
    assert (header.models, header.files) == (5, len(store.snapshot(2).files))
    assert list(store.headers()) == [store.snapshot(1).header, header]


def test_register_reads_the_footer(tiny_lake):
    store = LakeStore.open(tiny_lake)
    entry = store.register("tables/vertices/s0.parquet")
    assert entry == store.register(tiny_lake / "tables/vertices/s0.parquet")
    models = store.snapshot(1).file("models", "s0")
    assert (entry.rows, entry.min_model_id, entry.max_model_id) == (
        48,
        models.min_model_id,
        models.max_model_id,
    )
    assert entry.min_model_id < entry.max_model_id
    assert store.register("arrays/s0.zarr").rows == 16


def test_register_refuses_what_is_no_file_of_a_lake(own_lake, tmp_path):
    store = LakeStore.open(own_lake)
    for path in ("tables/models/../../x", "/etc/passwd", "breplake.json", "tables/nuts/a.parquet"):
        with pytest.raises(UsageError):
            store.register(path)
    pq.write_table(pa.table({"model_id": [1]}), store.table_path("faces", "bad"))
    with pytest.raises(UsageError, match="breaks the contract of table faces"):
        store.register("tables/faces/bad.parquet")
    with pytest.raises(UsageError, match="written once"):
        store.table_path("models", "s0")
    with pytest.raises(UsageError, match="a shard is named"):
        store.table_path("models", "../s0")


def test_a_model_is_added_once(own_lake, new_shard):
    store = LakeStore.open(own_lake)
    new_shard(store, "s2", {"new": (1, 1, 1), "big": (1, 1, 2)})
    with pytest.raises(CommitConflictError, match="boxes/big is in both"):
        store.commit(store.register_shard("s2"), **META)
    new_shard(store, "s3", {"broken": (1, 1, 1)})  # a fatal failure of the head
    with pytest.raises(CommitConflictError, match="boxes/broken"):
        store.commit(store.register_shard("s3"), **META)
    assert store.head().number == 2


def test_replacing_a_shard(own_lake, new_shard):
    store = LakeStore.open(own_lake)
    old = [entry.path for entry in store.head().files if entry.shard == "s0"]
    new_shard(store, "s2", {"small": (2, 2, 2), "long/flat": (9, 2, 1)})
    new = store.commit(store.register_shard("s2"), replaces=old, **META)
    assert {entry.shard for entry in new.files} == {"s1", "s2"}
    assert {entry.shard for entry in store.snapshot(2).files} == {"s0", "s1"}
    assert store.verify(store.snapshot(2)) == []
    with pytest.raises(CommitConflictError, match="replaced since"):
        store.commit([], replaces=old, **META)


def test_a_file_is_added_once(own_lake):
    store = LakeStore.open(own_lake)
    store.commit([dummy("a")], **META)
    with pytest.raises(CommitConflictError, match="in the lake already"):
        store.commit([dummy("a")], **META)


def test_names_that_share_an_id_collide(own_lake):
    store = LakeStore.open(own_lake)
    path = store.table_path("models", "s2")
    rows = pq.read_table(own_lake / "tables/models/s0.parquet")
    rows = rows.set_column(0, rows.schema.field(0), pa.array([7] * rows.num_rows))
    pq.write_table(rows, path)
    with pytest.raises(CommitConflictError, match=r"small.* share the id 7"):
        store.commit([store.register(path)], **META)


def test_threads_lose_no_commit(tmp_path):
    store = LakeStore.create(tmp_path / "lake")

    def work(worker: int) -> list[int]:
        return [store.commit([dummy(f"{worker}-{i}")], **META).number for i in range(15)]

    with ThreadPoolExecutor(8) as pool:
        numbers = [number for result in pool.map(work, range(8)) for number in result]
    assert sorted(numbers) == list(range(1, 121))
    assert len(store.head().files) == 120


def test_a_commit_whose_answer_was_lost(own_lake, monkeypatch):
    """The store has the document, and says to the second try that one is there."""
    store, other = LakeStore.open(own_lake), LakeStore.open(own_lake)
    real = Storage.create
    monkeypatch.setattr(Storage, "create", lambda *call: real(*call) and False)
    made = store.commit([dummy("a")], **META)
    monkeypatch.setattr(Storage, "create", real)
    assert made == LakeStore.open(own_lake).head()
    assert made.number == 3
    with pytest.raises(CommitConflictError, match="in the lake already"):
        other.commit([dummy("a")], **META)
    assert not other.log.create(dataclasses.replace(made, message="of another"))


def test_a_moved_lake_is_the_same(own_lake, tmp_path):
    store = LakeStore.open(own_lake)
    store.tag("v1", 1)
    shutil.move(own_lake, tmp_path / "else where")
    moved = LakeStore.open(tmp_path / "else where")
    assert moved.lake_id == store.lake_id
    assert moved.verify(moved.snapshot()) == []
    assert moved.snapshot("v1").number == 1


def test_tags(own_lake):
    store = LakeStore.open(own_lake)
    store.tag("v1", 1)
    store.tag("v1", store.snapshot(1))  # saying it twice is no error
    assert store.tags() == {"v1": 1}
    assert store.snapshot("v1").number == 1
    with pytest.raises(UsageError, match="names snapshot 1 for good"):
        store.tag("v1", 2)
    with pytest.raises(UsageError, match="must not be a number"):
        store.tag("7", 1)
    with pytest.raises(UsageError, match="a tag is named"):
        store.tag("a/b", 1)
    with pytest.raises(NameNotFoundError):
        store.tag("v2", 9)
    with pytest.raises(NameNotFoundError, match="tags v1"):
        store.snapshot("v2")


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def test_verify_finds_damage(own_lake):
    store = LakeStore.open(own_lake)
    flip(own_lake / "tables/faces/s0.parquet")
    flip(own_lake / "arrays/s1.zarr/normal/c/0/0")
    path = own_lake / "tables/patches/s1.parquet"
    path.write_bytes(path.read_bytes()[:-1])
    (own_lake / "tables/curves/s0.parquet").unlink()
    shutil.rmtree(own_lake / "arrays/s0.zarr")
    found = {problem.path: problem.kind for problem in store.verify(store.snapshot())}
    assert found == {
        "tables/faces/s0.parquet": "sha256",
        "arrays/s1.zarr": "sha256",
        "tables/patches/s1.parquet": "size",
        "tables/curves/s0.parquet": "missing",
        "arrays/s0.zarr": "missing",
    }


def test_higher_versions_are_refused(own_lake):
    path = own_lake / "snapshots/00000002.json"
    path.write_text(path.read_text().replace('"schema_version":1', '"schema_version":99'))
    with pytest.raises(LakeFormatError, match=r"schema version 99.*reads up to 1.*upgrade"):
        LakeStore.open(own_lake).snapshot()
    assert LakeStore.open(own_lake).snapshot(1).number == 1
    path.write_text("{}")
    with pytest.raises(LakeFormatError, match="not a snapshot"):
        LakeStore.open(own_lake).snapshot()
    marker = own_lake / "breplake.json"
    marker.write_text(marker.read_text().replace('"format_version": 1', '"format_version": 2'))
    with pytest.raises(LakeFormatError, match="format version 2"):
        LakeStore.open(own_lake)


def test_a_disk_without_hard_links_is_told(tmp_path, monkeypatch):
    import errno
    import os

    from breplake.errors import StorageError

    def refuse(*_):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(StorageError, match="has no hard links"):
        LakeStore.create(tmp_path / "lake")
    assert not list((tmp_path / "lake").rglob("*#*"))
