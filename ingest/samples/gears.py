"""Gears, racks, sprockets and ratchets."""

from math import pi, radians, sin, tan
from typing import Any

import cadquery as cq

from .outlines import around, bolt_circle, disc, involute_gear, rod, turned, without
from .registry import part


def spur(module: float, teeth: int, width: float) -> Any:
    """Spur gear blank on z = 0 without a bore."""
    face = cq.Face.makeFromWires(involute_gear(module, teeth))
    return cq.Workplane(obj=cq.Solid.extrudeLinear(face, cq.Vector(0, 0, width)))


@part("gear_spur", "Spur gear of 18 involute teeth with a hub and a keyed bore")
def _spur() -> Any:
    body = spur(3, 18, 16).union(disc(15, 28))
    return body.cut(disc(8, 40, -1)).cut(cq.Workplane("XY").rect(5, 20.6).extrude(40))


@part("gear_helical", "Helical gear of 14 involute teeth, helix angle 20 degrees")
def _helical() -> Any:
    module, teeth, width = 3.0, 14, 18.0
    turn = width * tan(radians(20)) / (module * teeth / 2) * 180 / pi
    solid = cq.Solid.extrudeLinearWithRotation(
        involute_gear(module, teeth), [], cq.Vector(), cq.Vector(0, 0, width), turn
    )
    return cq.Workplane(obj=solid).cut(disc(8, 40, -10))


@part("gear_bevel", "Bevel gear of 13 tapered teeth: a ruled loft")
def _bevel() -> Any:
    outline = involute_gear(3, 13)
    small = outline.scale(0.62).translate(cq.Vector(0, 0, 12))
    teeth = cq.Workplane(obj=cq.Solid.makeLoft([outline, small], ruled=True))
    return teeth.union(disc(13, 12, -11)).cut(disc(6, 40, -20))


@part("gear_ring", "Internal ring gear of 24 involute teeth with eight bolt holes")
def _ring_gear() -> Any:
    up = cq.Vector(0, 0, 1)
    rim = cq.Wire.makeCircle(44, cq.Vector(), up)
    holes = [cq.Wire.makeCircle(2.25, cq.Vector(x, y), up) for x, y in bolt_circle(39.5, 8)]
    face = cq.Face.makeFromWires(rim, [involute_gear(2.5, 24), *holes])
    return cq.Workplane(obj=cq.Solid.extrudeLinear(face, 12 * up))


@part("gear_rack", "Rack of nine straight teeth with two fixing holes")
def _rack() -> Any:
    module, count = 3.0, 9
    outline = [(0.0, -14.0)]
    for i in range(count):
        x = pi * module * i
        for dx, y in ((1.0, -3.75), (2.95, 3.0), (6.47, 3.0), (8.42, -3.75)):
            outline.append((x + dx, y))
    length = pi * module * count
    outline += [(length, -3.75), (length, -14)]
    body = cq.Workplane("XZ").polyline([(0, -14), (0, -3.75), *outline[1:]]).close().extrude(-16)
    side = cq.Workplane("XZ", origin=(length / 2, 0, -9)).rarray(length * 0.7, 1, 2, 1)
    return body.cut(side.circle(2.5).extrude(-16))


@part("sprocket", "Chain sprocket of 14 teeth with rounded seats")
def _sprocket() -> Any:
    pitch, teeth, roller = 12.7, 14, 4.3
    radius = pitch / (2 * sin(pi / teeth))
    body = turned([
        (0, -2.5), (radius, -2.5), (radius + 3.5, -1), (radius + 3.5, 1), (radius, 2.5), (0, 2.5),
    ])  # fmt: skip
    seats = around(rod((radius, 0, -4), (radius, 0, 4), roller), teeth)
    windows = around(rod((20, 0, -4), (20, 0, 4), 3), 6)
    body = without(body, [*seats, *windows])
    return body.union(disc(15, 20, -2.5)).cut(disc(8, 50, -20))


@part("geneva_wheel", "Geneva wheel of six slots")
def _geneva() -> Any:
    body = disc(40, 6)
    slot = cq.Workplane("XY", origin=(34, 0, 0)).slot2D(32, 6).extrude(6)
    recess = rod((46.2, 0, -1), (46.2, 0, 7), 19)
    body = without(body, around(slot, 6) + around(recess, 6, 30))
    return body.union(disc(9, 14)).cut(disc(5, 30, -5))
