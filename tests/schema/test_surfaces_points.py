"""``SurfaceSet.points``: the short way to normals and curvatures gives what the long one does."""

import numpy as np
import pytest

from breplake.errors import UsageError


def same(points, jet, limit=1e-9):
    """Compare with normals and curvatures from derivatives; NaN in the same places."""
    normal = jet.normal()
    bend = jet.curvature(normal)
    scale = 1 + np.maximum(np.abs(bend.k_min), np.abs(bend.k_max))
    for found, truth, unit in (
        (points.point, jet.point, 1 + np.abs(jet.point)),
        (points.normal, normal, 1.0),
        (points.k_min, bend.k_min, scale),
        (points.k_max, bend.k_max, scale),
    ):
        assert np.array_equal(np.isnan(found), np.isnan(truth))
        within = 1e-13 if found is points.point else limit
        assert np.nanmax(np.abs(found - truth) / unit, initial=0) < within


@pytest.mark.parametrize("order", ["runs", "shuffled", "short runs"])
def test_every_type_in_any_order(every_surface, order):
    """Long runs of one row are evaluated in another way than single points."""
    surfaces, count = every_surface.set(), len(every_surface.rows)
    rng = np.random.default_rng(1)
    row = np.repeat(rng.permutation(count), {"runs": 300, "shuffled": 300, "short runs": 7}[order])
    if order == "shuffled":
        row = rng.permutation(row)
    u, v = rng.uniform(0.05, 0.95, (2, len(row)))
    same(surfaces.points(row, u, v), surfaces.evaluate(row, u, v))


def test_one_row_for_all_and_one_point(every_surface):
    surfaces = every_surface.set()
    u, v = np.random.default_rng(2).uniform(0.05, 0.95, (2, 500))
    for row in range(len(every_surface.rows)):
        same(surfaces.points(row, u, v), surfaces.evaluate(row, u, v))
        same(surfaces.points([row], u[:1], v[:1]), surfaces.evaluate(row, u[0], v[0]))


def test_many_more_points_than_a_batch(every_surface):
    surfaces, names = every_surface.set(), list(every_surface.rows)
    row = np.repeat([names.index("Torus"), names.index("BSpline"), names.index("Plane")], 20_000)
    u, v = np.random.default_rng(3).uniform(0.05, 0.95, (2, len(row)))
    same(surfaces.points(row, u, v), surfaces.evaluate(row, u, v))


def test_unknown_rows_among_runs(every_surface):
    surfaces = every_surface.set({"type": "Other"})
    unknown = len(every_surface.rows)
    row = np.repeat([0, unknown, 3, unknown], 100)
    u, v = np.random.default_rng(4).uniform(0.05, 0.95, (2, len(row)))
    found = surfaces.points(row, u, v)
    same(found, surfaces.evaluate(row, u, v))
    assert np.isnan(found.point[row == unknown]).all()


@pytest.mark.parametrize("repeat", [1, 100])
def test_poles_and_apexes(every_surface, repeat):
    """Spheres have a normal at their poles; cones have none at the apex, nor toruses that touch."""
    cone = every_surface.rows["Cone"]
    horn = every_surface.rows["Torus"] | {"max_radius": 2.0, "min_radius": 2.0}
    surfaces = every_surface.set(horn)
    names = [*every_surface.rows, "horn"]
    apex = -cone["radius"] / np.sin(cone["angle"])
    for name, v, defined in (
        ("Sphere", np.pi / 2, True),
        ("Sphere", -np.pi / 2 - 1e-12, True),
        ("Cone", apex, False),
        ("Cone", apex + 1e-3, True),
        ("horn", np.pi, False),
        ("horn", np.pi - 1e-3, True),
    ):
        row = np.full(repeat, names.index(name))
        u = np.linspace(0, 6, repeat)
        found = surfaces.points(row, u, np.full(repeat, v))
        same(found, surfaces.evaluate(row, u, v))
        for part in (found.normal[:, 0], found.k_min, found.k_max):
            assert (~np.isnan(part) == defined).all()
        assert not np.isnan(found.point).any()


def test_both_sides_of_an_apex(every_surface):
    """On the far nappe du x dv turns round."""
    cone = every_surface.rows["Cone"]
    v = -cone["radius"] / np.sin(cone["angle"]) + np.repeat([-3.0, 3.0], 100)
    u = np.random.default_rng(5).uniform(0, 6, 200)
    surfaces = every_surface.alone("Cone")
    same(surfaces.points(0, u, v), surfaces.evaluate(0, u, v))


def test_axes_that_are_not_orthonormal_are_taken_as_they_are(every_surface):
    skew = every_surface.rows["Cylinder"] | {"x_axis": {"x": 1.0, "y": 0.01, "z": 0.0}}
    surfaces = every_surface.only(skew)
    u, v = np.random.default_rng(6).uniform(0, 1, (2, 200))
    found = surfaces.points(0, u, v)
    same(found, surfaces.evaluate(0, u, v))
    straight = every_surface.alone("Cylinder").points(0, u, v)
    assert np.abs(found.normal - straight.normal).max() > 1e-3


def test_empty_and_wrong_queries(every_surface):
    surfaces = every_surface.set()
    assert surfaces.points([], [], []).normal.shape == (0, 3)
    assert every_surface.only().points([], [], []).k_min.shape == (0,)
    with pytest.raises(UsageError, match="rows lie in"):
        surfaces.points(len(every_surface.rows), 0.0, 0.0)
    with pytest.raises(UsageError, match="one length"):
        surfaces.points([0, 1], [0.0, 1.0, 2.0], 0.0)
