"""Types and parameters of the paper's appendix against OCCT's own classes."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("OCP")

from OCP import Geom
from OCP.gp import gp_Ax2, gp_Ax3, gp_Cone, gp_Cylinder, gp_Dir, gp_Pln, gp_Pnt, gp_Sphere

from breplake.ingest.geometry import curve_row, surface_row
from breplake.ingest.lossless.knots import flat_knots

PLACE = gp_Ax3(gp_Pnt(1, -2, 3), gp_Dir(1, 2, 2), gp_Dir(2, 1, -2))
LEFT = gp_Ax3(gp_Pnt(1, -2, 3), gp_Dir(1, 2, 2), gp_Dir(2, 1, -2))
LEFT.YReverse()
CONIC = gp_Ax2(gp_Pnt(1, -2, 3), gp_Dir(1, 2, 2), gp_Dir(2, 1, -2))


def vector(struct):
    return np.array([struct[axis] for axis in "xyz"])


def quadric(c, p):
    x, y, z = p
    return (
        c[0] * x * x
        + c[1] * y * y
        + c[2] * z * z
        + 2 * (c[3] * x * y + c[4] * x * z + c[5] * y * z)
        + 2 * (c[6] * x + c[7] * y + c[8] * z)
        + c[9]
    )


@pytest.mark.parametrize("place", [PLACE, LEFT], ids=["right", "left"])
@pytest.mark.parametrize(
    ("kind", "surface", "primitive"),
    [
        ("Cylinder", lambda a: Geom.Geom_CylindricalSurface(a, 2.5), lambda a: gp_Cylinder(a, 2.5)),
        ("Sphere", lambda a: Geom.Geom_SphericalSurface(a, 2.5), lambda a: gp_Sphere(a, 2.5)),
        ("Cone", lambda a: Geom.Geom_ConicalSurface(a, 0.4, 2.5), lambda a: gp_Cone(a, 0.4, 2.5)),
        ("Cone", lambda a: Geom.Geom_ConicalSurface(a, -0.4, 2.5), lambda a: gp_Cone(a, -0.4, 2.5)),
    ],
    ids=["cylinder", "sphere", "cone", "narrowing-cone"],
)
def test_quadrics(place, kind, surface, primitive):
    made = surface(place)
    row = surface_row(made)
    assert row["type"] == kind
    assert row["radius"] == 2.5
    np.testing.assert_allclose(row["coefficients"], primitive(place).Coefficients(), atol=1e-13)
    for u, v in np.random.default_rng(0).uniform(-1.5, 1.5, (50, 2)):
        point = made.Value(u, v)
        assert quadric(row["coefficients"], (point.X(), point.Y(), point.Z())) == pytest.approx(
            0, abs=1e-12
        )


@pytest.mark.parametrize("place", [PLACE, LEFT], ids=["right", "left"])
def test_plane(place):
    row = surface_row(Geom.Geom_Plane(place))
    assert row["type"] == "Plane"
    np.testing.assert_allclose(row["coefficients"], gp_Pln(place).Coefficients(), atol=1e-14)
    np.testing.assert_allclose(vector(row["location"]), [1, -2, 3])


def test_torus_and_cone_parameters():
    torus = surface_row(Geom.Geom_ToroidalSurface(PLACE, 5.0, 1.5))
    assert (torus["type"], torus["max_radius"], torus["min_radius"]) == ("Torus", 5.0, 1.5)
    assert torus["u_periodic"]
    assert torus["v_periodic"]
    cone = surface_row(Geom.Geom_ConicalSurface(PLACE, 0.3, 2.0))
    apex = vector(cone["location"]) - 2 / math.tan(0.3) * vector(cone["z_axis"])
    np.testing.assert_allclose(vector(cone["apex"]), apex, atol=1e-12)


def test_conics():
    ellipse = curve_row(Geom.Geom_Ellipse(CONIC, 5.0, 3.0))
    assert (ellipse["type"], ellipse["x_radius"], ellipse["y_radius"]) == ("Ellipse", 5.0, 3.0)
    away = 4 * vector(ellipse["x_axis"])
    np.testing.assert_allclose(vector(ellipse["focus1"]), vector(ellipse["location"]) + away)
    np.testing.assert_allclose(vector(ellipse["focus2"]), vector(ellipse["location"]) - away)
    parabola = curve_row(Geom.Geom_Parabola(CONIC, 1.25))
    assert (parabola["type"], parabola["focal"]) == ("Parabola", 1.25)
    hyperbola = curve_row(Geom.Geom_Hyperbola(CONIC, 3.0, 4.0))
    reach = vector(hyperbola["focus1"]) - vector(hyperbola["location"])
    np.testing.assert_allclose(reach, 5 * vector(hyperbola["x_axis"]))
    assert curve_row(Geom.Geom_Circle(CONIC, 2.0))["radius"] == 2.0


def test_swept_surfaces_carry_their_curve():
    circle = Geom.Geom_Circle(CONIC, 2.0)
    extrusion = surface_row(Geom.Geom_SurfaceOfLinearExtrusion(circle, gp_Dir(0, 3, 4)))
    assert (extrusion["type"], extrusion["curve"]["type"]) == ("Extrusion", "Circle")
    np.testing.assert_allclose(vector(extrusion["direction"]), [0, 0.6, 0.8])
    axis = PLACE.Axis()
    revolution = surface_row(Geom.Geom_SurfaceOfRevolution(circle, axis))
    assert (revolution["type"], revolution["curve"]["radius"]) == ("Revolution", 2.0)


def test_trimmed_and_offset():
    line = Geom.Geom_Line(PLACE.Axis())
    trimmed = Geom.Geom_TrimmedCurve(line, 1.0, 2.0)
    assert curve_row(trimmed)["type"] == "Line"
    offset = Geom.Geom_OffsetSurface(Geom.Geom_Plane(PLACE), 1.0)
    assert surface_row(offset)["type"] == "Other"


@pytest.mark.parametrize(
    ("knots", "multiplicities", "degree", "expected"),
    [
        ([0, 1, 2], [3, 1, 3], None, [0, 0, 0, 1, 2, 2, 2]),
        ([0, 1, 2, 3], [1, 1, 1, 1], 2, [-2, -1, 0, 1, 2, 3, 4, 5]),
        ([0, 1, 3], [2, 1, 2], 2, [-2, 0, 0, 1, 3, 3, 4]),
        ([0, 6], [6, 6], 6, [-6, 0, 0, 0, 0, 0, 0, 6, 6, 6, 6, 6, 6, 12]),
    ],
    ids=["clamped", "periodic", "multiple", "as-many-poles-as-degree"],
)
def test_flat_knots(knots, multiplicities, degree, expected):
    assert flat_knots(knots, multiplicities, degree) == expected
