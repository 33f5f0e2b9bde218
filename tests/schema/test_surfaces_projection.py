"""Foot points of 3D points on surfaces."""

import numpy as np
import pyarrow as pa
import pytest

from breplake.errors import UsageError
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.tables import PATCHES


def vec(p):
    return dict(zip("xyz", map(float, p), strict=True))


def patches(*rows):
    return SurfaceSet.from_patches(pa.Table.from_pylist(list(rows), PATCHES.schema))


X, Y, Z = (vec(axis) for axis in np.eye(3))
FRAME = {"location": vec((1, 2, 3)), "x_axis": X, "y_axis": Y, "z_axis": Z}
SPHERE = {"type": "Sphere", "radius": 2.5, **FRAME}
WAVE = [[vec((i, j, np.sin(i + 2 * j))) for j in range(4)] for i in range(3)]
SPLINE = {
    "type": "BSpline",
    "u_degree": 2,
    "v_degree": 3,
    "u_knots": [0.0] * 3 + [1.0] * 3,
    "v_knots": [0.0] * 4 + [1.0] * 4,
    "poles": WAVE,
}
ARCH = {
    "type": "BSpline",
    "degree": 2,
    "knots": [-2.0, -2, -2, 0, 2, 2, 2],
    "poles": [vec(p) for p in ((3, 0, 0), (4, 0, 1), (3, 1, 2), (5, 0, 3))],
    "weights": [1.0, 2.0, 0.5, 1.0],
}
HYPERBOLA = {"type": "Hyperbola", "x_radius": 1.5, "y_radius": 0.5, **FRAME}
ALL = [
    {"type": "Plane", **FRAME},
    {"type": "Cylinder", "radius": 2.5, **FRAME},
    {"type": "Cone", "radius": 2.5, "angle": 0.4, **FRAME},
    SPHERE,
    {"type": "Torus", "max_radius": 7.0, "min_radius": 2.5, **FRAME},
    {"type": "Revolution", "location": vec((0, 0, 0)), "z_axis": Z, "curve": ARCH},
    {"type": "Extrusion", "direction": Y, "curve": ARCH},
    {"type": "Extrusion", "direction": Z, "curve": HYPERBOLA},
    SPLINE,
    SPLINE | {"weights": [[1.0, 0.5, 2, 1], [1, 1, 3, 1], [0.7, 1, 1, 1]]},
]


def test_projection_finds_the_foot_point():
    rng = np.random.default_rng(9)
    rows = np.repeat(np.arange(len(ALL)), 50)
    u, v = rng.uniform(0.2, 0.8, (2, len(rows)))
    these = patches(*ALL)
    jet = these.evaluate(rows, u, v)
    height = rng.uniform(-0.02, 0.02, len(rows))
    points = jet.point + height[:, None] * jet.normal()
    start = u + rng.uniform(-0.05, 0.05, len(rows)), v + rng.uniform(-0.05, 0.05, len(rows))
    pu, pv, residual = these.project(rows, points, *start)
    assert np.abs(residual - np.abs(height)).max() < 1e-13
    assert np.abs(these.evaluate(rows, pu, pv).point - jet.point).max() < 1e-8
    _, _, zero = these.project(rows, jet.point, *start)
    assert zero.max() < 1e-13


def test_projection_is_never_worse_than_its_start():
    rng = np.random.default_rng(10)
    rows = np.repeat(np.arange(len(ALL)), 100)
    these = patches(*ALL)
    u, v = rng.uniform(-1, 1, (2, len(rows)))
    points = rng.normal(size=(len(rows), 3)) * 20
    before = np.linalg.norm(these.evaluate(rows, u, v).point - points, axis=1)
    pu, pv, residual = these.project(rows, points, u, v)
    assert (residual <= before).all()
    after = np.linalg.norm(these.evaluate(rows, pu, pv).point - points, axis=1)
    assert np.allclose(after, residual, rtol=1e-14, atol=0)


def test_projection_stays_inside_bounds():
    these = patches(SPLINE)
    bounds = [0.25, 0.75, 0.0, 1.0]
    target = these.evaluate(0, 0.9, 0.5).point
    u, v, residual = these.project(0, target, 0.5, 0.4, bounds)
    assert u[0] == 0.75
    fine = np.linspace(0, 1, 20001)
    line = np.linalg.norm(these.evaluate(0, 0.75, fine).point - target, axis=1)
    assert abs(residual[0] - line.min()) < 1e-8
    assert abs(v[0] - fine[line.argmin()]) < 1e-4


def test_projection_from_a_pole():
    """du vanishes at the start: the search must go on along v."""
    these = patches(SPHERE)
    target = these.evaluate(0, 0.0, 1.2).point
    _, v, residual = these.project(0, target, 0.0, np.pi / 2)
    assert residual[0] < 1e-14
    assert abs(v[0] - 1.2) < 1e-14


@pytest.mark.parametrize(("shape", "bounds"), [((2, 3), None), ((1, 2), None), ((1, 3), [0, 1])])
def test_wrong_shapes_of_a_projection(shape, bounds):
    with pytest.raises(UsageError, match="must be"):
        patches(SPLINE).project(0, np.zeros(shape), [0.5], [0.5], bounds)
