"""Flanges, pipes and what joins them."""

from typing import Any

import cadquery as cq

from .outlines import around, bolt_circle, disc, ring, rod, turned, without
from .registry import part


def flange(bore: float, outer: float, thickness: float, circle: float, holes: int) -> Any:
    """Weld-neck flange on z = 0 with a raised face below and its neck above."""
    neck = bore + 6
    profile = [
        (bore, -2), (bore + 14, -2), (bore + 14, 0), (outer, 0), (outer, thickness),
        (neck + 9, thickness), (neck, thickness + 22), (neck, thickness + 32),
        (bore, thickness + 32),
    ]  # fmt: skip
    body = turned(profile)
    body = body.faces(">Z").workplane(origin=(0, 0, 0))
    drilled = body.pushPoints(bolt_circle(circle, holes, 180 / holes)).hole(18)
    return drilled.edges(cq.selectors.RadiusNthSelector(-1)).chamfer(1.5)


@part("flange_weld_neck", "Weld-neck flange with eight bolt holes and a raised face")
def _weld_neck() -> Any:
    return flange(40, 100, 20, 80, 8)


@part("flange_blind", "Blind flange with a ring groove and twelve bolt holes")
def _blind() -> Any:
    body = disc(110, 24).faces(">Z").workplane().circle(62).circle(54).cutBlind(-5)
    body = body.faces("<Z").workplane().polarArray(88, 0, 360, 12).hole(20)
    return body.faces(">Z").edges(cq.selectors.RadiusNthSelector(-1)).fillet(3)


@part("pipe_elbow", "Pipe elbow of 90 degrees with two bolted flanges")
def _elbow() -> Any:
    def collar(z: float) -> Any:
        return ring(48, 20, 12, z).faces("<Z").workplane().polarArray(37, 45, 360, 4).hole(9)

    bend = cq.Workplane("XY").circle(24).circle(20).revolve(90, (60, 0, 0), (60, 1, 0))
    end = collar(0).rotate((60, 0, 0), (60, 1, 0), 90)
    return bend.union(collar(-12)).union(end)


@part("pipe_tee", "Pipe tee with three collars")
def _tee() -> Any:
    run, branch = rod((-60, 0, 0), (60, 0, 0), 25), rod((0, 0, 0), (0, 0, 55), 20)
    body = run.union(branch).edges(cq.selectors.BoxSelector((-30, -30, 5), (30, 30, 35))).fillet(4)
    for x in (-60, 50):
        body = body.union(rod((x, 0, 0), (x + 10, 0, 0), 31))
    body = body.union(rod((0, 0, 45), (0, 0, 55), 26))
    return body.cut(rod((-61, 0, 0), (61, 0, 0), 21)).cut(rod((0, 0, 0), (0, 0, 56), 16))


@part("pipe_cross", "Cross fitting of four equal pipes whose bores meet in ellipses")
def _cross() -> Any:
    outer = rod((-50, 0, 0), (50, 0, 0), 18).union(rod((0, -50, 0), (0, 50, 0), 18))
    bores = rod((-51, 0, 0), (51, 0, 0), 14).union(rod((0, -51, 0), (0, 51, 0), 14))
    return outer.cut(bores)


@part("pipe_reducer", "Concentric pipe reducer with weld bevels")
def _reducer() -> Any:
    return turned([
        (37, 0), (38, 0), (40, 2), (40, 20), (25, 70), (25, 88), (23, 90), (22, 90),
        (22, 69.4), (37, 19.4),
    ])  # fmt: skip


@part("hose_barb", "Hose barb with a hexagon and four conical teeth")
def _hose_barb() -> Any:
    outline = [(3.5, 0), (8, 0), (8, 14), (5.2, 14)]
    outline += [(radius, z) for z in (24, 31, 38, 45) for radius in (5.2, 6.6)]
    body = turned([*outline, (5.2, 52), (3.5, 52)])
    return body.union(cq.Workplane(origin=(0, 0, 14)).polygon(6, 22).circle(3.5).extrude(8))


def serpentine(bends: int, pitch: float, length: float, radius: float) -> Any:
    """Path of straight runs joined by half turns, in the plane z = 0."""
    path = cq.Workplane("XY").moveTo(0, 0).lineTo(length, 0)
    side, y = 1, 0.0
    for _ in range(bends):
        x = length if side > 0 else 0.0
        path = path.threePointArc((x + side * pitch / 2, y + pitch / 2), (x, y + pitch))
        side, y = -side, y + pitch
        path = path.lineTo(length if side > 0 else 0.0, y)
    return cq.Workplane("YZ").circle(radius).circle(radius - 1).sweep(path)


@part("condenser_coil", "Serpentine condenser coil: 16 half turns, 32 torus faces")
def _condenser() -> Any:
    return serpentine(16, 16, 120, 5)


def _wave(wall: float, count: int) -> list[tuple[float, float, float]]:
    """Half circles (z of the start, radius of the start, bulge) of a bellows' wall.

    ``wall`` is the distance from the middle of the sheet, positive outward.
    """
    arcs: list[tuple[float, float, float]] = []
    for i in range(count):
        root, crest = 2 - wall, 2 + wall
        arcs.append((8 * i + 4 - crest, 26, crest))
        if i < count - 1:
            arcs.append((8 * i + 8 - root, 20, -root))
    return arcs


def _sheet(profile: Any, arcs: list[tuple[float, float, float]], direction: int) -> Any:
    """Extend a profile by half circles, upward or downward, with straight lines between."""
    for z, radius, bulge in arcs[::direction]:
        span = 2 * abs(bulge)
        first, last = (z, z + span) if direction > 0 else (z + span, z)
        profile = profile.lineTo(radius, first)
        profile = profile.threePointArc((radius + bulge, z + span / 2), (radius, last))
    return profile


@part("bellows", "Metal bellows of torus convolutions between two weld cuffs")
def _bellows() -> Any:
    count, half = 9, 0.3
    top = 8.0 * count
    profile = cq.Workplane("XZ").moveTo(17.8, -10).lineTo(18.4, -10).lineTo(18.4, 2 - half)
    profile = _sheet(profile, _wave(half, count), 1)
    profile = profile.lineTo(18.4, top - 2 + half).lineTo(18.4, top + 10).lineTo(17.8, top + 10)
    profile = profile.lineTo(17.8, top - 2 - half)
    profile = _sheet(profile, _wave(-half, count), -1).lineTo(17.8, 2 + half)
    return profile.close().revolve(360, (0, 0, 0), (0, 1, 0))


@part("lens_ring_gasket", "Lens ring of two spherical faces for a high-pressure joint")
def _lens_ring() -> Any:
    ball = cq.Workplane().sphere(40).translate((0, 0, -32))
    other = cq.Workplane().sphere(40).translate((0, 0, 32))
    return ball.intersect(other).intersect(disc(22, 40, -20)).cut(disc(12, 40, -20))


@part("spray_nozzle", "Spray nozzle with a conical bore and six oblique jets")
def _nozzle() -> Any:
    body = turned([(0, 0), (14, 0), (14, 18), (9, 30), (0, 30)])
    body = body.cut(turned([(0, -1), (9, -1), (9, 12), (3, 22), (0, 22)]))
    return without(body, around(rod((0, 0, 18), (12, 0, 32), 1.4), 6))
