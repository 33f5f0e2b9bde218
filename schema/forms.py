"""Normals and principal curvatures from derivatives: the fundamental forms of a surface.

Vectors are ``(3, n)``, numbers ``(n,)``, of numpy or torch. Quotients are guarded before they
are taken, so that gradients stay finite where a quantity is undefined.
"""

from __future__ import annotations

from typing import NamedTuple

from breplake.schema.namespace import Array, cross, dot, namespace, vanishing

__all__ = ["Principal", "bent", "principal", "unit_normal"]


class Principal(NamedTuple):
    """Principal curvatures ``(n,)`` and their directions ``(3, n)``; NaN where undefined."""

    k_min: Array
    k_max: Array
    d_min: Array
    d_max: Array


class _First(NamedTuple):
    """First fundamental form, guarded: what is undefined is 1 or 0."""

    defined: Array
    a: Array  # length of du
    b: Array  # part of dv along du
    c: Array  # part of dv across du: a c is the length of du x dv


def _guarded_root(square: Array, defined: Array) -> Array:
    """Return square roots, 1 where undefined."""
    xp = namespace(square)
    return xp.sqrt(xp.where(defined, square, 1.0))


def _regular(du: Array, dv: Array, area: Array, least: Array) -> tuple[Array, Array, Array]:
    """Return where a normal is defined, |du|^2 and |du x dv|^2; `area` is du x dv."""
    a2, b2, area2 = dot(du, du), dot(dv, dv), dot(area, area)
    defined = (a2 > least[0] * least[0]) & (b2 > least[1] * least[1])
    return defined & (area2 > vanishing(du) ** 2 * (a2 * b2)), a2, area2


def unit_normal(du: Array, dv: Array, least: Array) -> Array:
    """Return the unit normals du x dv / |du x dv|, NaN where undefined.

    Parameters
    ----------
    du, dv : array
        ``(3, n)`` tangents.
    least : array
        ``(2, n)`` lengths of du and dv at and below which rounding decides them.
    """
    xp = namespace(du)
    area = cross(du, dv)
    defined, _, area2 = _regular(du, dv, area, least)
    return xp.where(defined, area / _guarded_root(area2, defined), xp.nan)


def _first_form(du: Array, dv: Array, area: Array, least: Array) -> _First:
    """Return the first fundamental form; `area` is du x dv."""
    xp = namespace(du)
    defined, a2, area2 = _regular(du, dv, area, least)
    a, width = _guarded_root(a2, defined), _guarded_root(area2, defined)
    return _First(defined, a, xp.where(defined, dot(du, dv), 0.0) / a, width / a)


def _second_form(
    first: _First, seconds: tuple[Array, Array, Array], normal: Array
) -> tuple[Array, Array, Array]:
    """Return the second fundamental form in an orthonormal basis of the tangent plane.

    Eigenvalues of a symmetric matrix are then as accurate as its entries.
    """
    xp = namespace(normal)
    normal = xp.where(first.defined, normal, 0.0)
    uu, uv, vv = (xp.where(first.defined, dot(part, normal), 0.0) for part in seconds)
    _, a, b, c = first
    s11 = uu / a / a
    mixed = uv / a
    s12 = (mixed - b * s11) / c
    return s11, s12, (vv - b * (2 * mixed - b * s11)) / c / c


def _tangent(s11: Array, s12: Array, s22: Array) -> Array:
    """Return the tangent of the angle that diagonalises symmetric 2 x 2 matrices.

    One Jacobi rotation: unlike mean and difference, it keeps a small eigenvalue beside a
    large one exact when the matrix is diagonal already, as it is in the parameters of most
    surfaces.
    """
    xp = namespace(s11)
    half = (s22 - s11) / 2
    square = half * half + s12 * s12
    turned = square > 0
    below = abs(half) + _guarded_root(square, turned)
    return xp.where(turned, xp.where(half < 0, -s12, s12) / below, 0.0)


def bent(
    du: Array, dv: Array, seconds: tuple[Array, Array, Array], least: Array
) -> tuple[Array, Array, Array]:
    """Return unit normals ``(3, n)``, k_min and k_max ``(n,)`` towards them; NaN if undefined.

    Parameters
    ----------
    du, dv : array
        ``(3, n)`` tangents.
    seconds : tuple of array
        duu, duv and dvv, each ``(3, n)``.
    least : array
        ``(2, n)`` as in `unit_normal`.
    """
    xp = namespace(du)
    area = cross(du, dv)
    first = _first_form(du, dv, area, least)
    normal = area / (first.a * first.c)
    s11, s12, s22 = _second_form(first, seconds, normal)
    shift = _tangent(s11, s12, s22) * s12
    k1, k2 = s11 - shift, s22 + shift
    return (
        xp.where(first.defined, normal, xp.nan),
        xp.where(first.defined, xp.minimum(k1, k2), xp.nan),
        xp.where(first.defined, xp.maximum(k1, k2), xp.nan),
    )


def principal(
    du: Array, dv: Array, seconds: tuple[Array, Array, Array], normal: Array, least: Array
) -> Principal:
    """Return principal curvatures towards `normal`, and their directions.

    Parameters
    ----------
    du, dv, seconds, least
        As in `bent`.
    normal : array
        ``(3, n)`` unit normals of either side.
    """
    xp = namespace(du)
    first = _first_form(du, dv, cross(du, dv), least)
    s11, s12, s22 = _second_form(first, seconds, normal)
    tangent = _tangent(s11, s12, s22)
    k1, k2 = s11 - tangent * s12, s22 + tangent * s12
    cosine = 1 / xp.sqrt(1 + tangent * tangent)
    sine = tangent * cosine
    t1 = du / first.a
    t2 = (dv - first.b * t1) / first.c
    d1, d2 = cosine * t1 - sine * t2, sine * t1 + cosine * t2
    swap = k1 > k2
    return Principal(
        xp.where(first.defined, xp.where(swap, k2, k1), xp.nan),
        xp.where(first.defined, xp.where(swap, k1, k2), xp.nan),
        xp.where(first.defined, xp.where(swap, d2, d1), xp.nan),
        xp.where(first.defined, xp.where(swap, d1, d2), xp.nan),
    )
