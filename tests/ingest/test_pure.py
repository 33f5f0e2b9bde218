"""Pure functions of ingest: dihedral angles, mesh quality, fingerprints, settings."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("OCP")

from breplake.errors import UsageError
from breplake.ingest.measures import duplicate_group, is_single_primitive
from breplake.ingest.quality import measure
from breplake.ingest.settings import Settings
from breplake.ingest.sharpness import Dihedral, classify

ALONG = np.tile([0.0, 1.0, 0.0], (5, 1))  # tangent of the curve
UP = np.tile([0.0, 0.0, 1.0], (5, 1))  # outward normal of its left patch


def turned(degrees):
    """The right patch's normal: the left one's, turned about the curve."""
    angle = np.radians(np.broadcast_to(degrees, 5))
    return np.column_stack([np.sin(angle), np.zeros(5), np.cos(angle)])


@pytest.mark.parametrize("degrees", [0.0, 1e-6, 18.0, 18.3, 90.0, 161.0, 170.0])
@pytest.mark.parametrize("side", [1, -1])
def test_dihedral(degrees, side):
    dihedral = Dihedral.between(UP, turned(side * degrees), ALONG)
    assert math.degrees(dihedral.angle_max) == pytest.approx(degrees, rel=1e-9, abs=1e-12)
    expected = None if degrees < 0.5 else "convex" if side > 0 else "concave"
    assert dihedral.convexity == expected
    assert dihedral.sharp == (18.2 < degrees < 161.8)
    assert classify(dihedral) == ("sharp" if degrees > 18.2 else "smooth")


def test_box_edge_is_convex():
    """The top edge of a box at x = 1, which the top's loop follows along y."""
    assert Dihedral.between(UP, turned(90), ALONG).convexity == "convex"


def test_one_smooth_sample_makes_a_curve_not_sharp():
    dihedral = Dihedral.between(UP, turned([30, 30, 5, 30, 30]), ALONG)
    assert not dihedral.sharp
    assert dihedral.angle_max == pytest.approx(math.radians(30))


def test_undefined_normals_are_left_out():
    right = turned(90)
    right[0] = np.nan
    assert Dihedral.between(UP, right, ALONG).sharp
    nothing = Dihedral.between(UP, np.full((5, 3), np.nan), ALONG)
    assert math.isnan(nothing.angle_min)
    assert not nothing.sharp


def test_both_sides():
    assert Dihedral.between(UP, turned([40, 40, 0, -40, -40]), ALONG).convexity == "mixed"


def test_quality_of_a_tetrahedron():
    points = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    quality = measure(points, faces)
    assert quality.max_edge == pytest.approx(math.sqrt(8))
    assert quality.min_angle == pytest.approx(math.pi / 3)
    assert quality.regular_angles == 1
    assert quality.is_watertight
    open_quality = measure(points, faces[1:])
    assert (open_quality.n_boundary_edges, open_quality.is_watertight) == (3, False)
    double = measure(points, np.concatenate([faces, faces[:1, ::-1]]))
    assert double.n_nonmanifold_edges == 3


def rows(*types):
    return [{"type": t, "area": 1.0} for t in types]


@pytest.mark.parametrize(
    ("patches", "corners", "curves", "expected"),
    [
        (rows(*["Plane"] * 6), 8, 12, True),
        (rows(*["Plane"] * 6), 9, 13, False),
        (rows("Cylinder", "Plane", "Plane"), 2, 3, True),
        (rows("Cylinder", "Cylinder", "Plane", "Plane"), 4, 6, True),
        (rows("Cylinder", *["Plane"] * 7), 14, 21, False),
        (rows("Sphere"), 2, 3, True),
        (rows("Torus"), 1, 2, True),
        (rows("Plane"), 4, 4, True),
        (rows("Cylinder", "Cone"), 3, 5, False),
        (rows("BSpline"), 4, 4, False),
    ],
)
def test_single_primitive(patches, corners, curves, expected):
    assert is_single_primitive(1, patches, corners, curves) is expected
    assert not is_single_primitive(2, patches, corners, curves)


def test_duplicate_group_is_a_function_of_the_fingerprint():
    assert duplicate_group("a", "x") == duplicate_group("a", "y") >= 0
    assert duplicate_group("a", "x") != duplicate_group("b", "x")
    assert duplicate_group(None, "x") != duplicate_group(None, "y")


@pytest.mark.parametrize(
    "bad", [{"mesh": "fine"}, {"max_edge": 0}, {"max_edge": 2}, {"timeout": 0}, {"memory": 0.1}]
)
def test_settings_say_the_rule(bad):
    (name,) = bad
    with pytest.raises(UsageError, match=f"{name} must be.*got"):
        Settings(**bad)


def test_only_content_decides_the_hash():
    assert Settings(timeout=1, memory=2).config_hash == Settings().config_hash
    assert Settings(max_edge=0.02).config_hash != Settings().config_hash
    assert Settings(mesh="adaptive").config_hash != Settings().config_hash
    assert Settings(per_turn=9).config_hash == Settings().config_hash  # adaptive only
    adaptive = Settings(mesh="adaptive")
    assert Settings(mesh="adaptive", per_turn=9).config_hash != adaptive.config_hash
