"""Groups of copies, and how mirror images and scaled copies are named."""

import json

import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.queries.duplicates import find_duplicates

A, B = "a" * 16, "b" * 16


class Rows:
    """A lake as far as `find_duplicates` looks at it."""

    def __init__(self, *fingerprints):
        # (fingerprint, sha256); a group for each fingerprint
        groups = {f: 100 + i for i, f in enumerate(dict.fromkeys(f for f, _ in fingerprints))}
        self.rows = [(i, f"c/m{i}", sha, f, groups[f]) for i, (f, sha) in enumerate(fingerprints)]

    def sql(self, _query):
        return self

    def fetchall(self):
        return self.rows


def test_copies_are_grouped_and_explained():
    found = find_duplicates(
        Rows((f"{A}-00-5", "x"), (f"{A}-00-5", "x"), (f"{B}-00-5", "y"), (f"{B}-00-5", "z"))
    )
    assert [group.explanation for group in found.groups] == [
        "the same file",
        "the same shape and size",
    ]
    assert found.n_copies == 2


def test_mirror_images_and_sizes_are_named_but_not_merged():
    found = find_duplicates(
        Rows((f"{A}-+0-5", "x"), (f"{A}--0-5", "y"), (f"{A}-+0-9", "z"), (f"{B}-00-5", "w"))
    )
    by_name = {group.models[0][1]: group for group in found.groups}
    assert by_name.keys() == {"c/m0", "c/m1", "c/m2"}
    assert by_name["c/m0"].mirrors == (by_name["c/m1"].number,)
    assert by_name["c/m0"].scaled == (by_name["c/m2"].number,)
    assert by_name["c/m2"].mirrors == ()
    assert found.n_copies == 0


def test_a_part_that_is_its_own_mirror_image_mirrors_none():
    assert not find_duplicates(Rows((f"{A}-00-5", "x"), (f"{B}-00-5", "y"))).groups


def test_models_without_patches_are_copies_only_as_files():
    rows = Rows((None, "x"))
    rows.rows = [(0, "c/m0", "x", None, 7), (1, "c/m1", "x", None, 7), (2, "c/m2", "y", None, 8)]
    (group,) = find_duplicates(rows).groups
    assert group.explanation == "the same file"


def test_the_inch_twin_is_found(sample_lake):
    lake = breplake.open(sample_lake)
    names = {m["name"] for m in lake.scan("models").collect().to_dicts()}
    twins = {n for n in names if n.endswith(("_inch", "_mm"))}
    if len(twins) < 2:
        pytest.skip("the sample lake holds no twins")
    groups = [{n.rpartition("/")[2] for _, n in g.models} for g in find_duplicates(lake).groups]
    assert any(len(twins & group) == 2 for group in groups)


def test_the_command_prints_both_ways(sample_lake):
    plain = CliRunner().invoke(app, ["duplicates", "--lake", str(sample_lake)])
    assert plain.exit_code == 0
    assert "of them copies of others" in plain.output
    listed = CliRunner().invoke(app, ["duplicates", "--lake", str(sample_lake), "--json"])
    assert isinstance(json.loads(listed.output), list)
