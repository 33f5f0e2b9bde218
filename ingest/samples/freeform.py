"""Parts of free-form surfaces: lofts, sweeps and revolved splines."""

from math import cos, pi, radians, sin
from typing import Any

import cadquery as cq

from .outlines import airfoil, around, disc, joined, ring, rod, turned
from .registry import part

Section = list[tuple[float, float, float]]


def profile_wire(points: Section) -> cq.Wire:
    """Wire of one spline through the points and a straight trailing edge."""
    vectors = [cq.Vector(*p) for p in points]
    closing = cq.Edge.makeLine(vectors[-1], vectors[0])
    return cq.Wire.assembleEdges([cq.Edge.makeSpline(vectors), closing])


def blade_section(chord: float, thickness: float, camber: float, pitch: float, r: float) -> Section:
    """Airfoil at the distance ``r`` along x, turned by ``pitch`` degrees about x."""
    c, s = cos(radians(pitch)), sin(radians(pitch))
    points = airfoil(chord, thickness, camber, 9)
    return [(r, c * x - s * y, s * x + c * y) for x, y in points]


def lofted(sections: list[Section]) -> Any:
    """Smooth solid through closed profile sections."""
    return cq.Workplane(obj=cq.Solid.makeLoft([profile_wire(s) for s in sections]))


@part("impeller", "Centrifugal impeller with six backward-curved twisted blades")
def _impeller() -> Any:
    hub = cq.Workplane("XZ").moveTo(0, 0).lineTo(50, 0).lineTo(50, 3)
    curve = [(30, 7), (15, 18), (11, 32)]
    hub = hub.spline(curve, tangents=[(-1, 0.1), (0, 1)], includeCurrent=True)
    hub = hub.lineTo(0, 32).close().revolve(360, (0, 0, 0), (0, 1, 0))
    low = [(10.0, -2.0), (22.0, -3.0), (34.0, -9.0), (46.0, -20.0)]
    stations = ((1.2, 0, 0), (0.9, 14, 12), (0.6, 26, 26))
    sections = [_blade_trace(low, half, z, twist) for half, z, twist in stations]
    blade = lofted([[(x, y, z) for x, y in trace] for trace, z in sections])
    limit = cq.Workplane("XZ").moveTo(0, 0.5).lineTo(49, 0.5).lineTo(49, 9)
    limit = limit.threePointArc((33, 15), (25, 29)).lineTo(0, 29).close()
    blade = blade.intersect(limit.revolve(360, (0, 0, 0), (0, 1, 0)))
    return joined(hub, around(blade, 6)).cut(disc(5, 40, -1))


def _blade_trace(
    middle: list[tuple[float, float]], half: float, z: float, twist: float
) -> tuple[list[tuple[float, float]], float]:
    """Outline of a thin blade at the height ``z``, turned about z by ``twist`` degrees."""
    c, s = cos(radians(twist)), sin(radians(twist))
    sides = [(x, y + half) for x, y in middle] + [(x, y - half) for x, y in reversed(middle)]
    return [(c * x - s * y, s * x + c * y) for x, y in sides], z


@part("propeller", "Ship propeller of four lofted blades on a rounded hub")
def _propeller() -> Any:
    sections = [
        blade_section(26, 0.17, 0.03, 58, 8),
        blade_section(36, 0.11, 0.04, 42, 26),
        blade_section(40, 0.08, 0.04, 31, 44),
        blade_section(26, 0.07, 0.03, 25, 62),
    ]
    blade = lofted(sections)
    hub = cq.Workplane("XZ").moveTo(0, -18).lineTo(15, -18).lineTo(15, 8)
    hub = hub.radiusArc((0, 23), -15).close().revolve(360, (0, 0, 0), (0, 1, 0))
    return joined(hub, around(blade, 4)).cut(disc(5, 30, -19))


@part("turbine_blade", "Turbine blade: twisted airfoil on a platform with a fir-tree root")
def _turbine_blade() -> Any:
    sections = []
    for i in range(4):
        scale = 1 - 0.1 * i
        section = blade_section(34 * scale, 0.14, 0.12, -12 + 11 * i, 18.0 * i)
        sections.append([(-y, x + 4, r + 2) for r, x, y in section])
    blade = lofted(sections)
    platform = cq.Workplane("XY").box(26, 44, 5).translate((0, 8, 0.5))
    half = [(6, 0), (9, -5), (5, -8), (7, -12), (3.5, -15), (4.5, -19)]
    outline = [*half, *[(-x, z) for x, z in reversed(half)]]
    root = cq.Workplane("XZ", origin=(0, 30, 0)).polyline(outline).close().extrude(44)
    return blade.union(platform).union(root)


@part("wing_panel", "Tapered wing panel with a spar hole")
def _wing() -> Any:
    root, tip = blade_section(90, 0.15, 0.03, 0, 0), blade_section(50, 0.11, 0.02, 3, 160)
    body = lofted([root, [(x, y + 14, z + 8) for x, y, z in tip]])
    return body.cut(rod((-1, 2, 2.5), (40, 2, 3.5), 3))


@part("bottle", "Bottle: a revolved spline with a hollow inside and a bead at the neck")
def _bottle() -> Any:
    outer = [(30, 8), (32, 40), (26, 70), (31, 98), (24, 122), (12, 140)]
    profile = (
        cq.Workplane("XZ")
        .moveTo(0, 4)
        .spline([(14, 2.5), (24, 0)], tangents=[(1, 0), (1, -0.1)], includeCurrent=True)
    )
    profile = profile.spline(outer, includeCurrent=True).lineTo(12, 158)
    profile = profile.threePointArc((14.5, 160), (12, 162)).lineTo(12, 170).lineTo(9.6, 170)
    profile = profile.lineTo(9.6, 140)
    inner = [(x - 2.4, z) for x, z in reversed(outer[:-1])]
    profile = profile.spline([*inner, (21, 4)], includeCurrent=True).lineTo(0, 7).close()
    return profile.revolve(360, (0, 0, 0), (0, 1, 0))


@part("mug", "Mug with a swept handle and a rounded lip")
def _mug() -> Any:
    cup = cq.Workplane("XZ").moveTo(0, 0).lineTo(36, 0).threePointArc((39, 1.2), (40, 4))
    cup = cup.lineTo(42, 90).lineTo(38, 90).lineTo(36, 6).lineTo(0, 6).close()
    body = cup.revolve(360, (0, 0, 0), (0, 1, 0)).faces(">Z").edges().fillet(1.6)
    path = cq.Workplane("XZ").moveTo(37, 72).lineTo(50, 72).threePointArc((74, 48), (50, 24))
    path = path.lineTo(37, 24)
    handle = cq.Workplane("YZ", origin=(37, 0, 72)).ellipse(6.5, 4).sweep(path)
    inside = turned([(0, 6), (36, 6), (38, 90), (0, 90)])
    return body.union(handle.cut(inside))


@part("duct_transition", "Sheet duct from a square to a round opening, shelled")
def _duct() -> Any:
    outer = cq.Workplane("XY").rect(80, 80).workplane(offset=70).circle(26).loft()
    inner = cq.Workplane("XY").rect(76, 76).workplane(offset=70).circle(24).loft()
    body = outer.cut(inner).union(ring(26, 24, 16, 70))
    rim = cq.Workplane("XY", origin=(0, 0, -4)).rect(96, 96).rect(76, 76).extrude(4)
    holes = cq.Workplane("XY", origin=(0, 0, -5)).rarray(86, 86, 2, 2).circle(2.6).extrude(8)
    return body.union(rim).cut(holes)


@part("handle_ergonomic", "Tool handle lofted through ellipses, with a steel tang")
def _handle() -> Any:
    sizes = [(0, 9, 11), (12, 13, 16), (40, 10, 14), (70, 12, 17), (100, 11, 15), (112, 7, 9)]
    body = cq.Workplane("XY")
    height = 0.0
    for z, a, b in sizes:
        body = body.workplane(offset=z - height).ellipse(a, b)
        height = z
    tang = cq.Workplane("XY", origin=(0, 0, -40)).rect(6, 14).extrude(50).edges("|Z").fillet(1.5)
    return body.loft().union(tang)


@part("hook_crane", "Crane hook of a varying section swept along a bent path")
def _hook() -> Any:
    stations = [(-80, 5.0), (-30, 10.0), (30, 13.0), (90, 12.0), (150, 9.0), (185, 4.5)]
    wires = []
    for angle, size in stations:
        a = radians(angle)
        centre = cq.Vector(26 * sin(a), 0, -26 * cos(a))
        along = cq.Vector(cos(a), 0, sin(a))
        wires.append(cq.Wire.makeCircle(size, centre, along))
    return cq.Workplane(obj=cq.Solid.makeLoft(list(reversed(wires))))


@part("hull_boat", "Boat hull lofted through five frames with a flat deck")
def _hull() -> Any:
    wires = []
    for x, width, depth in ((0, 22, 20), (45, 27, 24), (95, 26, 25), (140, 17, 23), (175, 4, 17)):
        keel = [(-width, 0), (-width * 0.8, -depth * 0.6), (0, -depth), (width * 0.8, -depth * 0.6),
                (width, 0)]  # fmt: skip
        vectors = [cq.Vector(x, y, z) for y, z in keel]
        edges = [cq.Edge.makeSpline(vectors), cq.Edge.makeLine(vectors[-1], vectors[0])]
        wires.append(cq.Wire.assembleEdges(edges))
    return cq.Workplane(obj=cq.Solid.makeLoft(wires))


@part("knob_door", "Door knob: a revolved ellipse arc on a stem and a rose")
def _door_knob() -> Any:
    ball = cq.Workplane("XZ").moveTo(0, 28).lineTo(9, 28)
    ball = ball.spline([(24, 38), (27, 48), (16, 60), (0, 64)], includeCurrent=True,
                       tangents=[(1, 0.1), (-1, 0)]).close()  # fmt: skip
    knob = ball.revolve(360, (0, 0, 0), (0, 1, 0)).union(disc(9, 26, 4))
    rose = turned([(0, 0), (28, 0), (28, 2), (24, 5), (0, 5)])
    return knob.union(rose)


@part("gasket_wave", "Wave spring washer: a ring whose height follows a sine")
def _wave_washer() -> Any:
    def trace(radius: float, z: float) -> cq.Edge:
        points = [
            cq.Vector(radius * cos(a), radius * sin(a), z + 1.6 * sin(3 * a))
            for a in (2 * pi * i / 36 for i in range(36))
        ]
        return cq.Edge.makeSpline(points, periodic=True)

    corners = [trace(20, 0), trace(26, 0), trace(26, 0.9), trace(20, 0.9)]
    faces = [cq.Face.makeRuledSurface(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    return cq.Workplane(obj=cq.Solid.makeSolid(cq.Shell.makeShell(faces)))
