"""Lakes with shards of several contracts: their columns are known without opening each file."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import breplake
from breplake.queries.check import check_lake
from breplake.schema import older
from breplake.schema.lake import LakeStore
from breplake.schema.older import CONTRACT, TableFile, by_schema
from breplake.schema.snapshot import Snapshot, read_header
from breplake.schema.tables import TABLES

OLD = "0123456789abcdef"
META = {"message": "m", "tools": {}, "config_hash": "c"}
COUNTS = "SELECT count(*), count(pcurve) FROM coedges"


def age(root: Path, contract: str, *, without: dict[str, str] | None = None) -> None:
    """Make a lake one of an older breplake, whose ``coedges`` had no ``pcurve``.

    `contract` is what its snapshots say; `without` tells of shards whose files lack another
    column.
    """
    store = LakeStore.open(root)
    entries = {}
    for entry in store.head().table_files("coedges"):
        path = root / entry.path
        column = (without or {}).get(entry.shard, "pcurve")
        pq.write_table(pq.read_table(path).drop_columns([column]), path)
        digest = store.storage.hash(entry.path)
        entries[entry.path] = entry._replace(bytes=path.stat().st_size, sha256=digest)
    for number in store.numbers():
        old = store.snapshot(number)
        files = tuple(entries.get(entry.path, entry) for entry in old.files)
        document = Snapshot(**{**vars(old), "files": files, "contract": contract}).to_json()
        (root / f"snapshots/{number:08d}.json").write_bytes(document)


@pytest.fixture
def old_lake(own_lake):
    age(own_lake, OLD)
    return own_lake


@pytest.fixture
def mixed_lake(old_lake, new_shard):
    """The older lake with two commits of today."""
    for shard in ("s2", "s3"):
        store = LakeStore.open(old_lake)
        new_shard(store, shard, {shard: (3, 2, 1)})
        store.commit(store.register_shard(shard), **META)
    return old_lake


@pytest.fixture
def footers(monkeypatch):
    """The files whose footers are read for their columns."""
    found: list[Path] = []
    read = pq.read_schema

    def counted(source, *rest):
        found.append(Path(source))
        return read(source, *rest)

    monkeypatch.setattr(older.pq, "read_schema", counted)
    return found


def tables(footers):
    return sorted(path.parent.name for path in footers)


def test_an_older_lake_opens_one_file_of_each_table(old_lake, footers):
    lake = breplake.open(old_lake)
    assert lake.sql(COUNTS).fetchall() == [(120, 0)]
    used = sorted(table for table in TABLES if lake.files(table))
    assert len(lake.files("coedges")) == 2
    assert tables(footers) == used, "one footer of each table, though there are two shards"


def test_files_of_today_are_not_opened_at_all(mixed_lake, footers):
    lake = breplake.open(mixed_lake)
    assert lake.sql(COUNTS).fetchall() == [(168, 0)]
    assert {path.stem for path in footers} == {"s0", "s1"}
    assert len(tables(footers)) == len(set(tables(footers)))


def test_a_lake_of_today_opens_none(own_lake, footers):
    assert breplake.open(own_lake).sql(COUNTS).fetchall() == [(120, 0)]
    assert footers == []


def test_a_commit_remembers_the_contracts(mixed_lake):
    store = LakeStore.open(mixed_lake)
    head = store.head()
    assert head.contract == ""
    assert head.contracts == {"s0": OLD, "s1": OLD, "s2": CONTRACT, "s3": CONTRACT}
    text = (mixed_lake / f"snapshots/{head.number:08d}.json").read_text()
    lines = ",\n".join(sorted([f'"{OLD}":["s0","s1"]', f'"{CONTRACT}":["s2","s3"]']))
    assert text.endswith(f',\n"contracts":{{\n{lines}\n}}}}\n')
    assert Snapshot.from_json(text.encode(), "it") == head
    assert read_header(text.splitlines()[0].encode(), "it") == head.header


def test_the_parts_that_older_readers_know_are_as_they_were(mixed_lake):
    """They look for three members by name, and refuse a header with words that are new."""
    store = LakeStore.open(mixed_lake)
    head = store.head()
    mixed = json.loads((mixed_lake / f"snapshots/{head.number:08d}.json").read_text())
    first = json.loads((mixed_lake / "snapshots/00000001.json").read_text())
    assert mixed.keys() == first.keys() | {"contracts"}
    assert mixed["snapshot"].keys() == first["snapshot"].keys()
    assert mixed["columns"] == first["columns"]
    assert all(len(row) == 5 for row in mixed["shards"]["s0"].values())


def test_what_a_commit_replaces_does_not_count(mixed_lake, new_shard):
    store = LakeStore.open(mixed_lake)
    old = [entry.path for entry in store.head().files if entry.shard in ("s0", "s1")]
    new_shard(store, "s4", {"last": (3, 2, 1)})
    made = store.commit(store.register_shard("s4"), replaces=old, **META)
    assert (made.contract, made.contracts) == (CONTRACT, {})
    assert b"contracts" not in made.to_json()


def test_removing_shards_leaves_one_contract(mixed_lake):
    store = LakeStore.open(mixed_lake)
    new = [entry.path for entry in store.head().files if entry.shard in ("s2", "s3")]
    made = store.commit([], replaces=new, **META)
    assert (made.contract, made.contracts) == (OLD, {})


def test_shards_of_which_nothing_is_known(own_lake, new_shard, footers):
    """The first snapshots said nothing where files differ: each of their files is looked into."""
    age(own_lake, "", without={"s1": "t_min"})
    store = LakeStore.open(own_lake)
    new_shard(store, "s2", {"new": (3, 2, 1)})
    made = store.commit(store.register_shard("s2"), **META)
    assert (made.contract, made.contracts) == ("", {"s2": CONTRACT})
    assert breplake.open(own_lake).sql(COUNTS).fetchall() == [(144, 0)]
    assert {path.stem for path in footers} == {"s0", "s1"}
    assert tables(footers).count("coedges") == 2


def test_a_consolidated_copy_is_looked_into(old_lake, footers):
    from breplake.queries.consolidated import consolidate

    consolidate(breplake.open(old_lake), ["coedges"])
    lake = breplake.open(old_lake)
    assert lake.sql(COUNTS).fetchall() == [(120, 0)]
    assert [path.parent.name for path in footers if "coedges" in str(path)] == ["consolidated"]


def test_groups_keep_the_order_of_files(tmp_path):
    table = TABLES["corners"]
    files = []
    for name, contract in (("a", OLD), ("b", CONTRACT), ("c", OLD), ("d", ""), ("e", "")):
        path = tmp_path / f"{name}.parquet"
        lacks = [] if name in "be" else ["vertex_id"]
        pq.write_table(table.empty().drop_columns(lacks), path)
        files.append(TableFile(str(path), contract))
    groups = {
        "vertex_id" in schema.names: [Path(path).stem for path in paths]
        for schema, paths in by_schema(table, files)
    }
    assert groups == {False: ["a", "c", "d"], True: ["b", "e"]}


def test_check_finds_a_file_that_lacks_more_than_its_contract(own_lake, new_shard):
    """Readers take the columns of one file for those of all: the odd one out is damage."""
    store = LakeStore.open(own_lake)
    new_shard(store, "s2", {"new": (3, 2, 1)})
    store.commit(store.register_shard("s2"), **META)
    age(own_lake, OLD)
    report = check_lake(breplake.open(own_lake))
    assert "contract" not in {rule.name for rule in report.broken}
    path = own_lake / "tables/coedges/s1.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["t_min"]), path)
    report = check_lake(breplake.open(own_lake))
    (rule,) = (rule for rule in report.broken if rule.name == "contract")
    assert "s1.parquet" in str(rule)
    assert "s0.parquet" not in str(rule)
