"""Turned shafts, their keys, cams and cranks, and what sits on them."""

from math import radians
from typing import Any

import cadquery as cq

from .outlines import around, bolt_circle, disc, joined, polar, ring, rod, turned, without
from .registry import part


@part("shaft_stepped", "Stepped shaft with fillets, chamfers, a keyway and a centre hole")
def _stepped() -> Any:
    body = turned([
        (0, 0), (9, 0), (10, 1), (10, 30), (15, 30), (15, 75), (18, 75), (18, 83), (12.5, 83),
        (12.5, 110), (8, 110), (8, 134), (7, 135), (0, 135),
    ])  # fmt: skip
    for z in (30, 75, 83, 110):
        edge = body.edges(cq.selectors.BoxSelector((-20, -20, z - 0.1), (20, 20, z + 0.1)))
        body = edge.edges(cq.selectors.RadiusNthSelector(0)).fillet(1.2)
    key = cq.Workplane("XY", origin=(0, 0, 11)).slot2D(30, 8).extrude(10)
    body = body.cut(key.rotate((0, 0, 0), (0, 1, 0), 90).translate((0, 0, 52.5)))
    return body.cut(turned([(0, -1), (1.6, -1), (1.6, 4), (0, 7)]))


@part("shaft_o_ring_grooves", "Piston rod with six rounded O-ring grooves")
def _o_ring_grooves() -> Any:
    profile = cq.Workplane("XZ").moveTo(0, 0).lineTo(11, 0).lineTo(12, 1)
    for i in range(6):
        z = 12 + 13 * i
        profile = profile.lineTo(12, z - 2.5).threePointArc((9.5, z), (12, z + 2.5))
    profile = profile.lineTo(12, 95).threePointArc((10.6, 98.4), (7, 100)).lineTo(0, 100)
    body = profile.close().revolve(360, (0, 0, 0), (0, 1, 0))
    return body.cut(rod((-13, 0, 88), (13, 0, 88), 3))


@part("spindle_grip", "Ball-ended grip with 32 rounded grooves: more than 30 torus faces")
def _grip() -> Any:
    profile = cq.Workplane("XZ").moveTo(0, 0).lineTo(8, 0)
    for i in range(32):
        z = 6 + 3.0 * i
        profile = profile.lineTo(8, z - 1).threePointArc((7, z), (8, z + 1))
    profile = profile.lineTo(8, 104).lineTo(5, 108).lineTo(5, 116)
    profile = profile.threePointArc((13, 128), (0, 141)).close()
    return profile.revolve(360, (0, 0, 0), (0, 1, 0))


@part("shaft_splined", "Splined shaft with six straight keys")
def _splined() -> Any:
    body = disc(13, 60).union(disc(10, 85))
    tooth = cq.Workplane("XY").rect(6, 6).extrude(60).translate((14, 0, 0))
    body = joined(body, around(tooth, 6))
    return body.intersect(turned([(0, 0), (15, 0), (16, 1), (16, 58), (12, 62), (12, 85), (0, 85)]))


def cam(base: float, lift: float, nose: float, width: float) -> Any:
    """Plate cam on z = 0: base circle and nose circle joined by their common tangents."""
    distance = base + lift - nose
    slope = (base - nose) / distance
    x, y = slope, (1 - slope**2) ** 0.5
    outline = (
        cq.Workplane("XY")
        .moveTo(base * x, base * y)
        .threePointArc((-base, 0), (base * x, -base * y))
        .lineTo(distance + nose * x, -nose * y)
        .threePointArc((distance + nose, 0), (distance + nose * x, nose * y))
    )
    return outline.close().extrude(width)


@part("cam_plate", "Plate cam with a hub, a keyed bore and lightening holes")
def _cam_plate() -> Any:
    body = cam(28, 16, 9, 10).union(disc(15, 22))
    body = body.cut(disc(8, 30, -1)).cut(cq.Workplane("XY").rect(5, 21).extrude(30))
    return body.cut(rod((26, 0, -1), (26, 0, 11), 5)).edges(">Z").chamfer(0.6)


@part("camshaft", "Camshaft of four cams at 90 degrees and five bearing journals")
def _camshaft() -> Any:
    journals = [disc(14, 14, 5 + 42 * i if i else 0) for i in range(5)]
    lobes = [
        lobe.translate((0, 0, 19.0 + 42 * i)) for i, lobe in enumerate(around(cam(12, 7, 4, 14), 4))
    ]
    body = joined(disc(9, 190), journals + lobes)
    return body.faces(">Z or <Z").edges().chamfer(0.8)


@part("crankshaft", "Crankshaft of three throws with counterweights")
def _crankshaft() -> Any:
    pieces = []
    for i, side in enumerate((1, -1, 1)):
        z = 48 * i
        web = cq.Workplane("XY").ellipse(22, 34).extrude(9).translate((0, 6.0 * side, z))
        pieces += [web, web.translate((0, 0, 25)), disc(13, 14, z + 34)]
        pieces.append(rod((0, 20 * side, z + 9), (0, 20 * side, z + 25), 10))
    body = joined(disc(13, 24, -24), [*pieces, disc(28, 6, 144)])
    return body.faces(">Z").workplane().polarArray(21, 0, 360, 6).hole(6)


@part("connecting_rod", "Connecting rod with an I-section shank and an oil hole")
def _connecting_rod() -> Any:
    shank = cq.Workplane("XY").polyline([(0, 13), (110, 8), (110, -8), (0, -13)]).close()
    body = shank.extrude(14).union(disc(26, 22, -4)).union(disc(15, 18, -2).translate((110, 0, 0)))
    pocket = cq.Workplane("XY").polyline([(32, 7), (90, 4.5), (90, -4.5), (32, -7)]).close()
    pocket = pocket.extrude(4).edges("|Z").fillet(2)
    body = body.cut(pocket).cut(pocket.translate((0, 0, 10)))
    body = body.cut(disc(19, 40, -10)).cut(disc(9, 40, -10).translate((110, 0, 0)))
    body = body.cut(rod((110, 0, 7), (140, 0, 7), 1.5))
    return body.faces(">Z[0] or <Z[0]").edges(cq.selectors.RadiusNthSelector(-1)).chamfer(1)


@part("pulley_v_belt", "V-belt pulley of two grooves with five lightening holes")
def _v_pulley() -> Any:
    body = turned([
        (12, 0), (26, 0), (26, 6), (50, 6), (50, 0), (60, 0), (60, 3), (51, 6), (51, 12),
        (60, 15), (60, 19), (51, 22), (51, 28), (60, 31), (60, 34), (50, 34), (50, 28), (26, 28),
        (26, 40), (12, 40),
    ])  # fmt: skip
    body = body.cut(ring(47, 29, 10, 20)).faces("<Z").workplane(origin=(0, 0, 0))
    body = body.pushPoints(bolt_circle(38, 5)).hole(13)
    return body.cut(cq.Workplane("XY").rect(6, 29).extrude(40))


@part("handwheel", "Handwheel with a torus rim, four bent spokes and a crank handle")
def _handwheel() -> Any:
    rim = cq.Workplane(obj=cq.Solid.makeTorus(70, 8))
    body = turned([(8, -38), (18, -38), (16, -12), (8, -12)])
    body = joined(body, around(rod((12, 0, -25), (69, 0, 0), 4.5), 4, 30))
    handle = turned([(0, 0), (4, 0), (4, 12), (7, 14), (8, 44), (6, 52), (0, 54)])
    x, y = polar(71, radians(250))
    handle = handle.translate((x, y, 2))
    rim = rim.union(handle, clean=False)  # merging faces would turn the torus inside out
    return body.cut(disc(8, 60, -50)).union(rim, clean=False)


@part("knob_star", "Star knob with seven scallops and a rounded crown")
def _star_knob() -> Any:
    body = cq.Workplane("XZ").moveTo(0, 0).lineTo(26, 0).lineTo(26, 10)
    body = body.radiusArc((0, 20), -38.8).close().revolve(360, (0, 0, 0), (0, 1, 0))
    body = without(body, around(rod((31, 0, -1), (31, 0, 25), 9), 7, 11))
    return body.union(disc(10, 16, -14)).cut(disc(4, 26, -15))
