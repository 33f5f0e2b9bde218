"""A lake in object storage: published, pulled, tagged, committed to, verified and collected."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta

import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.errors import CommitConflictError, LakeNotFoundError, UsageError
from breplake.queries.versions.mirror import mirror
from breplake.schema.copies import copy_files
from breplake.schema.gc import Retention, collect
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import FileEntry

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of botocore and moto

META = {"message": "m", "tools": {}, "config_hash": "c"}


def test_there_and_back(own_lake, bucket, tmp_path):
    with pytest.raises(LakeNotFoundError):
        LakeStore.open(bucket)
    store = LakeStore.open(own_lake)
    store.tag("v1", 1)

    def call(*arguments):
        result = CliRunner().invoke(app, [str(a) for a in arguments])
        assert result.exit_code == 0, result.stderr
        return result.stdout

    assert " 0 were there" in call("publish", bucket, "--lake", own_lake)
    assert "snapshot 1: 0 files copied" in call("publish", bucket, "--lake", own_lake, "--at", 1)
    remote = LakeStore.open(bucket)
    assert (remote.numbers(), remote.tags()) == ([1, 2], {"v1": 1})
    assert remote.verify(remote.snapshot()) == []
    call("pull", bucket, "--lake", tmp_path / "back")
    back = LakeStore.open(tmp_path / "back")
    assert back.snapshot() == store.snapshot()
    assert back.verify(back.snapshot()) == []
    call("pull", bucket, "--lake", tmp_path / "some", "--where", "name = 'big'")
    assert breplake.open(tmp_path / "some").model("big")["area"] == 148
    for _ in range(2):  # the same selection is the same lake, so it goes on where it was
        call("publish", bucket.replace("one", "big"), "--lake", own_lake, "--where", "name = 'big'")
    result = CliRunner().invoke(app, ["publish", bucket, "--lake", str(tmp_path / "some")])
    assert "holds another lake" in result.stderr
    with pytest.raises(UsageError, match="by way of one"):
        mirror(remote, bucket.replace("one", "two"), remote.snapshot())
    result = CliRunner().invoke(app, ["publish", "s3://none/x", "--lake", str(own_lake)])
    assert result.stderr.startswith("breplake: cannot copy between here and s3://none/x: ")


def test_writers_in_object_storage(own_lake, new_shard, bucket):
    store = LakeStore.open(own_lake)
    mirror(store, bucket, store.snapshot())

    def work(worker):
        remote = LakeStore.open(bucket)
        entries = [FileEntry("corners", f"{worker}-{i}", 1, 1, "0", 1, 2) for i in range(8)]
        return [remote.commit([entry], **META).number for entry in entries]

    with ThreadPoolExecutor(4) as pool:
        numbers = sorted(number for found in pool.map(work, range(4)) for number in found)
    assert numbers == list(range(3, 35))
    remote = LakeStore.open(bucket)
    assert len(remote.head().files) == len(store.head().files) + 32
    new_shard(store, "s2", {"fresh": (1, 1, 1)})
    entries = store.register_shard("s2")
    copy_files(store.storage, remote.storage, entries)
    assert remote.commit(entries, **META).number == 35
    new_shard(store, "s3", {"big": (1, 1, 1)})
    entries = store.register_shard("s3")
    copy_files(store.storage, remote.storage, entries)
    with pytest.raises(CommitConflictError, match="boxes/big is in both"):
        remote.commit(entries, **META)


def test_damage_and_garbage_in_object_storage(own_lake, new_shard, bucket):
    store = LakeStore.open(own_lake)
    mirror(store, bucket, store.snapshot(1))
    mirror(store, bucket, store.snapshot(2))
    remote = LakeStore.open(bucket)
    remote.storage.overwrite("tables/faces/orphan.parquet", b"half")
    assert collect(remote).young == ["tables/faces/orphan.parquet"]
    old = [entry.path for entry in remote.head().files if entry.shard == "s0"]
    remote.commit([], replaces=old, **META)
    found = collect(remote, Retention(keep=1), grace=timedelta(0))
    assert found.snapshots == [1, 2]
    assert {item.path for item in found.garbage} == {*old, "tables/faces/orphan.parquet"}
    assert remote.verify(remote.head()) == []
    assert [file.path for file in remote.storage.files("arrays/s0.zarr")] == []
    remote.storage.overwrite("arrays/s1.zarr/normal/c/0/0", b"?")
    remote.storage.remove("tables/faces/s1.parquet")
    found = {problem.path: problem.kind for problem in remote.verify(remote.head())}
    assert found == {"arrays/s1.zarr": "size", "tables/faces/s1.parquet": "missing"}
