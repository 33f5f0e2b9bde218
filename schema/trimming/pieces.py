"""Boundaries cut into pieces on which neither u nor v turns back, and crossings with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from breplake.schema.namespace import Bools, Floats, Ints, slices
from breplake.schema.roots import bracketed_roots, isolate
from breplake.schema.trimming.loops import Arcs
from breplake.schema.trimming.outline import Outlines

__all__ = ["Pieces", "cut", "cut_at"]

_EPS: Final = np.finfo(np.float64).eps
_TINY: Final = 1e-9  # of u, that much of v (or the other way round) is nothing
_STEPS: Final = 16  # of a ladder, a power of two
_PAIRS = 2_000_000  # pairs of point and piece that are compared at once


@dataclass(frozen=True, slots=True)
class Pieces:
    """Monotone pieces of the boundaries of all patches, by patch.

    Neighbours share their end points to the last bit: a horizontal line crosses a closed
    boundary as often upwards as downwards, whatever the rounding.

    Attributes
    ----------
    outlines : Outlines
        The curves.
    arcs : Arcs
        The pieces.
    first : numpy.ndarray
        ``(n_patches + 1,)`` first piece of each patch.
    ladder : numpy.ndarray
        ``(2, n, k)`` points at equal steps of each piece's parameter, both ends included.
    """

    outlines: Outlines
    arcs: Arcs
    first: Ints
    ladder: Floats

    @staticmethod
    def of(outlines: Outlines, arcs: Arcs, n_patches: int) -> Pieces:
        """Sort pieces by patch."""
        arcs = arcs.take(np.argsort(arcs.patch, kind="stable"))
        first = np.searchsorted(arcs.patch, np.arange(n_patches + 1))
        return Pieces(outlines, arcs, first, _ladder(outlines, arcs))

    def box(self) -> Floats:
        """Return ``(4, n)`` least and greatest u, least and greatest v of each piece."""
        low = np.minimum(self.arcs.start, self.arcs.stop)
        high = np.maximum(self.arcs.start, self.arcs.stop)
        return np.stack([low[0], high[0], low[1], high[1]])

    def winding(self, patch: Ints, u: Floats, v: Floats) -> Ints:
        """Return how often each point's patch winds around it.

        A ray to greater u counts the pieces that it crosses: up is one, down is minus one.

        Parameters
        ----------
        patch, u, v : numpy.ndarray
            ``(n,)`` row of the patch, and point.
        """
        order = np.argsort(patch, kind="stable")
        heads = np.searchsorted(patch[order], np.arange(len(self.first)))
        none = np.zeros(0, dtype=np.int64)
        found = [(none, none, none)]
        total = np.zeros(len(patch))
        for row in np.unique(patch):
            mine = order[heads[row] : heads[row + 1]]
            near = np.arange(self.first[row], self.first[row + 1])
            for part in slices(len(mine), max(1, _PAIRS // max(1, len(near)))):
                some = mine[part]
                total[some], ray, beside, sign = self._rays(near, u[some], v[some])
                found.append((some[ray], beside, sign))
        point, piece, sign = (np.concatenate(part) for part in zip(*found, strict=True))
        hit = self._left(piece, u[point], v[point])
        total += np.bincount(point, sign * hit, minlength=len(patch))
        return np.round(total).astype(np.int64)

    def crossings(self, near: Ints, u: Floats, v: Floats) -> Ints:
        """Return the signed crossings of rays with pieces `near` alone, ``(n,)``."""
        count, point, piece, sign = self._rays(near, u, v)
        hit = self._left(piece, u[point], v[point])
        count = count + np.bincount(point, sign * hit, minlength=len(u))
        return np.round(count).astype(np.int64)

    def _rays(self, near: Ints, u: Floats, v: Floats) -> tuple[Floats, Ints, Ints, Ints]:
        """Cross rays with pieces `near`.

        Returns
        -------
        count : numpy.ndarray
            ``(n,)`` signed crossings with pieces whose ends lie on one side of the point.
        point, piece, sign : numpy.ndarray
            ``(k,)`` those that remain to be solved, and how they count.
        """
        start, stop = self.arcs.start[:, near], self.arcs.stop[:, near]
        above = v[:, None] >= np.stack([start[1], stop[1]])[:, None, :]  # (2, n, k)
        sign = above[0].astype(np.int8) - above[1]  # (n, k) up is 1
        sign[u[:, None] >= np.maximum(start[0], stop[0])] = 0
        point, piece = np.nonzero(sign)
        signs = sign[point, piece].astype(np.int64)
        clear = u[point] < np.minimum(start[0], stop[0])[piece]
        count = np.bincount(point[clear], signs[clear], minlength=len(u))
        return count.astype(np.float64), point[~clear], near[piece[~clear]], signs[~clear]

    def _left(self, piece: Ints, u: Floats, v: Floats) -> Bools:
        """Tell which points ``(n,)``, at a height between the ends of pieces, lie left of them."""
        steps = self.ladder.shape[2] - 1
        low, high = np.zeros(len(piece), dtype=np.int64), np.full(len(piece), steps)
        up = self.arcs.stop[1, piece] > self.arcs.start[1, piece]
        while len(piece) and high[0] - low[0] > 1:  # the same number of steps for all
            middle = (low + high) // 2
            below = (self.ladder[1, piece, middle] <= v) == up
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        ends = self.ladder[0, piece, low], self.ladder[0, piece, high]
        left = u < np.minimum(*ends)
        near = np.flatnonzero(~left & (u < np.maximum(*ends)))
        t0, t1 = self.arcs.t[:, piece[near]]
        bracket = t0 + (t1 - t0) * np.stack([low[near], high[near]]) / steps
        t = self._parameter(
            piece[near], 1, v[near], bracket, self.ladder[1, piece[near], low[near]]
        )
        point = self.outlines.evaluate(self.arcs.curve[piece[near]], t)[0]
        left[near] = u[near] < point[0] + self.arcs.shift[0, piece[near]]
        return np.asarray(left)

    def parameter(self, piece: Ints, axis: int, value: Floats) -> Floats:
        """Return where pieces ``(n,)`` reach a u (axis 0) or v (axis 1) between their ends."""
        first = self.arcs.start[axis, piece]
        return self._parameter(piece, axis, value, self.arcs.t[:, piece], first)

    def _parameter(
        self, piece: Ints, axis: int, value: Floats, bracket: Floats, first: Floats
    ) -> Floats:
        curve, shift = self.arcs.curve[piece], self.arcs.shift[axis, piece]

        def height(index: Ints, t: Floats) -> tuple[Floats, Floats]:
            jet = self.outlines.evaluate(curve[index], t)[:2, axis]
            return jet[0] + shift[index] - value[index], jet[1]

        return bracketed_roots(height, bracket[0], bracket[1], first - value)


def _ladder(outlines: Outlines, arcs: Arcs) -> Floats:
    """Return points ``(2, n, _STEPS + 1)`` at equal steps of the parameter of each arc."""
    t = arcs.t[0][:, None] + (arcs.t[1] - arcs.t[0])[:, None] * np.linspace(0, 1, _STEPS + 1)
    curve = np.repeat(arcs.curve, _STEPS + 1)
    points = outlines.evaluate(curve, t.ravel())[0].reshape(2, len(arcs), _STEPS + 1)
    points += arcs.shift[:, :, None]
    points[:, :, 0], points[:, :, -1] = arcs.start, arcs.stop
    return np.asarray(points)


def cut(outlines: Outlines, arcs: Arcs, n_patches: int) -> Pieces:
    """Cut arcs where their curve is not smooth, and where u or v has an extremum."""
    bent = np.flatnonzero(~outlines.straight[arcs.curve])
    low, high = np.sort(arcs.t[:, bent], axis=0)
    knots = [
        outlines.breaks(*ends)
        for ends in zip(arcs.curve[bent].tolist(), low.tolist(), high.tolist(), strict=True)
    ]
    arcs = cut_at(
        outlines,
        arcs,
        np.repeat(bent, [len(found) for found in knots]),
        np.concatenate([*knots, np.zeros(0)]),
    )
    extrema = [_extrema(outlines, arcs, axis) for axis in (0, 1)]
    arc, t = (np.concatenate(part) for part in zip(*extrema, strict=True))
    return Pieces.of(outlines, cut_at(outlines, arcs, arc, t), n_patches)


def _extrema(outlines: Outlines, arcs: Arcs, axis: int) -> tuple[Ints, Floats]:
    """Return arcs, and the parameters on them where u (axis 0) or v (axis 1) turns back."""
    bent = np.flatnonzero(~outlines.straight[arcs.curve])
    curve = arcs.curve[bent]

    def slope(index: Ints, t: Floats) -> tuple[Floats, Floats]:
        jet = outlines.evaluate(curve[index], t)[1:, axis]
        return jet[0], jet[1]

    index, root = isolate(slope, _scale(arcs)[axis, bent], *np.sort(arcs.t[:, bent], axis=0))
    return bent[index], root


def _scale(arcs: Arcs) -> Floats:
    """Return the greatest abs(u) and abs(v) around the patch of each arc, ``(2, n)``."""
    most = np.zeros((2, int(arcs.patch.max(initial=-1)) + 1))
    for axis in (0, 1):
        for ends in (arcs.start[axis], arcs.stop[axis]):
            np.maximum.at(most[axis], arcs.patch, np.abs(ends))
    scale = np.maximum(most, _TINY * most.max(axis=0, initial=0))
    return np.asarray(scale[:, arcs.patch])


def cut_at(outlines: Outlines, arcs: Arcs, arc: Ints, t: Floats) -> Arcs:
    """Cut arcs at parameters.

    Parameters
    ----------
    arc, t : numpy.ndarray
        ``(k,)`` which arc is cut, and where; what is no inner place of it, or comes twice, is
        left out.
    """
    margin = 8 * _EPS * np.abs(arcs.t).max(axis=0, initial=0)
    low, high = np.sort(arcs.t, axis=0)
    inner = (t > (low + margin)[arc]) & (t < (high - margin)[arc])
    arc, t = arc[inner], t[inner]
    order = np.lexsort([np.where((arcs.t[0] < arcs.t[1])[arc], t, -t), arc])
    arc, t = arc[order], t[order]
    fresh = np.ones(len(arc), dtype=bool)
    fresh[1:] = (arc[1:] != arc[:-1]) | (np.abs(np.diff(t)) > margin[arc[1:]])
    arc, t = arc[fresh], t[fresh]
    point = outlines.evaluate(arcs.curve[arc], t)[0] + arcs.shift[:, arc]
    count = np.bincount(arc, minlength=len(arcs)) + 1
    last = np.cumsum(count) - 1
    pieces = arcs.take(np.repeat(np.arange(len(arcs)), count))
    starts, stops = np.ones(len(pieces), dtype=bool), np.ones(len(pieces), dtype=bool)
    starts[last - count + 1] = stops[last] = False  # those keep the arc's own ends
    for ends, which, at in ((pieces.start, starts, 0), (pieces.stop, stops, 1)):
        ends[:, which] = point
        pieces.t[at, which] = t
    return pieces
