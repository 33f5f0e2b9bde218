"""Lines and conics as p(t) = origin + a(t) A + b(t) B: the functions a and b."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from breplake.schema.namespace import Array, namespace

__all__ = ["CONICS", "conic_jet"]

Plane = tuple[tuple[Array, Array], tuple[Array, Array], tuple[Array, Array]]
"""(a, b), (a', b') and (a'', b''), each ``(n,)``."""


def _line(t: Array, size: Array) -> Plane:
    zero = namespace(t).zeros_like(t)
    return (t, zero), (zero + 1, zero), (zero, zero)


def _ellipse(t: Array, size: Array) -> Plane:
    xp = namespace(t)
    x, y = size
    cosine, sine = xp.cos(t), xp.sin(t)
    return (x * cosine, y * sine), (-x * sine, y * cosine), (-x * cosine, -y * sine)


def _parabola(t: Array, size: Array) -> Plane:
    zero = namespace(t).zeros_like(t)
    double = 2 * size[0]  # twice the focal length
    return (t * t / (2 * double), t), (t / double, zero + 1), (1 / double, zero)


def _hyperbola(t: Array, size: Array) -> Plane:
    xp = namespace(t)
    x, y = size
    cosine, sine = xp.cosh(t), xp.sinh(t)
    return (x * cosine, y * sine), (x * sine, y * cosine), (x * cosine, y * sine)


CONICS: Final[dict[str, Callable[[Array, Array], Plane]]] = {
    "Line": _line,
    "Circle": _ellipse,
    "Ellipse": _ellipse,
    "Parabola": _parabola,
    "Hyperbola": _hyperbola,
}
"""By type of curve: parameters ``(n,)`` and sizes ``(2, n)`` to coefficients.

The sizes are the two radii (equal for a circle), or the focal length.
"""


def conic_jet(kind: str, t: Array, frame: Array, size: Array) -> tuple[Array, Array, Array]:
    """Return point and two derivatives, each ``(3, n)``, of lines or conics.

    Parameters
    ----------
    kind : str
        A key of `CONICS`.
    t : array
        ``(n,)`` parameters.
    frame : array
        ``(9, n)`` origin, A and B.
    size : array
        ``(2, n)``.
    """
    origin, first, second = frame[0:3], frame[3:6], frame[6:9]
    if kind == "Line":
        return origin + t * first, first, 0 * first
    (a, b), (a1, b1), (a2, b2) = CONICS[kind](t, size)
    point = origin + (a * first + b * second)
    return point, a1 * first + b1 * second, a2 * first + b2 * second
