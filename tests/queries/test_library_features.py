"""Features that the query library finds in sample parts, which were modelled with them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import breplake
from breplake.queries.session import Lake

from .library import ask, by


def test_torus_rich(samples: Lake):
    assert set(by(ask(samples, "torus_rich"))) == {"bellows", "spindle_grip"}
    assert "bellows" not in by(ask(samples, "torus_rich", more_than=10_000))


def test_freeform_share(samples: Lake):
    rows = by(ask(samples, "freeform_share"))
    for name in ("panel_offset", "duct_surface", "nozzle_nurbs", "gasket_wave"):
        assert rows[name]["share"] == pytest.approx(1)
    assert "gear_spur" not in rows
    assert by(ask(samples, "freeform_share", min_share=0))["hinge"]["freeform_patches"] == 0


def test_fillets(features: Lake, samples: Lake):
    rows = by(ask(features, "fillets"))
    assert (rows["dice"]["fillets"], rows["dice"]["rounds"]) == (0, 20)  # 12 edges, 8 corners
    assert rows["dice"]["most_radius"] == pytest.approx(2.5)
    assert "manifold_block" not in rows
    assert rows["enclosure"]["fillets"] > 0
    assert set(by(ask(features, "fillets", min_radius=3.5))) == {"block_machined", "enclosure"}
    assert "dice" in by(ask(features, "fillets", max_radius=2.6))
    plate = by(ask(samples, "fillets"))["base_plate_inch"]
    assert plate["rounds"] == 4
    assert plate["least_radius"] == pytest.approx(25.4 / 4)


def test_fillet_radii(features: Lake):
    rows = by(ask(features, "fillet_radii"), "radius")
    assert rows[2.5] == {"radius": 2.5, "fillets": 0, "rounds": 20, "models": 1}
    assert ask(features, "fillet_radii", min_models=5) == []


def test_holes(features: Lake, samples: Lake):
    rows = by(ask(features, "holes"), "radius")
    assert (rows[16]["stepped"], rows[11]["through"]) == (1, 1)  # counterbore of block_machined
    assert (rows[9]["stepped"], rows[3.2]["through"]) == (3, 4)  # ports of manifold_block
    assert (rows[1.6]["blind"], rows[1.6]["least_depth"]) == (4, pytest.approx(26.5))
    plates = by(ask(samples, "holes", where="name LIKE 'base_plate%'"), "radius")
    assert plates[12.7]["through"] == 2
    assert plates[4.763]["through"] + plates.get(4.762, {"through": 0})["through"] == 8
    assert all(row["radius"] >= 5 for row in ask(features, "holes", min_radius=5))
    assert all(row["radius"] <= 5 for row in ask(features, "holes", max_radius=5))


def test_holes_are_one_however_their_wall_is_cut(features: Lake):
    rows = features.sql("SELECT len(patches), depth, high - low FROM holes").fetchall()
    assert all(n >= 1 and depth == pytest.approx(extent) for n, depth, extent in rows)
    axis = "SELECT axis.x * foot.x + axis.y * foot.y + axis.z * foot.z FROM holes"
    assert all(abs(dot) < 1e-9 for (dot,) in features.sql(axis).fetchall())


def test_hole_patterns(samples: Lake, features: Lake):
    flange = [r for r in ask(samples, "hole_patterns") if r["name"] == "flange_joint"]
    assert [(r["holes"], r["pattern"]) for r in flange] == [(8, "circle")] * 2
    assert flange[0]["circle_radius"] == pytest.approx(80)
    plate = next(r for r in ask(samples, "hole_patterns") if r["name"] == "base_plate_mm")
    assert (plate["holes"], plate["pattern"]) == (4, "rectangle")
    assert plate["radius"] == pytest.approx(4.7625)
    ports = [r for r in ask(features, "hole_patterns") if r["name"] == "manifold_block"]
    assert {(r["radius"], r["pattern"]) for r in ports} == {
        (5.0, "row"), (9.0, "row"), (3.2, "rectangle"),
    }  # fmt: skip
    assert all(r["holes"] >= 8 for r in ask(samples, "hole_patterns", min_holes=8))


def test_counterbores(features: Lake):
    rows = ask(features, "counterbores")
    block = next(row for row in rows if row["name"] == "block_machined")
    assert (block["radius"], block["head_radius"], block["head_depth"]) == pytest.approx(
        (11, 16, 6)
    )
    assert [row["name"] for row in rows].count("manifold_block") == 3


def test_turned_parts(samples: Lake):
    rows = {row["name"] for row in ask(samples, "turned_parts")}
    assert {"plumb_bob", "spindle_grip", "bellows"} & rows
    assert not {"gear_spur", "base_plate_mm", "gasket_wave"} & rows
    everything = ask(samples, "turned_parts", min_share=0)
    assert all(0 < row["share"] <= 1 + 1e-6 for row in everything)


HELICES = """
CREATE OR REPLACE VIEW patches AS SELECT
    $id AS model_id, unnest([0, 1]) AS patch_id, 'Cylinder' AS type, 2.0 AS radius,
    {'x': 1.0, 'y': 0.0, 'z': 0.0} AS x_axis, {'x': 0.0, 'y': 1.0, 'z': 0.0} AS y_axis,
    {'x': 0.0, 'y': 0.0, 'z': 1.0} AS z_axis;
CREATE OR REPLACE VIEW coedges AS SELECT
    $id AS model_id, unnest([0, 1, 0, 0]) AS patch_id,
    unnest([5, 5, 6, 9]) AS curve_id, unnest([7, 7, 8, 9]) AS pcurve,
    0.0 AS t_min, unnest([$length, $length, 1.0, 1.0]) AS t_max;
CREATE OR REPLACE VIEW pcurves AS
    SELECT
        $id AS model_id, 7 AS pcurve_id, 'Line' AS type, NULL::INT AS basis,
        NULL AS knots, NULL AS poles,
        {'u': 3 * pi() / $length, 'v': 4.5 / $length} AS direction
    UNION ALL BY NAME
    SELECT
        $id AS model_id, 8 AS pcurve_id, 'BSpline' AS type, [0.0, 0, 1, 1] AS knots,
        [{'u': 0.0, 'v': 1.0}, {'u': -3 * pi(), 'v': 5.5}] AS poles
    UNION ALL BY NAME
    SELECT
        $id AS model_id, 9 AS pcurve_id, 'BSpline' AS type, [0.0, 0, 0, 1, 1, 1] AS knots,
        [{'u': 0.0, 'v': 1.0}, {'u': 3.0, 'v': 1.0}, {'u': 6.0, 'v': 5.5}] AS poles;
"""
"""Curves on a cylinder of radius 2: a line and a spline of one and a half turns and pitch 3, one
rising to the right and one to the left, and a spline that bends and so is no helix. The line lies
between two patches of the cylinder."""


def test_helices(tiny_lake: Path):
    lake = breplake.open(tiny_lake)
    length = ((3 * math.pi) ** 2 + 4.5**2) ** 0.5  # of the line in the parameter plane
    values = {"$id": f"{lake.model('big')['model_id']}::BIGINT", "$length": str(length)}
    text = HELICES
    for name, value in values.items():
        text = text.replace(name, value)
    lake.connection.execute(text)
    rows = ask(lake, "helices")
    assert {(row["pitch"], row["handed"], row["helices"]) for row in rows} == {
        (3, "left", 1), (3, "right", 1),
    }  # fmt: skip
    assert all(row["turns"] == row["all_turns"] == pytest.approx(1.5) for row in rows)
    assert ask(lake, "helices", min_turns=2) == []


def test_a_thread_is_found(features: Lake):
    (row,) = ask(features, "helices")
    assert (row["name"], row["handed"], row["pitch"]) == ("lead_screw", "right", 5)
    assert row["all_turns"] > 10
    assert row["least_radius"] == row["most_radius"] == pytest.approx(8)


def test_thin_walled(samples: Lake):
    rows = {row["name"]: row for row in ask(samples, "thin_walled")}
    assert {"bellows", "gasket_wave", "trough_parabolic"} <= set(rows)
    assert not {"ball_steel", "base_plate_mm"} & set(rows)
    assert rows["bellows"]["thickness"] == pytest.approx(0.6, abs=0.01)


def test_sharp_share(samples: Lake):
    rows = by(ask(samples, "sharp_share"))
    assert rows["hinge"]["share"] <= 1
    assert rows["plumb_bob"]["sharp_curves"] == samples.model("plumb_bob")["n_sharp_curves"]
    assert "ball_steel" not in rows  # its one curve is a seam
    assert all(row["share"] >= 0.9 for row in ask(samples, "sharp_share", min_share=0.9))
