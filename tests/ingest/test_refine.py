"""Edge splitting on geometry of which everything is known."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("OCP")

from breplake.ingest.mesh import CurveNodes, Mesh, edge_lengths, unique_edges
from breplake.ingest.quality import measure
from breplake.ingest.refine import Periods, refine
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.tables import PATCHES

X, Y, Z = ({"x": float(i == 0), "y": float(i == 1), "z": float(i == 2)} for i in range(3))
ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}


class Tube:
    """A cylinder of radius 2 and height 1, its two rims as curves 0 and 1, seam as curve 2."""

    def __init__(self):
        row = {
            "type": "Cylinder",
            "radius": 2.0,
            "location": ORIGIN,
            "x_axis": X,
            "y_axis": Y,
            "z_axis": Z,
        }
        import pyarrow as pa

        names = list(row)
        fields = [PATCHES.schema.field(name) for name in names]
        self.surfaces = SurfaceSet.from_patches(pa.Table.from_pylist([row], pa.schema(fields)))

    def jet(self, patch_ids, u, v):
        return self.surfaces.evaluate(patch_ids, u, v)

    def curve_points(self, curve_id, t):
        if curve_id == 2:
            return np.column_stack([np.full(len(t), 2.0), np.zeros(len(t)), t])
        return np.column_stack([2 * np.cos(t), 2 * np.sin(t), np.full(len(t), float(curve_id))])


def coarse_tube(n=6):
    turn = np.arange(n) * 2 * np.pi / n
    uv = np.column_stack([np.tile(turn, 2), np.repeat([0.0, 1.0], n)])
    tube = Tube()
    points = tube.jet(np.zeros(2 * n, int), uv[:, 0], uv[:, 1]).point
    lower, upper = np.arange(n), np.arange(n, 2 * n)
    after = np.roll(lower, -1)
    triangles = np.concatenate(
        [
            np.column_stack([lower, after, upper]),
            np.column_stack([after, after + n, upper]),
        ]
    )
    corner = np.full(2 * n, -1)
    corner[[0, n]] = 0, 1
    closed = np.append(turn, 2 * np.pi)
    curves = {
        0: CurveNodes(np.append(lower, 0), closed),
        1: CurveNodes(np.append(upper, n), closed),
        2: CurveNodes(np.array([0, n]), np.array([0.0, 1.0])),
    }
    zeros = np.zeros(2 * n, dtype=np.int64)
    return Mesh(
        np.ascontiguousarray(points),
        triangles,
        np.zeros(len(triangles), dtype=np.int64),
        corner,
        curves,
        zeros,
        np.arange(2 * n),
        uv,
    )


PERIODS = Periods(np.array([[2 * np.pi, np.inf]]), np.array([[-np.inf, np.inf, -np.inf, np.inf]]))


@pytest.mark.parametrize("limit", [1.5, 0.4, 0.07])
def test_every_edge_is_within_the_limit_and_on_the_geometry(limit):
    mesh = refine(coarse_tube(), Tube(), PERIODS, limit, 10**7)
    edges, _, count = unique_edges(mesh.triangles)
    assert edge_lengths(mesh.points, edges).max() <= limit
    radius = np.hypot(mesh.points[:, 0], mesh.points[:, 1])
    np.testing.assert_allclose(radius, 2, atol=1e-12)
    rims = (count == 1).sum()
    assert (count <= 2).all()
    assert rims == sum(len(mesh.curves[i].t) - 1 for i in (0, 1))
    again = Tube().jet(mesh.pair_patch, mesh.uv[:, 0], mesh.uv[:, 1]).point
    np.testing.assert_allclose(again, mesh.points[mesh.pair_vertex], atol=1e-12)


def test_curves_keep_their_order_and_ends():
    mesh = refine(coarse_tube(), Tube(), PERIODS, 0.3, 10**7)
    for curve_id, nodes in mesh.curves.items():
        assert (np.diff(nodes.t) > 0).all()
        np.testing.assert_allclose(
            Tube().curve_points(curve_id, nodes.t), mesh.points[nodes.vertices], atol=1e-12
        )
    assert mesh.curves[0].vertices[0] == mesh.curves[0].vertices[-1] == 0


def test_angles_stay():
    """Rivara: bisecting longest edges never makes an angle less than half the smallest."""
    before = coarse_tube(12)
    after = refine(before, Tube(), PERIODS, 0.05, 10**7)
    first, last = (measure(m.points, m.triangles).min_angle for m in (before, after))
    assert last > 0.45 * first


def test_within_the_limit_nothing_changes():
    mesh = coarse_tube()
    assert refine(mesh, Tube(), PERIODS, 100.0, 10**7) is mesh


def test_most_triangles_is_respected():
    mesh = refine(coarse_tube(), Tube(), PERIODS, 0.01, 500)
    assert len(mesh.triangles) <= 500


def test_geometry_that_disagrees_ends():
    """A curve that lies elsewhere than its patch leaves long edges, not an endless loop."""

    class Astray(Tube):
        def curve_points(self, curve_id, t):
            return super().curve_points(curve_id, t) + np.array([0, 0, 50.0])

    mesh = refine(coarse_tube(), Astray(), PERIODS, 0.2, 10**7)
    edges, _, _ = unique_edges(mesh.triangles)
    assert edge_lengths(mesh.points, edges).max() > 0.2
    assert np.abs(mesh.points[:, 2]).max() < 2
