"""Housings, brackets, profiles and plates."""

from typing import Any

import cadquery as cq

from .outlines import around, bolt_circle, disc, joined, ring, rod, turned, without
from .registry import part


def box(size: tuple[float, float, float], centre: tuple[float, float, float] = (0, 0, 0)) -> Any:
    """Box by size and centre."""
    return cq.Workplane("XY").box(*size).translate(centre)


@part("enclosure", "Shelled enclosure with rounded edges, four screw bosses and ribs")
def _enclosure() -> Any:
    body = box((100, 64, 34), (0, 0, 17)).edges("|Z").fillet(8).faces("<Z").edges().fillet(3)
    body = body.faces(">Z").shell(-2.5)
    for x in (-40, 40):
        for y in (-22, 22):
            post = ring(4.5, 1.6, 27, 2).translate((x, y, 0))
            body = body.union(post)
    for x in (-20, 0, 20):
        body = body.union(box((2, 60, 8), (x, 0, 6)))
    return body.cut(rod((45, 0, 20), (55, 0, 20), 6)).cut(box((20, 10, 8), (0, -32, 20)))


@part("enclosure_lid", "Lid with a sealing lip, countersunk holes and louvres")
def _lid() -> Any:
    body = box((100, 64, 4), (0, 0, 2)).edges("|Z").fillet(8)
    lip = box((94.6, 58.6, 3), (0, 0, -1.5)).edges("|Z").fillet(5.3)
    body = body.union(lip.cut(box((90, 54, 8)).edges("|Z").fillet(3)))
    corners = [(x, y) for x in (-40, 40) for y in (-22, 22)]
    body = body.faces(">Z").workplane(origin=(0, 0, 0)).pushPoints(corners).cskHole(3.4, 6.6, 90)
    slots = cq.Workplane("XY").rarray(1, 7, 1, 4).slot2D(40, 3).extrude(10)
    return body.cut(slots)


@part("housing_gearbox", "Half of a gearbox housing with two bearing seats and a bolted rim")
def _gearbox() -> Any:
    body = box((120, 70, 44), (0, 0, -22)).edges("|Z").fillet(12)
    body = body.cut(box((106, 56, 80), (0, 0, 3)).edges("|Z").fillet(6))
    body = body.union(
        box((144, 94, 8), (0, 0, -4))
        .edges("|Z")
        .fillet(16)
        .cut(box((106, 56, 20)).edges("|Z").fillet(6))
    )
    for x, radius in ((-28, 17.0), (26, 22.0)):
        seat = rod((x, -43, 0), (x, 43, 0), radius + 7).intersect(box((144, 86, 60), (0, 0, -30)))
        body = body.union(seat.cut(box((106, 56, 80)))).cut(rod((x, -60, 0), (x, 60, 0), radius))
    holes = cq.Workplane("XY", origin=(0, 0, -20)).rarray(128, 78, 2, 2).circle(4).extrude(40)
    return body.cut(holes)


@part("housing_pump", "Pump housing: volute ring, inlet, outlet with flange, mounting feet")
def _pump() -> Any:
    body = cq.Workplane(obj=cq.Solid.makeTorus(38, 15)).union(disc(38, 26, -13))
    body = body.union(rod((38, 4, 0), (38, 70, 0), 12)).union(rod((38, 64, 0), (38, 72, 0), 20))
    body = body.union(disc(17, 44, 0)).union(disc(27, 7, 37))
    feet = box((20, 14, 8), (-32, 0, -20)).union(box((20, 14, 8), (32, 0, -20)))
    body = body.union(feet).union(box((84, 14, 6), (0, 0, -16)))
    body = body.cut(cq.Workplane(obj=cq.Solid.makeTorus(38, 12))).cut(disc(36, 18, -9))
    return body.cut(rod((38, 10, 0), (38, 73, 0), 9)).cut(disc(13, 60, 0))


@part("pillow_block", "Pillow block bearing housing with a filleted foot")
def _pillow_block() -> Any:
    body = box((110, 34, 14), (0, 0, 7)).edges("|Z").fillet(6)
    body = body.union(rod((0, -17, 40), (0, 17, 40), 30)).union(box((60, 34, 40), (0, 0, 20)))
    body = body.edges("|Y").edges(cq.selectors.BoxSelector((-31, -20, 13), (31, 20, 15))).fillet(5)
    body = body.cut(rod((0, -18, 40), (0, 18, 40), 19)).cut(rod((0, -11, 40), (0, 11, 40), 24))
    for x in (-43, 43):
        body = body.cut(cq.Workplane("XY", origin=(x, 0, 0)).slot2D(14, 9).extrude(20))
    return body.cut(disc(2.5, 20, 58))


@part("bracket_angle", "Angle bracket with a gusset, fillets and four holes")
def _bracket() -> Any:
    body = box((60, 50, 8), (30, 0, 4)).union(box((8, 50, 60), (4, 0, 30)))
    body = body.edges(cq.selectors.NearestToPointSelector((8, 0, 8))).fillet(6)
    gusset = cq.Workplane("XZ", origin=(0, 3, 0)).polyline([(7, 7), (44, 7), (7, 44)]).close()
    body = body.union(gusset.extrude(6)).edges("|X and >Z").fillet(0.8)
    body = body.edges("|Z and >X").fillet(10)
    body = body.cut(rod((46, 15, -1), (46, 15, 9), 4.5)).cut(rod((46, -15, -1), (46, -15, 9), 4.5))
    return body.cut(rod((-1, 15, 48), (9, 15, 48), 4.5)).cut(rod((-1, -15, 48), (9, -15, 48), 4.5))


@part("bracket_sheet", "Bent sheet-metal bracket of constant thickness with slots")
def _sheet_bracket() -> Any:
    path = cq.Workplane("XZ").moveTo(0, 40).lineTo(0, 6).radiusArc((6, 0), -6).lineTo(44, 0)
    path = path.radiusArc((50, 6), -6).lineTo(50, 22).radiusArc((56, 28), 6).lineTo(80, 28)
    section = cq.Workplane("XY", origin=(0, 0, 40)).rect(2, 40)
    body = section.sweep(path, transition="right")
    body = body.cut(cq.Workplane("XY", origin=(25, 0, -5)).slot2D(24, 8).extrude(10))
    body = body.cut(rod((-3, 0, 26), (3, 0, 26), 5)).cut(rod((70, 10, 20), (70, 10, 34), 3.2))
    return body.cut(rod((70, -10, 20), (70, -10, 34), 3.2))


@part("heat_sink", "Heat sink of 15 fins with a milled clip slot")
def _heat_sink() -> Any:
    fins = [box((1.6, 60, 28), (-42 + 6 * i, 0, 19)) for i in range(15)]
    body = joined(box((88, 60, 6), (0, 0, 3)), fins)
    body = body.cut(box((100, 6, 22), (0, 0, 23)))
    return body.faces("<Z").workplane(origin=(0, 0, 0)).rarray(70, 44, 2, 2).hole(3.2, 5)


@part("heat_sink_pin", "Round pin-fin heat sink: 37 conical pins on a disc")
def _pin_sink() -> Any:
    spots = [(0.0, 0.0), *bolt_circle(9, 6), *bolt_circle(18, 12), *bolt_circle(27, 18)]
    pin = turned([(0, 4), (2.6, 4), (1.5, 23), (0, 23)])
    return joined(disc(32, 5), [pin.translate((x, y, 0)) for x, y in spots])


@part("beam_i", "Rolled I-beam with root fillets and web holes")
def _beam() -> Any:
    body = box((8, 160, 64))
    for z in (-35, 35):
        body = body.union(box((50, 160, 9), (0, 0, z)))
    body = body.edges("|Y").edges(cq.selectors.BoxSelector((-5, -90, -33), (5, 90, 33))).fillet(6)
    holes = cq.Workplane("YZ", origin=(-10, 0, 0)).rarray(45, 1, 3, 1).circle(14)
    return body.cut(holes.extrude(20))


@part("extrusion_t_slot", "T-slot aluminium profile")
def _t_slot() -> Any:
    body = box((40, 40, 70)).edges("|Z").fillet(2)
    slot = box((8.2, 10, 80), (0, 18, 0)).union(
        cq.Workplane("XY", origin=(0, 0, -40))
        .polyline([(-10, 15.5), (10, 15.5), (10, 12.5), (5, 8), (-5, 8), (-10, 12.5)])
        .close().extrude(80)
    )  # fmt: skip
    return without(body, [*around(slot, 4), disc(3.4, 80, -40)])


@part("manifold_block", "Hydraulic manifold with crossing bores, counterbores and drill points")
def _manifold() -> Any:
    body = box((90, 50, 40))
    body = body.cut(rod((-46, 0, 0), (30, 0, 0), 6))
    tip = turned([(0, 0), (5, 0), (5, 28), (0, 31)])
    for x in (-28, 0, 24):
        body = body.cut(tip.rotate((0, 0, 0), (1, 0, 0), 180).translate((x, 0, 21)))
        body = body.cut(disc(9, 8, 14).translate((x, 0, 0)))
    corners = cq.Workplane("XY", origin=(0, 0, -21)).rarray(76, 38, 2, 2).circle(3.2).extrude(42)
    return body.cut(corners).edges("|Z").chamfer(1.5)
