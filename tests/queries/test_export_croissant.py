"""Croissant: the reference implementation accepts the description, and reads the rows by it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import breplake
from breplake.errors import UsageError
from breplake.queries.export_croissant import croissant, write_croissant
from breplake.schema.tables import TABLES

mlc = pytest.importorskip("mlcroissant")

pytestmark = pytest.mark.filterwarnings(
    # warnings of mlcroissant and its dependencies about each other
    "ignore::DeprecationWarning",
    "ignore::FutureWarning",
)


def record(row, table):
    """A row of a lake as mlcroissant gives it: ids of fields for names, bytes for text."""

    def given(value, place):
        if isinstance(value, dict):
            return {f"{place}/{name}": given(v, f"{place}/{name}") for name, v in value.items()}
        return value.encode() if isinstance(value, str) else value

    return {f"{table}/{name}": given(value, f"{table}/{name}") for name, value in row.items()}


def without_nested(row):
    """Leave out lists, and structures that are null: mlcroissant makes them lists of nulls."""
    return {
        name: value
        for name, value in row.items()
        if isinstance(value, bytes | int | float)
        or (isinstance(value, dict) and value and all(isinstance(v, float) for v in value.values()))
    }


@pytest.mark.parametrize("at", [1, 2])
def test_it_is_valid_and_reads_as_the_lake(own_lake, at):
    lake = breplake.open(own_lake, at)
    path = write_croissant(lake, own_lake / "croissant.json")
    dataset = mlc.Dataset(path)
    assert not dataset.metadata.issues.errors
    for table in ("models", "patches", "curves", "vertices", "corners"):
        expected = [record(row, table) for row in lake.scan(table).collect().to_dicts()]
        found = list(dataset.records(table))
        assert len(found) == len(expected) > 0
        for one, other in zip(found, expected, strict=True):
            assert without_nested(one) == without_nested(other)
    hashes = {file.id: file.sha256 for file in dataset.metadata.file_objects}
    tables = [entry for entry in lake.snapshot.files if entry.table != "arrays"]
    assert hashes == {entry.path: entry.sha256 for entry in tables}


def test_types_of_real_parts(sample_lake, tmp_path):
    lake = shutil.copytree(sample_lake, tmp_path / "lake")
    path = write_croissant(breplake.open(lake), tmp_path / "croissant.json")  # in a folder above
    dataset = mlc.Dataset(path)
    assert not dataset.metadata.issues.errors
    opened = breplake.open(lake)
    sets = {record_set.id: record_set for record_set in dataset.metadata.record_sets}
    assert set(sets) == {table for table in TABLES if opened.files(table)}
    for table in ("models", "surfaces", "shapes", "motions"):  # together, all kinds of nesting
        assert len(list(dataset.records(table))) == opened.scan(table).collect().height
    (first, *_) = dataset.records("patches")
    (expected, *_) = opened.scan("patches").collect().to_dicts()
    assert without_nested(first) == without_nested(record(expected, "patches"))
    splines = opened.sql("SELECT count(*) FROM curves WHERE poles IS NOT NULL").fetchall()[0][0]
    found = [row["curves/poles"] for row in dataset.records("curves") if row.get("curves/knots")]
    assert len(found) == splines > 0
    assert set(found[0][0]) == {"curves/poles/x", "curves/poles/y", "curves/poles/z"}


def test_a_published_lake(tiny_lake, tmp_path):
    lake = breplake.open(tiny_lake)
    path = write_croissant(lake, tmp_path / "croissant.json", "https://example.org/lake")
    assert not mlc.Dataset(path).metadata.issues.errors
    document = json.loads(path.read_text())
    urls = [f["contentUrl"] for f in document["distribution"] if "contentUrl" in f]
    assert "https://example.org/lake/tables/models/s0.parquet" in urls
    with pytest.raises(UsageError, match="not above"):
        write_croissant(lake, Path("/nowhere/croissant.json"))


def test_what_is_known_of_licences_is_said(tiny_lake):
    document = croissant(breplake.open(tiny_lake), ".")
    assert "license" not in document  # no model states one
    assert document["version"] == "2.0.0"
    assert "5 CAD models (boxes)" in document["description"]
