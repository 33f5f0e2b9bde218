"""Quality by the query library: faults, tiny features, candidates for a benchmark."""

from __future__ import annotations

from pathlib import Path

import pytest

import breplake
from breplake.queries.session import Lake

from .library import ask, by


def test_invalid_models(samples: Lake):
    rows = by(ask(samples, "invalid_models"))
    assert rows["duct_surface"]["faults"] == ["open"]
    assert rows["duct_surface"]["boundary_curves"] == 2
    assert "base_plate_mm" not in rows
    assert "tolerance" in by(ask(samples, "invalid_models", max_tolerance=0))["mug"]["faults"]


def test_mesh_quality(samples: Lake, tiny_lake: Path):
    rows = by(ask(samples, "mesh_quality", min_angle=2.0))
    assert len(rows) == 22
    assert all("angle" in row["faults"] for row in rows.values())
    assert "holes" not in {f for row in rows.values() for f in row["faults"]}
    assert by(ask(breplake.open(tiny_lake), "mesh_quality"))["bare"]["faults"] == ["no mesh"]


def test_tiny_features(samples: Lake):
    every = ask(samples, "tiny_features", max_ratio=10)
    assert {row["feature"] for row in every} == {"curve", "patch"}
    box = [r for r in every if r["name"] == "base_plate_mm" and r["feature"] == "patch"]
    assert len(box) == samples.model("base_plate_mm")["n_patches"]
    assert all(row["ratio"] <= 1e-2 for row in ask(samples, "tiny_features", max_ratio=1e-2))


def test_benchmark_candidates(samples: Lake):
    rows = by(ask(samples, "benchmark_candidates", min_bytes=0))
    assert "ball_steel" not in rows  # a single primitive
    assert {"mug", "bellows", "base_plate_inch", "base_plate_mm"} <= set(rows)
    unique = by(ask(samples, "benchmark_candidates", min_bytes=0, unique=True))
    assert set(rows) - set(unique) == {"base_plate_mm"}
    assert ask(samples, "benchmark_candidates", max_faces=10) == []
    assert ask(samples, "benchmark_candidates", min_vertices=10**8) == []


@pytest.mark.parametrize(
    "given", [{}, {"min_bytes": 0, "unique": True}, {"max_faces": 900, "min_vertices": 0}]
)
def test_every_input_is_a_candidate_or_rejected(samples: Lake, tiny_lake: Path, given: dict):
    for lake in (samples, breplake.open(tiny_lake)):
        taken, rejected = (
            by(ask(lake, name, **given), "model_id")
            for name in ("benchmark_candidates", "benchmark_rejects")
        )
        query = "SELECT model_id FROM models UNION SELECT model_id FROM failures WHERE fatal"
        assert sorted([*taken, *rejected]) == sorted(row for (row,) in lake.sql(query).fetchall())
        assert all(row["reasons"] for row in rejected.values())


def test_benchmark_rejects(samples: Lake, tiny_lake: Path):
    none = {"min_bytes": 0, "min_vertices": 0}
    reasons = {row["name"]: row["reasons"] for row in ask(samples, "benchmark_rejects", **none)}
    assert reasons["ball_steel"] == ["single-primitive"]
    assert "mug" not in reasons
    ball = by(ask(samples, "benchmark_rejects", max_faces=10))["ball_steel"]
    assert ball["reasons"][:2] == ["nearly-empty", "single-primitive"]
    assert "mesh-too-large" in ball["reasons"]
    unique = by(ask(samples, "benchmark_rejects", min_bytes=0, unique=True))
    assert unique["base_plate_mm"]["reasons"] == ["duplicate"]
    assert "base_plate_inch" not in unique
    failed = by(ask(breplake.open(tiny_lake), "benchmark_rejects", **none))
    assert "not-cad" in failed["broken"]["reasons"]
