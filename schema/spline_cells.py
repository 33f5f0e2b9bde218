"""Runs of points on spline surfaces, cell by cell.

Between two knots in u and two in v, a spline surface is one polynomial. A run with many points
in each of its cells is evaluated by one matrix product a cell: Taylor coefficients about the
cell's middle, found by the kernels that find derivatives anywhere, times products of powers at
the points. Most patches of real parts are a single cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial, perm
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from breplake.schema.forms import bent
from breplake.schema.namespace import Floats, Ints
from breplake.schema.series import indices
from breplake.schema.splines import divided

if TYPE_CHECKING:
    from breplake.schema.surface_parameters import SurfaceKind
    from breplake.schema.surfaces import SurfaceSet

__all__ = ["Place", "SplineCells"]

Place: TypeAlias = tuple[int, slice]
"""Row of a run, and where its points are in the query."""

_STEEPEST: Final = 5  # powers of a higher degree would lose digits
_FEWEST: Final = 24  # points in a cell that are worth a matrix product
_ORDERS: Final = indices(2, 2)


@dataclass(frozen=True, slots=True)
class SplineCells:
    """Polynomials of the cells of some splines of one kind.

    Attributes
    ----------
    surfaces : SurfaceSet
    kind : SurfaceKind
    breaks : dict
        By row, the distinct knots in u and in v.
    first : dict
        By row, its first cell; those with the same span in u follow each other.
    middle, half : numpy.ndarray
        ``(2, n_cells)`` middle and half of the width of each cell, in u and v.
    origin : numpy.ndarray
        ``(n_cells, 3, 1)`` what is to be added to points.
    powers : numpy.ndarray
        ``(n_cells, 6 * k, n_powers)`` coefficients of point, du, dv, duu, duv and dvv, k being
        3 or, with the weight, 4.
    """

    surfaces: SurfaceSet
    kind: SurfaceKind
    breaks: dict[int, tuple[Floats, Floats]]
    first: dict[int, int]
    middle: Floats
    half: Floats
    origin: Floats
    powers: Floats

    @staticmethod
    def build(surfaces: SurfaceSet, kind: SurfaceKind, runs: list[Place]) -> SplineCells:
        """Prepare the rows of which there are enough points in each cell."""
        splines = surfaces.splines
        breaks: dict[int, tuple[Floats, Floats]] = {}
        first, count = dict[int, int](), 0
        for row, place in runs if max(kind.degrees) <= _STEEPEST else ():
            if row not in breaks:
                both = splines.u_knots.within(row), splines.v_knots.within(row)
                cells = (len(both[0]) - 1) * (len(both[1]) - 1)
                if cells * _FEWEST <= place.stop - place.start:
                    breaks[row], first[row] = both, count
                    count += cells
        rows = np.repeat(list(breaks), [(len(a) - 1) * (len(b) - 1) for a, b in breaks.values()])
        spans = [np.zeros((4, 0)), *(_spans(a, b) for a, b in breaks.values())]
        corners = np.concatenate(spans, axis=1)  # low and high u, low and high v
        middle, half = (corners[1::2] + corners[0::2]) / 2, (corners[1::2] - corners[0::2]) / 2
        taylor, origin = _taylor(surfaces, kind, rows.astype(np.int64), middle, half)
        powers = _powers(taylor, half, kind.degrees)
        return SplineCells(surfaces, kind, breaks, first, middle, half, origin, powers)

    def evaluate(self, runs: list[Place], u: Floats, v: Floats, out: Floats) -> list[Place]:
        """Write points, normals and curvatures of runs to ``(8, n)``; return other runs."""
        mine = [run for run in runs if run[0] in self.first]
        total = sum(place.stop - place.start for _, place in mine)
        if mine:
            local, order = np.empty((2, total)), np.empty(total, dtype=np.int64)
            pieces = list[tuple[int, int, int]]()  # cell, start and stop in `local`
            start = 0
            for row, place in mine:
                stop = start + place.stop - place.start
                counts = self._locate(
                    row, u[place], v[place], local[:, start:stop], order[start:stop]
                )
                ends = start + np.cumsum(counts)
                cells = range(self.first[row], self.first[row] + len(counts))
                pieces += zip(cells, (ends - counts).tolist(), ends.tolist(), strict=True)
                start = stop
            self._write(mine, self._blocks(mine, local, pieces), order, out)
        return [run for run in runs if run[0] not in self.first]

    def _locate(self, row: int, u: Floats, v: Floats, local: Floats, order: Ints) -> Ints:
        """Sort points by cell and bring them to -1 .. 1; return how many are in each cell."""
        splines, wraps = self.surfaces.splines, self.kind.periodic
        here, first = np.array([row]), self.first[row]
        u = splines.u_knots.wrap(here, u) if wraps[0] else u
        v = splines.v_knots.wrap(here, v) if wraps[1] else v
        (u_breaks, v_breaks), cell = self.breaks[row], here * 0 + first
        count = (len(u_breaks) - 1) * (len(v_breaks) - 1)
        order[:] = np.arange(len(u))
        counts = np.array([len(u)])
        if count > 1:
            lines = np.searchsorted(u_breaks[1:-1], u, side="right") * (len(v_breaks) - 1)
            places = lines + np.searchsorted(v_breaks[1:-1], v, side="right")
            small = places.astype(np.int16) if count < 2**15 else places
            order[:] = np.argsort(small, kind="stable")
            u, v, cell = u[order], v[order], first + places[order]
            counts = np.bincount(places, minlength=count)
        for target, values, middle, half in zip(local, (u, v), self.middle, self.half, strict=True):
            np.subtract(values, middle[cell], out=target)
            target /= half[cell]
        return counts

    def _blocks(
        self, runs: list[Place], local: Floats, pieces: list[tuple[int, int, int]]
    ) -> Floats:
        """Return points, normals and curvatures, ``(8, m)``, in the order of the cells."""
        powers = _products(local, self.kind.degrees)
        jet = np.empty((self.powers.shape[1], local.shape[1]))
        for cell, start, stop in pieces:
            np.matmul(self.powers[cell], powers[:, start:stop], out=jet[:, start:stop])
        parts = list(jet.reshape(6, -1, local.shape[1]))
        if self.kind.rational:
            parts = divided(_ORDERS, [p[:3] for p in parts], [p[3] for p in parts])
        point, du, dv, *seconds = parts
        for cell, start, stop in pieces:
            point[:, start:stop] += self.origin[cell]
        lengths = [place.stop - place.start for _, place in runs]
        least = np.repeat(self.surfaces.least[:, [row for row, _ in runs]], lengths, axis=1)
        normal, k_min, k_max = bent(du, dv, (seconds[0], seconds[1], seconds[2]), least)
        return np.concatenate([point, normal, k_min[None], k_max[None]])

    def _write(self, runs: list[Place], blocks: Floats, order: Ints, out: Floats) -> None:
        start = 0
        for row, place in runs:
            stop = start + place.stop - place.start
            if len(self.breaks[row][0]) == len(self.breaks[row][1]) == 2:  # a single cell
                out[:, place] = blocks[:, start:stop]
            else:
                out[:, place.start + order[start:stop]] = blocks[:, start:stop]
            start = stop


def _spans(u: Floats, v: Floats) -> Floats:
    """Return low and high u, low and high v of each cell, ``(4, n_cells)``."""
    columns, lines = len(v) - 1, len(u) - 1
    sides = [np.repeat(u[:-1], columns), np.repeat(u[1:], columns)]
    return np.stack([*sides, np.tile(v[:-1], lines), np.tile(v[1:], lines)])


def _taylor(
    surfaces: SurfaceSet, kind: SurfaceKind, rows: Ints, middle: Floats, half: Floats
) -> tuple[Floats, Floats]:
    """Return Taylor coefficients in -1 .. 1, and what was taken off the points.

    Returns
    -------
    coefficients : numpy.ndarray
        ``(u_degree + 1, v_degree + 1, 3 or 4, n_cells)``, the last one of the four the weight.
    origin : numpy.ndarray
        ``(n_cells, 3, 1)``.
    """
    table, origin = surfaces.splines.derivatives(
        rows, middle[0], middle[1], kind.degrees, kind.rational, kind.periodic
    )
    p, q = kind.degrees
    for i in range(p + 1):
        for j in range(q + 1):
            table[i, j] *= half[0] ** i * half[1] ** j / (factorial(i) * factorial(j))
    return table, origin.T[:, :, None]


def _powers(taylor: Floats, half: Floats, degrees: tuple[int, int]) -> Floats:
    """Return coefficients of all six parts of a jet, ``(n_cells, 6 * k, n_powers)``."""
    p, q = degrees
    height, cells = taylor.shape[2:]
    found = np.zeros((cells, 6, height, p + 1, q + 1))
    for part, (i, j) in enumerate(_ORDERS):
        for a in range(p + 1 - i):
            for b in range(q + 1 - j):
                factor = perm(a + i, i) * perm(b + j, j) / (half[0] ** i * half[1] ** j)
                found[:, part, :, a, b] = (taylor[a + i, b + j] * factor).T
    return found.reshape(cells, 6 * height, (p + 1) * (q + 1))


def _products(local: Floats, degrees: tuple[int, int]) -> Floats:
    """Return the products of powers of x and y, ``(n_powers, m)``, those of y changing first."""
    p, q = degrees
    x, y = local
    found = np.empty((p + 1, q + 1, len(x)))
    found[0, 0] = 1.0
    for j in range(1, q + 1):
        np.multiply(found[0, j - 1], y, out=found[0, j])
    for i in range(1, p + 1):
        np.multiply(found[i - 1], x, out=found[i])
    return found.reshape(-1, len(x))
