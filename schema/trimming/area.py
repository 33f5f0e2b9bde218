"""Exact areas of trimmed patches, by Green's theorem.

The integral of w = abs(du x dv) over what a boundary encloses is the integral of F dv along
it, where F(u, v) is that of w from some u to u. Along a piece of the boundary between creases
all of this is smooth, so Gauss' quadrature converges fast, and no inside has to be known.
Where w does not depend on v the parts of u and v are swapped: F is then w times a length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from breplake.schema.namespace import Bools, Floats, Ints, slices
from breplake.schema.trimming.density import Density
from breplake.schema.trimming.loops import Arcs
from breplake.schema.trimming.outline import Outlines
from breplake.schema.trimming.pieces import Pieces, cut_at

__all__ = ["areas"]

Rule: TypeAlias = tuple[Floats, Floats]
"""Nodes and weights of a quadrature on [-1, 1]."""

_FINE: Final = np.polynomial.legendre.leggauss(8)
_ROUGH: Final = np.polynomial.legendre.leggauss(6)
_GAIN: Final = 4 / 3  # the finer rule has so many times the digits of the rougher one
_DEEPEST: Final = 10  # halvings of a piece
_STRIPS: Final = 20_000  # inner integrals at once
_ROUNDING: Final = 1e-14  # of the integrals along all pieces: less is lost in their sum


def areas(density: Density, pieces: Pieces, window: Floats, relative: float) -> Floats:
    """Return the area of each patch, ``(n_patches,)`` mm^2.

    Parameters
    ----------
    density : Density
        The patches.
    pieces : Pieces
        Their boundaries, the patch to the left.
    window : numpy.ndarray
        ``(4, n_patches)`` least and greatest u and v of what counts.
    relative : float
        Error asked for, as a share of each patch's area.
    """
    sideways = density.sideways(window)
    arcs = _cut_at_creases(density, pieces, window)
    across = np.where(sideways[arcs.patch], 0, 1)  # the parameter that is integrated last
    at = np.arange(len(arcs.patch))
    start, stop = arcs.start[across, at], arcs.stop[across, at]
    low, high = window[2 * across, arcs.patch], window[2 * across + 1, arcs.patch]
    counts = (start != stop) & (start + stop > 2 * low) & (start + stop < 2 * high)
    integrals = _Integrals(density, pieces.outlines, arcs.take(counts), window, sideways)
    return integrals.adaptive(relative)


def _cut_at_creases(density: Density, pieces: Pieces, window: Floats) -> Arcs:
    """Cut pieces where they cross the creases of their patch, or the sides of its window."""
    box, arcs = pieces.box(), pieces.arcs
    found = [(np.zeros(0, dtype=np.int64), np.zeros(0))]
    for axis in (0, 1):
        piece, value = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
        for row in np.unique(arcs.patch):
            mine = np.arange(pieces.first[row], pieces.first[row + 1])
            low, high = box[2 * axis, mine], box[2 * axis + 1, mine]
            at = density.creases(int(row), axis, float(low.min()), float(high.max()))
            at = np.union1d(at, window[2 * axis : 2 * axis + 2, row])
            crossed, crease = np.nonzero((low[:, None] < at) & (at < high[:, None]))
            piece.append(mine[crossed])
            value.append(at[crease])
        crossed = np.concatenate(piece)
        found.append((crossed, pieces.parameter(crossed, axis, np.concatenate(value))))
    crossed, t = (np.concatenate(part) for part in zip(*found, strict=True))
    return cut_at(pieces.outlines, arcs, crossed, t)


@dataclass(frozen=True, slots=True)
class _Integrals:
    """Integrals of F dv (or -F du where `sideways`) along arcs between creases."""

    density: Density
    outlines: Outlines
    arcs: Arcs
    window: Floats
    sideways: Bools

    def adaptive(self, relative: float) -> Floats:
        """Halve arcs until two rules agree on them, and add up by patch."""
        count, patch = self.window.shape[1], self.arcs.patch
        total = np.zeros(count)
        arc, low, high = np.arange(len(patch)), self.arcs.t[0], self.arcs.t[1]
        allowed = np.zeros(count)
        for level in range(_DEEPEST + 1):
            value = self.along(arc, low, high, 2**level, _FINE)
            error = np.abs(value - self.along(arc, low, high, 2**level, _ROUGH))
            if level == 0:
                size = np.bincount(patch, np.abs(value), minlength=count)
                share = relative / np.sqrt(np.maximum(np.bincount(patch, minlength=count), 1))
                allowed = np.abs(np.bincount(patch, value, minlength=count)) * share
                allowed = np.maximum(allowed, _ROUNDING * size)
            scale = np.maximum(np.abs(value), np.finfo(np.float64).tiny)
            rough = scale * np.minimum(error / scale, 1.0) ** _GAIN > allowed[patch[arc]]
            rough &= level < _DEEPEST
            total += np.bincount(patch[arc], np.where(rough, 0.0, value), minlength=count)
            if not rough.any():
                break
            arc, low, high = arc[rough], low[rough], high[rough]
            arc, middle = np.tile(arc, 2), (low + high) / 2
            low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        return total

    def along(self, arc: Ints, low: Floats, high: Floats, strips: int, rule: Rule) -> Floats:
        """Return the integrals along arcs from parameter `low` to `high`, ``(n,)``."""
        nodes, weights = rule
        middle, half = (low + high) / 2, (high - low) / 2
        t = (middle[:, None] + half[:, None] * nodes).ravel()
        which = np.repeat(arc, len(nodes))
        point, slope, _ = self.outlines.evaluate(self.arcs.curve[which], t)
        row = self.arcs.patch[which]
        inner = self.inner(row, point + self.arcs.shift[:, which], strips, rule)
        rate = np.where(self.sideways[row], -slope[0], slope[1])
        return np.asarray((inner * rate).reshape(-1, len(nodes)) @ weights * half)

    def inner(self, row: Ints, point: Floats, strips: int, rule: Rule) -> Floats:
        """Return F at points ``(2, n)``; `strips` is how often a smooth range is divided."""
        low, high = self.window[::2, row], self.window[1::2, row]
        width = np.clip(point, low, high) - low
        along = np.where(self.sideways[row], width[1], width[0])
        value = np.zeros(len(row))
        easy = self.density.single[row]
        at = np.flatnonzero(easy & (along != 0))
        value[at] = self.density.at(row[at], *point[:, at]) * along[at]
        hard = np.flatnonzero(~easy & (along != 0))
        for one in np.unique(row[hard]).tolist():
            mine = hard[row[hard] == one]
            axis = int(self.sideways[one])
            stop, height = low[axis, mine] + along[mine], point[1 - axis, mine]
            value[mine] = self._across(one, axis, stop, height, strips, rule)
        return value

    def _across(
        self, row: int, axis: int, stop: Floats, height: Floats, strips: int, rule: Rule
    ) -> Floats:
        """Integrate one patch's density from the window's side to `stop`, crease by crease."""
        nodes, weights = rule
        start, end = self.window[2 * axis, row], stop.max()
        edges = np.append(start, self.density.creases(row, axis, start, end))
        fine = np.linspace(edges, np.append(edges[1:], end), strips, endpoint=False, axis=1)
        low, high = fine.ravel(), np.append(fine.ravel()[1:], end)
        value = np.zeros(len(stop))
        for part in slices(len(stop), max(1, _STRIPS // len(low))):
            point, strip = np.nonzero(stop[part, None] > low)
            point += part.start
            half = (np.minimum(high[strip], stop[point]) - low[strip]) / 2
            along = ((low[strip] + half)[:, None] + half[:, None] * nodes).ravel()
            across = np.repeat(height[point], len(nodes))
            place = (across, along) if axis else (along, across)
            found = self.density.at(np.full(len(along), row), *place)
            value += np.bincount(point, found.reshape(-1, len(nodes)) @ weights * half, len(stop))
        return value
