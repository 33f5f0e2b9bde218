"""Lengths of curves, and points at given lengths along them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from breplake.schema.curves import CurveSet
from breplake.schema.namespace import Floats, Ints
from breplake.schema.roots import bracketed_roots

__all__ = ["CurveLengths"]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_RELATIVE: Final = 1e-12  # error of a span's length, as a share of its curve's
_DEEPEST: Final = 20  # halvings of a span


@dataclass(frozen=True, slots=True)
class CurveLengths:
    """Curves cut into spans on which Gauss' rule integrates their speed exactly enough.

    Attributes
    ----------
    curves : CurveSet
    row : numpy.ndarray
        ``(n,)`` rows of the curves that are measured.
    first : numpy.ndarray
        ``(n + 1,)`` first span of each.
    t : numpy.ndarray
        ``(2, n_spans)`` parameters between which a span lies.
    ends : numpy.ndarray
        ``(n_spans,)`` lengths of all spans up to the end of each.
    """

    curves: CurveSet
    row: Ints
    first: Ints
    t: Floats
    ends: Floats

    @staticmethod
    def of(curves: CurveSet, row: Ints, low: Floats, high: Floats) -> CurveLengths:
        """Measure curves between parameters.

        Parameters
        ----------
        curves : CurveSet
        row : numpy.ndarray
            ``(n,)`` known rows.
        low, high : numpy.ndarray
            ``(n,)`` parameters, ``low <= high``.
        """
        owner, start, stop = _smooth(curves, row, low, high)
        scale = np.bincount(owner, _integral(curves, row[owner], start, stop), len(row))
        done = [(owner[:0], start[:0], stop[:0], start[:0])]
        for level in range(_DEEPEST + 1):
            whole = _integral(curves, row[owner], start, stop)
            middle = (start + stop) / 2
            halves = [
                _integral(curves, row[owner], *ends) for ends in ((start, middle), (middle, stop))
            ]
            rough = np.abs(halves[0] + halves[1] - whole) > _RELATIVE * scale[owner]
            rough &= level < _DEEPEST
            length = (halves[0] + halves[1])[~rough]
            done.append((owner[~rough], start[~rough], stop[~rough], length))
            owner = np.tile(owner[rough], 2)
            start, stop = (
                np.concatenate([start[rough], middle[rough]]),
                np.concatenate([middle[rough], stop[rough]]),
            )
            if not len(owner):
                break
        owner, start, stop, length = (np.concatenate(part) for part in zip(*done, strict=True))
        order = np.lexsort([start, owner])
        first = np.searchsorted(owner[order], np.arange(len(row) + 1))
        return CurveLengths(
            curves, row, first, np.stack([start, stop])[:, order], np.cumsum(length[order])
        )

    @property
    def offset(self) -> Floats:
        """Length of all curves before each, and of all at the end, ``(n + 1,)`` mm."""
        return np.append(0.0, self.ends)[self.first]

    @property
    def length(self) -> Floats:
        """Length of each curve, ``(n,)`` mm."""
        return np.diff(self.offset)

    def at(self, distance: Floats) -> tuple[Ints, Floats]:
        """Find the points at distances along all curves, one behind the other.

        Parameters
        ----------
        distance : numpy.ndarray
            ``(m,)`` mm, between 0 and the length of all curves.

        Returns
        -------
        curve : numpy.ndarray
            ``(m,)`` place in `row`.
        t : numpy.ndarray
            ``(m,)`` parameter on it.
        """
        span = np.minimum(np.searchsorted(self.ends, distance, "right"), len(self.ends) - 1)
        curve = np.searchsorted(self.first, span, "right") - 1
        rest = distance - (self.ends[span] - np.diff(self.ends, prepend=0.0)[span])
        row, (low, high) = self.row[curve], self.t[:, span]

        def beyond(index: Ints, t: Floats) -> tuple[Floats, Floats]:
            length = _integral(self.curves, row[index], low[index], t)
            return length - rest[index], _speed(self.curves, row[index], t)

        return curve, bracketed_roots(beyond, low, high, -np.ones(len(rest)))


def _smooth(curves: CurveSet, row: Ints, low: Floats, high: Floats) -> tuple[Ints, Floats, Floats]:
    """Cut ranges of curves at their knots; return curve, start and stop of each part."""
    cuts = []
    for r, a, b in zip(row.tolist(), low.tolist(), high.tolist(), strict=True):
        inner = curves.breaks(r, a, b)
        cuts.append(np.concatenate([[a], inner[(inner > a) & (inner < b)], [b]]))
    owner = np.repeat(np.arange(len(cuts)), [len(cut) - 1 for cut in cuts])
    empty = [np.zeros(0)]
    start = np.concatenate([cut[:-1] for cut in cuts] or empty)
    return owner, start, np.concatenate([cut[1:] for cut in cuts] or empty)


def _speed(curves: CurveSet, row: Ints, t: Floats) -> Floats:
    return np.asarray(np.linalg.norm(curves.arrays(row, t)[1], axis=0))


def _integral(curves: CurveSet, row: Ints, low: Floats, high: Floats) -> Floats:
    """Return the lengths ``(n,)`` of curves between parameters."""
    middle, half = (low + high) / 2, (high - low) / 2
    t = middle[:, None] + half[:, None] * _NODES
    speed = _speed(curves, np.repeat(row, len(_NODES)), t.ravel())
    return np.asarray(speed.reshape(t.shape) @ _WEIGHTS * half)
