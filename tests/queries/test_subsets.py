"""Subsets: frozen, split by group, the same in every lake that has the models."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.errors import LakeFormatError, NameNotFoundError, UsageError
from breplake.queries.subset_files import SubsetFile, export_subset, import_subset, missing_models
from breplake.queries.subsets import (
    create_subset,
    diff_subsets,
    form_groups,
    load_subset,
    save_subset,
    split_codes,
    subsets,
)
from breplake.schema.gc import Retention, collect
from breplake.schema.lake import LakeStore
from breplake.schema.storage import Storage
from breplake.schema.subset import Subset, pinned_snapshots, subset_path

HALVES = {"train": 0.5, "test": 0.5}
META = {"message": "m", "tools": {}, "config_hash": "c"}


@pytest.fixture
def lake(own_lake):
    return breplake.open(own_lake)


def names_of(lake, ids):
    rows = lake.sql("SELECT name FROM models WHERE model_id IN (SELECT unnest(?))", [ids.tolist()])
    return {name for (name,) in rows.fetchall()}


def test_a_subset_is_frozen(lake):
    made = create_subset(lake, "large", where="volume > 50 -- mm^3", split=HALVES, seed=3)
    assert names_of(lake, made.model_ids) == {"big", "wide"}
    found = lake.subset("large")
    assert found == made
    assert found.hash == made.hash
    assert (found.snapshot, found.lake_id, found.seed) == (2, lake.store.lake_id, 3)
    assert found.sql == "SELECT model_id FROM models WHERE (volume > 50 -- mm^3\n)"
    assert (np.diff(found.ids()) > 0).all()
    assert sorted([*found.ids("train"), *found.ids("test")]) == found.ids().tolist()
    assert sum(found.counts().values()) == len(found) == 2
    assert [s.name for s in subsets(lake)] == ["large"]
    with pytest.raises(NameNotFoundError, match="train, test"):
        found.ids("validation")


def test_a_subset_of_a_snapshot_that_is_collected_meanwhile_fails(lake, monkeypatch):
    lake.store.commit([], **META)
    create = lake.store.storage.create

    def collect_first(path, data):
        store = LakeStore.open(lake.root)
        assert collect(store, Retention(keep=1), grace=timedelta(0)).snapshots == [1, 2]
        return create(path, data)

    monkeypatch.setattr(lake.store.storage, "create", collect_first)
    with pytest.raises(NameNotFoundError, match="snapshot 2 was removed meanwhile"):
        create_subset(lake, "late", where="true")
    assert subsets(lake) == []


def test_a_subset_made_before_keeps_its_snapshot(lake):
    create_subset(lake, "early", where="true")
    lake.store.commit([], **META)
    assert collect(lake.store, Retention(keep=1), grace=timedelta(0)).snapshots == [1]
    assert lake.store.verify(lake.store.snapshot(2)) == []


def test_any_tool_reads_it(lake):
    made = create_subset(lake, "whole", sql="SELECT model_id FROM models", split=HALVES)
    path = lake.root / subset_path("whole")
    rows = pq.read_table(path).to_pylist()
    assert [row["model_id"] for row in rows] == made.ids().tolist()
    text = "".join(f"{row['model_id']} {row['split']}\n" for row in rows)
    assert hashlib.sha256(text.encode()).hexdigest() == made.hash
    assert {row["split"] for row in rows} <= set(HALVES)


def test_the_snapshot_is_pinned(own_lake, new_shard):
    first = create_subset(breplake.open(own_lake, at=1), "old", where="true")
    assert len(first) == 2
    store = LakeStore.open(own_lake)
    new_shard(store, "s2", {"new": (2, 2, 2)})
    store.commit(store.register_shard("s2"), message="m", tools={}, config_hash="c")
    lake = breplake.open(own_lake)
    assert lake.subset("old").model_ids.tolist() == first.model_ids.tolist()
    create_subset(lake, "new", where="true")
    assert pinned_snapshots(Storage(own_lake)) == {"old": 1, "new": 3}


def test_names_are_for_good(lake):
    made = create_subset(lake, "a", where="volume > 50")
    assert create_subset(lake, "a", where="volume > 50").time == made.time
    for different in ({"where": "volume > 51"}, {"where": "volume > 50", "split": HALVES}):
        with pytest.raises(UsageError, match="immutable"):
            create_subset(lake, "a", **different)
    assert load_subset(lake, "a") == made
    for name in ("", "../a", "a/b", ".a", "a" * 101):
        with pytest.raises(UsageError, match="named by letters"):
            create_subset(lake, name, where="true")
        with pytest.raises(NameNotFoundError, match="has no subset"):
            lake.subset(name)
    create_subset(lake, "training", where="true")
    with pytest.raises(NameNotFoundError, match="did you mean training"):
        lake.subset("trainin")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "either sql or where"),
        ({"sql": "SELECT 1", "where": "true"}, "either sql or where"),
        ({"sql": "SELECT name FROM models"}, "column model_id"),
        ({"sql": "SELECT 1.5 AS model_id"}, "whole numbers"),
        ({"sql": "SELECT NULL::BIGINT AS model_id"}, "without nulls"),
        ({"sql": "SELECT 7 AS model_id"}, "no models of snapshot 2: 7"),
        ({"sql": "DROP VIEW models"}, "reading statement"),
        ({"sql": "SELECT error(name) AS model_id FROM models"}, "Invalid Input Error"),
        ({"where": "false"}, "selects no model"),
        ({"where": "n_torsu > 1"}, "n_torsu"),
        ({"where": "true", "limit": 0}, "at least 1"),
        ({"where": "true", "split": {"a": 0.5, "b": 0.4}}, "sum to 1"),
        ({"where": "true", "split": {"a": 1.5, "b": -0.5}}, "at most 1"),
        ({"where": "true", "split": {"all": 1.0}}, "not 'all'"),
        ({"where": "true", "split": {}}, "sum to 1"),
    ],
)
def test_mistakes_are_named(lake, arguments, message):
    with pytest.raises(UsageError, match=message):
        create_subset(lake, "x", **arguments)
    assert subsets(lake) == []


def test_ids_that_repeat_count_once(lake):
    made = create_subset(lake, "x", sql="SELECT model_id, patch_id FROM patches")
    assert len(made) == 5
    assert made.splits == ("all",)
    assert made.ids("all").tolist() == made.ids().tolist()


fractions = st.lists(st.integers(1, 9), min_size=1, max_size=4).map(
    lambda parts: {f"s{i}": part / sum(parts) for i, part in enumerate(parts)}
)


@given(
    groups=st.lists(st.integers(-(2**62), 2**62), min_size=1, max_size=40),
    shares=fractions,
    seed=st.integers(0, 2**40),
)
def test_a_group_keeps_its_split_whatever_the_others_are(groups, shares, seed):
    codes = split_codes(np.array(groups * 2, np.int64), shares, seed)
    assert codes[: len(groups)].tolist() == codes[len(groups) :].tolist()
    assert ((codes >= 0) & (codes < len(shares))).all()
    for group, code in zip(groups, codes, strict=False):
        assert split_codes(np.array([group], np.int64), shares, seed).tolist() == [code]


def test_shares_hold_on_average():
    groups = np.arange(20_000)
    shares = {"train": 0.7, "validation": 0.1, "test": 0.2}
    found = np.bincount(split_codes(groups, shares, 0)) / len(groups)
    np.testing.assert_allclose(found, list(shares.values()), atol=0.01)  # 3 sigma
    other = split_codes(groups, shares, 1)
    assert 0.3 < (other != split_codes(groups, shares, 0)).mean() < 0.6  # 1 - sum of squares


def test_copies_stay_together(sample_lake):
    """Of one part, the sample lake has two files with different units."""
    lake = breplake.open(sample_lake)
    query = "SELECT duplicate_group, list(model_id) FROM models GROUP BY 1 HAVING count(*) > 1"
    copies = lake.sql(query).fetchall()
    assert copies
    groups = np.array([g for g, ids in copies for _ in ids])
    for seed in range(20):
        codes = split_codes(groups, HALVES, seed)
        assert all(len(set(codes[groups == g])) == 1 for g in np.unique(groups))


def test_a_limit_takes_nearly_the_same_models_when_some_are_added(lake):
    few = create_subset(lake, "few", where="true", limit=2)
    assert len(few) == 2
    three = create_subset(lake, "three", where="true", limit=3)
    assert set(few.ids()) < set(three.ids())
    assert len(create_subset(lake, "many", where="true", limit=99)) == 5
    picked = {tuple(create_subset(lake, f"s{s}", where="true", limit=2, seed=s).ids())
              for s in range(8)}  # fmt: skip
    assert len(picked) > 1


def test_diff(lake):
    a = create_subset(lake, "a", where="volume < 100", split=HALVES)
    b = create_subset(lake, "b", where="volume > 1", split=HALVES)
    found = diff_subsets(a, b)
    assert names_of(lake, found.only_first) == {"small"}
    assert names_of(lake, found.only_second) == {"big", "wide"}
    assert found.common == 2
    assert not len(found.moved)
    renamed = replace(a, fractions={"x": 0.5, "test": 0.5})
    moved = diff_subsets(a, renamed).moved
    assert moved.tolist() == a.ids("train").tolist()


def test_damage_is_found(lake):
    create_subset(lake, "a", where="true")
    path = lake.root / subset_path("a")
    table = pq.read_table(path)
    pq.write_table(table.slice(1), path)
    with pytest.raises(LakeFormatError, match="damaged"):
        lake.subset("a")
    with pytest.raises(LakeFormatError, match="damaged"):
        pinned_snapshots(Storage(lake.root))
    pq.write_table(table.replace_schema_metadata({}), path)
    with pytest.raises(LakeFormatError, match="is not a subset"):
        lake.subset("a")
    path.write_bytes(b"nothing")
    with pytest.raises(LakeFormatError, match="is not a subset"):
        lake.subset("a")


@pytest.mark.parametrize("ending", ["json", "csv"])
def test_the_same_subset_in_another_lake(lake, tmp_path, new_shard, ending):
    made = create_subset(lake, "a", where="volume > 1", split=HALVES, seed=5)
    path = tmp_path / f"a.{ending}"
    export_subset(lake, made, path)
    other_store = LakeStore.create(tmp_path / "other")
    for shard, boxes in (
        ("x", {"wide": (7, 8, 2), "big": (4, 5, 6)}),
        ("y", {"long/flat": (9, 2, 1), "bare": (3, 3, 3), "more": (1, 1, 2)}),
    ):
        new_shard(other_store, shard, boxes)
        other_store.commit(
            other_store.register_shard(shard), message=shard, tools={}, config_hash="c"
        )
    other = breplake.open(tmp_path / "other")
    copied = import_subset(other, "b", SubsetFile.read(path))
    assert copied.hash == made.hash
    assert copied.fractions == made.fractions
    assert copied.ids("train").tolist() == made.ids("train").tolist()
    assert (copied.lake_id, copied.snapshot) == (other.store.lake_id, 2)
    assert copied.origin is not None
    assert (copied.origin.lake_id, copied.origin.name) == (lake.store.lake_id, "a")
    assert other.subset("b") == copied
    export_subset(other, copied, tmp_path / f"b.{ending}")
    assert SubsetFile.read(tmp_path / f"b.{ending}").models == SubsetFile.read(path).models


def test_missing_models_are_listed(lake, tmp_path):
    made = create_subset(lake, "a", where="true")
    path = tmp_path / "a.json"
    export_subset(lake, made, path)
    text = path.read_text()
    old = breplake.open(lake.root, at=1)
    file = SubsetFile.read(path)
    assert {(m.label, why) for m, why in missing_models(old, file)} == {
        (f"boxes/{name}", "absent") for name in ("big", "wide", "bare")
    }
    with pytest.raises(UsageError, match=r"3 of 5 models are not in snapshot 1: .*boxes/big"):
        import_subset(old, "b", file)
    part = import_subset(old, "b", file, partial=True)
    assert len(part) == 2
    assert part.hash != made.hash

    changed = lake.model("big")["sha256"]
    path.write_text(text.replace(changed, "0" * 64))
    with pytest.raises(UsageError, match=r"boxes/big \(of another source file\)"):
        import_subset(lake, "c", SubsetFile.read(path))
    path.write_text(text.replace(made.hash, "0" * 64))
    with pytest.raises(UsageError, match="it was edited"):
        import_subset(lake, "c", SubsetFile.read(path))


def test_a_list_of_ones_own(lake, tmp_path):
    ids = [lake.model(name)["model_id"] for name in ("big", "small", "wide")]
    path = tmp_path / "mine.csv"
    path.write_text("split,model_id\n" + "".join(f"{s},{i}\n" for s, i in zip("abb", ids)))  # noqa: B905
    made = import_subset(lake, "mine", SubsetFile.read(path))
    assert made.counts() == {"a": 1, "b": 2}
    assert made.origin is None
    assert sum(made.fractions.values()) == pytest.approx(1)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "", "lists no model"),
        ("a.csv", "model_id\n", "lists no model"),
        ("a.csv", "name\nbig\n", "no list of models"),
        ("a.csv", "model_id\n1\n1\n", "lists model 1 twice"),
        ("a.csv", "model_id\nx\n", "no list of models"),
        ("a.csv", '# {"format": "other", "version": 1}\nmodel_id\n1\n', "no list of models"),
        ("a.json", "[]", "no list of models"),
        ("a.json", "{", "no list of models"),
        ("b.json", None, "cannot read"),
    ],
)
def test_files_that_are_no_lists(tmp_path, name, text, message):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(UsageError, match=message):
        SubsetFile.read(tmp_path / name)


def test_endings(lake, tmp_path):
    made = create_subset(lake, "a", where="true")
    with pytest.raises(UsageError, match=r"\.json or \.csv"):
        export_subset(lake, made, tmp_path / "a.txt")


def test_the_file_is_plain(lake, tmp_path):
    made = create_subset(lake, "a", where="true")
    export_subset(lake, made, tmp_path / "a.json")
    document = json.loads((tmp_path / "a.json").read_text())
    assert [m["model_id"] for m in document["models"]] == list(map(str, made.ids().tolist()))
    export_subset(lake, made, tmp_path / "a.csv")
    with (tmp_path / "a.csv").open() as stream:
        assert json.loads(next(stream)[1:])["hash"] == made.hash
        rows = list(csv.DictReader(stream))
    assert [int(row["model_id"]) for row in rows] == made.ids().tolist()
    assert {row["collection"] for row in rows} == {"boxes"}


@pytest.fixture
def call(own_lake, monkeypatch, tmp_path):
    monkeypatch.setenv("BREPLAKE", str(own_lake))
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(app, ["subset", *map(str, arguments)])


def test_commands(call, own_lake, tmp_path):
    done = call("create", "a", "--where", "volume > 1", "--split", "train=0.5, test=0.5")
    assert done.exit_code == 0, done.stderr
    assert done.stdout.startswith("a: 4 models (train ")
    assert call("create", "b", "--sql", "SELECT model_id FROM models", "--limit", 3).exit_code == 0
    listed = call("list").stdout
    assert [line.split()[0] for line in listed.splitlines() if line.split()[:1] in (["a"], ["b"])]
    shown = call("show", "a").stdout
    made: Subset = breplake.open(own_lake).subset("a")
    assert made.hash in shown
    assert "volume > 1" in shown
    diff = call("diff", "a", "b").stdout.splitlines()
    assert "the same" in diff[-1]
    assert all(line[:8] in ("- boxes/", "+ boxes/", "~ boxes/") for line in diff[:-1])
    assert call("export", "a").stdout.strip().endswith("a.json")
    again = call("create", "c", "--from", "a.json")
    assert made.hash in again.stdout
    partly = call("create", "d", "--from", "a.json", "--at", 1, "--partial")
    assert partly.exit_code == 0
    assert "left out boxes/big: absent" in partly.stderr
    assert f"a of lake {made.lake_id} at snapshot 2" in call("show", "c").stdout


def test_pack_command(call):
    pytest.importorskip("torch")
    call("create", "a", "--where", "true", "--split", "train=0.5,test=0.5")
    done = call("pack", "a", "-o", "clouds", "-n", 16)
    assert done.exit_code == 0, done.stderr
    assert done.stdout == "clouds: 4 clouds of 16 points; 1 models without a mesh are left out\n"
    assert "written once" in call("pack", "a", "-o", "clouds").stderr
    assert "source is" in call("pack", "a", "-o", "b", "--source", "sky").stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("create", "a"), "either sql or where"),
        (("create", "a", "--where", "true", "--split", "train"), "name=share"),
        (("create", "a", "--where", "true", "--split", "a=.5,a=.5"), "named twice"),
        (("create", "a", "--where", "true", "--partial"), "--partial goes with --from"),
        (("create", "a", "--from", "x.json", "--seed", 1), "no other option"),
        (("create", "a", "--from", "x.json"), "cannot read x.json"),
        (("show", "a"), "no subset 'a'"),
    ],
)
def test_mistakes_on_the_command_line(call, arguments, message):
    done = call(*arguments)
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert message in line


def test_two_writers_of_one_name(own_lake, tmp_path):
    """Put-if-absent: the first one wins, the second is told."""
    lake = breplake.open(own_lake)
    first = create_subset(lake, "a", where="volume > 50")
    copy = shutil.copytree(own_lake, tmp_path / "moved")
    assert breplake.open(copy).subset("a") == first  # a lake may be moved
    with pytest.raises(UsageError, match="immutable"):
        save_subset(lake, replace(first, seed=9))


# Which models share a split

PRINTS = {"small": f"{7:016x}-++-1", "big": f"{7:016x}-++-9", "wide": f"{7:016x}----1"}
"""A part, the part in another size, its mirror image; the other models have no fingerprint."""


@pytest.fixture
def scaled(lake):
    lake.connection.execute(
        "CREATE TABLE given AS SELECT * REPLACE (CASE name "
        + " ".join(f"WHEN '{name}' THEN '{text}'" for name, text in PRINTS.items())
        + " END AS fingerprint) FROM models; CREATE OR REPLACE VIEW models AS FROM given"
    )
    return lake


def test_scaled_copies_and_mirror_images_share_a_split_if_asked_to(scaled):
    where = f"name IN {tuple(PRINTS)}"
    made = {
        together: [
            create_subset(scaled, f"{together}{seed}", where=where, split=HALVES, seed=seed,
                          together=together)
            for seed in range(8)
        ]
        for together in ("copies", "form")
    }  # fmt: skip
    assert any(len(set(found.codes.tolist())) == 2 for found in made["copies"])
    assert all(len(set(found.codes.tolist())) == 1 for found in made["form"])
    assert len({found.codes[0] for found in made["form"]}) == 2
    assert load_subset(scaled, "form3").together == "form"
    assert load_subset(scaled, "copies3").together == "copies"
    with pytest.raises(UsageError, match="copies or form, got 'hand'"):
        create_subset(scaled, "x", where=where, together="hand")


def test_a_file_says_what_stayed_together(scaled, tmp_path):
    made = create_subset(scaled, "a", where="true", split=HALVES, together="form")
    for ending in ("json", "csv"):
        path = tmp_path / f"a.{ending}"
        export_subset(scaled, made, path)
        assert import_subset(scaled, f"b{ending}", SubsetFile.read(path)).together == "form"


def test_models_without_a_fingerprint_are_of_their_own_form():
    groups = np.array([-5, 8, 8, 2**62], np.int64)
    prints = [None, None, f"{2**64 - 5:016x}-00-1", f"{3:016x}-+--1"]
    assert form_groups(groups, prints).tolist() == [-5, 8, -5, 3]


def test_a_default_subset_is_written_as_before(lake):
    """Its document has no new fact, and the hash depends on ids and splits alone."""
    made = create_subset(lake, "a", where="true", split=HALVES)
    facts = json.loads(pq.read_schema(lake.root / subset_path("a")).metadata[b"breplake.subset"])
    assert "together" not in facts
    assert replace(made, together="form").hash == made.hash


def test_an_empty_split_is_told(own_lake):
    arguments = ["subset", "create", "a", "--where", "name = 'big'", "-l", str(own_lake)]
    result = CliRunner().invoke(app, [*arguments, "--split", "train=0.5,val=0.5"])
    assert result.exit_code == 0
    (line,) = result.stderr.splitlines()
    assert "has no model: 1 models are few" in line
    assert CliRunner().invoke(app, [*arguments[:2], "b", *arguments[3:]]).stderr == ""
