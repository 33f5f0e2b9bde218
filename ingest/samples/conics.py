"""Parabolas, hyperbolas, ellipses and what they sweep."""

from math import asinh
from typing import Any

import cadquery as cq
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
from OCP.GC import GC_MakeArcOfHyperbola
from OCP.GeomConvert import GeomConvert
from OCP.gp import gp_Ax2, gp_Dir, gp_Hypr, gp_Parab, gp_Pnt

from .outlines import disc, ring, rod, turned
from .registry import part


def parabola(focal: float, start: float, end: float, z: float = 0.0) -> cq.Edge:
    """Edge of the parabola ``z + x² / (4 focal)`` in the plane y = 0, between two x."""
    axes = gp_Ax2(gp_Pnt(0, 0, z), gp_Dir(0, 1, 0), gp_Dir(0, 0, 1))
    return cq.Edge(BRepBuilderAPI_MakeEdge(gp_Parab(axes, focal), start, end).Edge())


def hyperbola(waist: float, slope: float, start: float, end: float) -> cq.Edge:
    """Edge of the hyperbola ``x² = waist² + (slope z)²`` in the plane y = 0, between two z.

    It is a rational spline of the same shape: the kernel's STEP reader fails on a surface of
    revolution whose meridian is an unbounded hyperbola.
    """
    axes = gp_Ax2(gp_Pnt(0, 0, 0), gp_Dir(0, -1, 0), gp_Dir(1, 0, 0))
    conic = gp_Hypr(axes, waist, waist / slope)
    first, last = asinh(start * slope / waist), asinh(end * slope / waist)
    arc = GC_MakeArcOfHyperbola(conic, first, last, True).Value()
    spline = GeomConvert.CurveToBSplineCurve_s(arc)
    return cq.Edge(BRepBuilderAPI_MakeEdge(spline).Edge())


def bounded(first: cq.Edge, second: cq.Edge) -> cq.Wire:
    """Wire of two edges and the straight lines between their ends."""
    lines = [
        cq.Edge.makeLine(first.endPoint(), second.endPoint()),
        cq.Edge.makeLine(second.startPoint(), first.startPoint()),
    ]
    return cq.Wire.assembleEdges([first, lines[0], second, lines[1]])


def revolved(outline: cq.Wire) -> Any:
    """Solid of revolution about z with an outline in the plane y = 0."""
    axis = cq.Vector(0, 0, 1)
    return cq.Workplane(obj=cq.Solid.revolve(outline, [], 360, cq.Vector(), axis))


@part("trough_parabolic", "Parabolic trough mirror on two ribs: extruded parabolas")
def _trough() -> Any:
    def sheet(low: float, high: float, length: float, y: float) -> Any:
        outline = bounded(parabola(22, -60, 60, low), parabola(22, -60, 60, high))
        face = cq.Face.makeFromWires(outline.translate(cq.Vector(0, y, 0)))
        return cq.Workplane(obj=cq.Solid.extrudeLinear(face, cq.Vector(0, length, 0)))

    ribs = sheet(-7, -1, 5, 20).union(sheet(-7, -1, 5, 115))
    feet = cq.Workplane("XY").box(24, 5, 16).translate((0, 22.5, -12))
    return sheet(-1.5, 0, 140, 0).union(ribs).union(feet).union(feet.translate((0, 95, 0)))


@part("dish_parabolic", "Parabolic dish: a paraboloid with its apex, a rim and a stem")
def _dish() -> Any:
    body = revolved(bounded(parabola(26, 0, 70, 0), parabola(26, 0, 70, -2)))
    height = 70 * 70 / (4 * 26)
    return body.union(ring(74, 69.2, 3, height - 2.5)).union(rod((0, 0, -24), (0, 0, -1), 9))


@part("cooling_tower", "Cooling tower: a shell of revolved hyperbolas on a ring beam")
def _cooling_tower() -> Any:
    body = revolved(bounded(hyperbola(22, 0.45, -70, 25), hyperbola(20, 0.45, -70, 25)))
    return body.union(ring(40.5, 35, 5, -75))


@part("cone_sections", "Cone with apex and flats: parabola, hyperbola and ellipse edges")
def _cone_sections() -> Any:
    cone = turned([(0, 0), (50, 0), (0, 75)])
    flat = cq.Workplane("XY").box(60, 140, 160)
    hyperbolic = flat.translate((62, 0, 0))
    slope = 56.309932474020215  # atan(75 / 50): parallel to a generator
    parabolic = flat.rotate((0, 0, 0), (0, 1, 0), 90 - slope).translate((-58, 0, 0))
    return cone.cut(hyperbolic).cut(parabolic)


@part("plumb_bob", "Plumb bob: a cone whose apex is a vertex, with a drilled neck")
def _plumb_bob() -> Any:
    body = turned([(0, 0), (14, 46), (14, 60), (10, 66), (10, 84), (0, 84)])
    return body.cut(rod((-11, 0, 78), (11, 0, 78), 1.5)).cut(disc(4, 20, 72))


@part("tank_elliptic", "Elliptic tank: shelled ellipse cylinder with a filler neck and saddles")
def _elliptic_tank() -> Any:
    outer = cq.Workplane("XZ").ellipse(40, 26).extrude(120)
    inner = cq.Workplane("XZ", origin=(0, -3, 0)).ellipse(37, 23).extrude(114)
    neck = rod((0, -60, 20), (0, -60, 40), 12)
    saddles = cq.Workplane("XY").box(60, 10, 24).translate((0, -25, -22))
    saddles = saddles.union(saddles.translate((0, -70, 0)))
    body = outer.union(neck).union(saddles).cut(inner)
    return body.cut(rod((0, -60, 10), (0, -60, 41), 9))


@part("gasket_elliptic", "Ring joint gasket of elliptic section: closed in both directions")
def _elliptic_gasket() -> Any:
    return (
        cq.Workplane("XZ", origin=(0, 0, 0))
        .center(40, 0)
        .ellipse(4, 7)
        .revolve(360, (-40, 0, 0), (-40, 1, 0))
    )


@part("cam_elliptic", "Elliptic cam disc with an elliptic groove on a round shaft")
def _elliptic_cam() -> Any:
    body = cq.Workplane("XY").ellipse(34, 22).extrude(12)
    groove = cq.Workplane("XY", origin=(0, 0, 8)).ellipse(28, 16).ellipse(24, 12).extrude(6)
    return body.cut(groove).union(disc(9, 50, -20)).faces("<Z or >Z").edges().chamfer(0.8)


@part("pipe_mitre", "Mitred pipe bend of three segments: their joints are ellipses")
def _mitre() -> Any:
    path = cq.Workplane("XZ").polyline([(0, 0), (0, 45), (32, 77), (77, 77)])
    pipe = cq.Workplane("XY").circle(22).circle(19).sweep(path, transition="right")
    return pipe.union(ring(30, 19, 6))
