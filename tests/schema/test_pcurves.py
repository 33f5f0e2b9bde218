"""Curves in parameter planes: closed forms, nesting, and what cannot be evaluated."""

import numpy as np
import pyarrow as pa
import pytest

from breplake.errors import UsageError
from breplake.schema.pcurves import PcurveSet
from breplake.schema.shape_tables import PCURVES


def uv(p):
    return dict(zip("uv", map(float, p), strict=True))


AT = {"location": uv((1, 2)), "x_axis": uv((0.6, 0.8)), "y_axis": uv((0.8, -0.6))}  # left-handed
LINE = {"type": "Line", "location": uv((1, 2)), "direction": uv((0.6, 0.8))}
CIRCLE = {"type": "Circle", "radius": 2.0, **AT}
ELLIPSE = {"type": "Ellipse", "x_radius": 3.0, "y_radius": 2.0, **AT}
PARABOLA = {"type": "Parabola", "focal": 0.5, **AT}
HYPERBOLA = {"type": "Hyperbola", "x_radius": 3.0, "y_radius": 2.0, **AT}
POLES = ((0, 0), (1, 2), (3, 3), (4, 0))
BEZIER = {"type": "Bezier", "poles": [uv(p) for p in POLES]}
SPLINE = {
    "type": "BSpline",
    "degree": 2,
    "knots": [0.0, 0, 0, 1, 3, 3, 3],
    "poles": [uv(p) for p in POLES],
    "weights": [1.0, 2.0, 0.5, 1.0],
}
MODEL = 2**62 + 1


def pcurves(*rows, model=MODEL):
    """A table of rows whose pcurve_id is their place."""
    full = [{"model_id": model, "pcurve_id": i} | row for i, row in enumerate(rows)]
    return PCURVES.from_rows(full)


def curves(*rows):
    return PcurveSet.from_pcurves(pcurves(*rows))


def test_closed_forms():
    t = np.linspace(-1, 1, 9)
    one, zero = 1 + 0 * t, 0 * t
    ch, sh, c, s = np.cosh(t), np.sinh(t), np.cos(t), np.sin(t)
    planar = {  # coordinates along the two axes, and their derivatives
        "circle": (CIRCLE, [2 * c, 2 * s], [-2 * s, 2 * c], [-2 * c, -2 * s]),
        "ellipse": (ELLIPSE, [3 * c, 2 * s], [-3 * s, 2 * c], [-3 * c, -2 * s]),
        "parabola": (PARABOLA, [t * t / 2, t], [t, one], [one, zero]),
        "hyperbola": (HYPERBOLA, [3 * ch, 2 * sh], [3 * sh, 2 * ch], [3 * ch, 2 * sh]),
    }
    axes = np.array([[0.6, 0.8], [0.8, -0.6]])
    for row, *expected in planar.values():
        jet = curves(row).evaluate(0, t)
        for found, local, origin in zip(
            (jet.point, jet.d1, jet.d2), expected, ([1, 2], 0, 0), strict=True
        ):
            assert np.allclose(found, np.transpose(local) @ axes + origin, rtol=0, atol=2e-15)
    line = curves(LINE).evaluate(0, t)
    assert np.allclose(line.point, [1, 2] + t[:, None] * [0.6, 0.8], rtol=0, atol=1e-15)
    assert not line.d2.any()


def test_a_bezier_curve_needs_no_knots():
    t = np.linspace(-0.1, 1.1, 25)[:, None]
    s, p = 1 - t, np.array(POLES)
    point = s**3 * p[0] + 3 * s * s * t * p[1] + 3 * s * t * t * p[2] + t**3 * p[3]
    among = curves(SPLINE, BEZIER, LINE, BEZIER | {"poles": BEZIER["poles"][:2]})
    assert among.known.all()
    assert np.allclose(among.evaluate(1, t[:, 0]).point, point, rtol=0, atol=1e-13)
    straight = among.evaluate(3, t[:, 0])
    assert np.allclose(straight.point, s * p[0] + t * p[1], rtol=0, atol=1e-14)
    alone = curves(SPLINE).evaluate(0, t[:, 0])
    assert np.array_equal(among.evaluate(0, t[:, 0]).d2, alone.d2)


@pytest.mark.parametrize("row", [LINE, CIRCLE, ELLIPSE, PARABOLA, HYPERBOLA, BEZIER, SPLINE])
def test_offset_curves_run_beside_their_basis(row):
    """To the right of it, at the distance; their derivatives are those of what they draw."""
    t, h = np.linspace(0.1, 0.9, 30), 1e-5
    both = curves(row, {"type": "Offset", "basis": 0, "offset": 0.25})
    basis, offset = both.evaluate(0, t), both.evaluate(1, t)
    right = np.stack([basis.d1[:, 1], -basis.d1[:, 0]], axis=1)
    right /= np.linalg.norm(right, axis=1)[:, None]
    assert np.abs(offset.point - (basis.point + 0.25 * right)).max() < 1e-14
    ahead, behind = both.evaluate(1, t + h), both.evaluate(1, t - h)
    for one, two, truth in (("point", "d1", offset.d1), ("d1", "d2", offset.d2)):
        assert truth is getattr(offset, two)
        found = (getattr(ahead, one) - getattr(behind, one)) / (2 * h)
        assert np.abs(found - truth).max() < 1e-6 * (1 + np.abs(truth).max())


def test_nested_curves_are_resolved_within_their_model():
    """Trimming leaves the parameter alone; offsets on the way add up."""
    rows = (
        {"type": "Trimmed", "basis": 1, "t_min": 0.2, "t_max": 0.4},
        {"type": "Offset", "basis": 2, "offset": 0.5},
        {"type": "Trimmed", "basis": 3},
        {"type": "Offset", "basis": 4, "offset": 0.25},
        CIRCLE,
    )
    other = pcurves(*[CIRCLE | {"radius": 9.0}] * 5, model=MODEL + 1)  # the same ids, another model
    table = pa.concat_tables([other, pcurves(*rows)]).take([9, 0, 1, 2, 3, 4, 8, 7, 6, 5])
    found = PcurveSet.from_pcurves(table)
    assert found.known.all()
    t = np.linspace(-1, 1, 9)
    expected = curves(CIRCLE | {"radius": 1.25}).evaluate(0, t)
    # the axes are left-handed: the right side of the curve is inside
    assert np.allclose(found.evaluate(9, t).point, expected.point, rtol=0, atol=1e-15)
    assert np.allclose(found.evaluate(9, t).d2, expected.d2, rtol=0, atol=1e-14)


def test_curves_that_cannot_be_evaluated():
    rows = (
        {"type": "Trimmed", "basis": 77},
        {"type": "Trimmed", "basis": 2},
        {"type": "Trimmed", "basis": 1},  # the two go round in a circle
        {"type": "Offset", "basis": 8},
        {"type": "Offset", "offset": 1.0},
        {"type": "Circle", **AT},
        {"type": "BSpline", "degree": 2, "knots": [0.0, 1.0]},
        {"type": "Bezier"},
        LINE,
        {"type": "Trimmed", "basis": 9},
    )
    found = curves(*rows)
    assert np.flatnonzero(found.known).tolist() == [8]
    jet = found.evaluate(np.arange(len(rows)), 0.5)
    assert np.flatnonzero(~np.isnan(jet.point).any(axis=1)).tolist() == [8]
    assert found.breaks(0).tolist() == []


def test_breaks_are_the_knots():
    trimmed = {"type": "Trimmed", "basis": 0, "t_min": 0.5, "t_max": 2.0}
    found = curves(SPLINE, BEZIER, CIRCLE, trimmed)
    assert found.breaks(0).tolist() == found.breaks(3).tolist() == [0, 1, 3]
    assert found.breaks(0, 0.5, 1.0).tolist() == [1.0]
    assert found.breaks(1).tolist() == [0, 1]
    assert found.breaks(2).tolist() == []
    with pytest.raises(UsageError, match="rows lie in"):
        found.breaks(4)


def test_breaks_of_a_periodic_spline_come_again():
    ring = SPLINE | {"periodic": True, "weights": None, "degree": 1}
    ring |= {"knots": [-1.0, 0, 1, 3, 4], "poles": [uv(p) for p in POLES[:2]]}
    ring = curves(ring)
    assert ring.breaks(0).tolist() == [0.0, 1.0, 3.0]
    assert ring.breaks(0, -3.5, 4.0).tolist() == [-3.0, -2.0, 0.0, 1.0, 3.0, 4.0]


def test_empty():
    none = PcurveSet.from_pcurves(PCURVES.empty())
    assert none.evaluate([], []).d2.shape == (0, 2)


def spline_by_occt(rng, rational, periodic):
    """A random plane spline of OCCT, and its row."""
    from OCP.Geom2d import Geom2d_BSplineCurve
    from OCP.gp import gp_Pnt2d
    from OCP.TColgp import TColgp_Array1OfPnt2d
    from OCP.TColStd import TColStd_Array1OfInteger, TColStd_Array1OfReal

    degree, count = 3, 8
    poles, weights = TColgp_Array1OfPnt2d(1, count), TColStd_Array1OfReal(1, count)
    for i, p in enumerate(rng.normal(size=(count, 2)) + 40):
        poles.SetValue(i + 1, gp_Pnt2d(*map(float, p)))
        weights.SetValue(i + 1, float(rng.uniform(0.5, 2)) if rational else 1.0)
    n = count + 1 if periodic else count - degree + 1
    knots, mults = TColStd_Array1OfReal(1, n), TColStd_Array1OfInteger(1, n)
    for i, knot in enumerate(np.cumsum(rng.uniform(0.1, 1, n))):
        knots.SetValue(i + 1, float(knot))
        mults.SetValue(i + 1, degree + 1 if not periodic and i in (0, n - 1) else 1)
    curve = Geom2d_BSplineCurve(poles, weights, knots, mults, degree, periodic)
    sequence = curve.KnotSequence()
    row = {
        "type": "BSpline",
        "degree": degree,
        "periodic": periodic,
        "knots": [sequence.Value(i) for i in range(sequence.Lower(), sequence.Upper() + 1)],
        "poles": [uv((curve.Pole(i).X(), curve.Pole(i).Y())) for i in range(1, count + 1)],
        "weights": [curve.Weight(i) for i in range(1, count + 1)] if rational else None,
    }
    return curve, row


@pytest.mark.parametrize("rational", [False, True])
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_splines_and_their_offsets_against_occt(rational, periodic, seed):
    pytest.importorskip("OCP")
    from OCP.Geom2d import Geom2d_OffsetCurve
    from OCP.gp import gp_Pnt2d, gp_Vec2d

    rng = np.random.default_rng([seed, 110])
    curve, row = spline_by_occt(rng, rational, periodic)
    both = curves(row, {"type": "Offset", "basis": 0, "offset": 0.01})
    low, high = curve.FirstParameter(), curve.LastParameter()
    turn = 1.7 * (high - low) if periodic else 0.0
    for i, theirs in enumerate((curve, Geom2d_OffsetCurve(curve, 0.01))):
        t = rng.uniform(low - turn, high + turn, 60)
        jet = both.evaluate(i, t)
        truth = np.empty((3, len(t), 2))
        for k, x in enumerate(t):
            parts = gp_Pnt2d(), gp_Vec2d(), gp_Vec2d()
            theirs.D2(float(x), *parts)
            truth[:, k] = [[p.X(), p.Y()] for p in parts]
        for found, expected in zip((jet.point, jet.d1, jet.d2), truth, strict=True):
            assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
