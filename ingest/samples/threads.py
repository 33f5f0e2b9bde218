"""Parts with helicoidal threads, and springs."""

from typing import Any

import cadquery as cq

from .outlines import disc, hexagon, ring, turned
from .registry import part


def ridge(radius: float, pitch: float, turns: float, profile: list[tuple[float, float]]) -> Any:
    """Helicoidal ridge of four ruled faces and two caps.

    Parameters
    ----------
    radius : float
        Radius that the profile's first coordinate is added to, mm.
    pitch : float
        Rise a turn, mm.
    turns : float
        Number of turns.
    profile : list of (height, z)
        Four corners, counter-clockwise when the axis is at the left.

    Returns
    -------
    cadquery.Workplane
        The solid; it starts on the x axis at z = 0.
    """
    helices = [
        cq.Wire.makeHelix(pitch, pitch * turns, radius + h).translate(cq.Vector(0, 0, z))
        for h, z in profile
    ]
    count = len(helices)
    faces = [cq.Face.makeRuledSurface(helices[i], helices[(i + 1) % count]) for i in range(count)]
    for at in (0.0, 1.0):
        corners = [h.positionAt(at) for h in helices]
        faces.append(cq.Face.makeFromWires(cq.Wire.makePolygon([*corners, corners[0]])))
    return cq.Workplane(obj=cq.Solid.makeSolid(cq.Shell.makeShell(faces)))


def screw(outer: float, pitch: float, length: float) -> Any:
    """Threaded rod on z = 0 with a 60 degree thread and a chamfered tip below."""
    core = outer - 0.61 * pitch
    profile = [(-0.15, -0.42 * pitch), (outer - core, -0.07 * pitch),
               (outer - core, 0.07 * pitch), (-0.15, 0.42 * pitch)]  # fmt: skip
    turns = int((length - 1) / pitch) - 0.6
    thread = ridge(core, pitch, turns, profile).translate((0, 0, 1 + 0.5 * pitch))
    return turned([(0, 0), (core - 1, 0), (core, 1), (core, length), (0, length)]).union(thread)


def hexagon_head(across: float, height: float) -> Any:
    """Hexagon on z = 0 whose upper corners are cut by a cone: its edges are hyperbolas."""
    corner = across / 3**0.5
    outer, inner = corner + 2, 0.475 * across
    shoulder = height - 0.5 * (outer - inner)
    cone = turned([(0, 0), (outer, 0), (outer, shoulder), (inner, height), (0, height)])
    prism = cq.Workplane("XY").polyline(hexagon(across)).close().extrude(height)
    return prism.intersect(cone)


@part("bolt_hex_m10", "Hexagon bolt M10 with a helicoidal thread")
def _bolt() -> Any:
    shank = disc(5, 25, 15)
    head = hexagon_head(16, 6.4).translate((0, 0, 40))
    return screw(5, 1.5, 15).union(shank).union(head)


@part("nut_hex_m10", "Hexagon nut M10 with a helicoidal thread inside")
def _nut() -> Any:
    blank = hexagon_head(16, 8.4).intersect(
        hexagon_head(16, 8.4).rotate((0, 0, 4.2), (1, 0, 4.2), 180)
    )
    thread = ridge(5.1, 1.5, 4.3, [(0.15, -0.63), (0.15, 0.63), (-0.9, 0.1), (-0.9, -0.1)])
    return blank.cut(disc(5.1, 20, -5)).union(thread.translate((0, 0, 0.95)))


@part("lead_screw", "Lead screw with a square thread and turned journals")
def _lead_screw() -> Any:
    thread = ridge(8, 5, 7, [(-0.5, -1.25), (2.5, -1.25), (2.5, 1.25), (-0.5, 1.25)])
    core = turned([(0, -24), (5, -24), (6, -23), (6, -6), (8, -6), (8, 44), (6, 44), (6, 64),
                   (5, 65), (0, 65)])  # fmt: skip
    return core.union(thread.translate((0, 0, 2)))


def coil(radius: float, wire: float, pitch: float, turns: float, taper: float = 360) -> Any:
    """Round wire swept along a helix; ``taper`` is a cone's half angle in degrees, 360 for none."""
    helix = cq.Wire.makeHelix(pitch, pitch * turns, radius, angle=taper)
    return cq.Workplane("XZ", origin=(radius, 0, 0)).circle(wire).sweep(helix, isFrenet=True)


@part("spring_compression", "Compression spring of seven turns with ground ends")
def _compression() -> Any:
    height = 8 * 7.0
    body = coil(16, 2, 8, 7)
    return body.intersect(cq.Workplane("XY").box(60, 60, height - 2).translate((0, 0, height / 2)))


@part("spring_conical", "Conical spring of six turns")
def _conical() -> Any:
    return coil(20, 1.5, 6, 6, 15)


@part("washer_spring", "Split spring washer with a helical rise")
def _spring_washer() -> Any:
    return ridge(7.5, 2.4, 0.97, [(-2, -1), (2, -1), (2, 1), (-2, 1)])


@part("drill_twist", "Twist drill with two helical flutes and a conical point")
def _drill() -> Any:
    body = turned([(0, 0), (8, 4.8), (8, 90), (7, 91), (0, 91)])
    flute = cq.Workplane("XY").pushPoints([(7.5, 0), (-7.5, 0)]).circle(5.4)
    return body.cut(flute.twistExtrude(56, 260))


@part("auger", "Screw conveyor: a helicoid of constant thickness on a tube")
def _auger() -> Any:
    flight = ridge(9, 30, 4, [(-1, -1), (21, -1), (21, 1), (-1, 1)])
    tube = ring(9, 6, 140, -10)
    return tube.union(flight)
