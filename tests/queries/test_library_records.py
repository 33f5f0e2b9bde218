"""Records by the query library: licences, failures, costs, units, collections."""

from __future__ import annotations

from pathlib import Path

import pytest

import breplake
from breplake.queries.session import Lake

from .library import ask, by


def test_licences(tiny_lake: Path):
    lake = breplake.open(tiny_lake)
    lake.connection.execute(
        "CREATE TABLE given AS SELECT * REPLACE (if(name = 'big', 'MIT', NULL) AS licence, "
        "if(name = 'big', 'Ada', NULL) AS owner) FROM models"
    )
    lake.connection.execute("CREATE OR REPLACE VIEW models AS FROM given")
    rows = ask(lake, "licences")
    assert [(r["licence"], r["owner"], r["models"]) for r in rows] == [
        (None, None, 4),
        ("MIT", "Ada", 1),
    ]
    assert rows[1]["example"] == "big"


def test_failures_by_kind(tiny_lake: Path):
    rows = by(ask(breplake.open(tiny_lake), "failures_by_kind"), "kind")
    assert (rows["not-cad"]["fatal"], rows["not-cad"]["example"]) == (True, "broken")
    assert rows["timeout"]["message"] == "took longer than 1 s"
    assert ask(breplake.open(tiny_lake, 1), "failures_by_kind") == []


def test_ingest_cost(samples: Lake):
    rows = by(ask(samples, "ingest_cost"), "stage")
    assert rows["total"]["share"] == 1
    stages = sum(rows[stage]["total"] for stage in ("load", "brep", "mesh", "truth", "write"))
    assert 0 < stages <= rows["total"]["total"]
    assert rows["mesh"]["models"] == 22


def test_length_units(samples: Lake):
    rows = {row["length_unit"]: row for row in ask(samples, "length_units")}
    assert sum(row["models"] for row in rows.values()) == 22
    assert {row["scale_to_mm"] for row in rows.values()} == {1.0, 25.4}


def test_collections(samples: Lake):
    (row,) = ask(samples, "collections")
    assert (row["models"], row["duplicates"], row["meshed_share"]) == (22, 1, 1)
    assert row["closed_share"] == pytest.approx(21 / 22)
    assert row["patches"] == sum(samples.info().patches.values())
