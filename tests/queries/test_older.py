"""Lakes that an older breplake wrote: what it did not know is null, by every way of reading."""

from __future__ import annotations

import json
from pathlib import Path

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from polars.testing import assert_frame_equal

import breplake
from breplake.errors import LakeFormatError
from breplake.queries.check import check_lake
from breplake.queries.consolidated import consolidate
from breplake.queries.named import named_queries
from breplake.queries.versions.extract import Selection, extract
from breplake.schema.identity import model_id
from breplake.schema.lake import LakeStore
from breplake.schema.older import CONTRACT, contract_hash
from breplake.schema.tables import TABLES

LACKING = {"models": ["import_repairs"], "coedges": ["pcurve", "t_min"]}
"""Columns that the older lake has not; of the structure ``patches.curve`` it lacks a member."""
MEMBER = "basis_type"
META = {"message": "m", "tools": {}, "config_hash": "c"}


def older(rows: pa.Table, table: str) -> pa.Table:
    """The rows as a breplake without these columns had them."""
    if table == "patches":
        column = rows.schema.field("curve")
        members = [field for field in column.type if field.name != MEMBER]
        at = rows.schema.get_field_index("curve")
        line = {"type": "Line", "t_min": 0.0, "t_max": 1.0}
        narrow = pa.array([line] * rows.num_rows, pa.struct(members))
        rows = rows.set_column(at, pa.field("curve", narrow.type), narrow)
    return rows.drop_columns(LACKING.get(table, []))


def age(root: Path) -> None:
    """Make a lake what an older breplake would have written: files and snapshots."""
    store = LakeStore.open(root)
    entries = {}
    for entry in store.head().files:
        path = root / entry.path
        if entry.table != "arrays":
            rows = pq.read_table(path)
            pq.write_table(older(rows, entry.table), path)
            digest = store.storage.hash(entry.path)
            entries[entry.path] = entry._replace(bytes=path.stat().st_size, sha256=digest)
    for number in store.numbers():
        snapshot = store.snapshot(number)
        path = root / f"snapshots/{number:08d}.json"
        files = tuple(entries.get(entry.path, entry) for entry in snapshot.files)
        document = type(snapshot)(**{**vars(snapshot), "files": files, "contract": ""}).to_json()
        path.write_bytes(document)


@pytest.fixture
def old_lake(own_lake: Path) -> Path:
    age(own_lake)
    return own_lake


@pytest.fixture
def mixed_lake(old_lake: Path, new_shard) -> Path:
    """The older lake with a commit of today."""
    store = LakeStore.open(old_lake)
    new_shard(store, "s2", {"new": (3, 2, 1)})
    store.commit(store.register_shard("s2"), **META)
    return old_lake


def broken(report) -> set[str]:
    return {rule.name for rule in report.broken}


def test_the_hash_tells_the_columns_apart():
    assert contract_hash(TABLES) == CONTRACT
    assert contract_hash({"models": TABLES["models"]}) != CONTRACT


def test_a_lake_of_today_says_so(own_lake, new_shard):
    store = LakeStore.open(own_lake)
    assert [store.snapshot(n).contract for n in store.numbers()] == [CONTRACT] * 2
    assert json.loads((own_lake / "snapshots/00000001.json").read_text())["snapshot"]["contract"]
    age(own_lake)
    store = LakeStore.open(own_lake)
    assert store.head().contract == ""
    old = [entry.path for entry in store.head().files]
    new_shard(store, "s2", {"new": (3, 2, 1)})
    assert store.commit(store.register_shard("s2"), **META).contract == ""
    new_shard(store, "s3", {"newer": (3, 2, 1)})
    replaced = [*old, *(e.path for e in store.head().files if e.shard == "s2")]
    assert store.commit(store.register_shard("s3"), replaces=replaced, **META).contract == CONTRACT


@pytest.mark.parametrize("mixed", [False, True])
def test_every_way_of_reading(own_lake, new_shard, mixed):
    expected = {}
    if mixed:
        store = LakeStore.open(own_lake)
        new_shard(store, "s2", {"new": (3, 2, 1)})
    whole = breplake.open(own_lake)
    for name, table in TABLES.items():
        rows = whole.scan(name).collect()
        if mixed and (own_lake / f"tables/{name}/s2.parquet").exists():
            rows = pl.concat([rows, pl.read_parquet(own_lake / f"tables/{name}/s2.parquet")])
        expected[name] = rows.sort(table.key)
    age(own_lake)
    if mixed:
        store.commit(LakeStore.open(own_lake).register_shard("s2"), **META)
    lake = breplake.open(own_lake)
    for name, table in TABLES.items():
        frame = lake.scan(name).collect().sort(table.key)
        assert frame.schema == expected[name].schema
        same = [c for c in frame.columns if c not in (*LACKING.get(name, ()), "curve")]
        assert_frame_equal(frame.select(same), expected[name].select(same))
        by_sql = pl.from_arrow(lake.sql(f"FROM {name}").to_arrow_table()).sort(table.key)
        assert by_sql.columns == frame.columns
        assert_frame_equal(by_sql.select(same), frame.select(same))
        for column in LACKING.get(name, ()):
            old = frame.filter(pl.col("model_id") != model_id("boxes", "new"))
            assert old[column].null_count() == old.height > 0
    identity = model_id("boxes", "big")
    for name, table in TABLES.items():
        assert lake.read(name, identity).schema.names == table.schema.names
    assert lake.read("coedges", identity, ["pcurve"])["pcurve"].null_count == 24


def test_missing_members_of_a_structure_are_null(mixed_lake):
    lake = breplake.open(mixed_lake)
    query = f"SELECT count(curve.{MEMBER}), count(*) FROM patches"
    assert lake.sql(query).fetchall() == [(0, 36)]
    assert lake.sandbox(timeout=60).sql(query).to_pylist()[0]["count_star()"] == 36
    assert MEMBER in lake.scan("patches").collect_schema()["curve"].to_schema()


def test_all_named_queries_run(mixed_lake):
    lake = breplake.open(mixed_lake)
    names = [query.name for query in named_queries()]
    assert len(names) > 20
    for name in names:
        lake.query(name).fetchall()


def test_consolidated_copies_are_whole(mixed_lake):
    before = breplake.open(mixed_lake).scan("coedges").collect()
    consolidate(breplake.open(mixed_lake), ["models", "coedges"])
    lake = breplake.open(mixed_lake)
    assert len(lake.sources("coedges")) == 1 < len(lake.files("coedges"))
    assert_frame_equal(lake.scan("coedges").collect(), before, check_row_order=False)
    assert lake.sql("SELECT count(*) - count(pcurve) FROM coedges").fetchall() == [(144,)]


def test_copied_models_are_whole(mixed_lake, tmp_path):
    lake = breplake.open(mixed_lake)
    extract(lake.store, tmp_path / "some", lake.snapshot, Selection(where="name = 'big'"))
    some = breplake.open(tmp_path / "some")
    assert some.snapshot.contract == CONTRACT
    assert some.sql("SELECT count(*), count(pcurve) FROM coedges").fetchall() == [(24, 0)]


def test_check_accepts_what_was_not_known(mixed_lake):
    report = check_lake(breplake.open(mixed_lake))
    assert "contract" not in broken(report)
    assert report.models == 6


def test_a_column_that_is_lost_is_damage(own_lake):
    """A snapshot of today says that its files are whole: then a missing column is an error."""
    path = own_lake / "tables/coedges/s0.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["pcurve"]), path)
    assert "contract" in broken(check_lake(breplake.open(own_lake)))
    with pytest.raises(LakeFormatError, match="pcurve"):
        breplake.open(own_lake).sql("FROM coedges").fetchall()


def test_a_file_that_cannot_be_read_is_told(old_lake):
    (old_lake / "tables/faces/s1.parquet").write_bytes(b"no")
    with pytest.raises(LakeFormatError, match="breplake check"):
        breplake.open(old_lake).sql("FROM models")
