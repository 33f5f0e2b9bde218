"""Splines as a whole against the kernel pole by pole, and back."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("OCP")

from OCP import Geom, Geom2d
from OCP.gp import gp_Pnt, gp_Pnt2d
from OCP.TColgp import TColgp_Array1OfPnt, TColgp_Array1OfPnt2d, TColgp_Array2OfPnt
from OCP.TColStd import TColStd_Array1OfInteger, TColStd_Array1OfReal, TColStd_Array2OfReal

from breplake.ingest.lossless.bulk import make_curve, make_surface, spline_curve, spline_surface

RANDOM = np.random.default_rng(3)


def filled(array, values):
    for i, value in enumerate(values):
        array.SetValue(i + 1, value)
    return array


def reals(values):
    return filled(TColStd_Array1OfReal(1, len(values)), map(float, values))


def integers(values):
    return filled(TColStd_Array1OfInteger(1, len(values)), map(int, values))


def grid(kind, values):
    array = kind(1, len(values), 1, len(values[0]))
    for i, line in enumerate(values):
        for j, value in enumerate(line):
            array.SetValue(i + 1, j + 1, gp_Pnt(*value) if kind is TColgp_Array2OfPnt else value)
    return array


KNOTS = {
    "clamped": ([0.1, 0.35, 1.7], [4, 2, 4], False),
    "periodic": ([0.0, 0.25, 0.3, 1.1], [1, 2, 1, 1], True),
}


def curve(way, rational, size):
    knots, times, periodic = KNOTS[way]
    n = sum(times[:-1]) if periodic else sum(times) - 4
    points, weights = RANDOM.normal(size=(n, size)), RANDOM.uniform(0.5, 2, n)
    if size == 3:
        poles = filled(TColgp_Array1OfPnt(1, n), [gp_Pnt(*p) for p in points])
        kind = Geom.Geom_BSplineCurve
    else:
        poles = filled(TColgp_Array1OfPnt2d(1, n), [gp_Pnt2d(*p) for p in points])
        kind = Geom2d.Geom2d_BSplineCurve
    extra = [reals(weights)] if rational else []
    return kind(poles, *extra, reals(knots), integers(times), 3, periodic)


def coordinates(point):
    return [getattr(point, axis)() for axis in "XYZ"[: 2 if isinstance(point, gp_Pnt2d) else 3]]


@pytest.mark.parametrize("size", [2, 3], ids=["plane", "space"])
@pytest.mark.parametrize("rational", [False, True])
@pytest.mark.parametrize("way", KNOTS)
def test_curves(way, rational, size):
    made = curve(way, rational, size)
    n = made.NbPoles()
    for spline in (spline_curve(made), spline_curve(make_curve(spline_curve(made)))):
        assert spline.degree == 3
        assert spline.periodic == made.IsPeriodic()
        assert spline.poles.tolist() == [coordinates(made.Pole(i + 1)) for i in range(n)]
        assert spline.knots.tolist() == KNOTS[way][0]
        assert spline.times.tolist() == KNOTS[way][1]
        weights = [made.Weight(i + 1) for i in range(n)]
        assert spline.weights is None if not rational else spline.weights.tolist() == weights


@pytest.mark.parametrize("rational", [False, True])
@pytest.mark.parametrize("size", [2, 3])
def test_bezier_curves(size, rational):
    points = RANDOM.normal(size=(5, size))
    if size == 3:
        poles = filled(TColgp_Array1OfPnt(1, 5), [gp_Pnt(*p) for p in points])
        kind = Geom.Geom_BezierCurve
    else:
        poles = filled(TColgp_Array1OfPnt2d(1, 5), [gp_Pnt2d(*p) for p in points])
        kind = Geom2d.Geom2d_BezierCurve
    made = kind(poles, *([reals([1, 2, 3, 1, 1])] if rational else []))
    back = make_curve(spline_curve(made))
    assert type(back) is kind
    spline = spline_curve(back)
    assert (spline.degree, spline.periodic, len(spline.knots)) == (4, False, 0)
    np.testing.assert_array_equal(spline.poles, points)
    assert (spline.weights.tolist() if rational else spline.weights) == (
        [1, 2, 3, 1, 1] if rational else None
    )


@pytest.mark.parametrize("rational", ["no", "u", "both"])
@pytest.mark.parametrize(("u", "v"), [("clamped", "clamped"), ("periodic", "clamped")])
def test_surfaces(u, v, rational):
    (us, um, up), (vs, vm, vp) = KNOTS[u], KNOTS[v]
    n, m = (sum(t[:-1]) if p else sum(t) - 4 for t, p in ((um, up), (vm, vp)))
    points, weights = RANDOM.normal(size=(n, m, 3)), RANDOM.uniform(0.5, 2, (n, m))
    if rational == "u":
        weights = np.repeat(weights[:, :1], m, axis=1)
    extra = [] if rational == "no" else [grid(TColStd_Array2OfReal, weights.tolist())]
    made = Geom.Geom_BSplineSurface(
        grid(TColgp_Array2OfPnt, points.tolist()),
        *extra,
        *(reals(us), reals(vs), integers(um), integers(vm), 3, 3, up, vp),
    )
    first = spline_surface(made)
    for spline in (first, spline_surface(make_surface(first))):
        assert spline.degree == (3, 3)
        assert spline.periodic == (up, vp)
        assert spline.rational == (made.IsURational(), made.IsVRational())
        np.testing.assert_array_equal(spline.poles, points)
        assert [k.tolist() for k in spline.knots] == [us, vs]
        assert [t.tolist() for t in spline.times] == [um, vm]
        if rational == "no":
            assert spline.weights is None
        else:
            np.testing.assert_array_equal(spline.weights, weights)


@pytest.mark.parametrize("rational", [False, True])
def test_bezier_surfaces(rational):
    points, weights = RANDOM.normal(size=(3, 4, 3)), RANDOM.uniform(0.5, 2, (3, 4))
    extra = [grid(TColStd_Array2OfReal, weights.tolist())] if rational else []
    made = Geom.Geom_BezierSurface(grid(TColgp_Array2OfPnt, points.tolist()), *extra)
    back = make_surface(spline_surface(made))
    assert type(back) is Geom.Geom_BezierSurface
    spline = spline_surface(back)
    assert spline.degree == (2, 3)
    assert [len(k) for k in spline.knots] == [0, 0]
    np.testing.assert_array_equal(spline.poles, points)
    if rational:
        np.testing.assert_array_equal(spline.weights, weights)
    else:
        assert spline.weights is None
