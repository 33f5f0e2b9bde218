"""Delta tables: other readers see the rows of the lake, at each exported snapshot."""

from __future__ import annotations

import json
import os
from datetime import timedelta

import polars as pl
import pytest
from polars.testing import assert_frame_equal

import breplake
from breplake.errors import UsageError
from breplake.queries.export_delta import delta_schema, export_delta
from breplake.schema.gc import Retention, collect
from breplake.schema.lake import LakeStore
from breplake.schema.tables import TABLES

deltalake = pytest.importorskip("deltalake")

META = {"message": "m", "tools": {}, "config_hash": "c"}


def rows(lake, table):
    return lake.scan(table).sort(TABLES[table].key).collect()


@pytest.mark.parametrize("linked", ["hard", "symbolic"])
def test_every_table_reads_as_in_the_lake(tiny_lake, tmp_path, monkeypatch, linked):
    def refuse(*_):
        raise OSError("another file system")

    if linked == "symbolic":
        monkeypatch.setattr(os, "link", refuse)
    lake = breplake.open(tiny_lake)
    exported = export_delta(lake, tmp_path / "delta")
    assert [table.path.name for table in exported] == list(TABLES)
    for table in exported:
        name = table.path.name
        expected = rows(lake, name)
        delta = deltalake.DeltaTable(table.path)
        assert (delta.version(), len(delta.file_uris())) == (0, table.files)
        assert_frame_equal(
            pl.scan_delta(str(table.path)).sort(TABLES[name].key).collect(), expected
        )
        by_delta_rs = deltalake.QueryBuilder().register("t", delta)
        counted = pl.DataFrame(by_delta_rs.execute("SELECT count(model_id) AS n FROM t").read_all())
        assert counted["n"].item() == expected.height
    links = list((tmp_path / "delta").glob("*/*.parquet"))
    assert len(links) == sum(table.files for table in exported) == 17
    assert all(path.is_symlink() == (linked == "symbolic") for path in links)
    assert all(path.samefile(tiny_lake / "tables" / path.parent.name / path.name) for path in links)


def test_the_sample_lake(sample_lake, tmp_path):
    lake = breplake.open(sample_lake)
    for table in export_delta(lake, tmp_path / "delta"):
        name = table.path.name
        found = pl.scan_delta(str(table.path)).sort(TABLES[name].key).collect()
        assert_frame_equal(found, rows(lake, name))


def test_a_later_snapshot_is_a_new_version(own_lake, new_shard, tmp_path):
    first = breplake.open(own_lake, 1)
    assert {table.version for table in export_delta(first, tmp_path)} == {0}
    assert {table.version for table in export_delta(first, tmp_path)} == {0}  # nothing is new
    store = LakeStore.open(own_lake)
    old = [entry.path for entry in store.head().files if entry.shard == "s0"]
    new_shard(store, "s2", {"small": (2, 2, 2), "long/flat": (9, 2, 1)})
    store.commit(store.register_shard("s2"), replaces=old, **META)
    versions = {table.path.name: table.version for table in export_delta(first.at(), tmp_path)}
    assert versions["patches"] == 1
    assert versions["motions"] == 0  # has no files before and after
    path = str(tmp_path / "models")
    assert_frame_equal(pl.read_delta(path).sort("model_id"), rows(first.at(), "models"))
    assert_frame_equal(pl.read_delta(path, version=0).sort("model_id"), rows(first, "models"))
    assert deltalake.DeltaTable(path).history(1)[0]["userMetadata"].startswith("snapshot 3 of lake")


def test_links_outlive_a_collection_and_the_lake_a_vacuum(own_lake, new_shard, tmp_path):
    export_delta(breplake.open(own_lake, 1), tmp_path)
    store = LakeStore.open(own_lake)
    old = [entry.path for entry in store.head().files if entry.shard == "s0"]
    store.commit([], replaces=old, **META)
    export_delta(breplake.open(own_lake, 3), tmp_path)
    assert collect(store, Retention(keep=1), grace=timedelta(0)).snapshots == [1, 2]
    path = str(tmp_path / "models")
    assert pl.read_delta(path, version=0).height == 2
    removed = deltalake.DeltaTable(path).vacuum(
        retention_hours=0, enforce_retention_duration=False, dry_run=False
    )
    assert removed == ["s0.parquet"]
    assert store.verify(store.snapshot()) == []


def test_what_a_log_says(tiny_lake, tmp_path):
    export_delta(breplake.open(tiny_lake), tmp_path)
    text = (tmp_path / "faces/_delta_log/00000000000000000000.json").read_text()
    actions = [json.loads(line) for line in text.splitlines()]
    assert [next(iter(action)) for action in actions] == [
        *("commitInfo", "protocol", "metaData", "add", "add"),
    ]
    entry = breplake.open(tiny_lake).snapshot.file("faces", "s0")
    assert json.loads(actions[3]["add"]["stats"]) == {
        "numRecords": 24,
        "minValues": {"model_id": entry.min_model_id},
        "maxValues": {"model_id": entry.max_model_id},
        "nullCount": {"model_id": 0},
    }
    assert str(tiny_lake) not in text
    for table in TABLES.values():
        schema = deltalake.Schema.from_json(delta_schema(table))
        assert [field.name for field in schema.fields] == table.schema.names
        assert [field.nullable for field in schema.fields] == [c.nullable for c in table.columns]


def test_where_it_does_not_export(tiny_lake, own_lake, tmp_path):
    lake = breplake.open(tiny_lake)
    with pytest.raises(UsageError, match="inside the lake"):
        export_delta(lake, tiny_lake / "tables")
    export_delta(lake, tmp_path / "delta")
    with pytest.raises(UsageError, match="another lake"):
        export_delta(breplake.open(own_lake), tmp_path / "delta")
    (tmp_path / "delta/models/_delta_log/00000000000000000000.json").rename(tmp_path / "gone")
    (tmp_path / "delta/models/_delta_log/00000000000000000007.json").touch()
    with pytest.raises(UsageError, match="compacted by another tool"):
        export_delta(lake, tmp_path / "delta")
