"""Trimmed patches: areas in closed form, what is inside, loops of every kind, uniform points."""

from __future__ import annotations

import numpy as np
import pytest

from breplake.errors import UsageError
from breplake.schema.arclength import CurveLengths
from breplake.schema.curves import CurveSet
from breplake.schema.roots import isolate
from breplake.schema.shape_tables import PCURVES
from breplake.schema.tables import COEDGES, CURVES, PATCHES
from breplake.schema.trimming.patches import TrimmedPatches
from breplake.schema.trimming.sampling import UniformSampler

TAU = 2 * np.pi


def xyz(*p):
    return dict(zip("xyz", map(float, p), strict=True))


def uv(*p):
    return dict(zip("uv", map(float, p), strict=True))


AXES = {"location": xyz(1, 2, 3), "x_axis": xyz(1, 0, 0), "y_axis": xyz(0, 1, 0),
        "z_axis": xyz(0, 0, 1)}  # fmt: skip
NONE = {"u_closed": False, "v_closed": False, "u_periodic": False, "v_periodic": False}
CYLINDER = {"type": "Cylinder", "radius": 2.0, "u_periodic": True}
SPHERE = {"type": "Sphere", "radius": 2.0, "u_periodic": True}
TORUS = {"type": "Torus", "min_radius": 1.0, "max_radius": 3.0, "u_periodic": True,
         "v_periodic": True}  # fmt: skip
CONE = {"type": "Cone", "radius": 2.0, "angle": 0.5, "u_periodic": True}


def line(a, b):
    """A pcurve from a to b, and its range."""
    a, b = np.array(a, float), np.array(b, float)
    length = float(np.linalg.norm(b - a))
    return {"type": "Line", "location": uv(*a), "direction": uv(*(b - a) / length)}, 0.0, length


def circle(u, v, radius, start=0.0):
    row = {"type": "Circle", "location": uv(u, v), "x_axis": uv(1, 0), "y_axis": uv(0, 1),
           "radius": radius}  # fmt: skip
    return row, start, start + TAU


def polygon(*corners):
    return [line(a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]


def box(u0, u1, v0, v1):
    return polygon((u0, v0), (u1, v0), (u1, v1), (u0, v1))


def trimmed(surface, *loops, reverse=(), internal=(), flipped=False, bounds=(0, 1, 0, 1)):
    """One patch; loops are lists of pcurves with ranges, those in `reverse` run backwards."""
    coedges, pcurves = [], []
    for number, loop in enumerate(loops):
        for place, (row, low, high) in enumerate(loop):
            against = (number in reverse) != flipped
            coedges.append(
                {"model_id": 1, "patch_id": 0, "loop": number, "place": place, "curve_id": 0,
                 "reversed": against, "internal": number in internal, "pcurve": len(pcurves),
                 "t_min": low, "t_max": high}
            )  # fmt: skip
            pcurves.append({"model_id": 1, "pcurve_id": len(pcurves)} | row)
        if (number in reverse) != flipped:
            for coedge in coedges[-len(loop) :]:
                coedge["place"] = len(loop) - 1 - coedge["place"]
    sides = dict(zip(("u_min", "u_max", "v_min", "v_max"), map(float, bounds), strict=True))
    patch = {"model_id": 1, "patch_id": 0, "part_id": 0, "reversed": flipped, "area": 0.0,
             "n_loops": len(loops), "tolerance": 1e-7} | NONE | AXES | sides | surface  # fmt: skip
    curve = {"model_id": 1, "curve_id": 0, "type": "Other", "tolerance": 1e-7, "n_patches": 1,
             "kind": "seam", "sharp": False}  # fmt: skip
    return TrimmedPatches.from_tables(
        PATCHES.from_rows([patch]),
        CURVES.from_rows([curve]),
        COEDGES.from_rows(coedges),
        PCURVES.from_rows(pcurves),
    )


PLANE = {"type": "Plane"}
FULL = [
    ("round hole", PLANE, [box(0, 3, 0, 4), [circle(1, 1, 0.5)]], (1,), 12 - np.pi / 4),
    ("disk that starts anywhere", PLANE, [[circle(1, 1, 2, start=1.234)]], (), 4 * np.pi),
    ("cylinder with a seam", CYLINDER, [box(0, TAU, 0, 5)], (), 20 * np.pi),
    ("ellipse on a cylinder", CYLINDER, [[circle(1, 1, 0.5)]], (), np.pi / 2),
    ("sphere with poles", SPHERE, [box(0, TAU, -np.pi / 2, np.pi / 2)], (), 16 * np.pi),
    ("torus with seams", TORUS, [box(0, TAU, 0, TAU)], (), 12 * np.pi**2),
    ("cone to its apex", CONE, [box(0, TAU, -2 / np.sin(0.5), 0)], (), 4 * np.pi / np.sin(0.5)),
]  # fmt: skip


@pytest.mark.parametrize(("surface", "loops", "reverse", "area"), [c[1:] for c in FULL],
                         ids=[c[0] for c in FULL])  # fmt: skip
@pytest.mark.parametrize("flipped", [False, True])
def test_areas_in_closed_form(surface, loops, reverse, area, flipped):
    patch = trimmed(surface, *loops, reverse=reverse, flipped=flipped)
    assert patch.area()[0] == pytest.approx(area, rel=1e-9)
    assert not patch.turned[0]


def test_inside_a_plate_with_a_hole():
    patch = trimmed(PLANE, box(0, 3, 0, 4), [circle(1, 1, 0.5)], reverse=(1,))
    u, v = np.random.default_rng(0).uniform(-1, 5, (2, 20_000))
    wanted = (u > 0) & (u < 3) & (v > 0) & (v < 4) & (np.hypot(u - 1, v - 1) > 0.5)
    np.testing.assert_array_equal(patch.inside(0, u, v), wanted)


def test_heights_of_corners_and_extrema_are_no_trouble():
    patch = trimmed(PLANE, [circle(0, 0, 1)])
    for v in (1.0, -1.0, 0.0, np.nextafter(1, 0)):
        assert not patch.inside(0, [-5.0, 5.0], [v, v]).any()


def test_loops_that_run_backwards_are_turned():
    patch = trimmed(PLANE, box(0, 3, 0, 4), [circle(1, 1, 0.5)], reverse=(0,))
    assert patch.turned[0]
    assert patch.area()[0] == pytest.approx(12 - np.pi / 4, rel=1e-12)


def test_a_gap_is_closed():
    corners = [(0, 0), (2, 0), (2, 2), (0, 2)]
    sides = polygon(*corners)
    row, low, high = sides[1]
    sides[1] = (row, low, high - 1e-3)  # ends early
    patch = trimmed(PLANE, sides)
    v = np.linspace(1.9991, 1.9999, 50)
    assert not patch.inside(0, np.full(50, -1.0), v).any()
    assert patch.inside(0, np.full(50, 1.0), v).all()
    assert patch.area()[0] == pytest.approx(4, rel=1e-12)


def test_a_hole_a_period_beside_its_patch():
    hole = [circle(1 + TAU, 2, 0.5)]
    patch = trimmed(CYLINDER, box(0, TAU, 0, 5), hole, reverse=(1,))
    assert not patch.inside(0, 1.0, 2.0)[0]
    assert patch.area()[0] == pytest.approx(20 * np.pi - np.pi / 2, rel=1e-9)


def test_neighbours_a_period_apart():
    sides = box(0, 1, 0, 5)
    row, low, high = line((1 + TAU, 0), (1 + TAU, 5))
    sides[1] = (row, low, high)
    assert trimmed(CYLINDER, sides).area()[0] == pytest.approx(10, rel=1e-12)


WOUND = [
    ("band of a cylinder", CYLINDER, [line((0, 1), (TAU, 1))], [line((TAU, 4), (0, 4))],
     12 * np.pi),
    ("its loops start apart", CYLINDER, [line((1, 1), (1 + TAU, 1))], [line((9, 4), (9 - TAU, 4))],
     12 * np.pi),
    ("band of a torus", TORUS, [line((0, 0), (TAU, 0))], [line((TAU, np.pi), (0, np.pi))],
     6 * np.pi**2),
    ("cap of a sphere", SPHERE, [line((0, 0.5), (TAU, 0.5))], None,
     8 * np.pi * (1 - np.sin(0.5))),
]  # fmt: skip


@pytest.mark.parametrize(("surface", "first", "second", "area"), [c[1:] for c in WOUND],
                         ids=[c[0] for c in WOUND])  # fmt: skip
def test_loops_around_a_surface_without_a_seam(surface, first, second, area):
    loops = [first] if second is None else [first, second]
    patch = trimmed(surface, *loops, bounds=(0, TAU, 0, 1))
    assert patch.area()[0] == pytest.approx(area, rel=1e-9)
    _, u, v = UniformSampler.of(patch).draw(2000, np.random.default_rng(0))
    assert patch.inside(0, u, v).all()
    assert not patch.inside(0, u, np.full(2000, first[0][0]["location"]["v"] - 0.1)).any()


def test_internal_edges_bound_nothing():
    patch = trimmed(PLANE, box(0, 1, 0, 1), [line((0.2, 0.2), (0.8, 0.8))], internal=(1,))
    assert patch.area()[0] == pytest.approx(1, rel=1e-12)


def test_a_patch_without_loops_has_its_natural_bounds():
    patch = trimmed(SPHERE, bounds=(0, TAU, -np.pi / 2, np.pi / 2))
    assert patch.area()[0] == pytest.approx(16 * np.pi, rel=1e-9)


def test_what_cannot_be_evaluated_is_flagged():
    patch = trimmed(CYLINDER, [({"type": "BSpline"}, 0.0, 1.0)])
    assert not patch.known[0]
    assert np.isnan(patch.area()[0])
    sampler = UniformSampler.of(patch)
    with pytest.raises(UsageError, match="no patch"):
        sampler.draw(1, np.random.default_rng(0))


def saddle(loop):
    grid = [[xyz(u, v, u * v / 4) for v in (-1, 1)] for u in (-1, 1)]
    row = {"type": "BSpline", "u_degree": 1, "v_degree": 1, "poles": grid,
           "u_knots": [-1.0, -1, 1, 1], "v_knots": [-1.0, -1, 1, 1]}  # fmt: skip
    return trimmed(row, loop)


def test_area_of_a_trimmed_spline():
    nodes, weights = np.polynomial.legendre.leggauss(40)
    r = (nodes + 1) / 4  # the density sqrt(1 + r^2 / 16) is round, and so is the loop
    wanted = TAU * np.sum(weights / 4 * r * np.sqrt(1 + r * r / 16))
    assert saddle([circle(0, 0, 0.5)]).area()[0] == pytest.approx(wanted, rel=1e-10)


SAMPLED = {
    "torus": trimmed(TORUS, box(0, TAU, 0, TAU)),
    "sphere": trimmed(SPHERE, box(0, TAU, -np.pi / 2, np.pi / 2)),
    "saddle": saddle([circle(0, 0, 0.9)]),
    "ring": trimmed(PLANE, [circle(0, 0, 1)], [circle(0, 0, 0.99)], reverse=(1,)),
}
CRITICAL = 60.0  # chi-square of 15 degrees of freedom: exceeded once in three million


@pytest.mark.parametrize("name", SAMPLED)
def test_samples_are_uniform_by_area(name):
    patch = SAMPLED[name]
    count, k, fine = 40_000, 4, 250
    _, u, v = UniformSampler.of(patch).draw(count, np.random.default_rng(1))
    assert patch.inside(0, u, v).all()
    u0, u1, v0, v1 = patch.window[:, 0]
    ticks = (np.arange(k * fine) + 0.5) / (k * fine)
    a, b = (g.ravel() for g in np.meshgrid(u0 + ticks * (u1 - u0), v0 + ticks * (v1 - v0),
                                           indexing="ij"))  # fmt: skip
    zero = np.zeros(len(a), dtype=np.int64)
    mass = patch.density.at(zero, a, b) * patch.inside(zero, a, b)
    share = mass.reshape(k, fine, k, fine).sum(axis=(1, 3)).ravel() / mass.sum()
    cell = np.floor((u - u0) / (u1 - u0) * k) * k + np.floor((v - v0) / (v1 - v0) * k)
    found = np.bincount(cell.astype(int), minlength=k * k)
    some = share * count > 5
    assert ((found - share * count)[some] ** 2 / (share * count)[some]).sum() < CRITICAL


def test_samples_depend_on_the_seed_alone():
    sampler = UniformSampler.of(SAMPLED["saddle"])
    many, few, other = (sampler.draw(n, np.random.default_rng(s)) for n, s in
                        ((5000, 3), (700, 3), (700, 4)))  # fmt: skip
    np.testing.assert_array_equal(many[1][:700], few[1])
    assert not np.array_equal(few[1], other[1])


@pytest.mark.parametrize("name", SAMPLED)
def test_no_density_exceeds_its_bound(name):
    cells = UniformSampler.of(SAMPLED[name]).cells
    random = np.random.default_rng(5).random((2, 200, len(cells)))
    u = cells.box[0] + random[0] * (cells.box[1] - cells.box[0])
    v = cells.box[2] + random[1] * (cells.box[3] - cells.box[2])
    row = np.tile(cells.patch, 200)
    found = SAMPLED[name].density.at(row, u.ravel(), v.ravel()).reshape(200, -1)
    assert (found <= cells.bound * (1 + 1e-12)).all()


def test_all_roots_are_isolated():
    count = 50
    wanted = np.sort(np.random.default_rng(2).uniform(-1, 1, (count, 6)), axis=1)

    def function(index, t):
        away = t[:, None] - wanted[index]
        slope = sum(np.delete(away, i, axis=1).prod(axis=1) for i in range(6))
        return away.prod(axis=1), slope

    index, found = isolate(function, np.ones(count), -np.ones(count), np.ones(count))
    np.testing.assert_array_equal(np.bincount(index, minlength=count), 6)
    found = found[np.lexsort([found, index])].reshape(count, 6)
    np.testing.assert_allclose(found, wanted, atol=1e-7)


def test_where_a_function_has_no_value_it_has_no_root():
    """The first is nowhere defined, the second only where it has its root, the third nowhere."""

    def function(index, t):
        slope = np.choose(index, [np.nan, np.where(t < 0, np.nan, 1.0), np.inf])
        return (t - 0.3) * slope, slope

    index, found = isolate(function, np.ones(3), -np.ones(3), np.ones(3))
    np.testing.assert_array_equal(index, [1])
    np.testing.assert_allclose(found, [0.3], atol=1e-15)


def test_points_at_lengths_along_curves():
    frame = AXES | {"model_id": 1, "tolerance": 0.0, "n_patches": 0, "kind": "free"}
    frame["sharp"] = True
    ellipse = {"type": "Ellipse", "x_radius": 3.0, "y_radius": 1.0}
    circle = {"type": "Circle", "radius": 2.0}
    rows = [frame | {"curve_id": 0} | circle, frame | {"curve_id": 1} | ellipse]
    curves = CurveSet.from_curves(CURVES.from_rows(rows))
    lengths = CurveLengths.of(curves, np.arange(2), np.zeros(2), np.array([TAU, TAU]))
    assert lengths.length[0] == pytest.approx(4 * np.pi, rel=1e-12)
    assert lengths.length[1] == pytest.approx(13.364893220555258, rel=1e-12)  # 4 a E(8 / 9)
    curve, t = lengths.at(np.array([np.pi, 4 * np.pi + lengths.length[1] / 4]))
    np.testing.assert_array_equal(curve, [0, 1])
    np.testing.assert_allclose(t, [np.pi / 2, np.pi / 2], rtol=1e-12)
