"""B-spline curves and surfaces: many of them, evaluated at many points at once.

Knots and poles of all splines lie end to end in flat buffers. A query gathers the knots
around each point, builds the basis functions that do not vanish there and gathers the poles
they belong to. Poles are kept relative to a centre of their spline: derivatives then lose no
digits when a part lies far from the origin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from breplake.schema.knots import MAX_DEGREE, Basis, Knots, basis_functions
from breplake.schema.namespace import Array, Bools, Floats, Ints, gather, namespace
from breplake.schema.ragged import Ragged
from breplake.schema.series import Index, Series, indices, quotient

__all__ = [
    "MAX_DEGREE",
    "Basis",
    "Knots",
    "Poles",
    "SplineCurves",
    "SplineSurfaces",
    "basis_functions",
    "divided",
]


@dataclass(frozen=True, slots=True)
class Poles:
    """Control points of many splines.

    Attributes
    ----------
    buffer : array
        ``(dim + 1, total)``: pole - centre, and weight.
    start, owner : array
        ``(n,)`` first pole of each spline, ``(total,)`` spline of each pole.
    centre : array
        ``(dim, n)`` what was taken off the poles; about the middle of far ones.
    extent : array
        ``(n,)`` half the largest side of the poles' bounding box.
    rational, valid : array
        ``(n,)`` bool.
    """

    buffer: Array
    start: Array
    owner: Array
    centre: Array
    extent: Array
    rational: Array
    valid: Array

    @staticmethod
    def build(poles: Ragged, weights: Ragged, dim: int = 3) -> Poles:
        """Check poles and weights, and take their centres off."""
        points, owner = poles.values.reshape(dim, -1), poles.owner
        rows, some = len(poles.length), poles.length > 0
        low, high = np.zeros((dim, rows)), np.zeros((dim, rows))
        if some.any():
            low[:, some] = np.minimum.reduceat(points, poles.start[some], axis=1)
            high[:, some] = np.maximum.reduceat(points, poles.start[some], axis=1)
        centre = _centre(low, high)
        rational = weights.length > 0
        valid = some & (~rational | (weights.length == poles.length))
        weight = np.ones(points.shape[1])
        given = (rational & valid)[weights.owner]
        weight[(rational & valid)[owner]] = weights.values[given]
        bad = ~np.isfinite(points).all(axis=0) | ~(weight > 0) | ~np.isfinite(weight)
        valid &= np.bincount(owner, bad, minlength=rows) == 0
        buffer = np.concatenate([points - centre[:, owner], weight[None]])
        extent = (high - low).max(axis=0, initial=0) / 2
        return Poles(buffer, poles.start, owner, centre, extent, rational, valid)

    @property
    def points(self) -> Array:
        """The poles where they are, ``(dim, total)``."""
        return self.buffer[:-1] + gather(self.centre, self.owner)

    def changed(self, points: Array, weights: Array) -> Poles:
        """Return the same splines with other poles ``(dim, total)`` and weights ``(total,)``."""
        xp = namespace(points)
        near = points - gather(self.centre, self.owner)
        return replace(self, buffer=xp.concatenate([near, weights[None]]))

    def gathered(self, index: list[Array], rational: bool) -> tuple[list[Array], list[Array]]:
        """Return poles ``(dim, ...)`` at indices of any shape; if rational, weights too."""
        points = [gather(self.buffer[:-1], i) for i in index]
        return points, [gather(self.buffer[-1], i) for i in index] if rational else []


def _centre(low: Floats, high: Floats) -> Floats:
    """Return what to take off poles between `low` and `high`, so that no rounding is needed.

    Near the origin that is nothing, far from it the middle rounded to few bits: what is left
    of each pole has no more digits than the pole.
    """
    half = (high - low) / 2
    usual = np.isfinite(half) & (half > 0)
    step = np.exp2(np.floor(np.log2(np.where(usual, half, 1.0))))
    with np.errstate(invalid="ignore"):  # infinite poles are found out elsewhere
        middle = low + half
        rounded = np.where(np.abs(middle) <= 2 * half, 0.0, np.round(middle / step) * step)
    return np.where(usual, rounded, low)


@dataclass(frozen=True, slots=True)
class SplineCurves:
    """B-spline curves by row of a table; rows that are none are not `valid`."""

    knots: Knots
    poles: Poles

    @property
    def valid(self) -> Array:
        """Whether each row is a spline, ``(n,)``."""
        return self.knots.valid & self.poles.valid

    @property
    def rational(self) -> Array:
        """Whether each row has weights, ``(n,)``."""
        return self.poles.rational

    @staticmethod
    def build(
        knots: Ragged, degree: Ints, periodic: Bools, poles: Ragged, weights: Ragged, dim: int = 3
    ) -> SplineCurves:
        """Check and store curves in space or in a plane; knots as ``KnotSequence`` has them."""
        return SplineCurves(
            Knots.build(knots, degree, poles.length, periodic), Poles.build(poles, weights, dim)
        )

    def evaluate(
        self, row: Array, t: Array, degree: int, rational: bool, periodic: bool, order: int = 2
    ) -> list[Array]:
        """Return point and derivatives up to `order`, each ``(dim, n)``.

        All rows must be of that degree, rational or not, periodic or not.
        """
        numbers, basis = self.knots.locate(row, t, degree, periodic, order)
        start = gather(self.poles.start, row)
        points, weights = self.poles.gathered([start + number for number in numbers], rational)
        centre = gather(self.poles.centre, row)
        if not rational:
            jet = basis.sums(points, order)
            return [jet[0] + centre, *jet[1:]]
        origin = points[0]
        points = [(p - origin) * w for p, w in zip(points, weights, strict=True)]
        index = indices(1, order)
        jet = divided(index, basis.sums(points, order), basis.sums(weights, order))
        return [jet[0] + (origin + centre), *jet[1:]]


@dataclass(frozen=True, slots=True)
class SplineSurfaces:
    """B-spline surfaces by row of a table; rows that are none are not `valid`."""

    u_knots: Knots
    v_knots: Knots
    poles: Poles

    @property
    def valid(self) -> Array:
        """Whether each row is a spline, ``(n,)``."""
        return self.u_knots.valid & self.v_knots.valid & self.poles.valid

    @property
    def rational(self) -> Array:
        """Whether each row has weights, ``(n,)``."""
        return self.poles.rational

    @staticmethod
    def build(u_knots: Knots, v_knots: Knots, poles: Ragged, weights: Ragged) -> SplineSurfaces:
        """Check and store surfaces; the poles' index in v runs fastest."""
        return SplineSurfaces(u_knots, v_knots, Poles.build(poles, weights))

    def evaluate(
        self,
        row: Array,
        u: Array,
        v: Array,
        degrees: tuple[int, int],
        rational: bool,
        periodic: tuple[bool, bool],
        order: int = 2,
    ) -> list[Array]:
        """Return point and derivatives up to `order` as ``indices(2, order)``, each ``(3, n)``.

        All rows must be of those degrees, rational or not, periodic or not.
        """
        u_numbers, u_basis = self.u_knots.locate(row, u, degrees[0], periodic[0], order)
        v_numbers, v_basis = self.v_knots.locate(row, v, degrees[1], periodic[1], order)
        xp = namespace(u)
        width, start = gather(self.v_knots.poles, row), gather(self.poles.start, row)
        lines = xp.stack([start + number * width for number in u_numbers])  # (u poles, n)
        points, weights = self.poles.gathered([lines + number for number in v_numbers], rational)
        centre, index = gather(self.poles.centre, row), indices(2, order)
        if not rational:
            jet = _sums(u_basis, v_basis, points, order)
            return [jet[i] + centre if i == (0, 0) else jet[i] for i in index]
        origin = points[0][:, :1]
        points = [(p - origin) * w for p, w in zip(points, weights, strict=True)]
        above = _sums(u_basis, v_basis, points, order)
        below = _sums(u_basis, v_basis, weights, order)
        tops, bottoms = ([part[i] for i in index] for part in (above, below))
        first, *rest = divided(index, tops, bottoms)
        return [first + (origin[:, 0] + centre), *rest]

    def derivatives(
        self,
        row: Ints,
        u: Floats,
        v: Floats,
        degrees: tuple[int, int],
        rational: bool,
        periodic: tuple[bool, bool],
    ) -> tuple[Floats, Floats]:
        """Return all derivatives that do not vanish, of weighted points and weights.

        Parameters
        ----------
        row, u, v, degrees, rational, periodic
            As for `evaluate`; numpy only.

        Returns
        -------
        table : numpy.ndarray
            ``(u_degree + 1, v_degree + 1, 3 or 4, n)`` by how often u and v are derived.
        origin : numpy.ndarray
            ``(3, n)`` what was taken off the points.
        """
        p, q = degrees
        u_numbers, u_basis = self.u_knots.locate(row, u, p, periodic[0], p)
        v_numbers, v_basis = self.v_knots.locate(row, v, q, periodic[1], q)
        width, start = gather(self.v_knots.poles, row), gather(self.poles.start, row)
        lines = np.stack([start + number * width for number in u_numbers])
        points, weights = self.poles.gathered([lines + number for number in v_numbers], rational)
        origin = points[0][:, :1]
        poles = [part - origin for part in points]
        if rational:
            pairs = zip(poles, weights, strict=True)
            poles = [np.concatenate([part * w, w[None]]) for part, w in pairs]
        table = np.empty((p + 1, q + 1, len(poles[0]), len(row)))
        for j, line in enumerate(v_basis.sums(poles, q)):
            for i, part in enumerate(u_basis.sums([line[:, k] for k in range(p + 1)], p)):
                table[i, j] = part
        return table, origin[:, 0] + gather(self.poles.centre, row)


def _sums(u_basis: Basis, v_basis: Basis, poles: list[Array], order: int) -> Series:
    """Return a spline and its derivatives; `poles` are ``(..., u poles, n)`` by pole in v."""
    found: Series = {}
    for j, line in enumerate(v_basis.sums(poles, order)):
        across = [line[..., i, :] for i in range(line.shape[-2])]
        for i, part in enumerate(u_basis.sums(across, order - j)):
            found[i, j] = part
    return found


def divided(index: tuple[Index, ...], above: list[Array], below: list[Array]) -> list[Array]:
    """Divide weighted points by their weights, and their derivatives by Leibniz' rule.

    Parameters
    ----------
    index : tuple of Index
        How often each part is derived.
    above, below : list of array
        Weighted points ``(dim, n)`` and weights ``(n,)``, each with derivatives.
    """
    parts = (dict(zip(index, part, strict=True)) for part in (above, below))
    return list(quotient(*parts).values())
