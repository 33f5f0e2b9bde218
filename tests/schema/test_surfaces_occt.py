"""Curves and surfaces against Open CASCADE, on random data of every type."""

from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

from breplake.schema.curves import CurveSet
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.tables import CURVES, PATCHES

pytest.importorskip("OCP")

POINTS = 40


@pytest.fixture(scope="module")
def occ():
    """The parts of OCP used here; imported late, because that takes seconds."""
    from OCP import Geom, GeomLProp, TColgp, TColStd, gp

    names = {}
    for module in (Geom, GeomLProp, TColgp, TColStd, gp):
        names |= {k: getattr(module, k) for k in dir(module) if not k.startswith("__")}
    return SimpleNamespace(**names)


def xyz(p):
    return {"x": p.X(), "y": p.Y(), "z": p.Z()}


def numbers(array):
    return [array.Value(i) for i in range(array.Lower(), array.Upper() + 1)]


def point(occ, p):
    return occ.gp_Pnt(*(float(c) for c in p))


def random_axes(occ, rng, mirrored=False):
    """A random frame far from the origin."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    where = point(occ, rng.uniform(-200, 200, 3))
    ax = occ.gp_Ax3(where, occ.gp_Dir(*q[2]), occ.gp_Dir(*q[0]))
    if mirrored:
        ax.YReverse()
    return ax


def frame(ax):
    return {
        "location": xyz(ax.Location()),
        "x_axis": xyz(ax.XDirection()),
        "y_axis": xyz(ax.YDirection()),
        "z_axis": xyz(ax.Direction()),
    }


def random_knots(rng, degree, periodic):
    """Knots, multiplicities and number of poles; clamped, open or periodic."""
    knots = np.cumsum(rng.uniform(0.05, 1.0, rng.integers(2, 7)))
    mults = rng.integers(1, degree + 1, len(knots))
    if periodic:
        mults[-1] = mults[0]
        count = mults[:-1].sum()
        if count <= degree:  # OCCT's own KnotSequence then reads beyond its knots
            return random_knots(rng, degree, periodic)
        return knots, mults, int(count)
    mults[0], mults[-1] = degree + 1, rng.integers(1, degree + 2)
    count = mults.sum() - degree - 1
    if count < degree + 1:
        return random_knots(rng, degree, periodic)
    return knots, mults, int(count)


def filled(array, values):
    for i, value in enumerate(values):
        array.SetValue(i + 1, value)
    return array


def reals(occ, values):
    return filled(occ.TColStd_Array1OfReal(1, len(values)), map(float, values))


def integers(occ, values):
    return filled(occ.TColStd_Array1OfInteger(1, len(values)), map(int, values))


def random_spline_curve(occ, rng):
    degree, periodic, rational = int(rng.integers(1, 9)), rng.random() < 0.4, rng.random() < 0.5
    knots, mults, count = random_knots(rng, degree, periodic)
    poles = occ.TColgp_Array1OfPnt(1, count)
    centre = rng.uniform(-100, 100, 3)
    for i in range(count):
        poles.SetValue(i + 1, point(occ, centre + rng.normal(size=3) * 10))
    weights = reals(occ, rng.uniform(0.3, 3, count) if rational else np.ones(count))
    return occ.Geom_BSplineCurve(
        poles, weights, reals(occ, knots), integers(occ, mults), degree, periodic, True
    )


def curve_row(curve):
    """The columns of CURVE_GEOMETRY for an OCCT curve."""
    name = type(curve).__name__.removeprefix("Geom_")
    if name == "BSplineCurve":
        return {
            "type": "BSpline",
            "degree": curve.Degree(),
            "periodic": curve.IsPeriodic(),
            "rational": curve.IsRational(),
            "knots": numbers(curve.KnotSequence()),
            "poles": [xyz(p) for p in numbers(curve.Poles())],
            "weights": numbers(curve.Weights()) if curve.IsRational() else None,
        }
    if name == "Line":
        line = curve.Lin()
        place = {"location": xyz(line.Location()), "direction": xyz(line.Direction())}
        return {"type": "Line", **place}
    row = frame(curve.Position())
    if name == "Circle":
        return {"type": name, "radius": curve.Radius(), **row}
    if name == "Parabola":
        return {"type": name, "focal": curve.Focal(), **row}
    return {"type": name, "x_radius": curve.MajorRadius(), "y_radius": curve.MinorRadius(), **row}


def random_curve(occ, rng, name):
    if name == "BSpline":
        return random_spline_curve(occ, rng)
    ax = random_axes(occ, rng)
    if name == "Line":
        return occ.Geom_Line(ax.Location(), ax.Direction())
    big, small = np.sort(rng.uniform(1, 50, 2))[::-1]
    sizes = (big, small) if name in {"Ellipse", "Hyperbola"} else (big,)
    return getattr(occ, f"Geom_{name}")(ax.Ax2(), *sizes)


CURVE_NAMES = ("Line", "Circle", "Ellipse", "Parabola", "Hyperbola", "BSpline")
SURFACE_NAMES = ("Plane", "Cylinder", "Cone", "Sphere", "Torus", "BSpline")
OCCT_NAMES = {
    "Plane": "Geom_Plane",
    "Cylinder": "Geom_CylindricalSurface",
    "Cone": "Geom_ConicalSurface",
    "Sphere": "Geom_SphericalSurface",
    "Torus": "Geom_ToroidalSurface",
}


def random_spline_surface(occ, rng, rational):
    degrees = [int(d) for d in rng.integers(1, 6, 2)]
    periodic = [bool(p) for p in rng.random(2) < 0.4]
    (uk, um, nu), (vk, vm, nv) = (
        random_knots(rng, d, p) for d, p in zip(degrees, periodic, strict=True)
    )
    poles = occ.TColgp_Array2OfPnt(1, nu, 1, nv)
    weights = occ.TColStd_Array2OfReal(1, nu, 1, nv)
    centre = rng.uniform(-100, 100, 3)
    for i in range(nu):
        for j in range(nv):
            p = centre + np.array([5.0 * i, 5.0 * j, 0.0]) + rng.normal(size=3)
            poles.SetValue(i + 1, j + 1, point(occ, p))
            weights.SetValue(i + 1, j + 1, float(rng.uniform(0.3, 3)) if rational else 1.0)
    knots = reals(occ, uk), reals(occ, vk), integers(occ, um), integers(occ, vm)
    return occ.Geom_BSplineSurface(poles, weights, *knots, *degrees, *periodic)


def surface_row(surface, name):
    """The geometry columns of PATCHES for an OCCT surface."""
    if name == "BSpline":
        nu, nv = surface.NbUPoles(), surface.NbVPoles()
        rational = surface.IsURational() or surface.IsVRational()
        grid = [[(i, j) for j in range(1, nv + 1)] for i in range(1, nu + 1)]
        weights = [[surface.Weight(*ij) for ij in line] for line in grid]
        return {
            "type": name,
            "u_degree": surface.UDegree(),
            "v_degree": surface.VDegree(),
            "u_periodic": surface.IsUPeriodic(),
            "v_periodic": surface.IsVPeriodic(),
            "u_knots": numbers(surface.UKnotSequence()),
            "v_knots": numbers(surface.VKnotSequence()),
            "poles": [[xyz(surface.Pole(*ij)) for ij in line] for line in grid],
            "weights": weights if rational else None,
        }
    if name == "Revolution":
        axis = surface.Axis()
        place = {"location": xyz(axis.Location()), "z_axis": xyz(axis.Direction())}
        return {"type": name, "curve": curve_row(surface.BasisCurve()), **place}
    if name == "Extrusion":
        along = xyz(surface.Direction())
        return {"type": name, "curve": curve_row(surface.BasisCurve()), "direction": along}
    row = {"type": name, **frame(surface.Position())}
    if name in {"Cylinder", "Sphere"}:
        row["radius"] = surface.Radius()
    if name == "Cone":
        row |= {"radius": surface.RefRadius(), "angle": surface.SemiAngle()}
    if name == "Torus":
        row |= {"max_radius": surface.MajorRadius(), "min_radius": surface.MinorRadius()}
    return row


def random_surface(occ, rng, name):
    if name == "BSpline":
        return random_spline_surface(occ, rng, rng.random() < 0.5)
    ax = random_axes(occ, rng, mirrored=rng.random() < 0.5)
    big, small = np.sort(rng.uniform(1, 50, 2))[::-1]
    sizes = {
        "Plane": (),
        "Cylinder": (big,),
        "Cone": (rng.uniform(-1.4, 1.4), big),
        "Sphere": (big,),
        "Torus": (big + small, small),
    }
    return getattr(occ, OCCT_NAMES[name])(ax, *sizes[name])


def curve_truth(occ, curve, ts):
    """Point and two derivatives by OCCT, ``(3, n, 3)``."""
    out = np.empty((3, len(ts), 3))
    for i, t in enumerate(ts):
        p, d1, d2 = occ.gp_Pnt(), occ.gp_Vec(), occ.gp_Vec()
        curve.D2(float(t), p, d1, d2)
        out[:, i] = [[q.X(), q.Y(), q.Z()] for q in (p, d1, d2)]
    return out


def surface_truth(occ, surface, us, vs):
    """Point, du, dv, duu, duv, dvv by OCCT, ``(6, n, 3)``."""
    out = np.empty((6, len(us), 3))
    for i, (u, v) in enumerate(zip(us, vs, strict=True)):
        p, du, dv, duu, dvv, duv = occ.gp_Pnt(), *(occ.gp_Vec() for _ in range(5))
        surface.D2(float(u), float(v), p, du, dv, duu, dvv, duv)
        out[:, i] = [[q.X(), q.Y(), q.Z()] for q in (p, du, dv, duu, duv, dvv)]
    return out


def properties_truth(occ, surface, us, vs):
    """Normal ``(n, 3)``, k_min, k_max ``(n,)`` and their directions ``(n, 3)`` by OCCT."""
    rows = []
    for u, v in zip(us, vs, strict=True):
        props = occ.GeomLProp_SLProps(surface, float(u), float(v), 2, 1e-12)
        n, d_max, d_min = props.Normal(), occ.gp_Dir(), occ.gp_Dir()
        props.CurvatureDirections(d_max, d_min)
        dirs = [[d.X(), d.Y(), d.Z()] for d in (n, d_min, d_max)]
        rows.append((*dirs, props.MinCurvature(), props.MaxCurvature()))
    n, d_min, d_max, k_min, k_max = zip(*rows, strict=True)
    return [np.array(a) for a in (n, k_min, k_max, d_min, d_max)]


def close(found, truth, tolerance, size):
    """Compare derivative by derivative, each relative to its own greatest value."""
    for order, (a, b) in enumerate(zip(found, truth, strict=True)):
        scale = max(np.abs(b).max(), size if order == 0 else 0.0, 1e-9)
        worst = np.abs(a - b).max() / scale
        assert worst < tolerance, f"derivative {order} is off by {worst}"


@pytest.mark.parametrize("name", CURVE_NAMES)
@pytest.mark.parametrize("seed", range(8))
def test_curve_derivatives(occ, name, seed):
    rng = np.random.default_rng([seed, CURVE_NAMES.index(name)])
    curve = random_curve(occ, rng, name)
    low, high = (
        (curve.FirstParameter(), curve.LastParameter()) if name == "BSpline" else (-2.0, 2.0)
    )
    ts = rng.uniform(low, high, POINTS)
    if name == "BSpline":
        ts = np.concatenate([ts, [low, high], numbers(curve.Knots())])
    curves = CurveSet.from_curves(pa.Table.from_pylist([curve_row(curve)], CURVES.schema))
    assert curves.known.all()
    jet = curves.evaluate(0, ts)
    close((jet.point, jet.d1, jet.d2), curve_truth(occ, curve, ts), 1e-11, 1.0)


@pytest.mark.parametrize("seed", range(60))
def test_many_spline_curves_in_one_query(occ, seed):
    rng = np.random.default_rng([seed, 7])
    curves = [random_spline_curve(occ, rng) for _ in range(20)]
    table = pa.Table.from_pylist([curve_row(c) for c in curves], CURVES.schema)
    these = CurveSet.from_curves(table)
    assert these.known.all()
    rows = rng.integers(0, len(curves), 200)
    ts = np.array(
        [rng.uniform(curves[r].FirstParameter(), curves[r].LastParameter()) for r in rows]
    )
    jet = these.evaluate(rows, ts)
    for r in np.unique(rows):
        mine = rows == r
        truth = curve_truth(occ, curves[r], ts[mine])
        close((jet.point[mine], jet.d1[mine], jet.d2[mine]), truth, 1e-11, 1.0)


@pytest.mark.parametrize("seed", range(20))
def test_parameters_outside_the_knots(occ, seed):
    """Periodic splines wrap; others continue their end spans."""
    rng = np.random.default_rng([seed, 8])
    curve = random_spline_curve(occ, rng)
    low, high = curve.FirstParameter(), curve.LastParameter()
    reach = 2.3 if curve.IsPeriodic() else 0.02
    ts = np.array([low - reach * (high - low), high + reach * (high - low)])
    jet = CurveSet.from_curves(pa.Table.from_pylist([curve_row(curve)], CURVES.schema)).evaluate(
        0, ts
    )
    close((jet.point, jet.d1, jet.d2), curve_truth(occ, curve, ts), 1e-9, 1.0)


def check_surface(occ, surface, name, rng, tolerance=1e-11):
    if name in {"Torus", "Revolution"}:
        us, vs = rng.uniform(0, 2 * np.pi, POINTS), rng.uniform(0.1, 1.1, POINTS)
    elif name == "BSpline":
        u0, u1, v0, v1 = surface.Bounds()
        us, vs = rng.uniform(u0, u1, POINTS), rng.uniform(v0, v1, POINTS)
        us[:4], vs[:4] = [u0, u1, u0, u1], [v0, v0, v1, v1]
    else:
        us, vs = rng.uniform(-3, 3, POINTS), rng.uniform(-1.5, 1.5, POINTS)
    patches = SurfaceSet.from_patches(
        pa.Table.from_pylist([surface_row(surface, name)], PATCHES.schema)
    )
    assert patches.known.all()
    jet = patches.evaluate(0, us, vs)
    found = (jet.point, jet.du, jet.dv, jet.duu, jet.duv, jet.dvv)
    close(found, surface_truth(occ, surface, us, vs), tolerance, 1.0)
    check_properties(occ, surface, jet, us, vs)


def check_properties(occ, surface, jet, us, vs):
    n, k_min, k_max, d_min, d_max = properties_truth(occ, surface, us, vs)
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
def test_surface(occ, name, seed):
    rng = np.random.default_rng([seed, 20 + SURFACE_NAMES.index(name)])
    check_surface(occ, random_surface(occ, rng, name), name, rng)


@pytest.mark.parametrize("name", ["Revolution", "Extrusion"])
@pytest.mark.parametrize("basis", CURVE_NAMES)
@pytest.mark.parametrize("seed", range(4))
def test_swept_surface(occ, name, basis, seed):
    rng = np.random.default_rng([seed, 40 + CURVE_NAMES.index(basis)])
    axis, curve = random_axes(occ, rng).Axis(), random_curve(occ, rng, basis)
    if name == "Revolution":
        surface = occ.Geom_SurfaceOfRevolution(curve, axis)
    else:
        surface = occ.Geom_SurfaceOfLinearExtrusion(curve, axis.Direction())
    check_surface(occ, surface, name, rng)


def test_spline_made_periodic_by_occt(occ):
    """SetPeriodic drops poles and knots: what is left must still be the same curve."""
    rng = np.random.default_rng(5)
    count, degree = 9, 3
    poles = occ.TColgp_Array1OfPnt(1, count)
    first = point(occ, rng.normal(size=3))
    for i in range(count):
        last = i in (0, count - 1)
        poles.SetValue(i + 1, first if last else point(occ, rng.normal(size=3)))
    knots, mults = reals(occ, np.linspace(0, 1, 7)), integers(occ, [4, 1, 1, 1, 1, 1, 4])
    curve = occ.Geom_BSplineCurve(poles, knots, mults, degree, False)
    ts = np.linspace(0, 1, 50)
    before = curve_truth(occ, curve, ts)
    curve.SetPeriodic()
    assert curve.IsPeriodic()
    curves = CurveSet.from_curves(pa.Table.from_pylist([curve_row(curve)], CURVES.schema))
    jet = curves.evaluate(0, ts)
    close((jet.point, jet.d1, jet.d2), before, 1e-12, 1.0)


def test_all_types_in_one_query(occ):
    """Mixing types and rows gives bit for bit what each row gives alone."""
    rng = np.random.default_rng(6)
    names = [n for n in SURFACE_NAMES for _ in range(5)]
    surfaces = [random_surface(occ, rng, name) for name in names]
    table = pa.Table.from_pylist(
        [surface_row(s, n) for s, n in zip(surfaces, names, strict=True)], PATCHES.schema
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
