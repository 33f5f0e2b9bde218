"""Differences of snapshots: exactly what was changed is reported, and nothing else."""

from __future__ import annotations

import json
import shutil

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.queries.versions.diff import ColumnChange, TableChange, diff
from breplake.schema.lake import LakeStore
from breplake.schema.tables import TABLES

META = {"message": "m", "tools": {}, "config_hash": "c"}


def rewrite(store, shard, name, change=None):
    """Commit a copy of a shard whose tables `change(table name, rows)` may alter."""
    old = [entry for entry in store.head().files if entry.shard == shard]
    shutil.copytree(store.root / f"arrays/{shard}.zarr", store.array_path(name))
    for entry in old:
        if entry.table != "arrays":
            rows = pq.read_table(store.root / entry.path)
            if entry.table == "models":
                rows = put(rows, "shard", pa.array([name] * rows.num_rows))
            rows = change(entry.table, rows) if change else rows
            pq.write_table(rows, store.table_path(entry.table, name))
    files = store.register_shard(name)
    store.commit(files, replaces=[entry.path for entry in old], **META)


def put(rows, column, values):
    place = rows.schema.get_field_index(column)
    return rows.set_column(place, rows.schema.field(column), values)


@pytest.fixture
def store(own_lake):
    return LakeStore.open(own_lake)


def compare(store, old, new):
    return diff(breplake.open(store.root, old), breplake.open(store.root, new))


def test_a_snapshot_does_not_differ_from_itself(store):
    found = compare(store, 2, 2)
    assert (found.added, found.removed, found.changed, found.rewritten) == ([], [], [], 0)
    assert (found.tables, found.columns) == ([], [])


def test_added_and_removed_models(store):
    found = compare(store, 1, 2)
    assert found.added == ["boxes/bare", "boxes/big", "boxes/wide"]
    assert (found.removed, found.changed, found.rewritten, found.columns) == ([], [], 0, [])
    tables = {change.table: change for change in found.tables}
    assert tables["faces"] == TableChange("faces", 24, 0, 0)
    assert tables["failures"] == TableChange("failures", 2, 0, 0)
    back = compare(store, 2, 1)
    assert (back.added, back.removed) == ([], found.added)
    assert {t.table: t.removed for t in back.tables} == {t.table: t.added for t in found.tables}


def test_files_written_anew_with_the_same_rows(store):
    rewrite(store, "s0", "s2")
    found = compare(store, 2, 3)
    assert (found.added, found.removed, found.changed, found.rewritten) == ([], [], [], 2)
    assert found.tables == [TableChange("models", 0, 0, 2)]
    assert found.columns == [ColumnChange("models", "shard", 2, 2, content=False)]


def test_changed_columns_are_counted_by_rows_and_models(store):
    small = breplake.open(store.root).model("small")["model_id"]

    def change(table, rows):
        is_small = pc.equal(rows["model_id"], small)
        if table == "patches":  # three patches of one model, and a null that gets a value
            first = pc.and_(is_small, pc.less(rows["patch_id"], 3))
            rows = put(rows, "area", pc.if_else(first, 7.5, rows["area"]))
            return put(rows, "name", pc.if_else(is_small, "lid", rows["name"]))
        if table == "vertices":  # all of both models; NaN is no change of NaN
            return put(rows, "nx", pc.add(rows["nx"], 1.0))
        return rows

    rewrite(store, "s0", "s2", change)
    found = compare(store, 2, 3)
    assert found.changed == ["boxes/long/flat", "boxes/small"]
    assert found.columns == [
        ColumnChange("models", "shard", 2, 2, content=False),
        ColumnChange("patches", "area", 3, 1, content=True),
        ColumnChange("patches", "name", 6, 1, content=True),
        ColumnChange("vertices", "nx", 48, 2, content=True),
    ]
    assert found.tables == [
        TableChange("models", 0, 0, 2),
        TableChange("patches", 0, 0, 6),
        TableChange("vertices", 0, 0, 48),
    ]


def test_rows_that_come_and_go(store):
    def drop(table, rows):
        return rows.slice(1) if table == "faces" else rows

    rewrite(store, "s0", "s2", drop)
    found = compare(store, 2, 3)
    assert found.tables == [TableChange("models", 0, 0, 2), TableChange("faces", 0, 1, 0)]
    assert len(found.changed) == found.rewritten == 1


def test_nested_values_and_numbers_that_are_none(store):
    def change(table, rows):
        if table != "models":
            return rows
        boxes = [
            dict(box, x=box["x"] + (i == 0)) for i, box in enumerate(rows["bbox_max"].to_pylist())
        ]
        rows = put(rows, "bbox_max", pa.array(boxes, rows.schema.field("bbox_max").type))
        return put(rows, "volume", pa.array([float("nan")] * rows.num_rows))

    rewrite(store, "s0", "s2", change)
    rewrite(store, "s2", "s3", change)
    found = compare(store, 3, 4)
    assert [(c.column, c.rows) for c in found.columns] == [("bbox_max", 1), ("shard", 2)]


def test_a_column_that_only_one_side_has(store, monkeypatch):
    """As between versions of the contract; commits of today have all columns."""
    lake = breplake.open(store.root)
    rewrite(store, "s0", "s2")
    path = store.root / "tables/patches/s2.parquet"
    rows = pq.read_table(path)
    rows = rows.drop_columns(["colour"]).append_column(
        "texture", pa.nulls(rows.num_rows, pa.int8())
    )
    place = rows.schema.get_field_index("n_loops")
    rows = rows.set_column(place, "n_loops", rows["n_loops"].cast(pa.int64()))
    pq.write_table(rows, path)
    new = breplake.open(store.root)
    new._connection = lake.connection  # its views would refuse the file
    found = diff(lake, new)
    assert {(c.column, c.note) for c in found.columns if c.note} == {
        ("colour", "removed"),
        ("texture", "added"),
        ("n_loops", "INTEGER -> BIGINT"),
    }


def test_the_commands(store):
    rewrite(store, "s0", "s2")

    def call(*arguments):
        result = CliRunner().invoke(app, [*arguments, "--lake", str(store.root)])
        assert result.exit_code == 0, result.stderr
        return result.stdout

    text = call("diff", "1")
    assert text.startswith("snapshot 1 to 3\n3 models added: boxes/bare, boxes/big, boxes/wide\n")
    assert "2 models written anew, their content as before" in text
    assert "how it was made" in text
    assert json.loads(call("diff", "1", "2", "--json")) == compare(store, 1, 2).to_dict()
    assert "3: 19 files" in call("verify")
    assert json.loads(call("snapshots", "--json"))[0]["models"] == 2
    found = json.loads(call("gc", "--keep", "1", "--grace", "0", "--dry-run", "--json"))
    assert (found["snapshots"], len(found["garbage"])) == ([1, 2], 9)
    assert "snapshots removed: 1, 2" in call("gc", "--keep", "1", "--grace", "0")
    (store.root / "tables/faces/s1.parquet").write_bytes(b"?")
    result = CliRunner().invoke(app, ["verify", "--lake", str(store.root)])
    assert result.exit_code == 1
    assert "tables/faces/s1.parquet: 1 bytes instead of" in result.stdout
    for wrong in ("3", "x", "3 years"):
        result = CliRunner().invoke(app, ["gc", "--older-than", wrong, "--lake", str(store.root)])
        assert result.stderr.startswith("breplake: a time is a number with")


def test_every_table_is_compared(store):
    """Each table of the fixture has rows, so that a table that is left out is noticed."""
    found = compare(store, 1, 2)
    there = {entry.table for entry in store.snapshot(2).files if entry.rows} - {"arrays"}
    assert {change.table for change in found.tables} == there <= set(TABLES)
