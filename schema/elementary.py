"""Closed forms of planes, surfaces of revolution and extrusions.

Every kernel takes axes ``(12, n)`` (location, x, y, z axis), sizes ``(3, n)``, parameters
``(n,)`` and the order wanted, and returns point, du, dv, duu, duv, dvv and so on, each
``(3, n)``: the derivatives of ``series.indices(2, order)``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

from breplake.schema.namespace import Array, cross, dot, namespace, vanishing
from breplake.schema.series import indices

__all__ = ["ELEMENTARY", "extruded", "revolved", "sphere_curvature"]

Jet: TypeAlias = list[Array]
Profile: TypeAlias = tuple[list[Array], list[Array]]
"""Distance from the axis and height along it, each with its derivatives by v, as far as
they do not repeat or vanish."""


def _plane(axes: Array, size: Array, u: Array, v: Array, order: int) -> Jet:
    x, y = axes[3:6], axes[6:9]
    zero = 0 * x
    jet = [axes[0:3] + (u * x + v * y), x, y]
    return [*jet, *[zero] * (len(indices(2, order)) - len(jet))]


def _turned(axes: Array, u: Array, profile: Profile, order: int) -> Jet:
    """Turn a profile about the z axis, from the x axis towards the y axis."""
    xp = namespace(u)
    x, y, z = axes[3:6], axes[6:9], axes[9:12]
    cosine, sine = xp.cos(u), xp.sin(u)
    outward, along = cosine * x + sine * y, cosine * y - sine * x
    distance, height = profile
    jet = []
    for i, j in indices(2, order):
        side = distance[j] * (along if i % 2 else outward)
        side = -side if i % 4 > 1 else side
        jet.append(side if i else side + height[j] * z)
    return [axes[0:3] + jet[0], *jet[1:]]


def _straight(start: Array, slope: Array, order: int) -> list[Array]:
    """Return a linear function with its derivatives."""
    zero = 0 * slope
    return [start, zero + slope, *[zero] * (order - 1)]


def _cylinder(axes: Array, size: Array, u: Array, v: Array, order: int) -> Jet:
    radius = size[0]
    profile = _straight(radius, 0 * radius, order), _straight(v, 0 * radius + 1, order)
    return _turned(axes, u, profile, order)


def _cone(axes: Array, size: Array, u: Array, v: Array, order: int) -> Jet:
    radius, sine, cosine = size
    profile = _straight(radius + v * sine, sine, order), _straight(v * cosine, cosine, order)
    return _turned(axes, u, profile, order)


def _circle(centre: Array, radius: Array, v: Array, order: int) -> Profile:
    """Return a circle of the given distance of its centre from the axis."""
    xp = namespace(v)
    c, s = radius * xp.cos(v), radius * xp.sin(v)
    distance, height = [c, -s, -c, s], [s, c, -s, -c]
    repeats = range(order + 1)
    first = [centre + c, *(distance[k % 4] for k in repeats[1:])]
    return first, [height[k % 4] for k in repeats]


def _sphere(axes: Array, size: Array, u: Array, v: Array, order: int) -> Jet:
    return _turned(axes, u, _circle(0 * size[0], size[0], v, order), order)


def _torus(axes: Array, size: Array, u: Array, v: Array, order: int) -> Jet:
    return _turned(axes, u, _circle(size[0], size[1], v, order), order)


ELEMENTARY: Final[dict[str, Callable[[Array, Array, Array, Array, int], Jet]]] = {
    "Plane": _plane,
    "Cylinder": _cylinder,
    "Cone": _cone,
    "Sphere": _sphere,
    "Torus": _torus,
}
"""Kernel by type of patch. Sizes: radius; radius, sine and cosine of a cone's half angle;
major and minor radius of a torus."""


def sphere_curvature(curvature: Array, v: Array) -> Array:
    """Return the curvature of spheres towards du x dv, which beyond the poles turns over.

    Times dvv it is the unit normal, at the poles too, where du vanishes.

    Parameters
    ----------
    curvature : array
        ``(n,)`` of each sphere between its poles.
    v : array
        ``(n,)`` parameters.
    """
    xp = namespace(v)
    return xp.where(xp.cos(v) < -vanishing(v), -curvature, curvature)


def revolved(axes: Array, u: Array, curve: Jet, order: int) -> Jet:
    """Turn curves about the z axis by the right-hand rule.

    Parameters
    ----------
    axes : array
        ``(12, n)``; the x and y axis are not used.
    u : array
        ``(n,)`` angles.
    curve : list of array
        Point and derivatives of the curve up to `order`, each ``(3, n)``.
    order : int
        Derivatives wanted.
    """
    xp = namespace(u)
    z, cosine, sine = axes[9:12], xp.cos(u), xp.sin(u)
    turns = []  # of each derivative: along the axis, across it, and across it a quarter turn on
    for part in [curve[0] - axes[0:3], *curve[1:]]:
        height = dot(part, z) * z
        outward, along = part - height, cross(z, part)
        turns.append((height, cosine * outward + sine * along, cosine * along - sine * outward))
    jet = []
    for i, j in indices(2, order):
        height, swung, ahead = turns[j]
        side = ahead if i % 2 else swung
        side = -side if i % 4 > 1 else side
        jet.append(side if i else side + height)
    return [axes[0:3] + jet[0], *jet[1:]]


def extruded(axes: Array, v: Array, curve: Jet, order: int) -> Jet:
    """Move curves along the z axis; see `revolved`."""
    z = axes[9:12]
    zero = 0 * z
    jet = [curve[i] if not j else zero for i, j in indices(2, order)]
    jet[0] = curve[0] + v * z
    if order:
        jet[2] = z + zero
    return jet
