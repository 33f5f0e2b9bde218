"""Offset geometry in the flat tables: base, distance and direction give OCCT's own points."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("OCP")

from OCP import Geom
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.gp import gp_Ax1, gp_Ax2, gp_Ax3, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.TColgp import TColgp_Array2OfPnt
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Face

from breplake.ingest.geometry import curve_row, surface_row, untrimmed

PLACE = gp_Ax3(gp_Pnt(1, -2, 3), gp_Dir(1, 2, 2), gp_Dir(2, 1, -2))
CONIC = gp_Ax2(gp_Pnt(1, -2, 3), gp_Dir(1, 2, 2), gp_Dir(2, 1, -2))


def bezier():
    poles = TColgp_Array2OfPnt(1, 3, 1, 4)
    for i in range(3):
        for j in range(4):
            poles.SetValue(i + 1, j + 1, gp_Pnt(i, j, 0.3 * np.sin(i * j)))
    return Geom.Geom_BezierSurface(poles)


def motions():
    turn, mirror, scale = gp_Trsf(), gp_Trsf(), gp_Trsf()
    turn.SetRotation(gp_Ax1(gp_Pnt(1, 2, 3), gp_Dir(1, 2, -1)), 0.8)
    mirror.SetMirror(gp_Ax2(gp_Pnt(4, 5, 6), gp_Dir(1, 2, 3)))
    scale.SetScale(gp_Pnt(1, 1, 1), 2.5)
    return {"still": gp_Trsf(), "turned": turn, "mirrored": mirror, "scaled": scale}


TRIMMED = Geom.Geom_RectangularTrimmedSurface(bezier(), 0.1, 0.9, 0.1, 0.9)
SURFACES = {
    "Torus": Geom.Geom_OffsetSurface(Geom.Geom_ToroidalSurface(PLACE, 5, 2), 0.5),
    "Cylinder": Geom.Geom_OffsetSurface(Geom.Geom_CylindricalSurface(PLACE, 2), -0.5),
    "BSpline": Geom.Geom_OffsetSurface(bezier(), 0.25),
    "BSpline, trimmed": Geom.Geom_OffsetSurface(TRIMMED, 0.25),
    "BSpline, offset twice": Geom.Geom_OffsetSurface(Geom.Geom_OffsetSurface(bezier(), 0.25), 0.5),
    "Extrusion": Geom.Geom_OffsetSurface(
        Geom.Geom_SurfaceOfLinearExtrusion(Geom.Geom_Ellipse(CONIC, 3, 2), gp_Dir(1, 2, 2)), 0.25
    ),
}


def vector(value):
    return np.array([value.X(), value.Y(), value.Z()])


@pytest.mark.parametrize("motion", motions())
@pytest.mark.parametrize("name", SURFACES)
def test_surfaces(name, motion):
    """Base point plus distance times the unit of du x dv, with the location applied."""
    face = TopoDS_Face()
    BRep_Builder().MakeFace(face, SURFACES[name], TopLoc_Location(), 1e-6)
    placed = TopoDS.Face_s(face.Located(TopLoc_Location(motions()[motion]), False))
    surface = untrimmed(BRep_Tool.Surface_s(placed))
    row = surface_row(surface)
    basis = untrimmed(surface.BasisSurface())
    described = surface_row(basis)
    assert (row["type"], row["basis_type"]) == ("Other", name.split(",")[0])
    flags = {"type", "u_closed", "v_closed", "u_periodic", "v_periodic"}
    assert {k: row[k] for k in described.keys() - flags} == {
        k: described[k] for k in described.keys() - flags
    }
    for u, v in np.random.default_rng(0).uniform(0.2, 0.8, (25, 2)):
        point, du, dv = gp_Pnt(), gp_Vec(), gp_Vec()
        basis.D1(u, v, point, du, dv)
        normal = np.cross(vector(du), vector(dv))
        expected = vector(point) + row["offset"] * normal / np.linalg.norm(normal)
        np.testing.assert_allclose(vector(surface.Value(u, v)), expected, atol=1e-12)
        # and that is the place to which the motion takes the surface, whose v may be a length
        scale = abs(motions()[motion].ScaleFactor()) if name in ("Cylinder", "Extrusion") else 1
        there = vector(SURFACES[name].Value(u, v / scale).Transformed(motions()[motion]))
        np.testing.assert_allclose(expected, there, atol=1e-12)


def test_offsets_add_up():
    assert surface_row(SURFACES["BSpline, offset twice"])["offset"] == 0.75


@pytest.mark.parametrize("motion", motions())
def test_curves(motion):
    """Base point plus distance times the unit of tangent x direction."""
    circle = Geom.Geom_TrimmedCurve(Geom.Geom_Ellipse(CONIC, 3, 2), 0.2, 2)
    still = Geom.Geom_OffsetCurve(circle, 0.5, gp_Dir(0, 1, 3))
    curve = still.Transformed(motions()[motion])
    row = curve_row(curve)
    assert (row["type"], row["basis_type"], row["x_radius"]) == (
        "Other",
        "Ellipse",
        pytest.approx(3 * abs(motions()[motion].ScaleFactor())),
    )
    towards = np.array([row["offset_direction"][axis] for axis in "xyz"])
    for t in np.linspace(0.3, 1.9, 20):
        point, tangent = gp_Pnt(), gp_Vec()
        curve.BasisCurve().D1(t, point, tangent)
        side = np.cross(vector(tangent), towards)
        expected = vector(point) + row["offset"] * side / np.linalg.norm(side)
        np.testing.assert_allclose(vector(curve.Value(t)), expected, atol=1e-12)
        there = vector(still.Value(t).Transformed(motions()[motion]))
        np.testing.assert_allclose(expected, there, atol=1e-12)
