"""Curves and surfaces against Open CASCADE, on random data of every type."""

import numpy as np
import pyarrow as pa
import pytest

from breplake.schema.curves import CurveSet
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.tables import CURVES, PATCHES

pytest.importorskip("OCP")

POINTS = 40


CURVE_NAMES = ("Line", "Circle", "Ellipse", "Parabola", "Hyperbola", "BSpline")
SURFACE_NAMES = ("Plane", "Cylinder", "Cone", "Sphere", "Torus", "BSpline")


@pytest.mark.parametrize("name", CURVE_NAMES)
@pytest.mark.parametrize("seed", range(8))
def test_curve_derivatives(occt, name, seed):
    rng = np.random.default_rng([seed, CURVE_NAMES.index(name)])
    curve = occt.random_curve(rng, name)
    low, high = (
        (curve.FirstParameter(), curve.LastParameter()) if name == "BSpline" else (-2.0, 2.0)
    )
    ts = rng.uniform(low, high, POINTS)
    if name == "BSpline":
        ts = np.concatenate([ts, [low, high], occt.numbers(curve.Knots())])
    curves = CurveSet.from_curves(pa.Table.from_pylist([occt.curve_row(curve)], CURVES.schema))
    assert curves.known.all()
    jet = curves.evaluate(0, ts)
    occt.close((jet.point, jet.d1, jet.d2), occt.curve_truth(curve, ts), 1e-11, 1.0)


@pytest.mark.parametrize("seed", range(60))
def test_many_spline_curves_in_one_query(occt, seed):
    rng = np.random.default_rng([seed, 7])
    curves = [occt.random_spline_curve(rng) for _ in range(20)]
    table = pa.Table.from_pylist([occt.curve_row(c) for c in curves], CURVES.schema)
    these = CurveSet.from_curves(table)
    assert these.known.all()
    rows = rng.integers(0, len(curves), 200)
    ts = np.array(
        [rng.uniform(curves[r].FirstParameter(), curves[r].LastParameter()) for r in rows]
    )
    jet = these.evaluate(rows, ts)
    for r in np.unique(rows):
        mine = rows == r
        truth = occt.curve_truth(curves[r], ts[mine])
        occt.close((jet.point[mine], jet.d1[mine], jet.d2[mine]), truth, 1e-11, 1.0)


@pytest.mark.parametrize("seed", range(20))
def test_parameters_outside_the_knots(occt, seed):
    """Periodic splines wrap; others continue their end spans."""
    rng = np.random.default_rng([seed, 8])
    curve = occt.random_spline_curve(rng)
    low, high = curve.FirstParameter(), curve.LastParameter()
    reach = 2.3 if curve.IsPeriodic() else 0.02
    ts = np.array([low - reach * (high - low), high + reach * (high - low)])
    jet = CurveSet.from_curves(
        pa.Table.from_pylist([occt.curve_row(curve)], CURVES.schema)
    ).evaluate(0, ts)
    occt.close((jet.point, jet.d1, jet.d2), occt.curve_truth(curve, ts), 1e-9, 1.0)


def check_surface(occt, surface, name, rng, tolerance=1e-11):
    if name in {"Torus", "Revolution"}:
        us, vs = rng.uniform(0, 2 * np.pi, POINTS), rng.uniform(0.1, 1.1, POINTS)
    elif name == "BSpline":
        u0, u1, v0, v1 = surface.Bounds()
        us, vs = rng.uniform(u0, u1, POINTS), rng.uniform(v0, v1, POINTS)
        us[:4], vs[:4] = [u0, u1, u0, u1], [v0, v0, v1, v1]
    else:
        us, vs = rng.uniform(-3, 3, POINTS), rng.uniform(-1.5, 1.5, POINTS)
    patches = SurfaceSet.from_patches(
        pa.Table.from_pylist([occt.surface_row(surface, name)], PATCHES.schema)
    )
    assert patches.known.all()
    jet = patches.evaluate(0, us, vs)
    found = (jet.point, jet.du, jet.dv, jet.duu, jet.duv, jet.dvv)
    occt.close(found, occt.surface_truth(surface, us, vs), tolerance, 1.0)
    check_properties(occt, surface, jet, us, vs)


def check_properties(occt, surface, jet, us, vs):
    n, k_min, k_max, d_min, d_max = occt.properties_truth(surface, us, vs)
    normal = jet.normal()
    known = ~np.isnan(normal[:, 0])
    assert known.mean() > 0.9
    assert np.abs(normal - n)[known].max() < 1e-9
    curvature = jet.curvature(normal)
    scale = np.maximum(np.abs(k_min), np.abs(k_max))[known] + 1e-9
    assert (np.abs(curvature.k_min - k_min)[known] / scale).max() < 1e-7
    assert (np.abs(curvature.k_max - k_max)[known] / scale).max() < 1e-7
    apart = (k_max - k_min)[known] / scale > 1e-3  # directions mean little at umbilics
    for found, truth in ((curvature.d_min, d_min), (curvature.d_max, d_max)):
        along = np.abs((found * truth).sum(axis=1))[known][apart]
        assert np.abs(along - 1).max(initial=0) < 1e-9


@pytest.mark.parametrize("name", SURFACE_NAMES)
@pytest.mark.parametrize("seed", range(10))
def test_surface(occt, name, seed):
    rng = np.random.default_rng([seed, 20 + SURFACE_NAMES.index(name)])
    check_surface(occt, occt.random_surface(rng, name), name, rng)


@pytest.mark.parametrize("name", ["Revolution", "Extrusion"])
@pytest.mark.parametrize("basis", CURVE_NAMES)
@pytest.mark.parametrize("seed", range(4))
def test_swept_surface(occt, name, basis, seed):
    rng = np.random.default_rng([seed, 40 + CURVE_NAMES.index(basis)])
    axis, curve = occt.random_axes(rng).Axis(), occt.random_curve(rng, basis)
    if name == "Revolution":
        surface = occt.occ.Geom_SurfaceOfRevolution(curve, axis)
    else:
        surface = occt.occ.Geom_SurfaceOfLinearExtrusion(curve, axis.Direction())
    check_surface(occt, surface, name, rng)


def test_spline_made_periodic_by_occt(occt):
    """SetPeriodic drops poles and knots: what is left must still be the same curve."""
    rng = np.random.default_rng(5)
    count, degree = 9, 3
    poles = occt.occ.TColgp_Array1OfPnt(1, count)
    first = occt.point(rng.normal(size=3))
    for i in range(count):
        last = i in (0, count - 1)
        poles.SetValue(i + 1, first if last else occt.point(rng.normal(size=3)))
    knots, mults = occt.reals(np.linspace(0, 1, 7)), occt.integers([4, 1, 1, 1, 1, 1, 4])
    curve = occt.occ.Geom_BSplineCurve(poles, knots, mults, degree, False)
    ts = np.linspace(0, 1, 50)
    before = occt.curve_truth(curve, ts)
    curve.SetPeriodic()
    assert curve.IsPeriodic()
    curves = CurveSet.from_curves(pa.Table.from_pylist([occt.curve_row(curve)], CURVES.schema))
    jet = curves.evaluate(0, ts)
    occt.close((jet.point, jet.d1, jet.d2), before, 1e-12, 1.0)


def test_all_types_in_one_query(occt):
    """Mixing types and rows gives bit for bit what each row gives alone."""
    rng = np.random.default_rng(6)
    names = [n for n in SURFACE_NAMES for _ in range(5)]
    surfaces = [occt.random_surface(rng, name) for name in names]
    table = pa.Table.from_pylist(
        [occt.surface_row(s, n) for s, n in zip(surfaces, names, strict=True)], PATCHES.schema
    )
    patches = SurfaceSet.from_patches(table)
    rows, u, v = rng.integers(0, len(names), 5000), *rng.uniform(0.1, 0.9, (2, 5000))
    jet = patches.evaluate(rows, u, v)
    for r in range(len(names)):
        mine = rows == r
        alone = SurfaceSet.from_patches(table.slice(r, 1)).evaluate(0, u[mine], v[mine])
        assert np.array_equal(alone.point, jet.point[mine])
        assert np.array_equal(alone.dvv, jet.dvv[mine])
        assert np.array_equal(alone.normal(), jet.normal()[mine], equal_nan=True)
