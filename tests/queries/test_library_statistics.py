"""Statistics of the query library: types, sizes and neighbours, against what the lake counts."""

from __future__ import annotations

from pathlib import Path

import pytest

import breplake
from breplake.queries.session import Lake
from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES

from .library import HISTOGRAMS, ask, by


def test_surface_types(samples: Lake):
    rows = ask(samples, "surface_types")
    assert tuple(row["type"] for row in rows) == SURFACE_TYPES
    assert [row["patches"] for row in rows] == list(samples.info().patches.values())
    assert sum(row["share"] for row in rows) == pytest.approx(1)
    assert sum(row["area_share"] for row in rows) == pytest.approx(1)
    assert all(row["models"] >= 1 for row in rows)


def test_curve_types(samples: Lake):
    rows = by(ask(samples, "curve_types"), "type")
    assert set(rows) == set(CURVE_TYPES)
    assert {t: row["curves"] for t, row in rows.items()} == samples.info().curves
    assert [t for t, row in rows.items() if row["paper_type"] == "Other"] == [
        "Parabola", "Hyperbola", "Other",
    ]  # fmt: skip


@pytest.mark.parametrize("name", HISTOGRAMS)
def test_histograms(samples: Lake, name: str):
    column = f"n_{name.removesuffix('_per_model')}"
    rows = ask(samples, name, bin=7, last=100)
    counts = [n for (n,) in samples.sql(f"SELECT {column} FROM models").fetchall()]
    assert [row["low"] for row in rows] == [*range(0, 100, 7), 100]
    assert rows[-2]["high"] == 99
    assert rows[-1]["high"] is None
    for row in rows:
        high = float("inf") if row["high"] is None else row["high"]
        assert row["models"] == sum(row["low"] <= n <= high for n in counts)
    assert rows[-1]["cumulative"] == pytest.approx(1)
    with pytest.raises(Exception, match="bin must be at least 1"):
        ask(samples, name, bin=0)


def test_complexity(samples: Lake):
    rows = by(ask(samples, "complexity"), "measure")
    patches = sorted(n for (n,) in samples.sql("SELECT n_patches FROM models").fetchall())
    row = rows["n_patches"]
    assert (row["least"], row["most"], row["total"]) == (patches[0], patches[-1], sum(patches))
    assert row["median"] == (patches[10] + patches[11]) / 2
    assert rows["volume"]["models"] == 21  # duct_surface is a sheet


def test_surface_mixes(samples: Lake):
    rows = by(ask(samples, "surface_mixes"), "types")
    assert sum(row["models"] for row in rows.values()) == 22
    assert rows["Sphere"]["example"] == "ball_steel"
    assert "bellows" not in rows["BSpline"]["example"]


def test_neighbours(samples: Lake):
    rows = ask(samples, "neighbours", where="name = 'base_plate_mm'")
    found = {(row["type_a"], row["type_b"]): row for row in rows}
    rounds = found["Cylinder", "Plane"]
    assert rounds["smooth"] == 8  # four rounded corners with two sides each
    assert rounds["mixed"] == 0
    assert rounds["concave"] == 1  # the foot of the boss
    assert found["Plane", "Plane"]["mean_angle"] == pytest.approx(1.5708, abs=1e-3)
    every = ask(samples, "neighbours")
    kinds = ("smooth", "convex", "concave", "mixed", "unknown")
    assert all(sum(row[kind] for kind in kinds) == row["pairs"] for row in every)
    assert sum(row["share"] for row in every) == pytest.approx(1)
    assert all(row["type_a"] <= row["type_b"] for row in every)


MEETING = """
CREATE OR REPLACE VIEW patches AS
    SELECT $id AS model_id, unnest([0, 1]) AS patch_id, 'Plane' AS type;
CREATE OR REPLACE VIEW adjacency AS
    SELECT
        $id AS model_id, 0 AS patch_a, 1 AS patch_b, 1.0 AS length, 1.0 AS angle_min,
        1.0 AS angle_max, unnest(['sharp', 'sharp', 'sharp', 'nonmanifold', 'smooth']) AS kind,
        unnest(['mixed', 'convex', NULL, NULL, 'mixed']) AS convexity
"""
"""Curves between two patches; at the third, their orientations disagree."""


def test_neighbours_of_no_side_are_not_mixed(tiny_lake: Path):
    lake = breplake.open(tiny_lake)
    lake.connection.execute(MEETING.replace("$id", f"{lake.model('big')['model_id']}::BIGINT"))
    (row,) = ask(lake, "neighbours")
    kinds = ("smooth", "convex", "concave", "mixed", "unknown")
    assert [row[kind] for kind in kinds] == [1, 1, 0, 1, 2]


def test_spline_degrees(samples: Lake):
    rows = ask(samples, "spline_degrees")
    assert sum(row["patches"] for row in rows) == samples.info().patches["BSpline"]
    assert any(row["rational"] for row in rows)
    assert all(1 <= row["low_degree"] <= row["high_degree"] for row in rows)
