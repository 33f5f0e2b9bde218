"""Fasteners without a modelled thread, and rings."""

from typing import Any

import cadquery as cq

from .outlines import around, disc, hexagon, ring, rod, turned, without
from .registry import part
from .threads import hexagon_head


@part("screw_socket_head", "Socket head cap screw with a hexagon recess")
def _socket_head() -> Any:
    body = turned([(0, 0), (4.2, 0), (5, 0.8), (5, 40), (8, 40), (8, 49), (7.2, 49.8), (0, 49.8)])
    recess = cq.Workplane("XY", origin=(0, 0, 44)).polyline(hexagon(8)).close().extrude(6)
    edge = body.cut(recess).edges(cq.selectors.BoxSelector((-6, -6, 39.9), (6, 6, 40.1)))
    return edge.edges(cq.selectors.RadiusNthSelector(0)).fillet(0.6)


@part("screw_countersunk", "Countersunk screw with a cross recess")
def _countersunk() -> Any:
    body = turned([(0, 0), (2.4, 0), (3, 0.6), (3, 22), (6, 25), (6, 25.6), (0, 25.6)])
    cross = cq.Workplane("XY", origin=(0, 0, 26)).rect(6.6, 1.3).extrude(-3, taper=18)
    return body.cut(cross).cut(cross.rotate((0, 0, 0), (0, 0, 1), 90))


@part("bolt_eye", "Eye bolt whose ring is a full torus on a collar")
def _eye_bolt() -> Any:
    eye = cq.Workplane(obj=cq.Solid.makeTorus(17, 5, cq.Vector(0, 0, 64), cq.Vector(0, 1, 0)))
    shank = turned([(0, 0), (5, 0), (6, 1), (6, 36), (14, 36), (14, 41), (9, 46), (0, 50)])
    return shank.union(eye)


@part("bolt_u", "U-bolt: a half torus between two straight legs")
def _u_bolt() -> Any:
    path = cq.Workplane("XZ").moveTo(-25, 0).lineTo(-25, 50).threePointArc((0, 75), (25, 50))
    return cq.Workplane("XY", origin=(-25, 0, 0)).circle(4).sweep(path.lineTo(25, 0))


@part("nut_castle", "Castle nut: chamfer cone, six slots, hyperbola edges")
def _castle_nut() -> Any:
    body = hexagon_head(24, 14).union(disc(11, 20)).cut(disc(7, 30, -5))
    slot = cq.Workplane("XY", origin=(10, 0, 17.5)).box(20, 4, 7)
    body = without(body, around(slot, 6, 30))
    return body.cut(turned([(0, -1), (8.5, -1), (8.5, 0), (7, 1.5), (0, 1.5)]))


@part("nut_wing", "Wing nut with two rounded wings")
def _wing_nut() -> Any:
    body = turned([(0, 0), (10, 0), (7.5, 12), (0, 12)])
    wing = (
        cq.Workplane("XZ", origin=(0, 1.8, 0)).moveTo(5, 1).lineTo(9, 1)
        .threePointArc((21, 10), (24, 24)).threePointArc((19, 26), (15, 21))
        .threePointArc((11.5, 13), (5, 11)).close().extrude(3.6)
    )  # fmt: skip
    return body.union(wing).union(wing.rotate((0, 0, 0), (0, 0, 1), 180)).cut(disc(4, 20, -2))


@part("rivet_round_head", "Round-head rivet: a half sphere on a shank")
def _rivet() -> Any:
    head = cq.Workplane("XY").sphere(8).intersect(disc(10, 10))
    return head.union(turned([(0, -25), (4, -25), (4.5, -24), (4.5, 0), (0, 0)]))


@part("ring_retaining", "Retaining ring with two eyes")
def _retaining_ring() -> Any:
    body = ring(22, 18.5, 1.5).cut(cq.Workplane("XY", origin=(22, 0, 0)).rect(20, 9).extrude(2))
    for y in (-6.5, 6.5):
        eye = disc(3.6, 1.5).translate((18.5, y, 0))
        body = body.union(eye).cut(disc(1.3, 4, -1).translate((18.5, y, 0)))
    return body


@part("ring_o", "O-ring: one torus face closed in both directions")
def _o_ring() -> Any:
    return cq.Workplane(obj=cq.Solid.makeTorus(24, 2.6))


@part("clevis", "Clevis fork with its cross hole and a rounded end")
def _clevis() -> Any:
    body = cq.Workplane("XY").box(24, 24, 60).translate((0, 0, 30))
    body = body.intersect(
        rod((-20, 0, 48), (20, 0, 48), 12).union(
            cq.Workplane("XY").box(30, 30, 48).translate((0, 0, 24))
        )
    )
    body = body.cut(cq.Workplane("XY").box(12, 30, 42).translate((0, 0, 45)))
    body = body.cut(rod((-20, 0, 48), (20, 0, 48), 6)).cut(disc(5, 20, -1))
    return body.edges("<Z").chamfer(2)
