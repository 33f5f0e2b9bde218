"""Offset surfaces and curves against Open CASCADE, and against what they are made from."""

import numpy as np
import pyarrow as pa
import pytest

from breplake.schema.curves import CurveSet
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.tables import CURVES, PATCHES

pytest.importorskip("OCP")

CURVE_NAMES = ("Line", "Circle", "Ellipse", "Parabola", "Hyperbola", "BSpline")
SURFACE_NAMES = ("Plane", "Cylinder", "Cone", "Sphere", "Torus", "BSpline")
POINTS = 60


def surfaces(*rows):
    return SurfaceSet.from_patches(pa.Table.from_pylist(list(rows), PATCHES.schema))


def smooth_spline(occt, rng, rational):
    """A gently curved spline surface: offsets of OCCT need at least C1."""
    occ = occt.occ
    count, degree = 7, 3
    poles = occ.TColgp_Array2OfPnt(1, count, 1, count)
    weights = occ.TColStd_Array2OfReal(1, count, 1, count)
    centre = rng.uniform(-100, 100, 3)
    for i in range(count):
        for j in range(count):
            p = centre + np.array([5.0 * i, 5.0 * j, 0.0]) + rng.normal(size=3)
            poles.SetValue(i + 1, j + 1, occt.point(p))
            weights.SetValue(i + 1, j + 1, float(rng.uniform(0.7, 1.5)) if rational else 1.0)
    knots = occt.reals(np.linspace(0, 2, 5))
    mults = occt.integers([4, 1, 1, 1, 4])
    both = (knots, knots, mults, mults, degree, degree, False, False)
    return occ.Geom_BSplineSurface(poles, weights, *both)


def parameters(surface, name, rng):
    """Random u and v away from poles, apexes and the ends of splines."""
    if name == "BSpline":
        u0, u1, v0, v1 = surface.Bounds()
        return rng.uniform(u0, u1, POINTS), rng.uniform(v0, v1, POINTS)
    if name == "Cone":  # not through the apex
        return rng.uniform(-3, 3, POINTS), rng.uniform(0.0, 0.5, POINTS)
    if name in {"Revolution", "Extrusion"}:
        return rng.uniform(0.1, 1.1, (2, POINTS))
    return rng.uniform(-3, 3, POINTS), rng.uniform(-1.4, 1.4, POINTS)


def check(occt, basis, name, rng):
    """Derivatives, normals and curvatures of offsets to both sides, far and near."""
    us, vs = parameters(basis, name, rng)
    bend = occt.properties_truth(basis, us, vs)[1:3]
    usual = 1 / max(np.abs(bend).max(), 0.05)  # a radius of curvature
    for distance in (0.3 * usual, -0.3 * usual, 2.5 * usual, -2.5 * usual):
        surface = occt.occ.Geom_OffsetSurface(basis, float(distance))
        ours = surfaces(occt.surface_row(surface, name))
        assert ours.known.all()
        jet = ours.evaluate(0, us, vs)
        found = (jet.point, jet.du, jet.dv, jet.duu, jet.duv, jet.dvv)
        truth = occt.surface_truth(surface, us, vs)
        occt.close(found, truth, 1e-9, 1.0)
        normal, k_min, k_max, *_ = occt.properties_truth(surface, us, vs)
        for points in (ours.points(0, us, vs), ours.points(np.zeros(POINTS, int), us, vs)):
            scale = np.maximum(np.abs(k_min), np.abs(k_max)) + 1e-9
            # close to a focal point the rounding of the basis is magnified
            usual_bend = scale < 100 / usual
            assert usual_bend.mean() > 0.5
            assert np.abs(points.point - truth[0]).max() < 1e-12 * (1 + np.abs(truth[0]).max())
            assert np.abs(points.normal - normal)[usual_bend].max() < 1e-10
            assert (np.abs(points.k_min - k_min) / scale)[usual_bend].max() < 1e-7
            assert (np.abs(points.k_max - k_max) / scale)[usual_bend].max() < 1e-7


@pytest.mark.parametrize("name", SURFACE_NAMES)
@pytest.mark.parametrize("seed", range(4))
def test_offset_surface(occt, name, seed):
    rng = np.random.default_rng([seed, 60 + SURFACE_NAMES.index(name)])
    if name == "BSpline":
        basis = smooth_spline(occt, rng, rational=bool(seed % 2))
    else:
        basis = occt.random_surface(rng, name)
    check(occt, basis, name, rng)


@pytest.mark.parametrize("name", ["Revolution", "Extrusion"])
@pytest.mark.parametrize("curve", ["Line", "Circle", "Ellipse", "Parabola", "Hyperbola"])
def test_offset_of_a_swept_surface(occt, name, curve):
    rng = np.random.default_rng([70, CURVE_NAMES.index(curve)])
    axis, basis_curve = occt.random_axes(rng).Axis(), occt.random_curve(rng, curve)
    if name == "Revolution":
        basis = occt.occ.Geom_SurfaceOfRevolution(basis_curve, axis)
    else:
        basis = occt.occ.Geom_SurfaceOfLinearExtrusion(basis_curve, axis.Direction())
    check(occt, basis, name, rng)


@pytest.mark.parametrize("name", [*CURVE_NAMES])
@pytest.mark.parametrize("seed", range(4))
def test_offset_curve(occt, name, seed):
    rng = np.random.default_rng([seed, 80 + CURVE_NAMES.index(name)])
    basis = smooth_curve(occt, rng) if name == "BSpline" else occt.random_curve(rng, name)
    direction = occt.random_axes(rng).Direction()
    curve = occt.occ.Geom_OffsetCurve(basis, float(rng.uniform(-2, 2)), direction)
    ts = rng.uniform(0.1, 1.9, POINTS)
    curves = CurveSet.from_curves(pa.Table.from_pylist([occt.curve_row(curve)], CURVES.schema))
    assert curves.known.all()
    jet = curves.evaluate(0, ts)
    occt.close((jet.point, jet.d1, jet.d2), occt.curve_truth(curve, ts), 1e-10, 1.0)


def smooth_curve(occt, rng):
    occ, poles = occt.occ, occt.occ.TColgp_Array1OfPnt(1, 7)
    for i in range(7):
        poles.SetValue(i + 1, occt.point(np.array([5.0 * i, 0, 0]) + rng.normal(size=3)))
    knots, mults = occt.reals(np.linspace(0, 2, 5)), occt.integers([4, 1, 1, 1, 4])
    return occ.Geom_BSplineCurve(poles, knots, mults, 3, False)


@pytest.mark.parametrize("name", ["Revolution", "Extrusion"])
def test_a_swept_offset_curve_and_its_offset(occt, name):
    """Two offsets, one in the other: fourth derivatives of the innermost curve are needed."""
    rng = np.random.default_rng(90)
    basis = occt.occ.Geom_OffsetCurve(smooth_curve(occt, rng), 0.7, occt.occ.gp_Dir(0, 0, 1))
    axis = occt.occ.gp_Ax1(occt.occ.gp_Pnt(0, 40, 0), occt.occ.gp_Dir(1, 0, 0))
    if name == "Revolution":
        surface = occt.occ.Geom_SurfaceOfRevolution(basis, axis)
    else:
        surface = occt.occ.Geom_SurfaceOfLinearExtrusion(basis, occt.occ.gp_Dir(0, 0.6, 0.8))
    row = occt.surface_row(surface, name)
    assert row["curve"]["type"] == "Other"
    us, vs = rng.uniform(0.1, 1.9, (2, POINTS))
    jet = surfaces(row).evaluate(0, us, vs)
    found = (jet.point, jet.du, jet.dv, jet.duu, jet.duv, jet.dvv)
    occt.close(found, occt.surface_truth(surface, us, vs), 1e-10, 1.0)
    moved = surfaces(row | {"type": "Other", "basis_type": name, "offset": 1.5})
    away = moved.evaluate(0, us, vs)
    assert np.abs(away.point - (jet.point + 1.5 * jet.normal())).max() < 1e-12
    h = 1e-5
    for part, (du, dv), slope in (
        ("du", (h, 0), "duu"),
        ("dv", (0, h), "dvv"),
        ("du", (0, h), "duv"),
    ):
        right, left = (moved.evaluate(0, us + s * du, vs + s * dv) for s in (1, -1))
        found = (getattr(right, part) - getattr(left, part)) / (2 * h)
        truth = getattr(away, slope)
        assert np.abs(found - truth).max() < 1e-6 * (1 + np.abs(truth).max())


FRAME = {
    "location": {"x": 1.0, "y": 2.0, "z": 3.0},
    "x_axis": {"x": 1.0, "y": 0.0, "z": 0.0},
    "y_axis": {"x": 0.0, "y": 1.0, "z": 0.0},
    "z_axis": {"x": 0.0, "y": 0.0, "z": 1.0},
}


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("name", ["Plane", "Cylinder", "Cone", "Sphere", "Torus"])
def test_elementary_offsets_far_and_near(occt, name, mirrored):
    """Beyond the apex of a cone and past the axis, too, points are where OCCT has them."""
    occ, rng = occt.occ, np.random.default_rng(100)
    axes = occt.random_axes(rng, mirrored)
    sizes = {
        "Plane": [()],
        "Cylinder": [(2.0,)],
        "Cone": [(a, r) for a in (-1.3, -0.4, 0.4, 1.3) for r in (0.0, 2.0, 30.0)],
        "Sphere": [(2.0,)],
        "Torus": [(5.0, 2.0), (2.0, 1.9)],
    }[name]
    types = {"Plane": "Plane", "Cylinder": "CylindricalSurface", "Cone": "ConicalSurface"}
    types |= {"Sphere": "SphericalSurface", "Torus": "ToroidalSurface"}
    for size in sizes:
        basis = getattr(occ, f"Geom_{types[name]}")(axes, *size)
        for distance in (0.5, -0.5, 1.5, -1.5, 3.0, -3.0, 60.0, -60.0):
            surface = occ.Geom_OffsetSurface(basis, distance)
            u, v = rng.uniform(0, 6, 20), rng.uniform(-1.4, 1.4, 20)
            v *= 30 if name == "Cone" else 1
            found = surfaces(occt.surface_row(surface, name)).points(0, u, v).point
            truth = occt.surface_truth(surface, u, v)[0]
            assert np.abs(found - truth).max() < 1e-13 * (1 + np.abs(truth).max())


def test_offset_of_a_cylinder_is_a_cylinder():
    cylinder = {"type": "Cylinder", "radius": 2.0, **FRAME}
    u, v = np.random.default_rng(1).uniform(-3, 3, (2, 500))
    base = surfaces(cylinder).points(0, u, v)
    for distance, radius in ((1.5, 3.5), (-1.5, 0.5)):
        moved = {**cylinder, "type": "Other", "basis_type": "Cylinder", "offset": distance}
        found = surfaces(moved).points(0, u, v)
        assert np.allclose(found.point, base.point + distance * base.normal, rtol=0, atol=1e-14)
        assert np.allclose(found.normal, base.normal, rtol=0, atol=1e-14)
        assert np.allclose(found.k_min, -1 / radius, rtol=1e-14)
        assert not found.k_max.any()


def test_undefined_places_of_offsets_are_flagged():
    cylinder = {"type": "Other", "basis_type": "Cylinder", "radius": 2.0, "offset": -2.0, **FRAME}
    axis = surfaces(cylinder)  # moved onto its axis
    jet, points = axis.evaluate(0, [0.0, 1.0], 0.5), axis.points(0, [0.0, 1.0], 0.5)
    assert np.allclose(jet.point, [1, 2, 3.5], rtol=0, atol=1e-15)
    for flagged in (jet.normal(), jet.curvature().k_max, points.normal, points.k_min):
        assert np.isnan(flagged).all()
    tip = [{"x": 5.0, "y": 5.0, "z": 5.0}] * 2
    side = [{"x": 0.0, "y": 0.0, "z": 0.0}, {"x": 1.0, "y": 0.0, "z": 0.0}]
    collapsed = {
        "type": "Other",
        "basis_type": "BSpline",
        "u_degree": 1,
        "v_degree": 1,
        "u_knots": [0.0, 0, 1, 1],
        "v_knots": [0.0, 0, 1, 1],
        "poles": [tip, side],
        "offset": 1.0,
    }
    tips = surfaces(collapsed).evaluate(0, [0.0, 0.5], 0.5)
    assert np.isnan(tips.point).all(axis=1).tolist() == [True, False]


@pytest.mark.parametrize(
    "change", [{"offset": None}, {"basis_type": None}, {"basis_type": "Other"}, {"radius": None}]
)
def test_incomplete_offsets_are_unknown(change):
    row = {"type": "Other", "basis_type": "Cylinder", "radius": 2.0, "offset": 1.0, **FRAME}
    both = surfaces(row, row | change)
    assert both.known.tolist() == [True, False]
    assert np.isnan(both.points([0, 1], 0.5, 0.5).point).any(axis=1).tolist() == [False, True]


def test_an_offset_curve_without_direction_is_unknown():
    row = {"type": "Other", "basis_type": "Circle", "radius": 2.0, "offset": 1.0, **FRAME}
    assert not CurveSet.from_curves(pa.Table.from_pylist([row], CURVES.schema)).known.any()
