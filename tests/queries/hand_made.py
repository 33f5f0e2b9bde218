"""Solids in which ``breplake check`` must find no fault, each with what is peculiar to its kind."""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..rows import vec
from .solid import Solid

TAU = 2 * math.pi


def grid(n: int, m: int, *, wrap_n: bool = False, wrap_m: bool = False) -> list[tuple[int, ...]]:
    """Triangles of n x m places, both axes rising, counter-clockwise in (first, second)."""
    triangles = []
    for i in range(n if wrap_n else n - 1):
        for j in range(m if wrap_m else m - 1):
            a, b = i * m + j, (i + 1) % n * m + j
            c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
            triangles += [(a, b, c), (a, c, d)]
    return triangles


def flat(location: Any, x: Any, y: Any, sign: float = 1.0) -> Callable[[Any, Any], tuple[Any, ...]]:
    """Truth on a plane."""
    x, y, location = (np.asarray(a, float) for a in (x, y, location))
    normal = sign * np.cross(x, y)
    return lambda u, v: (location + u * x + v * y, normal, 0.0, 0.0, x, y)


def plane_row(location: Any, x: Any, y: Any, area: float, sign: float = 1.0) -> dict[str, Any]:
    z = np.cross(x, y)
    row = {"location": vec(location), "x_axis": vec(x), "y_axis": vec(y), "z_axis": vec(z)}
    coefficients = [*map(float, z), -float(z @ np.asarray(location, float))]
    return row | {"type": "Plane", "area": area, "reversed": sign < 0, "coefficients": coefficients}


def line(
    solid: Solid, a: Any, b: Any, uses: Any, ends: tuple[int, int], kind: str, n: int = 4
) -> None:
    a, b = np.asarray(a, float), np.asarray(b, float)
    length = float(np.linalg.norm(b - a))
    direction = (b - a) / length
    row = {"type": "Line", "location": vec(a), "direction": vec(direction), "length": length}
    t = np.linspace(0, length, n)
    solid.curve(row | {"kind": kind}, t, lambda s: a + s * direction, uses, ends)


def circle(solid: Solid, centre: Any, r: float, x: Any, y: Any, n: int, uses: Any, corner: int,
           kind: str) -> None:  # fmt: skip
    centre, x, y = (np.asarray(a, float) for a in (centre, x, y))
    row = {"type": "Circle", "location": vec(centre), "x_axis": vec(x), "y_axis": vec(y),
           "z_axis": vec(np.cross(x, y)), "radius": r, "length": TAU * r, "kind": kind}  # fmt: skip
    t = np.linspace(0, TAU, n + 1)
    at = lambda s: centre + r * (math.cos(s % TAU) * x + math.sin(s % TAU) * y)  # noqa: E731
    solid.curve(row, t, at, uses, (corner, corner))


def box() -> Solid:
    """A box 3 x 2 x 1 of six planes; those at the low sides are reversed."""
    solid, size, n = Solid("box"), np.array([3.0, 2.0, 1.0]), 4
    for axis in range(3):
        x, y = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        a, b = x @ size, y @ size
        uv = [(u, v) for u in np.linspace(0, a, n) for v in np.linspace(0, b, n)]
        for side, sign in ((0, -1.0), (1, 1.0)):
            at = side * size * np.eye(3)[axis]
            turned = grid(n, n) if side else [t[::-1] for t in grid(n, n)]
            solid.patch(plane_row(at, x, y, a * b, sign), uv, flat(at, x, y, sign), turned)
    corner = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    for c in corner:
        solid.corner(c * size)
    for axis in range(3):
        one, two = (axis + 1) % 3, (axis + 2) % 3
        for s, t in ((0, 0), (0, 1), (1, 0), (1, 1)):
            start = np.zeros(3, int)
            start[[one, two]] = s, t
            end = start + np.eye(3, dtype=int)[axis]
            # the patch normal to `one` has axes (two, axis): its loop runs along +axis at high two
            along = (t == 1) == (s == 1)
            uses = [(2 * one + s, 0, not along), (2 * two + t, 0, along)]
            ids = (corner.index(tuple(start)), corner.index(tuple(end)))
            line(solid, start * size, end * size, uses, ids, "sharp", n)
    solid.finish(volume=6.0, closed=True)
    return order_loops(solid)


def order_loops(solid: Solid) -> Solid:
    """Bring the coedges of each loop into walking order."""
    curves, done = solid.rows("curves"), []
    for key in sorted({(c["patch_id"], c["loop"]) for c in solid.rows("coedges")}):
        left = [c for c in solid.rows("coedges") if (c["patch_id"], c["loop"]) == key]
        ends = {}
        for c in left:
            curve = curves[c["curve_id"]]
            both = curve["start_corner"], curve["end_corner"]
            ends[id(c)] = both[::-1] if c["reversed"] else both
        walk = [left.pop(0)]
        while left:
            after = [c for c in left if ends[id(c)][0] == ends[id(walk[-1])][1]]
            follower = min(
                after, key=lambda c: ends[id(c)][0] != ends[id(c)][1]
            )  # closed ones first
            left.remove(follower)
            walk.append(follower)
        done += [c | {"place": i} for i, c in enumerate(walk)]
    solid.tables["coedges"] = done
    return solid


def disc(solid: Solid, z: float, r: float, n: int, sign: float) -> None:
    """A plane disc of n x 2 rings about the z axis, and its middle."""
    x, y = np.eye(3)[:2]
    polar = [(r * j / 2 * math.cos(TAU * i / n), r * j / 2 * math.sin(TAU * i / n))
             for i in range(n) for j in (1, 2)]  # fmt: skip
    # places run outwards, then around: (j, i) is clockwise seen from +z
    triangles = [t[::-1] for t in grid(n, 2, wrap_n=True)]
    triangles += [(2 * n, 2 * i, 2 * ((i + 1) % n)) for i in range(n)]
    if sign < 0:
        triangles = [t[::-1] for t in triangles]
    at = (0.0, 0.0, z)
    row = plane_row(at, x, y, math.pi * r * r, sign)
    solid.patch(row, [*polar, (0.0, 0.0)], flat(at, x, y, sign), triangles)


def cylinder() -> Solid:
    """Radius 2, height 3, with a seam."""
    solid, r, h, n, m = Solid("cylinder"), 2.0, 3.0, 24, 5

    def truth(u: float, v: float) -> tuple[Any, ...]:
        out = np.array([math.cos(u), math.sin(u), 0.0])
        around = np.array([-math.sin(u), math.cos(u), 0.0])
        return r * out + [0, 0, v], out, -1 / r, 0.0, around, np.array([0, 0, 1.0])

    row = {"type": "Cylinder", "radius": r, "location": vec([0, 0, 0]), "x_axis": vec([1, 0, 0]),
           "y_axis": vec([0, 1, 0]), "z_axis": vec([0, 0, 1]), "area": TAU * r * h,
           "u_closed": True, "u_periodic": True,
           "coefficients": [1.0, 1.0, 0, 0, 0, 0, 0, 0, 0, -r * r]}  # fmt: skip
    uv = [(TAU * i / n, h * j / (m - 1)) for i in range(n) for j in range(m)]
    solid.patch(row, uv, truth, grid(n, m, wrap_n=True))
    disc(solid, 0.0, r, n, -1.0)
    disc(solid, h, r, n, 1.0)
    low, high = solid.corner([r, 0, 0]), solid.corner([r, 0, h])
    x, y = np.eye(3)[:2]
    circle(solid, [0, 0, 0], r, x, y, n, [(0, 0, False), (1, 0, True)], low, "sharp")
    line(solid, [r, 0, 0], [r, 0, h], [(0, 0, False), (0, 0, True)], (low, high), "seam", m)
    circle(solid, [0, 0, h], r, x, y, n, [(0, 0, True), (2, 0, False)], high, "sharp")
    return order_loops(solid.finish(volume=math.pi * r * r * h, closed=True))


def cone() -> Solid:
    """Apex up at z = 3, base of radius 1.5 at z = 0: OCCT's angle is negative then."""
    solid, r, h, n, m = Solid("cone"), 1.5, 3.0, 24, 6
    angle = -math.atan2(r, h)
    slant = math.hypot(r, h)

    def truth(u: float, v: float) -> tuple[Any, ...]:
        here = r + v * math.sin(angle)
        out = np.array([math.cos(u), math.sin(u), 0.0])
        around = np.array([-math.sin(u), math.cos(u), 0.0])
        up = math.sin(angle) * out + [0, 0, math.cos(angle)]
        p = here * out + [0, 0, v * math.cos(angle)]
        if here < 1e-12:
            nothing = np.full(3, math.nan)
            return np.array([0, 0, h]), nothing, math.nan, math.nan, nothing, nothing
        normal = math.cos(angle) * out - [0, 0, math.sin(angle)]
        return p, normal, -math.cos(angle) / here, 0.0, around, up

    k = math.tan(angle) ** 2  # x^2 + y^2 = (r + z tan a)^2
    row = {"type": "Cone", "radius": r, "angle": angle, "apex": vec([0, 0, h]),
           "location": vec([0, 0, 0]), "x_axis": vec([1, 0, 0]), "y_axis": vec([0, 1, 0]),
           "z_axis": vec([0, 0, 1]), "area": math.pi * r * slant, "u_closed": True,
           "u_periodic": True,
           "coefficients": [1.0, 1.0, -k, 0, 0, 0, 0, 0, -r * math.tan(angle), -r * r]}  # fmt: skip
    uv = [(TAU * i / n, slant * j / m) for i in range(n) for j in range(m)]
    triangles = grid(n, m, wrap_n=True)
    triangles += [(n * m, i * m + m - 1, (i + 1) % n * m + m - 1) for i in range(n)]
    solid.patch(row, [*uv, (0.0, slant)], truth, triangles)
    disc(solid, 0.0, r, n, -1.0)
    low, high = solid.corner([r, 0, 0]), solid.corner([0, 0, h])
    x, y = np.eye(3)[:2]
    circle(solid, [0, 0, 0], r, x, y, n, [(0, 0, False), (1, 0, True)], low, "sharp")
    line(solid, [r, 0, 0], [0, 0, h], [(0, 0, False), (0, 0, True)], (low, high), "seam", m + 1)
    tip = {"type": "Other", "kind": "degenerate"}
    solid.curve(tip, [0.0], lambda _: [0, 0, h], [(0, 0, True)], (high, high))
    solid.rows("curves")[-1] |= {"vert_indices": None, "vert_parameters": None, "t_max": TAU}
    return order_loops(solid.finish(volume=math.pi * r * r * h / 3, closed=True))


def torus() -> Solid:
    """Radii 3 and 1, reversed: the body is outside, so its volume counts negative."""
    solid, big, small, n, m = Solid("torus"), 3.0, 1.0, 40, 20

    def truth(u: float, v: float) -> tuple[Any, ...]:
        out = np.array([math.cos(u), math.sin(u), 0.0])
        around = np.array([-math.sin(u), math.cos(u), 0.0])
        up = np.array([0, 0, 1.0])
        normal = math.cos(v) * out + math.sin(v) * up
        across = -math.sin(v) * out + math.cos(v) * up
        k = math.cos(v) / (big + small * math.cos(v))
        return big * out + small * normal, -normal, k, 1 / small, around, across

    row = {"type": "Torus", "max_radius": big, "min_radius": small, "location": vec([0, 0, 0]),
           "x_axis": vec([1, 0, 0]), "y_axis": vec([0, 1, 0]), "z_axis": vec([0, 0, 1]),
           "area": TAU * TAU * big * small, "reversed": True, "u_closed": True, "v_closed": True,
           "u_periodic": True, "v_periodic": True}  # fmt: skip
    uv = [(TAU * i / n, TAU * j / m) for i in range(n) for j in range(m)]
    solid.patch(row, uv, truth, [t[::-1] for t in grid(n, m, wrap_n=True, wrap_m=True)])
    corner = solid.corner([big + small, 0, 0])
    x, y, z = np.eye(3)
    both = [(0, 0, False), (0, 0, True)]
    circle(solid, [0, 0, 0], big + small, x, y, n, both, corner, "seam")
    circle(solid, [big, 0, 0], small, x, z, m, both, corner, "seam")
    return order_loops(solid.finish(volume=-2 * math.pi**2 * big * small**2, closed=True))


def saddle() -> Solid:
    """The open sheet z = x y / 4 over the square of side 2: a spline of degree 1 x 1."""
    solid, n = Solid("saddle"), 9

    def truth(u: float, v: float) -> tuple[Any, ...]:
        p, a, b = np.array([u, v, u * v / 4]), u / 4, v / 4  # z_y and z_x
        w = math.sqrt(1 + a * a + b * b)
        first = np.array([[1 + b * b, a * b], [a * b, 1 + a * a]])
        second = np.array([[0, 0.25], [0.25, 0]]) / w
        k, d = np.linalg.eig(np.linalg.solve(first, second))
        order = np.argsort(k)
        tangents = np.array([[1, 0, b], [0, 1, a]])
        low, high = (d[:, i] @ tangents for i in order)
        unit = lambda x: x / np.linalg.norm(x)  # noqa: E731
        return p, np.array([-b, -a, 1]) / w, *k[order], unit(low), unit(high)

    poles = [[vec([u, v, u * v / 4]) for v in (-1, 1)] for u in (-1, 1)]
    nodes, weights = np.polynomial.legendre.leggauss(20)
    u, v = np.meshgrid(nodes, nodes)
    area = weights @ np.sqrt(1 + (u * u + v * v) / 16) @ weights
    row = {"type": "BSpline", "u_degree": 1, "v_degree": 1, "u_rational": False,
           "v_rational": False, "continuity": 99, "poles": poles, "u_knots": [-1.0, -1, 1, 1],
           "v_knots": [-1.0, -1, 1, 1], "area": float(area)}  # fmt: skip
    ticks = np.linspace(-1, 1, n)
    solid.patch(row, [(u, v) for u in ticks for v in ticks], truth, grid(n, n))
    at = [[-1, -1, 0.25], [1, -1, -0.25], [1, 1, 0.25], [-1, 1, -0.25]]
    ids = [solid.corner(p) for p in at]
    for i in range(4):
        j = (i + 1) % 4
        line(solid, at[i], at[j], [(0, 0, False)], (ids[i], ids[j]), "boundary", n)
    return order_loops(solid.finish(volume=None, closed=False))


def wires() -> Solid:
    """One free curve of each conic, without patch and mesh."""
    solid = Solid("wires")
    x, y, z = np.eye(3)
    frame = {"location": vec([1, 2, 3]), "x_axis": vec(x), "y_axis": vec(y), "z_axis": vec(z)}
    frame |= {"kind": "free", "vert_indices": None, "vert_parameters": None, "length": 1.0}
    conics = {
        "Ellipse": {"x_radius": 5.0, "y_radius": 4.0,
                    "focus1": vec([4, 2, 3]), "focus2": vec([-2, 2, 3])},
        "Hyperbola": {"x_radius": 3.0, "y_radius": 4.0,
                      "focus1": vec([6, 2, 3]), "focus2": vec([-4, 2, 3])},
        "Parabola": {"focal": 2.0, "focus1": vec([3, 2, 3])},
    }  # fmt: skip
    for name, row in conics.items():
        ends = solid.corner([0, 0, 0]), solid.corner([1, 0, 0])
        solid.curve(frame | row | {"type": name}, [0.0, 1.0], lambda _: [0, 0, 0], [], ends)
        solid.rows("curves")[-1] |= {"vert_indices": None, "vert_parameters": None}
    return solid.finish(volume=None, closed=False)


MAKERS = {f.__name__: f for f in (box, cylinder, cone, torus, saddle, wires)}


@functools.cache
def made(name: str) -> Solid:
    return MAKERS[name]()


def fresh(name: str) -> Solid:
    return copy.deepcopy(made(name))
