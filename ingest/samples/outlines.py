"""Plane curves and small solids that several parts share."""

from collections.abc import Iterable, Sequence
from math import acos, atan2, cos, hypot, pi, radians, sin, sqrt, tan
from typing import Any

import cadquery as cq

Point = tuple[float, float]


def polar(radius: float, angle: float) -> Point:
    """Point at a radius and an angle in radians."""
    return radius * cos(angle), radius * sin(angle)


def turned(points: Sequence[Point]) -> Any:
    """Solid of revolution about z with a closed outline of straight lines.

    Parameters
    ----------
    points : sequence of (radius, z)
        Corners of the outline in order.

    Returns
    -------
    cadquery.Workplane
        The solid.
    """
    return cq.Workplane("XZ").polyline(list(points)).close().revolve(360, (0, 0, 0), (0, 1, 0))


def ring(outer: float, inner: float, height: float, z: float = 0.0) -> Any:
    """Tube of two radii about z that stands on the height ``z``."""
    return cq.Workplane(origin=(0, 0, z)).circle(outer).circle(inner).extrude(height)


def disc(radius: float, height: float, z: float = 0.0) -> Any:
    """Cylinder about z that stands on the height ``z``."""
    return cq.Workplane(origin=(0, 0, z)).circle(radius).extrude(height)


def rod(start: Sequence[float], end: Sequence[float], radius: float) -> Any:
    """Cylinder between two points in space."""
    direction = cq.Vector(*end) - cq.Vector(*start)
    solid = cq.Solid.makeCylinder(radius, direction.Length, cq.Vector(*start), direction)
    return cq.Workplane(obj=solid)


def bolt_circle(radius: float, count: int, first: float = 0.0) -> list[Point]:
    """Points evenly spaced on a circle, from the angle ``first`` in degrees."""
    return [polar(radius, radians(first) + 2 * pi * i / count) for i in range(count)]


def compound(models: Iterable[Any]) -> cq.Compound:
    """Compound of models that stay separate solids."""
    return cq.Compound.makeCompound([shape for model in models for shape in model.vals()])


def joined(body: Any, others: Iterable[Any]) -> Any:
    """Union of a body and many others in one step: faster than one by one."""
    return cq.Workplane(obj=body.val().fuse(*_solids(others)).clean())


def without(body: Any, tools: Iterable[Any]) -> Any:
    """Body less many tools in one step: faster than one by one."""
    return cq.Workplane(obj=body.val().cut(*_solids(tools)).clean())


def around(model: Any, count: int, first: float = 0.0) -> list[Any]:
    """Turn copies of a model evenly about z, from the angle ``first`` in degrees."""
    turns = [first + 360 * i / count for i in range(count)]
    return [model.rotate((0, 0, 0), (0, 0, 1), turn) for turn in turns]


def _solids(models: Iterable[Any]) -> list[cq.Shape]:
    return [solid for model in models for solid in model.solids().vals()]


def hexagon(across_flats: float) -> list[Point]:
    """Corners of a regular hexagon."""
    return bolt_circle(across_flats / sqrt(3.0), 6)


def involute_gear(module: float, teeth: int, *, pressure: float = 20.0) -> cq.Wire:
    """Outline of a spur gear with involute flanks.

    Parameters
    ----------
    module : float
        Pitch diameter over number of teeth, mm.
    teeth : int
        Number of teeth.
    pressure : float
        Pressure angle, degrees.

    Returns
    -------
    cadquery.Wire
        Closed outline in the plane z = 0.
    """
    pitch = module * teeth / 2
    base = pitch * cos(radians(pressure))
    tip, root = pitch + module, pitch - 1.25 * module
    half = pi / (2 * teeth) + tan(radians(pressure)) - radians(pressure)
    flank = _involute(base, max(base, root), tip, half)
    edges: list[cq.Edge] = []
    for i in range(teeth):
        edges += _tooth(flank, root, 2 * pi * i / teeth, 2 * pi / teeth)
    return cq.Wire.assembleEdges(edges)


def _involute(base: float, start: float, end: float, half: float, count: int = 7) -> list[Point]:
    """Points of the right flank of the tooth that is centred on the x axis, as (radius, angle)."""
    flank = []
    for i in range(count):
        radius = start + (end - start) * i / (count - 1)
        roll = sqrt(max((radius / base) ** 2 - 1, 0.0))
        flank.append((radius, roll - acos(min(base / radius, 1.0)) - half))
    return flank


def _tooth(flank: list[Point], root: float, turn: float, step: float) -> list[cq.Edge]:
    """Edges of one tooth and of the root that follows it."""
    right = [cq.Vector(*polar(r, turn + a)) for r, a in flank]
    left = [cq.Vector(*polar(r, turn - a)) for r, a in reversed(flank)]
    foot = flank[0][1]
    low = cq.Vector(*polar(root, turn + foot))
    back = cq.Vector(*polar(root, turn - foot))
    following = cq.Vector(*polar(root, turn + step + foot))
    edges = [cq.Edge.makeSpline(right), _arc(right[-1], left[0], turn), cq.Edge.makeSpline(left)]
    if flank[0][0] > root * (1 + 1e-9):
        edges = [cq.Edge.makeLine(low, right[0]), *edges, cq.Edge.makeLine(left[-1], back)]
    return [*edges, _arc(back, following, turn + step / 2)]


def _arc(start: cq.Vector, end: cq.Vector, middle: float) -> cq.Edge:
    """Arc about the origin through the angle ``middle``."""
    radius = hypot(start.x, start.y)
    return cq.Edge.makeThreePointArc(start, cq.Vector(*polar(radius, middle)), end)


def airfoil(chord: float, thickness: float, camber: float, count: int = 12) -> list[Point]:
    """Points around a cambered profile, from the trailing edge over the upper side and back.

    Parameters
    ----------
    chord : float
        Length; the quarter chord lies at the origin and the nose at negative x.
    thickness, camber : float
        Largest thickness and camber as fractions of the chord.
    count : int
        Points a side.

    Returns
    -------
    list of (x, y)
        First and last point are the two corners of a blunt trailing edge.
    """
    upper, lower = [], []
    for i in range(count + 1):
        x = 0.5 * (1 + cos(pi * i / count))
        half = (
            5
            * thickness
            * (0.2969 * sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4)
        )
        mean = 4 * camber * x * (1 - x)
        slope = atan2(4 * camber * (1 - 2 * x), 1)
        upper.append((x - half * sin(slope), mean + half * cos(slope)))
        lower.append((x + half * sin(slope), mean - half * cos(slope)))
    points = [*upper, *reversed(lower[:-1])]
    return [((x - 0.25) * chord, y * chord) for x, y in points]
