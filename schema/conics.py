"""Lines and conics as p(t) = origin + a(t) A + b(t) B: the functions a and b."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

from breplake.schema.namespace import Array, namespace

__all__ = ["CONICS", "conic_jet"]

Pairs: TypeAlias = list[tuple[Array, Array]]
"""(a, b), (a', b') and so on, each ``(n,)``."""


def _cycled(values: list[Array], order: int) -> list[Array]:
    """Repeat the derivatives of a function whose derivatives come back."""
    return [values[k % len(values)] for k in range(order + 1)]


def _line(t: Array, size: Array, order: int) -> Pairs:
    zero = namespace(t).zeros_like(t)
    return [(t, zero), (zero + 1, zero), *[(zero, zero)] * (order - 1)][: order + 1]


def _ellipse(t: Array, size: Array, order: int) -> Pairs:
    xp = namespace(t)
    x, y = size
    cosine, sine = xp.cos(t), xp.sin(t)
    a = [x * cosine, -x * sine, -x * cosine, x * sine]
    b = [y * sine, y * cosine, -y * sine, -y * cosine]
    return list(zip(_cycled(a, order), _cycled(b, order), strict=True))


def _parabola(t: Array, size: Array, order: int) -> Pairs:
    zero = namespace(t).zeros_like(t)
    double = 2 * size[0]  # twice the focal length
    jet = [(t * t / (2 * double), t), (t / double, zero + 1), (1 / double, zero)]
    return [*jet, *[(zero, zero)] * (order - 2)][: order + 1]


def _hyperbola(t: Array, size: Array, order: int) -> Pairs:
    xp = namespace(t)
    x, y = size
    cosine, sine = xp.cosh(t), xp.sinh(t)
    a, b = [x * cosine, x * sine], [y * sine, y * cosine]
    return list(zip(_cycled(a, order), _cycled(b, order), strict=True))


CONICS: Final[dict[str, Callable[[Array, Array, int], Pairs]]] = {
    "Line": _line,
    "Circle": _ellipse,
    "Ellipse": _ellipse,
    "Parabola": _parabola,
    "Hyperbola": _hyperbola,
}
"""By type of curve: parameters ``(n,)``, sizes ``(2, n)`` and order to coefficients.

The sizes are the two radii (equal for a circle), or the focal length.
"""


def conic_jet(kind: str, t: Array, frame: Array, size: Array, order: int = 2) -> list[Array]:
    """Return point and derivatives up to `order`, each ``(dim, n)``, of lines or conics.

    Parameters
    ----------
    kind : str
        A key of `CONICS`.
    t : array
        ``(n,)`` parameters.
    frame : array
        ``(3 * dim, n)`` origin, A and B, in space or in a plane.
    size : array
        ``(2, n)``.
    order : int
        Derivatives wanted.
    """
    dim = len(frame) // 3
    origin, first, second = frame[:dim], frame[dim : 2 * dim], frame[2 * dim :]
    if kind == "Line":
        return [origin + t * first, first, *[0 * first] * (order - 1)][: order + 1]
    (a, b), *rest = CONICS[kind](t, size, order)
    point = origin + (a * first + b * second)
    return [point, *(a * first + b * second for a, b in rest)]
