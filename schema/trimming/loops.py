"""Loops of patches as chains of oriented arcs in the parameter plane, closed without gaps.

Pcurves of neighbours in a loop may lie whole periods apart: a chain is walked from arc to
arc, each moved by the periods that bring it next to the one before. What gap is left is
closed by a straight segment, so that crossings count right at every height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from breplake.schema import ragged
from breplake.schema.namespace import Bools, Floats, Ints
from breplake.schema.trimming.outline import Outlines, rows_of

__all__ = ["Arcs", "chained", "closed", "coedge_arcs", "natural", "with_lines"]


@dataclass(frozen=True, slots=True)
class Arcs:
    """Stretches of curves in the direction of their loop, the patch to the left of them.

    Attributes
    ----------
    patch : numpy.ndarray
        ``(n,)`` row of the patch.
    loop : numpy.ndarray
        ``(n,)`` number of the loop, ascending over all patches.
    curve : numpy.ndarray
        ``(n,)`` number in `Outlines`.
    t : numpy.ndarray
        ``(2, n)`` parameter at start and end.
    shift : numpy.ndarray
        ``(2, n)`` what is added to the curve's u and v.
    start, stop : numpy.ndarray
        ``(2, n)`` first and last point, shift included.
    """

    patch: Ints
    loop: Ints
    curve: Ints
    t: Floats
    shift: Floats
    start: Floats
    stop: Floats

    def __len__(self) -> int:
        return len(self.patch)

    def take(self, index: Ints | Bools) -> Arcs:
        """Return some of the arcs."""
        ids = (self.patch[index], self.loop[index], self.curve[index])
        return Arcs(*ids, *(a[:, index] for a in (self.t, self.shift, self.start, self.stop)))

    def moved(self, by: Floats) -> Arcs:
        """Return the arcs moved by ``(2, n)``."""
        ends = (self.shift + by, self.start + by, self.stop + by)
        return Arcs(self.patch, self.loop, self.curve, self.t, *ends)

    @staticmethod
    def of(outlines: Outlines, patch: Ints, loop: Ints, curve: Ints, t: Floats) -> Arcs:
        """Return arcs that are not shifted."""
        start, stop = (outlines.evaluate(curve, at)[0] for at in t)
        return Arcs(patch, loop, curve, t, np.zeros_like(start), start, stop)

    def renumbered(self) -> Arcs:
        """Return the arcs with loops numbered without gaps."""
        loop = np.unique(self.loop, return_inverse=True)[1]
        ends = (self.t, self.shift, self.start, self.stop)
        return Arcs(self.patch, loop, self.curve, *ends)

    @staticmethod
    def joined(parts: list[Arcs]) -> Arcs:
        """Put arcs behind each other."""
        return Arcs(
            *(np.concatenate([getattr(p, name) for p in parts], axis=-1) for name in Arcs.__slots__)
        )


def coedge_arcs(
    outlines: Outlines, patches: pa.Table, curves: pa.Table, coedges: pa.Table, wanted: Bools
) -> tuple[Arcs, Bools]:
    """Return the arcs of all coedges that bound their patch, along the loops.

    Loops of reversed patches run as seen from outside; here they run as du x dv sees them.

    Parameters
    ----------
    wanted : numpy.ndarray
        ``(n_patches,)`` bool: patches of which arcs are returned.

    Returns
    -------
    arcs : Arcs
    known : numpy.ndarray
        ``(n_patches,)`` bool: a wanted patch all of whose coedges can be evaluated; the
        others have no arcs.
    """
    patch = rows_of(patches, "patch_id", ragged.identifiers(coedges, "patch_id"))
    curve = rows_of(curves, "curve_id", ragged.identifiers(coedges, "curve_id"))
    flipped = ragged.flags(patches, "reversed")[patch]
    loop, place = (ragged.integers(coedges, name) for name in ("loop", "place"))
    order = np.lexsort([np.where(flipped, -place, place), loop, patch])
    stored = np.stack([ragged.scalars(coedges, name) for name in ("t_min", "t_max")])
    range_ = np.stack([ragged.scalars(curves, name) for name in ("t_min", "t_max")])
    t = np.where(outlines.projected, range_[:, curve], stored)  # (2, n)
    t = np.where(ragged.flags(coedges, "reversed") != flipped, t[::-1], t)
    bounding = ~ragged.flags(coedges, "internal")
    bad = bounding & ~(outlines.known & np.isfinite(t).all(axis=0))
    known = wanted & (np.bincount(patch[bad], minlength=patches.num_rows) == 0)
    order = order[(bounding & known[patch])[order]]
    patch, loop = patch[order], loop[order]
    fresh = np.ones(len(order), dtype=bool)
    fresh[1:] = (patch[1:] != patch[:-1]) | (loop[1:] != loop[:-1])
    return Arcs.of(outlines, patch, np.cumsum(fresh) - 1, order, t[:, order]), known


def chained(arcs: Arcs, period: Floats) -> tuple[Arcs, Floats]:
    """Bring the arcs of each loop next to each other by whole periods.

    Parameters
    ----------
    arcs : Arcs
        In order of the loops.
    period : numpy.ndarray
        ``(2, n_patches)``, infinite where a surface is open.

    Returns
    -------
    arcs : Arcs
    turns : numpy.ndarray
        ``(2, n_loops)`` periods by which each loop ends beside its start: not zero where it
        winds around the surface.
    """
    first = np.diff(arcs.loop, prepend=-1) != 0
    heads = np.flatnonzero(first)
    tails = np.append(heads, len(arcs))[1:] - 1
    span = period[:, arcs.patch]
    before = np.roll(arcs.stop, 1, axis=1)
    steps = _periods(before - arcs.start, span)
    steps[:, first] = 0
    total = np.cumsum(steps, axis=1)
    moved = total - total[:, heads][:, np.cumsum(first) - 1]
    arcs = arcs.moved(moved * np.where(np.isfinite(span), span, 0.0))
    return arcs, _periods(arcs.stop[:, tails] - arcs.start[:, heads], span[:, heads])


def _periods(distance: Floats, period: Floats) -> Floats:
    """Return the number of periods that brings points nearest; 0 where there is none."""
    ratio = distance / period
    return np.asarray(np.round(np.where(np.isfinite(ratio), ratio, 0.0)))


def closed(outlines: Outlines, arcs: Arcs, turns: Floats, period: Floats) -> tuple[Outlines, Arcs]:
    """Close the gaps between the arcs of each loop by straight segments.

    A loop that winds around the surface ends beside its start, `turns` periods away.
    """
    heads = np.flatnonzero(np.diff(arcs.loop, prepend=-1) != 0)
    follower = np.arange(1, len(arcs) + 1)
    follower[np.append(heads, len(arcs))[1:] - 1] = heads
    target = arcs.start[:, follower]
    tails = np.flatnonzero(follower <= np.arange(len(arcs)))
    span = period[:, arcs.patch[heads]]
    target[:, tails] += turns * np.where(np.isfinite(span), span, 0.0)
    open_ = np.flatnonzero(np.any(target != arcs.stop, axis=0))
    if not len(open_):
        return outlines, arcs
    return with_lines(outlines, arcs, open_, arcs.stop[:, open_], target[:, open_])


def with_lines(
    outlines: Outlines, arcs: Arcs, beside: Ints, start: Floats, stop: Floats
) -> tuple[Outlines, Arcs]:
    """Add segments between points ``(2, k)`` to the loops of the arcs `beside`, ``(k,)``."""
    outlines, curve = outlines.with_segments(start, stop)
    t = np.tile([[0.0], [1.0]], len(beside))
    patch, loop = arcs.patch[beside], arcs.loop[beside]
    lines = Arcs(patch, loop, curve, t, np.zeros_like(start), start, stop)
    return outlines, Arcs.joined([arcs, lines])


def natural(outlines: Outlines, bare: Ints, bounds: Floats, loop: int) -> tuple[Outlines, Arcs]:
    """Return the natural bounds of patches without loops as loops.

    Parameters
    ----------
    outlines : Outlines
        To which segments are added.
    bare : numpy.ndarray
        ``(k,)`` rows of those patches.
    bounds : numpy.ndarray
        ``(4, k)`` least and greatest u, least and greatest v.
    loop : int
        Number of the first new loop.
    """
    corners = bounds[[[0, 1, 1, 0], [2, 2, 3, 3]]]  # (2, 4, k) counter-clockwise
    start, stop = (a.reshape(2, -1) for a in (corners, np.roll(corners, -1, axis=1)))
    outlines, curve = outlines.with_segments(start, stop)
    t = np.tile([[0.0], [1.0]], start.shape[1])
    numbers = np.tile(loop + np.arange(len(bare)), 4)
    lines = Arcs(np.tile(bare, 4), numbers, curve, t, np.zeros_like(start), start, stop)
    return outlines, lines
