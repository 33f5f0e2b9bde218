"""Spline, rational and offset surfaces, and models of surfaces without a solid."""

from math import cos, pi, sin
from typing import Any

import cadquery as cq

from .outlines import disc, ring, rod, turned
from .registry import part


def sheet(height: Any, size: tuple[float, float], counts: tuple[int, int] = (9, 9)) -> cq.Face:
    """Spline face over a rectangle: ``height(s, t)`` with s and t from 0 to 1."""
    nx, ny = counts
    grid = [
        [
            cq.Vector(size[0] * i / (nx - 1), size[1] * j / (ny - 1),
                      height(i / (nx - 1), j / (ny - 1)))
            for j in range(ny)
        ]
        for i in range(nx)
    ]  # fmt: skip
    return cq.Face.makeSplineApprox(grid, tol=1e-3, minDeg=3, maxDeg=3)


@part("panel_offset", "Curved panel of constant thickness: a spline face and its offset")
def _offset_panel() -> Any:
    face = sheet(lambda s, t: 10 * sin(pi * s) * sin(pi * t) + 6 * s * s, (90, 70))
    return cq.Workplane(obj=face.thicken(2.5))


@part("float_ellipsoid", "Ellipsoid float on a rod: rational spline faces")
def _ellipsoid() -> Any:
    ball = cq.Solid.makeSphere(20, cq.Vector(), cq.Vector(0, 0, 1), -90, 90, 360)
    stretch = cq.Matrix([[1.4, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0.8, 0]])
    body = cq.Workplane(obj=ball.transformGeometry(stretch))
    return body.union(rod((0, 10, 0), (0, 60, 0), 3))


@part("nozzle_nurbs", "Rocket nozzle with every face converted to rational splines")
def _nozzle_nurbs() -> Any:
    profile = cq.Workplane("XZ").moveTo(16, 0).lineTo(16, 24).threePointArc((12, 33), (8, 40))
    profile = profile.spline(
        [(14, 60), (24, 90)], tangents=[(0.2, 1), (0.25, 1)], includeCurrent=True
    )
    profile = profile.lineTo(26, 90).spline(
        [(16.4, 60), (10.4, 40)], tangents=[(-0.25, -1), (-0.2, -1)], includeCurrent=True
    )
    profile = profile.threePointArc((14.4, 34), (19, 24)).lineTo(19, 0).close()
    body = profile.revolve(360, (0, 0, 0), (0, 1, 0)).union(ring(26, 16, 5))
    return body.val().toNURBS()


@part("bracket_nurbs", "Block with a bore and fillets, every face a rational spline")
def _bracket_nurbs() -> Any:
    body = cq.Workplane("XY").box(50, 30, 20).edges("|Z").fillet(6).faces(">Z").edges().fillet(3)
    return body.cut(disc(8, 40, -20)).val().toNURBS()


@part("fairing_open", "Open fairing: two spline sheets that share an edge, no solid", is_open=True)
def _fairing() -> Any:
    left = sheet(lambda s, t: 18 * sin(pi * s / 2) * cos(pi * t / 2), (80, 50))
    right = left.mirror("XZ")
    return cq.Shell.makeShell([left, right])


@part("hood_open", "Open hood: half a sphere on a cylinder, a shell without a bottom", is_open=True)
def _hood() -> Any:
    body = disc(30, 40).union(cq.Workplane("XY").sphere(30).translate((0, 0, 40)))
    body = body.cut(rod((0, 0, 20), (40, 0, 20), 8))
    faces = [f for f in body.val().Faces() if f.Area() > 3000]  # not the bore, not the bottom
    return cq.Shell.makeShell(faces)


@part("duct_surface", "Open ruled duct between a circle and an ellipse", is_open=True)
def _duct_surface() -> Any:
    low = cq.Wire.makeCircle(30, cq.Vector(0, 0, 0), cq.Vector(0, 0, 1))
    ellipse = cq.Wire.makeEllipse(
        18, 34, cq.Vector(0, 0, 60), cq.Vector(0, 0, 1), cq.Vector(1, 0, 0)
    )
    return cq.Face.makeRuledSurface(low, ellipse)


@part("sail_trimmed", "Single trimmed spline face with a round hole", is_open=True)
def _sail() -> Any:
    face = sheet(lambda s, t: 12 * sin(pi * s) * (1 - t), (80, 100))
    hole = turned([(0, -40), (12, -40), (12, 40), (0, 40)]).translate((40, 45, 0))
    return face.cut(hole.val())
