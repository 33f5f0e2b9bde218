"""What stays of shards whose models are replaced, and what finding them costs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from breplake.bench.speed.metadata import write_models
from breplake.errors import CommitConflictError
from breplake.ingest.replace import remainder
from breplake.schema import identities
from breplake.schema.identities import read_ids
from breplake.schema.lake import LakeStore
from breplake.schema.storage import Storage

META = {"message": "m", "tools": {}, "config_hash": "c"}
MODELS = 3


def lake_of(path, shards):
    """Make a lake of small shards that have models alone."""
    store = LakeStore.create(path)
    files = [write_models(store, MODELS * shard, MODELS) for shard in range(shards)]
    store.commit(files, **META)
    return store


@pytest.fixture
def lake(tmp_path):
    return lake_of(tmp_path / "lake", 4)


@pytest.fixture
def opened(monkeypatch):
    """How often each file of models was asked for."""
    counts: Counter[str] = Counter()
    before = Storage.path

    def path(self: Storage, relative: str) -> Path:
        if relative.startswith("tables/models/"):
            counts[relative] += 1
        return before(self, relative)

    monkeypatch.setattr(Storage, "path", path)
    return counts


def replace(store, entry, ids):
    """Take models out of a shard and write the whole shard anew under another name."""
    with store.lock():
        kept, gone = remainder(store, ids)
        new = entry._replace(shard=f"{entry.shard}-new")
        store.root.joinpath(new.path).write_bytes(store.root.joinpath(entry.path).read_bytes())
        store.commit([*kept, new], replaces=gone, **META)
    return kept, gone


def test_a_file_is_read_once_in_a_run_that_replaces_shard_by_shard(tmp_path, opened):
    store = LakeStore.open(lake_of(tmp_path / "lake", 150).root)
    entries = store.head().table_files("models")
    before = sorted(read_ids(store.storage, entries).tolist())
    opened.clear()
    for entry in entries[:10]:
        kept, gone = replace(store, entry, set(read_ids(Storage(store.root), [entry]).tolist()))
        assert (kept, gone) == ([], [entry.path])
    left_alone = {entry.path for entry in entries[10:]}
    assert {opened[path] for path in left_alone} == {1}
    assert sorted(read_ids(store.storage, store.head().files).tolist()) == before


def test_part_of_a_shard(lake):
    first, second = lake.head().table_files("models")[:2]
    mine, theirs = (read_ids(lake.storage, [entry]).tolist() for entry in (first, second))
    kept, gone = remainder(lake, {mine[0], theirs[1]})
    assert gone == [first.path, second.path]
    assert [read_ids(lake.storage, [entry]).tolist() for entry in kept] == [
        mine[1:],
        [theirs[0], theirs[2]],
    ]
    assert remainder(lake, {-1}) == remainder(lake, set()) == ([], [])


def test_what_was_replaced_counts_no_more_and_what_came_does(lake):
    first, second = lake.head().table_files("models")[:2]
    mine = set(read_ids(lake.storage, [first]).tolist())
    lake.commit([], replaces=[first.path], **META)
    lake.commit([first], **META)  # its models are free again
    lake.commit([], replaces=[second.path], **META)
    copy = first._replace(shard="copy")
    lake.root.joinpath(copy.path).write_bytes(lake.root.joinpath(first.path).read_bytes())
    with pytest.raises(CommitConflictError, match="a model is added once") as caught:
        lake.commit([copy], **META)
    assert first.path in str(caught.value)
    assert copy.path in str(caught.value)
    assert lake.shards_of(lake.head(), mine) == [first.shard]


def test_a_name_used_again_is_read_again(lake):
    """What a refused commit left may be written anew with other models."""
    index = identities.IdentityIndex(lake.storage)
    (one, other) = lake.head().table_files("models")[:2]
    index.check([one], [])
    path = lake.root / one.path
    path.write_bytes(lake.root.joinpath(other.path).read_bytes())
    again = lake.register(path)
    theirs = read_ids(lake.storage, [other])
    assert index.shards([again], theirs.tolist()) == [one.shard]
    assert np.array_equal(read_ids(lake.storage, [again]), theirs)
