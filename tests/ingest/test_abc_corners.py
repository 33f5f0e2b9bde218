"""Triangles unfolded into the parameters of their patches, across seams and around poles."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("yaml")

from breplake.ingest.abc.corners import Corners
from breplake.ingest.abc.features import read_features
from breplake.ingest.mesh import Mesh

TURN = 2 * np.pi

FRAME = {
    "location": [0.0, 0.0, 0.0],
    "x_axis": [1.0, 0.0, 0.0],
    "y_axis": [0.0, 1.0, 0.0],
    "z_axis": [0.0, 0.0, 1.0],
    "coefficients": [0.0] * 10,
    "radius": 1.0,
}
CYLINDER = {"type": "Cylinder", **FRAME}
CONE = {"type": "Cone", **FRAME, "radius": 0.0, "angle": 0.5, "apex": [0.0, 0.0, 0.0]}


def unfolded(surface, uv, triangles) -> Corners:
    """Unfold one patch, whose vertices have these parameters."""
    geometry = read_features({"curves": [], "surfaces": [surface]}).geometry()
    uv = np.array(uv, dtype=float)
    owner = np.zeros(len(uv), dtype=np.int64)
    triangles = np.array(triangles)
    mesh = Mesh(
        points=np.asarray(geometry.jet(owner, *uv.T).point),
        triangles=triangles,
        patch=np.zeros(len(triangles), dtype=np.int64),
        corner=np.full(len(uv), -1),
        curves={},
        pair_patch=owner,
        pair_vertex=np.arange(len(uv)),
        uv=uv,
    )
    return Corners.of(mesh, geometry)


def tube(angles):
    """Two rings at heights 0 and 2, and the triangles between."""
    n = len(angles)
    uv = [*((a, 0.0) for a in angles), *((a, 2.0) for a in angles)]
    strip = [(i, (i + 1) % n) for i in range(n)]
    return uv, [t for i, j in strip for t in ((i, j, n + i), (j, n + j, n + i))]


@pytest.mark.parametrize("first", [0.0, 1.0, 5.0])
def test_three_vertices_around_a_tube(first):
    """Of the ways round of the same area, a shear, the one with the shortest sides is right."""
    angles = np.mod(first + TURN * np.arange(3) / 3, TURN)
    uv, triangles = tube(angles)
    corners = unfolded(CYLINDER, uv, triangles)
    assert corners.turn.sum() == pytest.approx(2 * TURN * 2.0)
    sides = np.abs(corners.uv - np.roll(corners.uv, 1, axis=1))[:, :, 0]
    assert sides.max() <= TURN / 3 + 1e-9
    assert corners.folded(1)[0] == 0.0


def test_uneven_vertices_around_a_tube():
    uv, triangles = tube([0.1, 1.0, 2.0, 3.0])  # the last side covers more than half of the turn
    corners = unfolded(CYLINDER, uv, triangles)
    assert corners.turn.sum() == pytest.approx(2 * TURN * 2.0)


@pytest.mark.parametrize("gap", [0.2, 0.45, 0.55, 0.8])
def test_two_triangles_share_the_tip_of_a_cone(gap):
    """Seen by the shorter way, one of them would turn the wrong way."""
    a = TURN * gap
    inner = [(0.0, 1.0), (a, 1.0)]
    outer = [(0.0, 2.0), (a / 2, 2.0), (a, 2.0), ((a + TURN) / 2, 2.0)]
    fan = [(1, 0, 6), (0, 1, 6)]
    band = [(0, 1, 3), (0, 3, 2), (1, 4, 3), (1, 0, 5), (1, 5, 4), (0, 2, 5)]
    corners = unfolded(CONE, [*inner, *outer, (0.0, 0.0)], [*fan, *band])
    assert (corners.turn > 0).all()
    assert corners.turn[:2].sum() == pytest.approx(TURN)
    assert corners.turn[2:].sum() == pytest.approx(2 * TURN)


def test_triangles_that_turn_the_other_way_are_told():
    uv, triangles = tube(TURN * np.arange(8) / 8)
    triangles[3] = triangles[3][::-1]
    corners = unfolded(CYLINDER, uv, triangles)
    assert corners.folded(1)[0] == pytest.approx(1 / 16)
