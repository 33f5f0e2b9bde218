"""Structure of models by the query library: genus, symmetry, copies, the largest."""

from __future__ import annotations

import pytest

from breplake.queries.session import Lake

from .library import ask, by


def test_genus(samples: Lake):
    rows = by(ask(samples, "genus"))
    assert rows["ball_steel"]["genus"] == rows["weight_lemon"]["genus"] == 0
    assert rows["mug"]["genus"] == rows["gear_spur"]["genus"] == 1
    assert rows["base_plate_mm"]["genus"] == 5  # its holes
    assert "duct_surface" not in rows  # open
    assert min(row["genus"] for row in ask(samples, "genus", min_genus=2)) == 2


def test_mirror_symmetry(samples: Lake):
    rows = by(ask(samples, "mirror_symmetry"))
    assert rows["trough_parabolic"]["x"] == rows["trough_parabolic"]["y"] == 1
    assert rows["trough_parabolic"]["z"] is None
    assert "ball_steel" not in rows  # too few corners
    assert "gear_spur" in rows


def test_repeated_parts(samples: Lake):
    rows = {row["part"]: row for row in ask(samples, "repeated_parts", model="flange_joint")}
    assert (rows["bolt"]["copies"], rows["nut"]["copies"], rows["flange"]["copies"]) == (8, 8, 2)
    mirrored = ask(samples, "repeated_parts", model="shelf_brackets")
    assert {row["copies"] for row in mirrored} == {2}
    assert len(ask(samples, "repeated_parts", model="ball_steel", min_copies=1)) == 1


def test_largest_models(samples: Lake):
    rows = ask(samples, "largest_models", limit=3)
    values = [n for (n,) in samples.sql("SELECT n_patches FROM models").fetchall()]
    assert [row["value"] for row in rows] == sorted(values, reverse=True)[:3]
    assert len(ask(samples, "largest_models", by="volume")) <= 20
    with pytest.raises(Exception, match="by is patches, curves"):
        ask(samples, "largest_models", by="weight")


def test_duplicates(samples: Lake):
    (cluster,) = ask(samples, "duplicates")
    assert cluster["names"] == ["base_plate_inch", "base_plate_mm"]
    assert cluster["models"] == 2
    assert ask(samples, "duplicates", min_models=3) == []
