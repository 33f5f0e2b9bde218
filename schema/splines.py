"""B-spline curves and surfaces: many of them, evaluated at many points at once.

Knots and poles of all splines lie end to end in flat buffers. A query gathers the knots
around each point, builds the basis functions that do not vanish there (Cox and de Boor,
as convex sums over spans of positive length, so that nothing cancels or divides by zero)
and gathers the poles they belong to. Poles are kept relative to the centre of their
spline: derivatives then lose no digits when a part lies far from the origin.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from breplake.schema.namespace import Array, Bools, Floats, Ints, gather, namespace
from breplake.schema.ragged import Ragged

__all__ = ["MAX_DEGREE", "Basis", "Knots", "SplineCurves", "SplineSurfaces", "basis_functions"]

MAX_DEGREE: Final = 25
"""OCCT's greatest degree; splines beyond it are not valid."""

Basis: TypeAlias = tuple[list[Array], list[Array], list[Array]]
"""Values, first and second derivatives of the basis functions, each ``degree + 1`` of ``(n,)``."""


@dataclass(frozen=True, slots=True)
class Knots:
    """Knot vectors of many splines in one direction.

    Attributes
    ----------
    values : numpy.ndarray
        All knots with their multiplicity, end to end.
    start, degree, poles : numpy.ndarray
        ``(n,)`` first knot, degree and number of poles of each spline.
    first, last : numpy.ndarray
        ``(n,)`` index in `values` of the knot that opens the first and the last span.
    low, high : numpy.ndarray
        ``(n,)`` ends of the parameter range.
    periodic : numpy.ndarray
        ``(n,)`` bool: parameters outside the range wrap; else the end spans extrapolate.
    valid : numpy.ndarray
        ``(n,)`` bool: the knots are those of a spline of that degree and number of poles.
    """

    values: Floats
    start: Ints
    degree: Ints
    poles: Ints
    first: Ints
    last: Ints
    low: Floats
    high: Floats
    periodic: Bools
    valid: Bools

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
        return Knots(values, start, degree, poles, first - 1, last - 1, low, high, periodic, valid)

    def wrap(self, row: Array, t: Array) -> Array:
        """Bring parameters ``(n,)`` of periodic splines into their range."""
        xp = namespace(t)
        low, high = gather(self.low, row), gather(self.high, row)
        outside = gather(self.periodic, row) & ((t < low) | (t > high))
        return xp.where(outside, low + xp.remainder(t - low, high - low), t)

    def span(self, row: Array, t: Array) -> Array:
        """Return the knot ``(n,)`` that opens the half-open span of each parameter.

        Parameters outside the range, and its end, belong to the first or last span.
        """
        xp = namespace(t)
        low, high = gather(self.first, row), gather(self.last, row)
        for _ in range(int((high - low).max()).bit_length()):
            middle = (low + high + 1) // 2
            right = gather(self.values, middle) <= t
            low = xp.where(right, middle, low)
            high = xp.where(right, high, middle - 1)
        return low

    def locate(self, row: Array, t: Array, degree: int) -> tuple[list[Array], Basis]:
        """Return the poles that bear on each point, and their basis functions.

        Parameters
        ----------
        row, t : array
            ``(n,)`` spline, all of the same degree, and parameter.
        degree : int
            That degree.

        Returns
        -------
        poles : list of array
            ``degree + 1`` times ``(n,)``: number of the pole in its spline.
        basis : Basis
        """
        t = self.wrap(row, t)
        span = self.span(row, t)
        near = [gather(self.values, span + shift) for shift in range(1 - degree, degree + 1)]
        first = span - gather(self.start, row) - degree
        poles = [first + i for i in range(degree + 1)]
        if bool(gather(self.periodic, row).any()):
            count = gather(self.poles, row)
            poles = [pole % count for pole in poles]
        return poles, basis_functions(near, t, degree)


def _shares(lower: list[Array], near: list[Array], degree: int) -> list[Array]:
    """Divide the functions of the degree below by the lengths of their supports."""
    middle = len(near) // 2 - 1  # near[middle] <= t < near[middle + 1]
    return [f / (near[middle + r + 1] - near[middle + r + 1 - degree]) for r, f in enumerate(lower)]


def _raised(lower: list[Array], near: list[Array], t: Array, degree: int) -> list[Array]:
    """Return the functions of `degree` from those of the degree below."""
    middle = len(near) // 2 - 1
    shares = _shares(lower, near, degree)
    rising = [(t - near[middle + r + 1 - degree]) * share for r, share in enumerate(shares)]
    falling = [(near[middle + r + 1] - t) * share for r, share in enumerate(shares)]
    inner = [rising[r - 1] + falling[r] for r in range(1, degree)]
    return [falling[0], *inner, rising[-1]]


def _slopes(lower: list[Array], near: list[Array], degree: int) -> list[Array]:
    """Return the derivatives of the functions of `degree` from the degree below."""
    shares = [degree * share for share in _shares(lower, near, degree)]
    inner = [shares[r - 1] - shares[r] for r in range(1, degree)]
    return [-shares[0], *inner, shares[-1]]


def basis_functions(near: list[Array], t: Array, degree: int) -> Basis:
    """Evaluate the ``degree + 1`` B-spline basis functions that do not vanish at `t`.

    Parameters
    ----------
    near : list of array
        ``2 * degree`` times ``(n,)``: the knots around each point, ``degree`` up to and
        including the one that opens its span, and as many after it.
    t : array
        ``(n,)`` parameters. Outside the span the functions are continued as polynomials.
    degree : int
        At least 1.

    Returns
    -------
    Basis
        Values, first and second derivatives.
    """
    xp = namespace(t)
    below = [xp.ones_like(t)]  # the functions of degree - 1
    slopes: list[Array] = []  # their derivatives
    for d in range(1, degree):
        if d == degree - 1:
            slopes = _slopes(below, near, d)
        below = _raised(below, near, t, d)
    values = _raised(below, near, t, degree)
    first = _slopes(below, near, degree)
    if degree == 1:
        return values, first, [xp.zeros_like(t)] * 2
    return values, first, _slopes(slopes, near, degree)


@dataclass(frozen=True, slots=True)
class _Poles:
    """Control points of many splines.

    Attributes
    ----------
    buffer : numpy.ndarray
        ``(4, total)``: weight times (pole - centre), and weight.
    start : numpy.ndarray
        ``(n,)`` first pole of each spline.
    centre : numpy.ndarray
        ``(3, n)`` middle of the poles' bounding box.
    extent : numpy.ndarray
        ``(n,)`` half the largest side of that box.
    rational, valid : numpy.ndarray
        ``(n,)`` bool.
    """

    buffer: Floats
    start: Ints
    centre: Floats
    extent: Floats
    rational: Bools
    valid: Bools

    @staticmethod
    def build(poles: Ragged, weights: Ragged) -> _Poles:
        points, owner = poles.values.reshape(3, -1), poles.owner
        rows, some = len(poles.length), poles.length > 0
        low, high = np.zeros((3, rows)), np.zeros((3, rows))
        if some.any():
            low[:, some] = np.minimum.reduceat(points, poles.start[some], axis=1)
            high[:, some] = np.maximum.reduceat(points, poles.start[some], axis=1)
        centre = low + (high - low) / 2
        rational = weights.length > 0
        valid = some & (~rational | (weights.length == poles.length))
        weight = np.ones(points.shape[1])
        given = (rational & valid)[weights.owner]
        weight[(rational & valid)[owner]] = weights.values[given]
        bad = ~np.isfinite(points).all(axis=0) | ~(weight > 0) | ~np.isfinite(weight)
        valid &= np.bincount(owner, bad, minlength=rows) == 0
        buffer = np.concatenate([(points - centre[:, owner]) * weight, weight[None]])
        extent = (high - low).max(axis=0, initial=0) / 2
        return _Poles(buffer, poles.start, centre, extent, rational, valid)


def _weighted(basis: list[Array], terms: list[Array]) -> Array:
    """Return the sum over poles of basis function times term."""
    total = basis[0] * terms[0]
    for function, term in zip(basis[1:], terms[1:], strict=True):
        total = total + function * term
    return total


@dataclass(frozen=True, slots=True)
class SplineCurves:
    """B-spline curves by row of a table; rows that are none are not `valid`."""

    knots: Knots
    poles: _Poles
    valid: Bools = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "valid", self.knots.valid & self.poles.valid)

    @property
    def rational(self) -> Bools:
        """Whether each row has weights, ``(n,)``."""
        return self.poles.rational

    @staticmethod
    def build(
        knots: Ragged, degree: Ints, periodic: Bools, poles: Ragged, weights: Ragged
    ) -> SplineCurves:
        """Check and store curves; knots as OCCT's ``KnotSequence`` gives them."""
        return SplineCurves(
            Knots.build(knots, degree, poles.length, periodic), _Poles.build(poles, weights)
        )

    def evaluate(
        self, row: Array, t: Array, degree: int, rational: bool
    ) -> tuple[Array, Array, Array]:
        """Return point, first and second derivative, each ``(3, n)``.

        All rows must be of that degree, and rational or not.
        """
        numbers, basis = self.knots.locate(row, t, degree)
        start = gather(self.poles.start, row)
        used = self.poles.buffer[: 4 if rational else 3]
        near = [gather(used, start + number) for number in numbers]  # (3 or 4, n) each
        jet = [_weighted(functions, near) for functions in basis]
        if rational:
            jet = _quotient_1d(jet)
        return jet[0] + gather(self.poles.centre, row), jet[1], jet[2]


def _quotient_1d(jet: list[Array]) -> list[Array]:
    """Divide by the weight, derivatives by the quotient rule."""
    (a, wa), (b, wb), (c, wc) = ((part[:3], part[3]) for part in jet)
    p = a / wa
    p1 = (b - wb * p) / wa
    return [p, p1, (c - 2 * wb * p1 - wc * p) / wa]


@dataclass(frozen=True, slots=True)
class SplineSurfaces:
    """B-spline surfaces by row of a table; rows that are none are not `valid`."""

    u_knots: Knots
    v_knots: Knots
    poles: _Poles
    valid: Bools = field(init=False)

    @property
    def rational(self) -> Bools:
        """Whether each row has weights, ``(n,)``."""
        return self.poles.rational

    @staticmethod
    def build(u_knots: Knots, v_knots: Knots, poles: Ragged, weights: Ragged) -> SplineSurfaces:
        """Check and store surfaces; the poles' index in v runs fastest."""
        return SplineSurfaces(u_knots, v_knots, _Poles.build(poles, weights))

    def __post_init__(self) -> None:
        valid = self.u_knots.valid & self.v_knots.valid & self.poles.valid
        object.__setattr__(self, "valid", valid)

    def evaluate(
        self, row: Array, u: Array, v: Array, degrees: tuple[int, int], rational: bool
    ) -> tuple[Array, ...]:
        """Return point, du, dv, duu, duv, dvv, each ``(3, n)``.

        All rows must be of those degrees, and rational or not.
        """
        u_numbers, u_basis = self.u_knots.locate(row, u, degrees[0])
        v_numbers, v_basis = self.v_knots.locate(row, v, degrees[1])
        xp = namespace(u)
        used = self.poles.buffer[: 4 if rational else 3]
        width, start = gather(self.v_knots.poles, row), gather(self.poles.start, row)
        lines = xp.stack([start + number * width for number in u_numbers])  # (u poles, n)
        near = [gather(used, lines + number) for number in v_numbers]  # (3 or 4, u poles, n) each
        strips = [
            [strip[:, i] for i in range(degrees[0] + 1)]
            for strip in (_weighted(functions, near) for functions in v_basis)
        ]  # by order of derivative in v, then pole in u: (3 or 4, n)
        orders = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
        jet = [_weighted(u_basis[i], strips[j]) for i, j in orders]
        if rational:
            jet = _quotient_2d(jet)
        return jet[0] + gather(self.poles.centre, row), *jet[1:]


def _quotient_2d(jet: list[Array]) -> list[Array]:
    """Divide by the weight, derivatives by the quotient rule."""
    w, wu, wv, wuu, wuv, wvv = (part[3] for part in jet)
    a, au, av, auu, auv, avv = (part[:3] for part in jet)
    p = a / w
    pu, pv = (au - wu * p) / w, (av - wv * p) / w
    puu = (auu - 2 * wu * pu - wuu * p) / w
    puv = (auv - wu * pv - wv * pu - wuv * p) / w
    return [p, pu, pv, puu, puv, (avv - 2 * wv * pv - wvv * p) / w]
