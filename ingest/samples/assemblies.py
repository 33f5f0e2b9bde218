"""Assemblies: several solids with names, colours and repeated instances."""

from typing import Any

import cadquery as cq

from .bearings import BRASS, DARK, STEEL
from .gears import spur
from .housings import box
from .outlines import around, bolt_circle, disc, joined, ring, rod, turned, without
from .pipes import flange
from .registry import part
from .threads import hexagon_head

RED = cq.Color(0.75, 0.16, 0.14)
BLUE = cq.Color(0.16, 0.34, 0.66)
GREEN = cq.Color(0.20, 0.52, 0.30)


def at(x: float, y: float, z: float, axis: tuple[float, float, float] = (0, 0, 1),
       angle: float = 0) -> cq.Location:  # fmt: skip
    """Place turned by an angle in degrees about an axis through it."""
    return cq.Location((x, y, z), axis, angle)


@part("chain_links", "Chain of 16 links, each of two half tori: 32 torus faces")
def _chain() -> Any:
    path = cq.Workplane("XY").moveTo(-8, -6).lineTo(8, -6).threePointArc((14, 0), (8, 6))
    path = path.lineTo(-8, 6).threePointArc((-14, 0), (-8, -6)).close()
    link = cq.Workplane("YZ", origin=(-8, -6, 0)).circle(2.4).sweep(path)
    chain = cq.Assembly(name="chain_links")
    for i in range(16):
        place = at(22.6 * i, 0, 0, (1, 0, 0), 90 * (i % 2))
        chain.add(link, name=f"link.{i + 1}", loc=place, color=STEEL)
    return chain


@part("flange_joint", "Bolted flange joint: two flanges, a gasket, eight bolts with nuts")
def _flange_joint() -> Any:
    half = flange(40, 100, 20, 80, 8)
    gasket = ring(54, 40, 2, -1)
    bolt = disc(8, 62, -28).union(hexagon_head(24, 10).translate((0, 0, 23)))
    nut = hexagon_head(24, 12).cut(disc(8, 14, -1))
    fastener = cq.Assembly(name="fastener")
    fastener.add(bolt, name="bolt", color=DARK)
    fastener.add(nut, name="nut", loc=at(0, 0, -23, (1, 0, 0), 180), color=BRASS)
    joint = cq.Assembly(name="flange_joint")
    joint.add(half, name="flange.1", loc=at(0, 0, 3), color=STEEL)
    joint.add(half, name="flange.2", loc=at(0, 0, -3, (1, 0, 0), 180), color=STEEL)
    joint.add(gasket, name="gasket", color=GREEN)
    for i, (x, y) in enumerate(bolt_circle(80, 8, 22.5)):
        joint.add(fastener, name=f"fastener.{i + 1}", loc=at(x, y, 0))
    return joint


@part("hinge", "Butt hinge: two leaves of interlocking knuckles and a headed pin")
def _hinge() -> Any:
    def leaf(knuckles: list[tuple[float, float]]) -> Any:
        body = cq.Workplane("XY").box(32, 3, 60).translate((20, 0, 30))
        for low, high in knuckles:
            arm = cq.Workplane("XY").box(5, 3, high - low).translate((4.5, 0, (low + high) / 2))
            body = body.union(arm).union(disc(5, high - low, low))
        body = body.cut(disc(2.6, 70, -5))
        holes = [rod((x, -3, z), (x, 3, z), 2.2) for x, z in ((28, 10), (20, 30), (28, 50))]
        return without(body, holes)

    pin = turned([(0, -3), (4, -3), (4, 0), (2.5, 0), (2.5, 61), (2, 62), (0, 62)])
    first = leaf([(0, 11.8), (24.2, 35.8), (48.2, 60)])
    second = leaf([(12.2, 23.8), (36.2, 47.8)])
    hinge = cq.Assembly(name="hinge").add(first, name="leaf_outer", color=BRASS)
    hinge.add(second, name="leaf_inner", loc=at(0, 0, 0, (0, 0, 1), 120), color=BRASS)
    return hinge.add(pin, name="pin", color=STEEL)


@part("piston", "Piston with ring grooves, gudgeon pin, rod and two instances of a ring")
def _piston() -> Any:
    crown = turned([(0, 0), (30, 0), (30, 30), (28, 30), (28, 33), (30, 33), (30, 37), (28, 37),
                    (28, 40), (30, 40), (30, 46), (0, 50)])  # fmt: skip
    bosses = box((50, 52, 20), (0, 0, 16)).cut(box((50, 28, 20), (0, 0, 16)))
    crown = crown.cut(disc(25, 34, -1)).union(bosses.intersect(disc(28, 50)))
    crown = crown.cut(rod((0, -40, 16), (0, 40, 16), 7))
    pin = rod((0, -27, 16), (0, 27, 16), 6.9).cut(rod((0, -28, 16), (0, 28, 16), 4))
    seal = ring(30.1, 28.1, 2.8).cut(box((6, 1, 9), (29, 0, 0)))
    shank = box((12, 9, 80), (0, 0, -32)).union(rod((0, -10, 16), (0, 10, 16), 11))
    shank = shank.cut(rod((0, -11, 16), (0, 11, 16), 6.95))
    piston = cq.Assembly(name="piston").add(crown, name="crown", color=STEEL)
    piston.add(pin, name="gudgeon_pin", color=DARK).add(shank, name="rod", color=BLUE)
    piston.add(seal, name="ring.1", loc=at(0, 0, 30.1), color=BRASS)
    return piston.add(seal, name="ring.2", loc=at(0, 0, 37.1, (0, 0, 1), 180), color=BRASS)


@part("gear_pair", "Two meshing spur gears of 12 and 20 teeth on their shafts")
def _gear_pair() -> Any:
    small = spur(2, 12, 10).cut(disc(5, 20, -1))
    large = spur(2, 20, 10).cut(disc(6, 20, -1))
    pair = cq.Assembly(name="gear_pair").add(small, name="pinion", color=BRASS)
    pair.add(large, name="wheel", loc=at(32.1, 0, 0, (0, 0, 1), 9), color=STEEL)
    pair.add(disc(4.95, 40, -15), name="shaft_pinion", color=DARK)
    return pair.add(disc(5.95, 40, -15), name="shaft_wheel", loc=at(32.1, 0, 0), color=DARK)


@part("caster", "Caster wheel: plate, fork, axle, wheel with a tyre")
def _caster() -> Any:
    plate = without(
        box((60, 46, 4), (0, 0, 60)),
        [rod((x, y, 55), (x, y, 65), 3) for x in (-23, 23) for y in (-16, 16)],
    )
    fork = box((30, 34, 4), (0, 0, 52)).union(disc(10, 5, 53.5))
    for y in (-15.5, 15.5):
        cheek = cq.Workplane("XZ", origin=(0, y + 1.5, 0)).polyline(
            [(-15, 54), (15, 54), (26, 0), (6, -6)]
        )
        fork = fork.union(cheek.close().extrude(3))
    fork = fork.cut(rod((14, -30, 6), (14, 30, 6), 4))
    tyre = turned([(20, -10), (30, -10), (32, -8), (32, 8), (30, 10), (20, 10)])
    hub = turned([(4.1, -12), (8, -12), (8, -9), (20, -9), (20, 9), (8, 9), (8, 12), (4.1, 12)])
    wheel = cq.Assembly(name="wheel").add(tyre, name="tyre", color=DARK)
    wheel.add(hub, name="hub", color=RED)
    caster = cq.Assembly(name="caster").add(plate, name="plate", color=STEEL)
    caster.add(fork, name="fork", color=STEEL)
    caster.add(rod((14, -20, 6), (14, 20, 6), 3.9), name="axle", color=BRASS)
    return caster.add(wheel, name="wheel", loc=at(14, 0, 6, (1, 0, 0), 90))


@part("coupling_jaw", "Jaw coupling: two equal hubs and an elastic spider between them")
def _coupling() -> Any:
    segment = ring(25, 11, 14, 14).intersect(box((60, 14, 60), (30, 0, 20)))
    hub = joined(ring(25, 8, 14), around(segment, 3))
    arm = box((15, 9.5, 13), (17, 0, 0))
    spider = joined(ring(10.5, 6, 13, -6.5), around(arm, 6))
    coupling = cq.Assembly(name="coupling_jaw")
    coupling.add(hub, name="hub.1", loc=at(0, 0, -22), color=STEEL)
    coupling.add(hub, name="hub.2", loc=at(0, 0, 22, (1, 0, 0), 180), color=STEEL)
    return coupling.add(spider, name="spider", loc=at(0, 0, 0, (0, 0, 1), 30), color=RED)


@part("block_machined", "Machined block whose seats and datum faces have names and colours")
def _machined() -> Any:
    body = box((60, 40, 24)).edges("|Z").fillet(4).cut(disc(11, 40, -20)).cut(disc(16, 8, 6))
    body = body.cut(rod((20, -30, 2), (20, 30, 2), 3)).cut(rod((-20, -30, 2), (-20, 30, 2), 3))
    bore = body.faces(cq.selectors.NearestToPointSelector((11, 0, -5))).val()
    faces = [
        (body.faces("<Z").val(), "datum_a", BLUE),
        (body.faces(">Z").val(), "top", GREEN),
        (bore, "bearing_seat", RED),
    ]
    block = cq.Assembly(name="block_machined")
    return block.add(body, name="block", color=STEEL, metadata={"faces": faces})


@part("shelf_brackets", "A bracket and its mirror image, joined by two shelf rods")
def _mirrored() -> Any:
    outline = [(0, 0), (60, 0), (60, 6), (14, 12), (6, 50), (0, 50)]
    left = cq.Workplane("XZ").polyline(outline).close().extrude(5)
    left = left.union(box((6, 18, 50), (3, -14, 25)).edges("|X").fillet(3))
    left = without(left, [rod((-1, -16, z), (7, -16, z), 2.5) for z in (8, 42)])
    right = left.mirror("XZ").translate((0, 90, 0))
    shelf = cq.Assembly(name="shelf_brackets").add(left, name="bracket_left", color=BLUE)
    shelf.add(right, name="bracket_right", color=BLUE)
    bar = rod((0, 0, 0), (0, 90, 0), 3)
    shelf.add(bar, name="bar.1", loc=at(20, 0, 14), color=STEEL)
    return shelf.add(bar, name="bar.2", loc=at(50, 0, 10.5), color=STEEL)
