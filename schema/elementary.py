"""Closed forms of planes, surfaces of revolution and extrusions.

Every kernel takes axes ``(12, n)`` (location, x, y, z axis), sizes ``(3, n)`` and
parameters ``(n,)`` and returns point, du, dv, duu, duv and dvv, each ``(3, n)``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

from breplake.schema.namespace import Array, cross, dot, namespace

__all__ = ["ELEMENTARY", "extruded", "revolved", "sphere_normal"]

Jet: TypeAlias = tuple[Array, Array, Array, Array, Array, Array]
Profile: TypeAlias = tuple[Array, Array, Array, Array, Array, Array]
"""Distance from the axis and height along it, with two derivatives each, by v."""

_NEAR_POLE = 1e-9  # rad: rounding may put v this far beyond a pole of a sphere


def _plane(axes: Array, size: Array, u: Array, v: Array) -> Jet:
    x, y = axes[3:6], axes[6:9]
    zero = 0 * x
    return axes[0:3] + (u * x + v * y), x, y, zero, zero, zero


def _turned(axes: Array, u: Array, profile: Profile) -> Jet:
    """Turn a profile about the z axis, from the x axis towards the y axis."""
    xp = namespace(u)
    x, y, z = axes[3:6], axes[6:9], axes[9:12]
    cosine, sine = xp.cos(u), xp.sin(u)
    outward, along = cosine * x + sine * y, cosine * y - sine * x
    distance, distance1, distance2, height, height1, height2 = profile
    side = distance * outward
    return (
        axes[0:3] + (side + height * z),
        distance * along,
        distance1 * outward + height1 * z,
        -side,
        distance1 * along,
        distance2 * outward + height2 * z,
    )


def _cylinder(axes: Array, size: Array, u: Array, v: Array) -> Jet:
    zero = namespace(v).zeros_like(v)
    return _turned(axes, u, (size[0], zero, zero, v, zero + 1, zero))


def _cone(axes: Array, size: Array, u: Array, v: Array) -> Jet:
    radius, sine, cosine = size
    zero = namespace(v).zeros_like(v)
    return _turned(axes, u, (radius + v * sine, sine, zero, v * cosine, cosine, zero))


def _sphere(axes: Array, size: Array, u: Array, v: Array) -> Jet:
    xp = namespace(v)
    c, s = size[0] * xp.cos(v), size[0] * xp.sin(v)
    return _turned(axes, u, (c, -s, -c, s, c, -s))


def _torus(axes: Array, size: Array, u: Array, v: Array) -> Jet:
    xp = namespace(v)
    c, s = size[1] * xp.cos(v), size[1] * xp.sin(v)
    return _turned(axes, u, (size[0] + c, -s, -c, s, c, -s))


ELEMENTARY: Final[dict[str, Callable[[Array, Array, Array, Array], Jet]]] = {
    "Plane": _plane,
    "Cylinder": _cylinder,
    "Cone": _cone,
    "Sphere": _sphere,
    "Torus": _torus,
}
"""Kernel by type of patch. Sizes: radius; radius, sine and cosine of a cone's half angle;
major and minor radius of a torus."""


def sphere_normal(axes: Array, size: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """Return the direction of du x dv on spheres, and the curvature towards it.

    It is exact at the poles too, where du vanishes.

    Returns
    -------
    normal : array
        ``(3, n)`` unit.
    curvature : array
        ``(n,)`` -1/radius where the normal points outward.
    """
    xp = namespace(v)
    x, y, z = axes[3:6], axes[6:9], axes[9:12]
    mirrored = dot(cross(x, y), z) < 0
    beyond = xp.cos(v) < -_NEAR_POLE
    side = xp.where(mirrored == beyond, 1.0, -1.0)
    radial = xp.cos(v) * (xp.cos(u) * x + xp.sin(u) * y) + xp.sin(v) * z
    return side * radial, -side / size[0]


def revolved(axes: Array, u: Array, curve: tuple[Array, Array, Array]) -> Jet:
    """Turn curves about the z axis by the right-hand rule.

    Parameters
    ----------
    axes : array
        ``(12, n)``; the x and y axis are not used.
    u : array
        ``(n,)`` angles.
    curve : tuple of array
        Point and two derivatives of the curve, each ``(3, n)``.
    """
    xp = namespace(u)
    z, cosine, sine = axes[9:12], xp.cos(u), xp.sin(u)

    def turned(vector: Array) -> tuple[Array, Array, Array]:
        """Return the turned vector, and its first and second derivative by u."""
        height = dot(vector, z) * z
        outward, along = vector - height, cross(z, vector)
        swung = cosine * outward + sine * along
        return height + swung, cosine * along - sine * outward, -swung

    point, du, duu = turned(curve[0] - axes[0:3])
    dv, duv, _ = turned(curve[1])
    dvv, _, _ = turned(curve[2])
    return axes[0:3] + point, du, dv, duu, duv, dvv


def extruded(axes: Array, v: Array, curve: tuple[Array, Array, Array]) -> Jet:
    """Move curves along the z axis; see `revolved`."""
    z = axes[9:12]
    zero = 0 * z
    return curve[0] + v * z, curve[1], z, curve[2], zero, zero
