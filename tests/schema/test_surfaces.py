"""Closed forms, limits and invariants of surfaces; no CAD kernel is needed."""

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from breplake.errors import UsageError
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.tables import PATCHES

AXES = np.eye(3)


def vec(p):
    return dict(zip("xyz", map(float, p), strict=True))


def frame(axes=AXES, origin=(1, 2, 3)):
    names = ("x_axis", "y_axis", "z_axis")
    return {"location": vec(origin)} | {n: vec(a) for n, a in zip(names, axes, strict=True)}


def patches(*rows):
    return SurfaceSet.from_patches(pa.Table.from_pylist(list(rows), PATCHES.schema))


def kinds(axes=AXES, origin=(1, 2, 3)):
    """One surface of each elementary type."""
    at = frame(axes, origin)
    return {
        "Plane": {"type": "Plane", **at},
        "Cylinder": {"type": "Cylinder", "radius": 2.5, **at},
        "Cone": {"type": "Cone", "radius": 2.5, "angle": 0.4, **at},
        "Sphere": {"type": "Sphere", "radius": 2.5, **at},
        "Torus": {"type": "Torus", "max_radius": 7.0, "min_radius": 2.5, **at},
    }


def curvatures(name, v):
    """k_min, k_max towards the outward normal."""
    zero = 0 * v
    return {
        "Plane": (zero, zero),
        "Cylinder": (zero - 1 / 2.5, zero),
        "Cone": (-np.cos(0.4) / (2.5 + v * np.sin(0.4)), zero),
        "Sphere": (zero - 1 / 2.5, zero - 1 / 2.5),
        "Torus": (zero - 1 / 2.5, -np.cos(v) / (7 + 2.5 * np.cos(v))),
    }[name]


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize("name", kinds())
def test_elementary_curvatures(name):
    rng = np.random.default_rng(1)
    u, v = rng.uniform(-3, 3, 4000), rng.uniform(-1.5, 1.5, 4000)
    jet = patches(kinds()[name]).evaluate(0, u, v)
    normal = jet.normal()
    found = jet.curvature(normal)
    k_min, k_max = curvatures(name, v)
    scale = np.maximum(np.abs(k_min), np.abs(k_max)) + 1e-300
    assert (np.abs(found.k_min - k_min) / scale).max() < 1e-12
    assert (np.abs(found.k_max - k_max) / scale).max() < 1e-12
    assert (found.k_min <= found.k_max).all()
    frame_of = np.stack([found.d_min, found.d_max, normal], axis=1)  # (n, 3, 3)
    assert np.abs(frame_of @ frame_of.transpose(0, 2, 1) - np.eye(3)).max() < 1e-14


@pytest.mark.parametrize("name", ["Cylinder", "Cone", "Sphere", "Torus"])
def test_normals_point_outward(name):
    u, v = np.random.default_rng(2).uniform(-1.5, 1.5, (2, 500))
    jet = patches(kinds()[name]).evaluate(0, u, v)
    outward = np.stack([np.cos(u), np.sin(u), 0 * u], axis=1)
    tilt = {"Cylinder": 0 * v, "Cone": 0 * v - 0.4, "Sphere": v, "Torus": v}[name]
    truth = np.cos(tilt)[:, None] * outward + np.sin(tilt)[:, None] * AXES[2]
    assert np.abs(jet.normal() - truth).max() < 1e-14


@pytest.mark.parametrize("name", kinds())
def test_mirrored_axes(name):
    """A left-handed frame mirrors the points; the natural normal turns inward."""
    u, v = np.random.default_rng(3).uniform(-1.4, 1.4, (2, 500))
    mirror = np.diag([1.0, -1.0, 1.0])
    right = patches(kinds(origin=(0, 0, 0))[name]).evaluate(0, u, v)
    left = patches(kinds(mirror, (0, 0, 0))[name]).evaluate(0, u, v)
    assert np.array_equal(left.point, right.point @ mirror)
    assert np.allclose(left.normal(), -right.normal() @ mirror, rtol=0, atol=1e-15)
    k_left, k_right = left.curvature(), right.curvature()
    assert np.allclose(k_left.k_min, -k_right.k_max, rtol=1e-14, atol=0)
    assert np.allclose(k_left.k_max, -k_right.k_min, rtol=1e-14, atol=0)


def test_the_other_side():
    """Against the opposite normal, curvatures and directions swap roles."""
    u, v = np.random.default_rng(4).uniform(-1.4, 1.4, (2, 200))
    row = np.arange(200) % 5
    jet = patches(*kinds().values()).evaluate(row, u, v)
    out, inward = jet.curvature(jet.normal()), jet.curvature(-jet.normal())
    assert np.array_equal(inward.k_min, -out.k_max)
    assert np.array_equal(inward.k_max, -out.k_min)
    apart = out.k_max - out.k_min > 1e-6
    along = np.abs((inward.d_min * out.d_max).sum(axis=1))[apart]
    assert np.abs(along - 1).max() < 1e-12


@pytest.mark.parametrize("v", [np.pi / 2, np.pi / 2 + 1e-15, np.pi / 2 - 1e-12, np.pi / 2 + 1e-10])
@pytest.mark.parametrize("sign", [1, -1])
def test_poles_of_a_sphere(v, sign):
    jet = patches(kinds()["Sphere"]).evaluate(0, np.linspace(0, 6, 7), sign * v)
    assert np.abs(jet.normal() - [0, 0, sign]).max() < 1e-9
    assert np.abs(np.linalg.norm(jet.normal(), axis=1) - 1).max() < 1e-15
    k = jet.curvature()
    assert np.array_equal(k.k_min, np.full(7, -1 / 2.5))
    assert np.array_equal(k.k_max, np.full(7, -1 / 2.5))
    assert np.array_equal(jet.curvature(-jet.normal()).k_min, np.full(7, 1 / 2.5))
    assert np.isnan(k.d_min).all()
    assert np.isnan(k.d_max).all()


def test_apex_of_a_cone():
    for angle in (0.4, -0.4):
        cone = kinds()["Cone"] | {"angle": angle}
        apex = -2.5 / np.sin(angle)
        jet = patches(cone).evaluate(0, [0.0, 1.0, 2.0, 3.0], [apex, apex + 1e-13, apex + 1, 0])
        assert np.isnan(jet.normal()).all(axis=1).tolist() == [True, True, False, False]
        k = jet.curvature()
        for part in (k.k_min, k.k_max, k.d_min[:, 0], k.d_max[:, 0]):
            assert np.isnan(part).tolist() == [True, True, False, False]


def bezier(poles, weights=None):
    n, m = len(poles), len(poles[0])
    knots = [[0.0] * k + [1.0] * k for k in (n, m)]
    return {
        "type": "BSpline",
        "u_degree": n - 1,
        "v_degree": m - 1,
        "u_knots": knots[0],
        "v_knots": knots[1],
        "poles": [[vec(p) for p in line] for line in poles],
        "weights": weights,
    }


def test_collapsed_side_of_a_spline():
    tip = [5.0, 5, 5]
    poles = [[tip, tip, tip], [[0, 0, 0], [1, 0, 0], [2, 0.5, 0]]]
    jet = patches(bezier(poles)).evaluate(0, [0.0, 0.0, 1e-3], [0.2, 0.8, 0.5])
    assert np.isnan(jet.normal()).all(axis=1).tolist() == [True, True, False]
    assert np.isnan(jet.curvature().k_min).tolist() == [True, True, False]


def test_parallel_sides_have_no_normal():
    """At the corner of a square bent to a disc, du and dv are parallel."""
    poles = [[[0, 0, 0], [1, 0, 0]], [[-1, 0, 0], [0, 1, 0]]]
    jet = patches(bezier(poles)).evaluate(0, [0.0, 0.5], [0.0, 0.5])
    assert np.isnan(jet.normal()[:, 2]).tolist() == [True, False]
    assert np.isnan(jet.curvature().k_max).tolist() == [True, False]


ARC = (np.array([[1, 0], [1, 1], [0, 1.0]]), np.array([1, np.sqrt(0.5), 1]))


def rational(profile, weights):
    """A quarter turn of a profile (distance, height) as a rational Bezier patch."""
    round_, round_weights = ARC
    poles = [[[r * c, r * s, z] for r, z in profile] for c, s in round_]
    return bezier(poles, (round_weights[:, None] * weights).tolist())


def test_rational_sphere_and_torus_are_the_analytic_ones():
    arc, weights = ARC
    sphere = rational(3 * arc, weights)
    torus = rational(arc * 2 + [5, 0], weights)
    u, v = np.random.default_rng(5).uniform(0.02, 0.98, (2, 3000))
    both = patches(sphere, torus)
    for row, (big, small) in enumerate([(0, 3), (5, 2)]):
        jet = both.evaluate(row, u, v)
        p = jet.point
        tilt = np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1]) - big)
        turn = np.arctan2(p[:, 1], p[:, 0])
        exact = patches(
            {"type": "Torus", "max_radius": float(big), "min_radius": float(small)}
            | frame(origin=(0, 0, 0))
        ).evaluate(0, turn, tilt)
        assert np.abs(exact.point - p).max() < 1e-14 * 10
        assert np.abs(exact.normal() - jet.normal()).max() < 1e-13
        found, truth = jet.curvature(), exact.curvature()
        assert np.abs(found.k_min - truth.k_min).max() < 1e-11
        assert np.abs(found.k_max - truth.k_max).max() < 1e-11


def turn_of(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def moved(row, turn, shift, scale):
    """Rotate, scale and shift every point, direction and length of a row."""
    if isinstance(row, list):
        return [moved(part, turn, shift, scale) for part in row]
    out = dict(row)
    for key, value in row.items():
        if key in {"location", "poles"}:
            out[key] = place(value, turn, shift, scale)
        elif key == "curve":
            out[key] = moved(value, turn, shift, scale)
        elif isinstance(value, dict):
            out[key] = vec(turn @ [value[c] for c in "xyz"])
        elif key.endswith("radius") or key == "focal":
            out[key] = value * scale
    return out


def place(value, turn, shift, scale):
    if isinstance(value, list):
        return [place(part, turn, shift, scale) for part in value]
    return vec(scale * (turn @ [value[c] for c in "xyz"]) + shift)


CONIC = {"location": vec((4, 0, 1)), "x_axis": vec((1, 0, 0)), "y_axis": vec((0, 0, 1))}
CURVES = (
    {"type": "Line", "location": vec((3, 0, 0)), "direction": vec((0.6, 0, 0.8))},
    {"type": "Circle", "radius": 1.5, **CONIC},
    {"type": "Ellipse", "x_radius": 1.5, "y_radius": 0.5, **CONIC},
    {"type": "Parabola", "focal": 0.7, **CONIC},
    {"type": "Hyperbola", "x_radius": 1.5, "y_radius": 0.5, **CONIC},
    {
        "type": "BSpline",
        "degree": 2,
        "knots": [-2.0, -2, -2, 0, 2, 2, 2],
        "poles": [vec(p) for p in ((3, 0, 0), (4, 0, 1), (3, 1, 2), (5, 0, 3))],
        "weights": [1.0, 2.0, 0.5, 1.0],
    },
)
REVOLVED = [
    {"type": "Revolution", "location": vec((0, 0, 0)), "z_axis": vec((0, 0, 1)), "curve": c}
    for c in CURVES
]
EXTRUDED = [{"type": "Extrusion", "direction": vec((0, 1, 0)), "curve": c} for c in CURVES]
SPLINE = bezier([[[i, j, np.sin(i + 2 * j)] for j in range(4)] for i in range(3)])
SPLINES = [SPLINE, SPLINE | {"weights": [[1.0, 0.5, 2, 1], [1, 1, 3, 1], [0.7, 1, 1, 1]]}]
ALL = [*kinds().values(), *REVOLVED, *EXTRUDED, *SPLINES]


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**31),
    st.sampled_from([1e-3, 0.04, 1.0, 25.4, 1e4]),
    st.tuples(*[st.floats(-100, 100)] * 3),
)
def test_rigid_motion_and_scale(seed, scale, shift):
    turn, shift = turn_of(seed), np.array(shift)
    rng = np.random.default_rng(seed)
    rows, (u, v) = np.repeat(np.arange(len(ALL)), 20), rng.uniform(0.1, 0.9, (2, 20 * len(ALL)))
    home = patches(*ALL).evaluate(rows, u, v)
    away = patches(*moved(ALL, turn, shift, scale)).evaluate(
        rows, u, np.where(np.isin(rows, straight()), v * scale, v)
    )
    if scale == 1.0:
        size = 10 + np.abs(shift).max()
        assert np.abs(away.point - (home.point @ turn.T + shift)).max() < 1e-14 * size
    same_place = np.isin(rows, unscaled())
    mine = same_place | (scale == 1.0)
    expected = scale * home.point @ turn.T + shift
    assert np.abs(away.point - expected)[mine].max() < 1e-13 * (10 * scale + np.abs(shift).max())
    k_home, k_away = home.curvature(), away.curvature()
    assert np.abs(away.normal() - home.normal() @ turn.T)[mine].max() < 1e-10
    for a, b in ((k_away.k_min, k_home.k_min), (k_away.k_max, k_home.k_max)):
        assert np.abs(a * scale - b)[mine].max() < 1e-9 * np.abs(b).max()


def straight():
    """Rows whose v is a length: it scales with the model."""
    return [1, 2]


def unscaled():
    """Rows whose parameters are angles, lengths along `straight` or spline parameters."""
    return [1, 2, 3, 4, 6, 7, 9, 10, *range(len(ALL) - 2, len(ALL))]


@pytest.mark.parametrize("row", range(len(ALL)))
def test_derivatives_against_differences(row):
    surface, h = patches(ALL[row]), 1e-4
    u, v = np.random.default_rng(row).uniform(0.1, 0.9, (2, 100))
    jet = surface.evaluate(0, u, v)
    steps = {
        s: surface.evaluate(0, u + s[0] * h, v + s[1] * h)
        for s in ((1, 0), (-1, 0), (0, 1), (0, -1))
    }
    checks = [
        ("point", (1, 0), jet.du),
        ("point", (0, 1), jet.dv),
        ("du", (1, 0), jet.duu),
        ("du", (0, 1), jet.duv),
        ("dv", (1, 0), jet.duv),
        ("dv", (0, 1), jet.dvv),
    ]
    for part, (a, b), truth in checks:
        found = getattr(steps[a, b], part) - getattr(steps[-a, -b], part)
        assert np.abs(found / (2 * h) - truth).max() < 1e-6 * (1 + np.abs(truth).max())


def test_gauss_bonnet_of_a_torus():
    """The integral of k_min k_max over a closed torus is 0, that of its area 4 pi^2 R r."""
    u, v = np.meshgrid(*[np.arange(64) * 2 * np.pi / 64] * 2)
    jet = patches(kinds()["Torus"]).evaluate(0, u.ravel(), v.ravel())
    cell = np.linalg.norm(np.cross(jet.du, jet.dv), axis=1) * (2 * np.pi / 64) ** 2
    k = jet.curvature()
    assert abs((k.k_min * k.k_max * cell).sum()) < 1e-12
    assert abs(cell.sum() - 4 * np.pi**2 * 7 * 2.5) < 1e-10


def test_unknown_rows_are_nan_and_leave_the_others_alone():
    rows = [
        {"type": "Other"},
        kinds()["Sphere"],
        kinds()["Sphere"] | {"radius": None},
        {"type": "Revolution", "location": vec((0, 0, 0)), "z_axis": vec((0, 0, 1))},
        REVOLVED[0] | {"curve": {"type": "Other"}},
        SPLINE | {"u_knots": [0.0, 1.0]},
        SPLINE | {"poles": [SPLINE["poles"][0], SPLINE["poles"][1][:2], SPLINE["poles"][2]]},
        {"type": None},
        SPLINE,
    ]
    found = patches(*rows)
    assert np.flatnonzero(found.known).tolist() == [1, 8]
    jet = found.evaluate(np.arange(9), 0.5, 0.5)
    assert np.flatnonzero(~np.isnan(jet.point[:, 0])).tolist() == [1, 8]
    assert np.flatnonzero(~np.isnan(jet.curvature().k_min)).tolist() == [1, 8]
    u, v, residual = found.project(np.arange(9), np.zeros((9, 3)), 0.5, 0.5)
    assert np.flatnonzero(~np.isnan(residual)).tolist() == [1, 8]
    assert u[0] == v[0] == 0.5


def test_empty():
    jet = patches(*ALL).evaluate([], [], [])
    assert jet.normal().shape == jet.curvature().d_min.shape == (0, 3)
    none = SurfaceSet.from_patches(PATCHES.schema.empty_table())
    assert none.evaluate([], [], []).curvature().k_min.shape == (0,)


def test_wrong_rows():
    with pytest.raises(UsageError, match="rows lie in"):
        patches(SPLINE).evaluate(1, 0.5, 0.5)
    with pytest.raises(UsageError, match="needs the column 'type'"):
        SurfaceSet.from_patches(pa.table({"radius": [1.0]}))
