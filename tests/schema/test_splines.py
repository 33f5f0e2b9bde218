"""B-spline basis functions and spline curves, against definitions and limits."""

from fractions import Fraction

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from breplake.schema.curves import CurveSet
from breplake.schema.splines import basis_functions
from breplake.schema.tables import CURVES


def cox_de_boor(knots, i, p, t):
    """The textbook's recursion for one function and one parameter; 0/0 counts as 0."""
    if p == 0:
        return float(knots[i] <= t < knots[i + 1])
    total = 0.0
    if knots[i + p] > knots[i]:
        total += (t - knots[i]) / (knots[i + p] - knots[i]) * cox_de_boor(knots, i, p - 1, t)
    if knots[i + p + 1] > knots[i + 1]:
        rest = (knots[i + p + 1] - t) / (knots[i + p + 1] - knots[i + 1])
        total += rest * cox_de_boor(knots, i + 1, p - 1, t)
    return total


def spline(poles, degree, knots, **more):
    return {
        "type": "BSpline",
        "degree": degree,
        "knots": list(map(float, knots)),
        "poles": [dict(zip("xyz", map(float, p), strict=True)) for p in poles],
        **more,
    }


def curves(*rows):
    return CurveSet.from_curves(pa.Table.from_pylist(list(rows), CURVES.schema))


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 9])
def test_basis_is_the_recursion(degree):
    rng = np.random.default_rng(degree)
    knots = np.sort(rng.uniform(0, 10, 3 * degree + 6))
    knots[degree + 2 : degree + 2 + min(2, degree)] = knots[degree + 2]  # a double knot
    for t in rng.uniform(knots[degree], knots[-degree - 1], 20):
        k = int(np.searchsorted(knots, t, side="right")) - 1
        near = [np.array([x]) for x in knots[k - degree + 1 : k + degree + 1]]
        values = basis_functions(near, np.array([t]), degree).values[0]
        truth = [cox_de_boor(knots, k - degree + i, degree, t) for i in range(degree + 1)]
        assert np.allclose(np.ravel(values), truth, rtol=0, atol=1e-14)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 12), st.integers(0, 2**31), st.floats(0, 1))
def test_splines_reproduce_constants_and_straight_lines(degree, seed, share):
    """Poles at the Greville abscissae make the spline t itself; equal poles make a constant."""
    rng = np.random.default_rng(seed)
    knots = np.cumsum(rng.choice([0.0, 1e-3, 1.0, 40.0], 2 * degree))
    knots[degree:] += 0.5  # the span of the points is not empty
    t = np.array([knots[degree - 1] + share * (knots[degree] - knots[degree - 1])])
    basis = basis_functions([np.array([k]) for k in knots], t, degree)
    assert all(value[0] >= 0 for value in basis.values[0])
    constant = basis.sums([np.array([7.0])] * (degree + 1), 3)
    assert abs(constant[0][0] - 7) < 1e-13
    assert not np.any(constant[1:])
    greville = [np.array([np.mean(knots[i : i + degree])]) for i in range(degree + 1)]
    value, slope, bend = (part[0] for part in basis.sums(greville, 2))
    assert abs(value - t[0]) < 1e-13 * knots[-1]
    assert abs(slope - 1) < 1e-12
    shortest = np.diff(knots)[np.diff(knots) > 0].min()
    assert abs(bend) < 1e-13 * degree / shortest * 10


def test_polynomials_are_reproduced():
    """A Bezier curve of degree 3 is its Bernstein polynomial, with its derivatives."""
    poles = np.array([[0, 0, 0], [1, 2, 0], [3, 3, 1], [4, 0, 2.0]])
    t = np.linspace(-0.1, 1.1, 25)[:, None]  # beyond the ends too
    s = 1 - t
    point = s**3 * poles[0] + 3 * s * s * t * poles[1] + 3 * s * t * t * poles[2] + t**3 * poles[3]
    legs = np.diff(poles, axis=0)
    d1 = 3 * (s * s * legs[0] + 2 * s * t * legs[1] + t * t * legs[2])
    bends = np.diff(legs, axis=0)
    d2 = 6 * (s * bends[0] + t * bends[1])
    jet = curves(spline(poles, 3, [0] * 4 + [1] * 4)).evaluate(0, t[:, 0])
    for found, truth in ((jet.point, point), (jet.d1, d1), (jet.d2, d2)):
        assert np.allclose(found, truth, rtol=0, atol=1e-13)


def test_ends_and_interior_knots():
    """The end is its last pole; at a corner the curve belongs to the span on its right."""
    poles = [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    jet = curves(spline(poles, 1, [0, 0, 1, 2, 2])).evaluate(0, [0.0, 1.0, 2.0])
    assert np.array_equal(jet.point, poles)
    assert np.array_equal(jet.d1, [[1, 0, 0], [0, 1, 0], [0, 1, 0]])
    assert np.array_equal(jet.d2, np.zeros((3, 3)))


def exactly(row, t):
    """Evaluate a clamped rational spline by de Boor's algorithm in rational numbers."""
    degree, knots, t = row["degree"], [Fraction(k) for k in row["knots"]], Fraction(t)
    span = max(i for i in range(degree, len(row["poles"])) if knots[i] <= t)
    near = range(span - degree, span + 1)
    weights = [Fraction(row["weights"][i]) for i in near]
    poles = [[Fraction(row["poles"][i][c]) for c in "xyz"] for i in near]
    d = [[*(w * c for c in p), w] for p, w in zip(poles, weights, strict=True)]
    for r in range(1, degree + 1):
        for j in range(degree, r - 1, -1):
            low, high = knots[j + span - degree], knots[j + 1 + span - r]
            share = (t - low) / (high - low)
            d[j] = [(1 - share) * a + share * b for a, b in zip(d[j - 1], d[j], strict=True)]
    return [float(c / d[-1][3]) for c in d[-1][:3]]


@pytest.mark.parametrize("degree", [2, 5, 14, 25])
def test_points_are_right_to_the_last_digits(degree):
    rng = np.random.default_rng(degree)
    count = degree + 4
    knots = [0.0] * degree + [0.0, 0.2, 0.200001, 0.7, 1.0] + [1.0] * degree
    weights = list(rng.uniform(0.1, 5, count))
    row = spline(rng.normal(size=(count, 3)) + 50, degree, knots, weights=weights)
    t = rng.uniform(0, 1, 30)
    truth = [exactly(row, x) for x in t]
    assert np.abs(curves(row).evaluate(0, t).point - truth).max() < 1e-15 * 50


def circle(radius=1.0):
    """A full circle as OCCT writes it: rational, periodic, degree 2, six poles."""
    angles = np.arange(6) * np.pi / 3
    far = radius * np.where(np.arange(6) % 2 == 0, 1.0, 2.0)
    poles = np.stack([far * np.cos(angles), far * np.sin(angles), 0 * far], axis=1)
    third = 2 * np.pi / 3
    knots = [-third, *(third * i for i in (0, 0, 1, 1, 2, 2, 3, 3)), 4 * third]
    return spline(poles, 2, knots, weights=[1.0, 0.5] * 3, periodic=True)


def test_rational_circle():
    jet = curves(circle(7.0)).evaluate(0, np.linspace(-20, 20, 400))
    assert np.abs(np.linalg.norm(jet.point, axis=1) - 7).max() < 1e-14 * 7 * 4
    bend = np.cross(jet.d1, jet.d2)[:, 2] / np.linalg.norm(jet.d1, axis=1) ** 3
    assert np.abs(bend - 1 / 7).max() < 1e-13


def test_periodic_spline_wraps():
    ring = curves(circle())
    t = np.linspace(0.1, 2 * np.pi - 0.1, 30)
    near, far = ring.evaluate(0, t), ring.evaluate(0, t + 6 * np.pi)
    assert np.allclose(near.point, far.point, rtol=0, atol=1e-13)
    assert np.allclose(near.d2, far.d2, rtol=0, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 6), st.booleans())
def test_derivatives_against_differences(seed, degree, rational):
    rng = np.random.default_rng(seed)
    count = degree + 1 + int(rng.integers(0, 5))
    inner = np.sort(rng.uniform(0.1, 0.9, count - degree - 1))
    knots = [0.0] * (degree + 1) + list(inner) + [1.0] * (degree + 1)
    weights = list(rng.uniform(0.5, 2, count)) if rational else None
    curve = curves(spline(rng.normal(size=(count, 3)), degree, knots, weights=weights))
    spans = np.array([0.0, *inner, 1.0])
    t = (spans[1:] + spans[:-1]) / 2  # away from the knots
    h = 1e-4 * np.diff(spans)
    left, jet, right = (curve.evaluate(0, t + s * h) for s in (-1, 0, 1))
    h = h[:, None]
    scale = np.abs(jet.d1).max() + np.abs(jet.d2).max()
    assert np.allclose((right.point - left.point) / (2 * h), jet.d1, rtol=0, atol=1e-5 * scale)
    assert np.allclose((right.d1 - left.d1) / (2 * h), jet.d2, rtol=0, atol=1e-5 * scale)


def test_far_from_the_origin_no_digits_of_the_derivative_are_lost():
    poles = np.random.default_rng(3).normal(size=(6, 3))
    knots = [0] * 4 + [0.3, 0.6] + [1] * 4
    shift = 2.0**23  # poles + shift are rounded, so the differences are compared with those
    far = poles + shift
    t = np.linspace(0, 1, 50)
    here = curves(spline(far - shift, 3, knots)).evaluate(0, t)
    there = curves(spline(far, 3, knots)).evaluate(0, t)
    assert np.abs(here.d2 - there.d2).max() < 1e-12 * np.abs(here.d2).max()


@pytest.mark.parametrize(
    "change",
    [
        {"degree": 0},
        {"degree": None},
        {"knots": [0.0, 0, 1, 1]},
        {"knots": [0.0, 0, 0, 1, 0.5, 2, 2, 2]},
        {"knots": [0.0, 0, 0, 0, 0, 0, 0, 0]},
        {"knots": [0.0, 0, 0, np.nan, 1, 1, 1, 1]},
        {"knots": None},
        {"poles": None},
        {"poles": []},
        {"weights": [1.0]},
        {"weights": [1.0, 1.0, -1.0, 1.0, 1.0]},
    ],
)
def test_broken_splines_are_unknown(change):
    good = spline(np.eye(5, 3), 2, [0, 0, 0, 0.3, 0.6, 1, 1, 1])
    both = curves(good, good | change, good)
    assert both.known.tolist() == [True, False, True]
    jet = both.evaluate([0, 1, 2], 0.5)
    assert np.isnan(jet.point[1]).all()
    assert np.array_equal(jet.point[0], jet.point[2])
