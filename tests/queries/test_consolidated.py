"""Consolidated copies: the same rows from one file, at exactly the snapshots they fit."""

from __future__ import annotations

import os
from datetime import timedelta
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.errors import NameNotFoundError, StorageError, UsageError
from breplake.queries import consolidated
from breplake.queries.consolidated import FOLDER, consolidate
from breplake.schema.gc import Retention, collect
from breplake.schema.tables import TABLES


def test_sql_and_polars_read_the_copy(own_lake: Path):
    lake = breplake.open(own_lake)
    names = [name for name in TABLES if lake.files(name)]
    before = {name: lake.sql(f"FROM {name} ORDER BY ALL").fetchall() for name in names}
    copies = consolidate(lake, names)
    assert [path.parent.name for path in copies] == [FOLDER] * len(names)
    again = breplake.open(own_lake)
    for name, copy in zip(names, copies, strict=True):
        assert again.sources(name) == [str(copy)]
        assert again.files(name) == lake.files(name)
        assert again.sql(f"FROM {name} ORDER BY ALL").fetchall() == before[name]
        assert again.scan(name).collect().height == len(before[name])
        assert pq.read_schema(copy).equals(TABLES[name].schema)
    answer = again.sandbox(timeout=60).sql("SELECT count(*) AS n FROM patches")
    assert answer.to_pylist() == [{"n": len(before["patches"])}]
    row = lake.model("big")
    assert again.read("faces", row["model_id"]).equals(lake.read("faces", row["model_id"]))
    assert again.model("big") == row


def test_a_copy_serves_its_snapshot_alone(own_lake: Path, new_shard):
    lake = breplake.open(own_lake)
    (copy,) = consolidate(lake)
    assert lake.at(1).sources("models") == lake.at(1).files("models")
    new_shard(lake.store, "s2", {"new": (1, 1, 1)})
    lake.store.commit(lake.store.register_shard("s2"), message="m", tools={}, config_hash="c")
    newest = breplake.open(own_lake)
    assert newest.sql("SELECT count(*) FROM models").fetchall() == [(6,)]
    assert breplake.open(own_lake, at=2).sources("models") == [str(copy)]
    (newer,) = consolidate(newest)
    assert newer != copy
    assert breplake.open(own_lake).sql("SELECT count(*) FROM models").fetchall() == [(6,)]
    assert breplake.open(own_lake, at=2).sql("SELECT count(*) FROM models").fetchall() == [(5,)]
    time = newer.stat().st_mtime_ns
    assert consolidate(newest) == [newer]
    assert newer.stat().st_mtime_ns == time  # it was there


def test_copies_stay_as_long_as_their_snapshot(own_lake: Path, new_shard):
    (copy,) = consolidate(breplake.open(own_lake))
    reader = breplake.open(own_lake)  # at snapshot 2
    assert reader.sql("SELECT count(*) FROM models").fetchall() == [(5,)]
    store = reader.store
    new_shard(store, "s2", {"new": (1, 1, 1)})
    store.commit(store.register_shard("s2"), message="m", tools={}, config_hash="c")
    (newer,) = consolidate(breplake.open(own_lake))
    assert reader.sql("SELECT count(*) FROM models").fetchall() == [(5,)]
    collect(store, Retention(keep=1), grace=timedelta(0))
    consolidate(breplake.open(own_lake))
    assert list((own_lake / FOLDER).iterdir()) == [newer]
    assert not copy.exists()


def test_row_groups_are_full(own_lake: Path, monkeypatch: pytest.MonkeyPatch):
    lake = breplake.open(own_lake)
    small = TABLES["faces"].__class__(**{**_fields(TABLES["faces"]), "row_group": 10})
    monkeypatch.setitem(consolidated.TABLES, "faces", small)
    (copy,) = consolidate(lake, ["faces"])
    metadata = pq.read_metadata(copy)
    sizes = [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)]
    assert sizes == [10, 10, 10, 10, 8]


def _fields(table: object) -> dict[str, object]:
    return {name: getattr(table, name) for name in table.__slots__}


def test_a_copy_that_is_not_finished_is_not_there(own_lake: Path, monkeypatch: pytest.MonkeyPatch):
    def fail(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(StorageError, match="No space left"):
        consolidate(breplake.open(own_lake))
    assert os.listdir(own_lake / FOLDER) == []


def test_what_cannot_be_copied(own_lake: Path):
    with pytest.raises(NameNotFoundError, match="did you mean models"):
        consolidate(breplake.open(own_lake), ["model"])
    with pytest.raises(UsageError, match="failures has no rows at snapshot 1"):
        consolidate(breplake.open(own_lake, at=1), ["failures"])


def test_command(own_lake: Path):
    result = CliRunner().invoke(app, ["consolidate", "models", "patches", "-l", str(own_lake)])
    assert result.exit_code == 0
    assert len(result.stdout.split()) == 2
    assert breplake.open(own_lake).sources("patches") == [result.stdout.split()[1]]
    assert result.stderr.split() == ["copying", "models", "copying", "patches"]
