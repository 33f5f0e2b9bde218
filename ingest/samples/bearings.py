"""Bearings: rings and rolling bodies as separate solids."""

from math import atan, degrees
from typing import Any

import cadquery as cq

from .outlines import bolt_circle, compound, disc, ring, rod, turned
from .registry import part

STEEL = cq.Color(0.72, 0.74, 0.77)
DARK = cq.Color(0.30, 0.32, 0.36)
BRASS = cq.Color(0.80, 0.62, 0.25)


@part("bearing_ball", "Deep groove ball bearing: two rings and nine balls, with colours")
def _ball_bearing() -> Any:
    groove = cq.Workplane(obj=cq.Solid.makeTorus(17, 4.1))
    outer = ring(23.5, 19, 14, -7).edges().chamfer(0.6).cut(groove)
    inner = ring(15, 10, 14, -7).edges().chamfer(0.6).cut(groove)
    ball = cq.Workplane("XY").sphere(3.95)
    assembly = cq.Assembly(name="bearing_ball")
    assembly.add(outer, name="outer_ring", color=STEEL)
    assembly.add(inner, name="inner_ring", color=STEEL)
    for i, (x, y) in enumerate(bolt_circle(17, 9)):
        assembly.add(ball, name=f"ball.{i + 1}", loc=cq.Location((x, y, 0)), color=DARK)
    return assembly


@part("bearing_taper", "Tapered roller bearing: cup, cone and twelve conical rollers")
def _taper_bearing() -> Any:
    cup = turned([(26, 0), (32, 0), (32, 14), (29.5, 14)])
    cone = turned([(14, -2), (23.4, -2), (23.4, 0), (19.5, 0), (22.6, 14), (22.6, 16), (14, 16)])
    inner = atan(3.1 / 14)
    mid = (degrees(inner) + degrees(atan(3.5 / 14))) / 2
    roller = turned([(0, -6), (2.75, -6), (3.0, 6), (0, 6)])
    roller = roller.rotate((0, 0, 0), (0, 1, 0), mid).translate((24.45, 0, 7))
    assembly = cq.Assembly(name="bearing_taper").add(cup, name="cup", color=STEEL)
    assembly.add(cone, name="cone", color=STEEL)
    for i in range(12):
        turn = cq.Location((0, 0, 0), (0, 0, 1), 30.0 * i)
        assembly.add(roller, name=f"roller.{i + 1}", loc=turn, color=BRASS)
    return assembly


@part("bearing_spherical_plain", "Spherical plain bearing: an inner ball in an outer ring")
def _plain() -> Any:
    ball = cq.Workplane("XY").sphere(15).intersect(disc(20, 20, -10)).cut(disc(8, 40, -20))
    outer = disc(21, 13, -6.5).cut(cq.Workplane("XY").sphere(15.05))
    return compound([ball, outer])


@part("bearing_shell_half", "Half of a plain bearing shell with an oil groove and a lug")
def _half_shell() -> Any:
    body = ring(24, 21, 22, -11).cut(ring(21.8, 20, 4, -2)).union(ring(26, 23, 2, -11))
    body = body.union(ring(26, 23, 2, 9))
    body = body.intersect(cq.Workplane("XY").box(60, 30, 60).translate((0, 15, 0)))
    return body.cut(rod((0, 15, 0), (0, 30, 0), 2))
