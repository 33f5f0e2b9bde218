"""Random curves and surfaces of Open CASCADE with their rows, and one row of every type."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

from breplake.schema.surfaces import SurfaceSet
from breplake.schema.tables import PATCHES

CURVE_NAMES = ("Line", "Circle", "Ellipse", "Parabola", "Hyperbola", "BSpline")
OCCT_NAMES = {
    "Plane": "Geom_Plane",
    "Cylinder": "Geom_CylindricalSurface",
    "Cone": "Geom_ConicalSurface",
    "Sphere": "Geom_SphericalSurface",
    "Torus": "Geom_ToroidalSurface",
}


@pytest.fixture(scope="session")
def occ():
    """The parts of OCP used here; imported late, because that takes seconds."""
    pytest.importorskip("OCP")
    from OCP import Geom, Geom2d, GeomLProp, TColgp, TColStd, gp

    names = {}
    for module in (Geom, Geom2d, GeomLProp, TColgp, TColStd, gp):
        names |= {k: getattr(module, k) for k in dir(module) if not k.startswith("__")}
    return SimpleNamespace(**names)


@pytest.fixture(scope="session")
def occt(occ):
    """The helpers below, those that make OCCT's objects bound to `occ`."""
    made = {f.__name__: partial(f, occ) for f in WITH_OCC}
    plain = {f.__name__: f for f in (xyz, numbers, curve_row, surface_row, close)}
    return SimpleNamespace(**made, **plain, occ=occ)


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
    if name == "OffsetCurve":
        basis = curve_row(curve.BasisCurve())
        moved = {"offset": curve.Offset(), "offset_direction": xyz(curve.Direction())}
        return basis | moved | {"type": "Other", "basis_type": basis["type"]}
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
    """The geometry columns of PATCHES for an OCCT surface; `name` is the type, or the basis'."""
    if type(surface).__name__ == "Geom_OffsetSurface":
        basis = surface_row(surface.BasisSurface(), name)
        return basis | {"type": "Other", "basis_type": name, "offset": surface.Offset()}
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
        scale = max(np.abs(b).max(), size if order == 0 else 1e-3)
        worst = np.abs(a - b).max() / scale
        assert worst < tolerance, f"derivative {order} is off by {worst}"


WITH_OCC = (
    point,
    random_axes,
    reals,
    integers,
    random_curve,
    random_spline_curve,
    random_surface,
    curve_truth,
    surface_truth,
    properties_truth,
)


def vec(p):
    return dict(zip("xyz", map(float, p), strict=True))


def one_of_every_surface():
    """Rows of ``patches`` by name: every type, left-handed, offset."""
    at = {"location": vec((1, 2, 3)), "x_axis": vec((0.6, 0.8, 0)), "y_axis": vec((-0.8, 0.6, 0))}
    at |= {"z_axis": vec((0, 0, 1))}
    rows = {
        "Plane": {"type": "Plane", **at},
        "Cylinder": {"type": "Cylinder", "radius": 2.5, **at},
        "Cone": {"type": "Cone", "radius": 2.5, "angle": 0.4, **at},
        "Sphere": {"type": "Sphere", "radius": 2.5, **at},
        "Torus": {"type": "Torus", "max_radius": 7.0, "min_radius": 2.5, **at},
    }
    rows |= {f"left-handed {n}": r | {"y_axis": vec((0.8, -0.6, 0))} for n, r in rows.items()}
    for name, curve in one_of_every_curve().items():
        turned = {"location": vec((0, -9, 0)), "z_axis": vec((0.6, 0, 0.8)), "curve": curve}
        rows[f"Revolution of {name}"] = {"type": "Revolution", **turned}
        moved = {"direction": vec((0.36, 0.48, 0.8)), "curve": curve}
        rows[f"Extrusion of {name}"] = {"type": "Extrusion", **moved}
    knots = {"u_knots": [0.0] * 3 + [1.0] * 3, "v_knots": [0.0] * 4 + [0.5] + [1.0] * 4}
    grid = [[vec((i, j, np.sin(i + 2 * j))) for j in range(5)] for i in range(3)]
    weights = [[1.0, 0.5, 2, 1, 1], [1, 1, 3, 1, 2], [0.7, 1, 1, 1, 1]]
    rows["BSpline"] = {"type": "BSpline", "u_degree": 2, "v_degree": 3, "poles": grid, **knots}
    rows["rational BSpline"] = rows["BSpline"] | {"weights": weights}
    ring = {"v_periodic": True, "v_degree": 2, "v_knots": [float(k) for k in range(-2, 8)]}
    rows["periodic BSpline"] = rows["BSpline"] | ring
    offsets = {
        f"offset {n}": {**r, "type": "Other", "basis_type": r["type"], "offset": 0.02}
        for n, r in rows.items()
        if "offset" not in n
    }
    return rows | offsets


def one_of_every_curve():
    """Rows of ``CURVE_GEOMETRY`` by name."""
    at = {"location": vec((4, 0, 1)), "x_axis": vec((1, 0, 0)), "y_axis": vec((0, 0.6, 0.8))}
    spline = {
        "type": "BSpline",
        "degree": 3,
        "knots": [-2.0, -2, -2, -2, 0, 2, 2, 2, 2],
        "poles": [vec(p) for p in ((3, 0, 0), (4, 0, 1), (3, 1, 2), (5, 0, 3), (6, 1, 3))],
    }
    rows = {
        "Line": {"type": "Line", "location": vec((3, 0, 0)), "direction": vec((0.6, 0, 0.8))},
        "Circle": {"type": "Circle", "radius": 1.5, **at},
        "Ellipse": {"type": "Ellipse", "x_radius": 1.5, "y_radius": 0.5, **at},
        "Parabola": {"type": "Parabola", "focal": 0.7, **at},
        "Hyperbola": {"type": "Hyperbola", "x_radius": 1.5, "y_radius": 0.5, **at},
        "BSpline": spline,
        "rational BSpline": spline | {"weights": [1.0, 2.0, 0.5, 1.0, 1.5]},
    }
    moved = {"offset": 0.2, "offset_direction": vec((0.6, 0.8, 0))}
    offsets = {
        f"offset {n}": {**r, "type": "Other", "basis_type": r["type"], **moved}
        for n, r in rows.items()
        if n in ("Ellipse", "rational BSpline")
    }
    return rows | offsets


class EverySurface:
    """One surface of every type, by name; ``rows`` keep their order in ``set``."""

    def __init__(self):
        self.rows = one_of_every_surface()

    def only(self, *rows):
        return SurfaceSet.from_patches(pa.Table.from_pylist(list(rows), PATCHES.schema))

    def alone(self, name):
        return self.only(self.rows[name])

    def set(self, *more):
        return self.only(*self.rows.values(), *more)


@pytest.fixture(scope="session")
def every_surface():
    return EverySurface()


def pytest_generate_tests(metafunc):
    """Tests that take ``surface_name`` or ``curve_name`` run once for each."""
    for fixture, rows in (
        ("surface_name", one_of_every_surface),
        ("curve_name", one_of_every_curve),
    ):
        if fixture in metafunc.fixturenames:
            metafunc.parametrize(fixture, list(rows()))


@pytest.fixture(scope="session")
def curve_rows():
    return one_of_every_curve()
