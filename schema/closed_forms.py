"""Points, normals and principal curvatures of elementary surfaces, in their own axes.

No derivative is formed: in orthonormal axes each of them is known beforehand.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from breplake.schema.namespace import Array, namespace, vanishing

__all__ = ["CLOSED_FORMS", "Local", "moved_along_normal"]


class Local(NamedTuple):
    """Elementary surfaces in their own axes, towards du x dv.

    Attributes
    ----------
    point, normal : tuple of array
        x, y and z, each ``(n,)``.
    bends : tuple of array
        k_min and k_max, ``(n,)``.
    defined : array or None
        ``(n,)`` bool: normal and curvature are defined; None if everywhere.
    """

    point: tuple[Array, Array, Array]
    normal: tuple[Array, Array, Array]
    bends: tuple[Array, Array]
    defined: Array | None


def _sorted(k1: Array, k2: Array) -> tuple[Array, Array]:
    xp = namespace(k1)
    return xp.minimum(k1, k2), xp.maximum(k1, k2)


def _plane(size: Array, side: Array, least: Array, u: Array, v: Array) -> Local:
    zero = 0 * side
    return Local((u, v, zero), (zero, zero, side), (zero, zero), None)


def _cylinder(size: Array, side: Array, least: Array, u: Array, v: Array) -> Local:
    xp = namespace(u)
    c, s = xp.cos(u), xp.sin(u)
    radius = size[0]
    bend = -side / radius
    point, normal = (radius * c, radius * s, v), (side * c, side * s, 0 * side)
    return Local(point, normal, _sorted(bend, 0 * bend), None)


def _cone(size: Array, side: Array, least: Array, u: Array, v: Array) -> Local:
    xp = namespace(u)
    radius, sine, cosine = size
    c, s = xp.cos(u), xp.sin(u)
    distance = radius + v * sine
    defined = abs(distance) > least[0]
    safe = xp.where(defined, distance, 1.0)
    side = xp.where(distance < 0, -side, side)
    bend = -side * cosine / safe
    outward = side * cosine
    normal = outward * c, outward * s, -side * sine
    point = distance * c, distance * s, v * cosine
    return Local(point, normal, _sorted(bend, 0 * bend), defined)


def _sphere(size: Array, side: Array, least: Array, u: Array, v: Array) -> Local:
    xp = namespace(u)
    radius = size[0]
    c, s = xp.cos(u), xp.sin(u)
    flat, up = xp.cos(v), xp.sin(v)
    x, y = flat * c, flat * s
    side = xp.where(flat < -vanishing(v), -side, side)
    bend = -side / radius
    point = radius * x, radius * y, radius * up
    return Local(point, (side * x, side * y, side * up), (bend, bend), None)


def _torus(size: Array, side: Array, least: Array, u: Array, v: Array) -> Local:
    xp = namespace(u)
    c, s = xp.cos(u), xp.sin(u)
    flat, up = xp.cos(v), xp.sin(v)
    distance = size[0] + size[1] * flat
    defined = abs(distance) > least[0]
    side = xp.where(distance < 0, -side, side)
    around = -side * flat / xp.where(defined, distance, 1.0)
    outward = side * flat
    point = distance * c, distance * s, size[1] * up
    normal = outward * c, outward * s, side * up
    return Local(point, normal, _sorted(around, -side / size[1]), defined)


CLOSED_FORMS: Final[dict[str, Callable[[Array, Array, Array, Array, Array], Local]]] = {
    "Plane": _plane,
    "Cylinder": _cylinder,
    "Cone": _cone,
    "Sphere": _sphere,
    "Torus": _torus,
}
"""By type of patch: sizes ``(3, n)`` as of ``elementary.ELEMENTARY``, handedness of the axes
(1 or -1) ``(n,)``, least lengths of du and dv ``(2, n)`` and parameters ``(n,)``."""


def moved_along_normal(
    point: Array, normal: Array, k_min: Array, k_max: Array, distance: Array
) -> tuple[Array, Array, Array, Array]:
    """Offset points, normals ``(3, n)`` and curvatures ``(n,)`` by distances ``(n,)``.

    A principal curvature k becomes k / (1 - k d). Where one of 1 - k d is negative, the
    offset has passed a centre of curvature and du x dv turns round; where one is zero, the
    offset has no normal.
    """
    xp = namespace(point)
    one, two = 1 - k_min * distance, 1 - k_max * distance
    least = vanishing(point)
    defined = (abs(one) > least) & (abs(two) > least)
    side = xp.where((one < 0) != (two < 0), -1.0, 1.0)
    k1, k2 = (side * k / xp.where(defined, part, 1.0) for k, part in ((k_min, one), (k_max, two)))
    return (
        point + distance * normal,
        xp.where(defined, side * normal, xp.nan),
        xp.where(defined, xp.minimum(k1, k2), xp.nan),
        xp.where(defined, xp.maximum(k1, k2), xp.nan),
    )
