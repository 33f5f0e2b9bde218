"""Loops of one patch beside and inside each other: the same period, and the right direction.

What is inside a patch follows from the loops alone, each one changing sides. Files do not
always wind their loops as they should, and may write a hole a whole period beside the patch.
"""

from __future__ import annotations

import numpy as np

from breplake.schema.namespace import Bools, Floats, Ints
from breplake.schema.trimming.loops import Arcs
from breplake.schema.trimming.outline import Outlines
from breplake.schema.trimming.pieces import Pieces

__all__ = ["oriented", "settled"]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_SLACK = 1e-6  # of a period, by which a hole may leave its outer loop and still be in it


def settled(pieces: Pieces, period: Floats) -> Pieces:
    """Move loops by whole periods into the largest loop of their patch.

    Parameters
    ----------
    pieces : Pieces
    period : numpy.ndarray
        ``(2, n_patches)``, infinite where a surface is open or its loops stay as they are.
    """
    arcs = pieces.arcs
    patch, low, high = _boxes(arcs)
    order = np.lexsort([-(high - low).prod(axis=0), patch])
    largest = order[np.searchsorted(patch[order], patch)]  # by loop
    span = period[:, patch]
    closed = np.isfinite(span)
    slack = _SLACK * np.where(closed, span, 0.0)
    room_low, room_high = low[:, largest] - slack, high[:, largest] + slack
    outside = closed & ((low < room_low) | (high > room_high))
    turns = np.ceil(
        (room_low - low) / np.where(closed, span, 1.0)
    )  # to the first that begins in it
    by = np.where(outside, turns * np.where(closed, span, 0.0), 0.0)
    fits = (high + by <= room_high).all(axis=0)
    by = np.where(fits, by, 0.0)[:, arcs.loop]
    if not by.any():
        return pieces
    return Pieces.of(pieces.outlines, arcs.moved(by), len(pieces.first) - 1)


def _boxes(arcs: Arcs) -> tuple[Ints, Floats, Floats]:
    """Return the patch of each loop and its least and greatest coordinates ``(2, n_loops)``."""
    count = int(arcs.loop.max(initial=-1)) + 1
    patch = np.zeros(count, dtype=np.int64)
    patch[arcs.loop] = arcs.patch
    low, high = np.full((2, count), np.inf), np.full((2, count), -np.inf)
    for axis in (0, 1):
        for ends in (arcs.start[axis], arcs.stop[axis]):
            np.minimum.at(low[axis], arcs.loop, ends)
            np.maximum.at(high[axis], arcs.loop, ends)
    return patch, low, high


def oriented(pieces: Pieces) -> tuple[Pieces, Bools]:
    """Turn loops so that each has the patch to its left.

    Returns
    -------
    pieces : Pieces
    turned : numpy.ndarray
        ``(n_patches,)`` bool: a loop of the patch was turned.
    """
    arcs = pieces.arcs
    count = int(arcs.loop.max(initial=-1)) + 1
    left = np.bincount(arcs.loop, _below(pieces.outlines, arcs), minlength=count) > 0
    hole = _holes(pieces, count)
    wrong = (left == hole)[arcs.loop]
    turned = np.zeros(len(pieces.first) - 1, dtype=bool)
    turned[arcs.patch[wrong]] = True
    if not wrong.any():
        return pieces, turned
    t = np.where(wrong, arcs.t[::-1], arcs.t)
    start, stop = (
        np.where(wrong, b, a) for a, b in ((arcs.start, arcs.stop), (arcs.stop, arcs.start))
    )
    fixed = Arcs(arcs.patch, arcs.loop, arcs.curve, t, arcs.shift, start, stop)
    return Pieces.of(pieces.outlines, fixed, len(turned)), turned


def _below(outlines: Outlines, arcs: Arcs) -> Floats:
    """Return the integral of u dv over each arc, ``(n,)``."""
    middle, half = arcs.t.mean(axis=0), (arcs.t[1] - arcs.t[0]) / 2
    t = middle[:, None] + half[:, None] * _NODES
    jet = outlines.evaluate(np.repeat(arcs.curve, len(_NODES)), t.ravel())
    u, dv = (a.reshape(t.shape) for a in (jet[0, 0], jet[1, 1]))
    return np.asarray(((u + arcs.shift[0][:, None]) * dv) @ _WEIGHTS * half)


def _holes(pieces: Pieces, count: int) -> Bools:
    """Return whether each loop lies in an odd number of other loops of its patch."""
    arcs, hole = pieces.arcs, np.zeros(count, dtype=bool)
    # the middle of a loop's longest piece is a place where it touches no other loop
    longest = np.lexsort([-np.abs(arcs.stop - arcs.start).max(axis=0), arcs.loop])
    probe = longest[np.searchsorted(arcs.loop[longest], np.arange(count))]
    middle = arcs.t[:, probe].mean(axis=0)
    point = pieces.outlines.evaluate(arcs.curve[probe], middle)[0] + arcs.shift[:, probe]
    patch = arcs.patch[probe]
    several = np.flatnonzero(np.bincount(patch, minlength=len(pieces.first))[patch] > 1)
    for loop in several:
        near = np.arange(*pieces.first[[patch[loop], patch[loop] + 1]])
        others = near[arcs.loop[near] != loop]
        hole[loop] = bool(pieces.crossings(others, *point[:, [loop]])[0] % 2)
    return hole
