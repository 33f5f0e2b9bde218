"""Plain bodies that a kernel must get right: full, half and hollow primitives."""

from typing import Any

import cadquery as cq

from .outlines import compound, disc, rod, turned
from .registry import Unit, part


@part("ball_steel", "Ball: one sphere face with both poles")
def _ball() -> Any:
    return cq.Workplane("XY").sphere(12.7)


@part("ball_half", "Half of a ball with a drilled hole")
def _half_ball() -> Any:
    half = cq.Workplane("XY").box(60, 60, 60).translate((30, 0, 0))
    return cq.Workplane("XY").sphere(20).intersect(half).cut(rod((-1, 0, 0), (16, 0, 0), 4))


@part("ring_half", "Half of a torus ring with flat ends")
def _half_ring() -> Any:
    return cq.Workplane("XZ").center(30, 0).circle(8).revolve(180, (-30, 0, 0), (-30, 1, 0))


@part("block_void", "Block with a closed spherical void: one solid of two shells")
def _void() -> Any:
    block = cq.Workplane("XY").box(40, 40, 40).edges().fillet(4)
    return block.cut(cq.Workplane("XY").sphere(12))


@part("weight_lemon", "Lemon-shaped weight: a spline revolved about its chord, with two poles")
def _lemon() -> Any:
    arc = cq.Workplane("XZ").moveTo(0, -24).spline([(13, 0), (0, 24)], includeCurrent=True)
    return arc.close().revolve(360, (0, 0, 0), (0, 1, 0))


@part("dice", "Die: rounded cube with spherical pips and sphere corners")
def _dice() -> Any:
    body = cq.Workplane("XY").box(16, 16, 16).edges().fillet(2.5)
    pips = [(0, 0, 8.6), (4, 4, -8.6), (-4, -4, -8.6), (8.6, 4, 4), (8.6, 0, 0), (8.6, -4, -4)]
    for p in pips:
        body = body.cut(cq.Workplane("XY").sphere(1.7).translate(p))
    return body


@part("bodies_touching", "Two solids that touch in a face without being joined")
def _touching() -> Any:
    return compound([turned([(0, 0), (20, 0), (20, 10), (0, 10)]), disc(12, 18, 10)])


def base_plate() -> Any:
    """Plate whose dimensions are whole eighths of an inch."""
    u = 25.4 / 8
    body = cq.Workplane("XY").box(40 * u, 24 * u, 4 * u).edges("|Z").fillet(2 * u)
    body = body.union(disc(6 * u, 6 * u, 2 * u)).cut(disc(4 * u, 20 * u, -10 * u))
    holes = cq.Workplane("XY", origin=(0, 0, -4 * u)).rarray(32 * u, 16 * u, 2, 2)
    body = body.cut(holes.circle(1.5 * u).extrude(8 * u))
    slot = cq.Workplane("XY", origin=(13 * u, 0, 0)).rect(6 * u, 4 * u).extrude(8 * u)
    return body.cut(slot)


_TWINS: tuple[tuple[str, Unit, str], ...] = (
    ("base_plate_mm", "mm", "Base plate in millimetres; the same part as base_plate_inch"),
    ("base_plate_inch", "inch", "Base plate in inches; the same part as base_plate_mm"),
)
for _name, _unit, _description in _TWINS:
    part(_name, _description, unit=_unit)(base_plate)
