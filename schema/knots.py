"""Knot vectors and B-spline basis functions: many of them, at many points at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from breplake.schema.namespace import Array, Bools, Floats, Ints, gather, namespace
from breplake.schema.ragged import Ragged

__all__ = ["MAX_DEGREE", "Basis", "Knots", "basis_functions"]

MAX_DEGREE: Final = 25
"""OCCT's greatest degree; splines beyond it are not valid."""


class Basis(NamedTuple):
    """Basis functions that do not vanish at some points, of a degree and of those below.

    Attributes
    ----------
    values : list of list of array
        ``degree + 1`` functions ``(n,)`` of the degree, then ``degree`` of the one below, and
        so on for as many derivatives as are wanted and do not vanish.
    slopes : list of list of array
        Derivatives are splines whose poles are differences of neighbours: by which factors
        ``(n,)``, for the first derivative, then for the second, and so on.
    """

    values: list[list[Array]]
    slopes: list[list[Array]]

    def sums(self, poles: list[Array], order: int) -> list[Array]:
        """Return the spline and its derivatives up to `order`.

        Differences of neighbours are exact, so that derivatives lose nothing where a spline
        is large, or far from the origin, and its spans are short.

        Parameters
        ----------
        poles : list of array
            ``(..., n)``, one for each function of the degree.
        order : int
            Derivatives wanted.
        """
        found = [_weighted(self.values[0], poles)]
        for functions, factors in zip(self.values[1 : order + 1], self.slopes, strict=False):
            poles = [
                (right - left) * factor
                for left, right, factor in zip(poles[:-1], poles[1:], factors, strict=True)
            ]
            found.append(_weighted(functions, poles))
        return [*found, *(0 * found[0] for _ in range(order + 1 - len(found)))]


def _weighted(functions: list[Array], terms: list[Array]) -> Array:
    """Return the sum over poles of basis function times term."""
    total = functions[0] * terms[0]
    for function, term in zip(functions[1:], terms[1:], strict=True):
        total += function * term  # in place: no gradient needs what it was
    return total


@dataclass(frozen=True, slots=True)
class Knots:
    """Knot vectors of many splines in one direction.

    Attributes
    ----------
    values : array
        All knots with their multiplicity, end to end.
    start, degree, poles : array
        ``(n,)`` first knot, degree and number of poles of each spline.
    first, last : array
        ``(n,)`` index in `values` of the knot that opens the first and the last span.
    low, high : array
        ``(n,)`` ends of the parameter range.
    periodic : array
        ``(n,)`` bool: parameters outside the range wrap; else the end spans extrapolate.
    valid : array
        ``(n,)`` bool: the knots are those of a spline of that degree and number of poles.
    most : int
        Greatest number of spans of a valid spline.
    """

    values: Array
    start: Array
    degree: Array
    poles: Array
    first: Array
    last: Array
    low: Array
    high: Array
    periodic: Array
    valid: Array
    most: int

    @staticmethod
    def build(knots: Ragged, degree: Ints, poles: Ints, periodic: Bools) -> Knots:
        """Find the spans of each knot vector and check it."""
        values, start, count, owner = knots.values, knots.start, knots.length, knots.owner
        rows = len(count)
        spans = count - 2 * degree - 1  # knots of the parameter range, less one
        valid = (degree >= 1) & (degree <= MAX_DEGREE) & (spans >= 1) & (poles >= 1)
        valid &= np.where(periodic, poles <= count - degree - 1, poles == count - degree - 1)
        falls = ~np.isfinite(values)
        falls[1:] |= (values[1:] < values[:-1]) & (owner[1:] == owner[:-1])
        valid &= np.bincount(owner, falls, minlength=rows) == 0
        padded = values if len(values) else np.zeros(1)
        low = padded[np.where(valid, start + degree, 0)]
        high = padded[np.where(valid, start + count - 1 - degree, 0)]
        valid &= low < high
        first = start + np.bincount(owner, values <= low[owner], minlength=rows).astype(np.int64)
        last = start + np.bincount(owner, values < high[owner], minlength=rows).astype(np.int64)
        first, last = np.where(valid, first - 1, 0), np.where(valid, last - 1, 0)
        most = int((last - first).max(initial=0)) + 1
        return Knots(values, start, degree, poles, first, last, low, high, periodic, valid, most)

    def within(self, row: int, low: float | None = None, high: float | None = None) -> Floats:
        """Return the distinct knots of a spline from `low` to `high`, ascending.

        By default those of the parameter range. Periodic ones come again in every period.
        """
        start, stop = float(self.low[row]), float(self.high[row])
        low, high = start if low is None else low, stop if high is None else high
        spans = slice(int(self.first[row]), int(self.last[row]) + 2)
        distinct = np.unique(np.asarray(self.values[spans]))
        if self.periodic[row]:
            period = stop - start
            one, two = (np.floor((end - start) / period) for end in (low, high))
            turns = np.arange(one, two + 1)
            distinct = np.unique(turns[:, None] * period + distinct[:-1])
        inside: Floats = distinct[(distinct >= low) & (distinct <= high)]
        return inside

    def wrap(self, row: Array, t: Array) -> Array:
        """Bring parameters ``(n,)`` of periodic splines into their range."""
        xp = namespace(t)
        low, high = gather(self.low, row), gather(self.high, row)
        outside = (t < low) | (t > high)
        return xp.where(outside, low + xp.remainder(t - low, high - low), t)

    def span(self, row: Array, t: Array) -> Array:
        """Return the knot ``(n,)`` that opens the half-open span of each parameter.

        Parameters outside the range, and its end, belong to the first or last span.
        """
        xp = namespace(t)
        low, high = gather(self.first, row), gather(self.last, row)
        spans = int((high - low).max()) if xp is np and len(low) else self.most - 1
        for _ in range(spans.bit_length()):
            middle = (low + high + 1) // 2
            right = gather(self.values, middle) <= t
            low = xp.where(right, middle, low)
            high = xp.where(right, high, middle - 1)
        return low

    def locate(
        self, row: Array, t: Array, degree: int, periodic: bool, order: int = 2
    ) -> tuple[list[Array], Basis]:
        """Return the poles that bear on each point, and their basis functions.

        Parameters
        ----------
        row, t : array
            ``(n,)`` spline, or ``(1,)`` if it is one for all, and parameter.
        degree : int
            Degree of all of these splines.
        periodic : bool
            Whether these splines are periodic.
        order : int
            Derivatives wanted.

        Returns
        -------
        poles : list of array
            ``degree + 1`` times ``(n,)``: number of the pole in its spline.
        basis : Basis
        """
        if periodic:
            t = self.wrap(row, t)
        span = self.span(row, t)
        near = [gather(self.values, span + shift) for shift in range(1 - degree, degree + 1)]
        first = span - gather(self.start, row) - degree
        poles = [first + i for i in range(degree + 1)]
        if periodic:
            count = gather(self.poles, row)
            poles = [pole % count for pole in poles]
        return poles, basis_functions(near, t, degree, order)


def basis_functions(near: list[Array], t: Array, degree: int, order: int = 2) -> Basis:
    """Evaluate the B-spline basis functions that do not vanish at `t`.

    The recursion of Cox and de Boor, as convex sums over spans of positive length, so that
    nothing cancels or divides by zero.

    Parameters
    ----------
    near : list of array
        ``2 * degree`` times ``(n,)``: the knots around each point, ``degree`` up to and
        including the one that opens its span, and as many after it.
    t : array
        ``(n,)`` parameters. Outside the span the functions are continued as polynomials.
    degree : int
        At least 1.
    order : int
        Derivatives wanted.
    """
    below = [t - knot for knot in near[:degree]]
    above = [knot - t for knot in near[degree:]]
    values, slopes = [[namespace(t).ones_like(t)]], list[list[Array]]()
    for d in range(1, degree + 1):
        supports = [1 / (near[degree + r] - near[degree + r - d]) for r in range(d)]
        shares = [f * s for f, s in zip(values[-1], supports, strict=True)]
        rising = [
            distance * share for distance, share in zip(below[degree - d :], shares, strict=True)
        ]
        falling = [distance * share for distance, share in zip(above[:d], shares, strict=True)]
        inner = [rising[r - 1] + falling[r] for r in range(1, d)]
        values.append([falling[0], *inner, rising[-1]])
        slopes.append([d * s for s in supports])
    known = min(order, degree)
    return Basis(values[degree - known :][::-1], slopes[degree - known :][::-1])
