"""Curves that bound patches in their parameter planes, from three sources behind one interface.

A coedge's curve is a row of ``pcurves`` or, on a plane, the curve in space projected onto the
plane's axes, which is exact. Straight segments close the gaps between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pyarrow as pa

from breplake.schema import ragged
from breplake.schema.curves import CurveSet
from breplake.schema.namespace import Bools, Floats, Ints, batches, dot, gather
from breplake.schema.pcurves import PcurveSet

__all__ = ["Outlines"]

_STORED: Final = 0  # a row of pcurves
_PROJECTED: Final = 1  # a row of curves, on a plane
_SEGMENT: Final = 2
_BATCH = 65_536  # curves evaluated together


@dataclass(frozen=True, slots=True)
class Outlines:
    """Curves (u, v)(t), numbered through: coedges first, then segments.

    Attributes
    ----------
    source : numpy.ndarray
        ``(n,)`` where a curve comes from; negative where it cannot be evaluated.
    row : numpy.ndarray
        ``(n,)`` its row in that source.
    plane : numpy.ndarray
        ``(9, n_coedges)`` location, x and y axis of the plane that a coedge lies on.
    segments : numpy.ndarray
        ``(4, n_segments)`` start and direction; t runs from 0 to 1.
    """

    stored: PcurveSet
    space: CurveSet
    source: Ints
    row: Ints
    plane: Floats
    segments: Floats

    @staticmethod
    def from_tables(
        patches: pa.Table, curves: pa.Table, coedges: pa.Table, pcurves: pa.Table
    ) -> Outlines:
        """Find the curve of every coedge; all rows are of one model."""
        stored, space = PcurveSet.from_pcurves(pcurves), CurveSet.from_curves(curves)
        patch = rows_of(patches, "patch_id", ragged.identifiers(coedges, "patch_id"))
        own = rows_of(pcurves, "pcurve_id", ragged.identifiers(coedges, "pcurve"))
        curve = rows_of(curves, "curve_id", ragged.identifiers(coedges, "curve_id"))
        flat = ragged.codes(patches, "type", ("Plane",))[patch] == 0
        frame = [ragged.vectors(patches, name) for name in ("location", "x_axis", "y_axis")]
        projected = flat & (own < 0) & (curve >= 0) & _at(space.known, curve)
        source = np.select([_at(stored.known, own), projected], [_STORED, _PROJECTED], -1)
        return Outlines(
            stored,
            space,
            source,
            np.where(source == _STORED, own, curve),
            np.concatenate(frame)[:, patch],
            np.zeros((4, 0)),
        )

    @property
    def known(self) -> Bools:
        """Whether each curve can be evaluated, ``(n,)``."""
        return np.asarray(self.source >= 0)

    @property
    def projected(self) -> Bools:
        """Whether each curve is one in space, seen from a plane's normal, ``(n,)``."""
        return np.asarray(self.source == _PROJECTED)

    @property
    def straight(self) -> Bools:
        """Whether each curve is a straight line, ``(n,)``."""
        straight = np.asarray(self.source == _SEGMENT)
        for source, curves in ((_STORED, self.stored.curves), (_PROJECTED, self.space)):
            mine = np.flatnonzero(self.source == source)
            lines = np.array([kind.name == "Line" for kind in curves.kinds], dtype=bool)
            straight[mine] = lines[curves.group[self.row[mine]]]
        return straight

    def with_segments(self, start: Floats, stop: Floats) -> tuple[Outlines, Ints]:
        """Add straight segments between points ``(2, k)``; return their numbers as well."""
        count, first = start.shape[1], self.segments.shape[1]
        added = replace(
            self,
            source=np.append(self.source, np.full(count, _SEGMENT)),
            row=np.append(self.row, first + np.arange(count)),
            segments=np.concatenate([self.segments, np.concatenate([start, stop - start])], axis=1),
        )
        return added, len(self.source) + np.arange(count)

    def evaluate(self, curve: Ints, t: Floats) -> Floats:
        """Return points (u, v) with two derivatives by t, ``(3, 2, n)``; NaN if unknown.

        Parameters
        ----------
        curve, t : numpy.ndarray
            ``(n,)`` numbers of curves, and parameters on them.
        """
        source = self.source[curve]
        out = np.full((3, 2, len(curve)), np.nan)
        for kind, index in batches(source, _BATCH):
            which, at = curve[index], t[index]
            if kind == _STORED:
                out[:, :, index] = self.stored.curves.arrays(self.row[which], at)
            elif kind == _PROJECTED:
                out[:, :, index] = self._projected(which, at)
            else:
                line = gather(self.segments, self.row[which])
                out[0][:, index] = line[:2] + at * line[2:]
                out[1][:, index], out[2][:, index] = line[2:], 0.0
        return out

    def _projected(self, curve: Ints, t: Floats) -> Floats:
        """Return the jet of curves in space, seen from their planes' normals."""
        jet = self.space.arrays(self.row[curve], t)
        plane = gather(self.plane, curve)
        jet[0] -= plane[0:3]
        return np.stack([np.stack([dot(part, plane[3:6]), dot(part, plane[6:9])]) for part in jet])

    def breaks(self, curve: int, low: float, high: float) -> Floats:
        """Return the parameters between `low` and `high` where a curve may not be smooth."""
        source, row = int(self.source[curve]), int(self.row[curve])
        if source == _STORED:
            found = self.stored.breaks(row, low, high)
        elif source == _PROJECTED:
            found = self.space.breaks(row, low, high)
        else:
            return np.zeros(0)
        inner: Floats = found[(found > low) & (found < high)]
        return inner


def rows_of(table: pa.Table, key: str, wanted: Ints) -> Ints:
    """Return the row of each id in a table of one model, ``(n,)``; -1 where it has none."""
    own = ragged.identifiers(table, key)
    if not len(own):
        return np.full(len(wanted), -1)
    order = np.argsort(own, kind="stable")
    at = np.minimum(np.searchsorted(own, wanted, sorter=order), len(own) - 1)
    found = order[at]
    return np.where((own[found] == wanted) & (wanted >= 0), found, -1)


def _at(known: Bools, row: Ints) -> Bools:
    """Return ``known[row]``, False where the row is -1."""
    return np.append(known, False)[row]
