"""Patches whose loops wind around a closed surface without a seam to cut it open.

Such a loop ends a whole period beside its start. It is closed by a way back through an
anchor: straight to the anchor's image, by whole periods to the anchor, straight to the start.
Summed over all images of the loops these ways cancel, but for those along the lower side of
the window. What is left to know is which side of a loop is inside.
"""

from __future__ import annotations

import numpy as np

from breplake.schema.namespace import Floats
from breplake.schema.trimming.loops import Arcs, with_lines
from breplake.schema.trimming.outline import Outlines
from breplake.schema.trimming.pieces import Pieces, cut

__all__ = ["unwrapped"]

_BESIDE = 1e-7  # of the window: how far to the left of a loop its inside is probed


def unwrapped(
    outlines: Outlines, arcs: Arcs, turns: Floats, period: Floats, window: Floats
) -> tuple[Outlines, Arcs]:
    """Return the loops of one patch as pieces that enclose it in its window.

    Parameters
    ----------
    outlines, arcs
        All loops of one patch, without gaps.
    turns : numpy.ndarray
        ``(2, n_loops)`` periods by which each loop, in ascending order, ends beside its start.
    period : numpy.ndarray
        ``(2,)``, infinite where the surface is open.
    window : numpy.ndarray
        ``(4,)`` least and greatest u and v: one period, or as far as the surface goes.

    Returns
    -------
    outlines, arcs
        Closed loops, those of all images that reach into the window. Some lie outside of it.
    """
    span = np.where(np.isfinite(period), period, 0.0)
    heads = np.unique(arcs.loop, return_index=True)[1]
    winding = np.flatnonzero(turns.any(axis=0))
    ways = [_way_back(window[[0, 2]], arcs.start[:, heads[i]], turns[:, i], span) for i in winding]
    of_loop = np.repeat(heads[winding], [way.shape[1] - 1 for way in ways])
    start = np.concatenate([way[:, :-1] for way in ways], axis=1)
    stop = np.concatenate([way[:, 1:] for way in ways], axis=1)
    outlines, closed = with_lines(outlines, arcs, of_loop, start, stop)
    images = _images(cut(outlines, closed, 0).arcs, span, window)
    if _winding_beside(outlines, images, arcs.take(heads[winding[:1]]), window, span) < 1:
        corners = window[[[0, 1, 1, 0], [2, 2, 3, 3]]]  # (2, 4) counter-clockwise
        beside = np.zeros(4, dtype=np.int64)
        outlines, images = with_lines(outlines, images, beside, corners, np.roll(corners, -1, 1))
    return outlines, images


def _way_back(anchor: Floats, start: Floats, turn: Floats, span: Floats) -> Floats:
    """Return the corners ``(2, k)`` of the way from where a loop ends to where it starts."""
    corners = [start + turn * span]
    u_turn, v_turn = int(turn[0]), int(turn[1])
    for i in range(u_turn, 0, -np.sign(u_turn) or -1):
        corners.append(anchor + np.array([i, v_turn]) * span)
    for i in range(v_turn, 0, -np.sign(v_turn) or -1):
        corners.append(anchor + np.array([0, i]) * span)
    return np.stack([*corners, anchor, start], axis=1)


def _images(arcs: Arcs, span: Floats, window: Floats) -> Arcs:
    """Return arcs with all their images by whole periods that reach into the window."""
    low = np.minimum(arcs.start, arcs.stop).min(axis=1)
    high = np.maximum(arcs.start, arcs.stop).max(axis=1)
    steps = [range(1)] * 2
    for axis in np.flatnonzero(span):
        first = np.ceil((window[2 * axis] - high[axis]) / span[axis])
        last = np.floor((window[2 * axis + 1] - low[axis]) / span[axis])
        steps[axis] = range(int(first), int(last) + 1)
    return Arcs.joined([arcs.moved((span * (i, j))[:, None]) for i in steps[0] for j in steps[1]])


def _winding_beside(
    outlines: Outlines, images: Arcs, arc: Arcs, window: Floats, span: Floats
) -> int:
    """Return how often the images wind around a point just to the left of an arc."""
    point, along, _ = outlines.evaluate(arc.curve, arc.t.mean(axis=0))
    size = window[1::2] - window[::2]
    size = np.where(size > 0, size, 1.0)  # of a patch that is no wider than a line
    left = np.array([-along[1, 0] / size[1], along[0, 0] / size[0]])  # in units of the window
    left *= np.sign(arc.t[1, 0] - arc.t[0, 0]) / (np.linalg.norm(left) or 1.0)
    probe = point[:, 0] + arc.shift[:, 0] + _BESIDE * size * left
    turns = np.floor((probe - window[::2]) / np.where(span > 0, span, np.inf))
    probe = probe - turns * span
    pieces = Pieces.of(outlines, images, 0)
    return int(pieces.crossings(np.arange(len(images)), probe[[0]], probe[[1]])[0])
