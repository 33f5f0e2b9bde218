"""Roots of many functions at once: bracketed Newton, and brackets certified by series."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np

from breplake.schema.namespace import Floats, Ints

__all__ = ["ORDER", "bracketed_roots", "isolate", "series", "series_nodes"]

ORDER: Final = 12
"""Degree of the Chebyshev series on a span; what is no such polynomial is split further."""

Values: TypeAlias = Callable[[Ints, Floats], tuple[Floats, Floats]]
"""From numbers of functions and parameters, each ``(n,)``, to values and derivatives."""

_EPS = np.finfo(np.float64).eps
_STEADY = 4 * _EPS  # of the parameters: a step this short is rounding
_ROUNDS = 200  # bisection alone needs 64; it takes over at least every other round
_RESOLVED = 1e-6  # share of a series' last terms in all, below which it is the function
_DEEPEST = 60  # halvings of a span


def bracketed_roots(function: Values, low: Floats, high: Floats, f_low: Floats) -> Floats:
    """Find a root of each function between two places where its signs differ.

    Newton's method, halving the bracket wherever a step would leave it or shrinks too slowly
    (Press et al., Numerical Recipes, "rtsafe").

    Parameters
    ----------
    function : callable
        See `Values`.
    low, high : numpy.ndarray
        ``(n,)`` ends of the brackets.
    f_low : numpy.ndarray
        ``(n,)`` values (or only their signs) at `low`.

    Returns
    -------
    numpy.ndarray
        ``(n,)`` roots to rounding.
    """
    low, high = low.copy(), high.copy()
    root = (low + high) / 2
    last = np.abs(high - low)  # (n,) step before the last
    active = np.arange(len(low))
    for _ in range(_ROUNDS):
        if not len(active):
            break
        at = root[active]
        value, slope = function(active, at)
        same = np.sign(value) == np.sign(f_low[active])
        low[active[same]] = at[same]
        high[active[~same]] = at[~same]
        with np.errstate(divide="ignore", invalid="ignore"):
            step = -value / slope
        left, right = low[active], high[active]
        newton = np.isfinite(step) & (2 * np.abs(step) < last[active])
        newton &= (at + step - left) * (at + step - right) <= 0
        trial = np.where(newton, at + step, (left + right) / 2)
        step = np.abs(trial - at)
        root[active] = np.where(value == 0, at, trial)
        last[active] = step
        size = np.maximum(np.abs(left), np.abs(right))
        moving = (value != 0) & (step > _STEADY * size) & (left != right)
        active = active[moving]
    return root


def series_nodes() -> Floats:
    """Return the Chebyshev points of the second kind in [-1, 1], ascending, ``(ORDER + 1,)``."""
    nodes: Floats = -np.cos(np.pi * np.arange(ORDER + 1) / ORDER)
    return nodes


_NODES: Final = series_nodes()
_TO_SERIES: Final = np.linalg.inv(np.polynomial.chebyshev.chebvander(_NODES, ORDER)).T
_DERIVED: Final = np.polynomial.chebyshev.chebder(np.eye(ORDER + 1), axis=1)


def series(values: Floats) -> Floats:
    """Return the Chebyshev coefficients ``(..., ORDER + 1)`` of values at `series_nodes`."""
    return np.asarray(values @ _TO_SERIES)


def isolate(function: Values, scale: Floats, low: Floats, high: Floats) -> tuple[Ints, Floats]:
    """Find all roots of smooth functions, each on an interval of its own.

    An interval is halved until the Chebyshev series shows that the function has no root there
    (its constant term exceeds all others together), or is monotone (the same of its
    derivative): then a root is bracketed by the values at the ends. It is given up where the
    function's integral over it is lost in the rounding of `scale`, and where it has no finite
    value.

    Parameters
    ----------
    function : callable
        See `Values`.
    scale : numpy.ndarray
        ``(n,)`` size of the coordinates whose derivative each function is.
    low, high : numpy.ndarray
        ``(n,)`` the intervals.

    Returns
    -------
    index : numpy.ndarray
        ``(k,)`` the function that each root belongs to.
    root : numpy.ndarray
        ``(k,)``.
    """
    index = np.arange(len(low))
    found = [(index[:0], low[:0], low[:0], low[:0])]
    for _ in range(_DEEPEST):
        if not len(index):
            break
        middle, half = (low + high) / 2, (high - low) / 2
        t = middle[:, None] + half[:, None] * _NODES
        t[:, 0], t[:, -1] = low, high  # neighbours must see the same sign where they meet
        value = function(np.repeat(index, ORDER + 1), t.ravel())[0].reshape(t.shape)
        finite = np.isfinite(value)
        terms = series(np.where(finite, value, np.nan))
        size = np.abs(terms)
        tail = 4 * size[:, -2:].sum(axis=1)
        slope = np.abs(terms @ _DERIVED)
        known = tail <= _RESOLVED * size.sum(axis=1)
        none = known & (size[:, 0] > size[:, 1:].sum(axis=1) + tail)
        monotone = known & (slope[:, 0] > slope[:, 1:].sum(axis=1) + ORDER**2 * tail)
        nowhere = ~finite.any(axis=1)
        flat = np.abs(value).max(axis=1) * 2 * half <= 8 * _EPS * scale[index]
        crossing = monotone & ~flat & (np.sign(value[:, 0]) != np.sign(value[:, -1]))
        # a root that is an end of the interval needs no search
        first = np.where(value[:, -1] == 0, high, low)
        last = np.where(value[:, 0] == 0, low, high)
        found.append((index[crossing], first[crossing], last[crossing], value[crossing, 0]))
        split = ~(none | monotone | flat | nowhere)
        index = np.tile(index[split], 2)
        low, high = (
            np.concatenate([low[split], middle[split]]),
            np.concatenate([middle[split], high[split]]),
        )
    index, low, high, f_low = (np.concatenate(part) for part in zip(*found, strict=True))
    numbers = index
    root = bracketed_roots(lambda i, t: function(numbers[i], t), low, high, f_low)
    return numbers, root
