"""Triangles of a published mesh in the parameters of their patches, unfolded across seams."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
import numpy.typing as npt

from breplake.ingest.abc.geometry import ExactGeometry
from breplake.ingest.mesh import Mesh

__all__ = ["POLE", "Corners", "cross"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]
_Bools = npt.NDArray[np.bool_]

_WIDE: Final = 0.3
"""A side of a triangle that covers this share of a period may go round the other way."""

_TURNED: Final = (0.15, 0.05)
"""A triangle that turns the wrong way may go round with a side of this share of a period, if it
covers this share of its bounding box, and so is not just thin. Others are folded."""

POLE: Final = 1e-6
"""Share of the greatest length of a derivative on a patch at which one vanishes."""


@dataclass(frozen=True, slots=True)
class Corners:
    """Triangles in the parameters of their patches.

    A corner at a pole, where one parameter is any, is the last one of its triangle.

    Parameters
    ----------
    patch : numpy.ndarray
        ``(f,)``.
    vertex : numpy.ndarray
        ``(f, 3)`` mesh vertices.
    uv : numpy.ndarray
        ``(f, 3, 2)``, across seams too.
    free : numpy.ndarray
        ``(f, 2)`` bool: u or v of the last corner may be any.
    """

    patch: _Ints
    vertex: _Ints
    uv: _Floats
    free: _Bools

    @classmethod
    def of(cls, mesh: Mesh, geometry: ExactGeometry) -> Corners:
        """Read them off a mesh; see `masses` for the parameters."""
        jet = geometry.jet(mesh.pair_patch, *mesh.uv.T)
        speed = np.column_stack([np.linalg.norm(jet.du, axis=1), np.linalg.norm(jet.dv, axis=1)])
        usual = np.zeros((int(mesh.pair_patch.max()) + 1, 2))
        np.maximum.at(usual, mesh.pair_patch, np.nan_to_num(speed))
        pole = speed <= POLE * usual[mesh.pair_patch]  # (m, 2)
        patch = mesh.patch
        pair = mesh.pairs(np.repeat(patch, 3), mesh.triangles.ravel()).reshape(-1, 3)
        first = (pole[pair].any(axis=2).argmax(axis=1) + 1) % 3  # the corner after the pole
        first[~pole[pair].any(axis=(1, 2))] = 0
        turned = (first[:, None] + np.arange(3)) % 3
        pair = np.take_along_axis(pair, turned, axis=1)
        uv = mesh.uv[pair]  # (f, 3, 2)
        periods = geometry.periods
        for corner in (1, 2):
            uv[:, corner] = periods.near(patch, uv[:, corner], uv[:, 0])
        # a closed surface that is not periodic ends at its bounds: on which side, all corners say
        middle = uv.mean(axis=1)
        uv += (periods.inside(patch, middle) - middle)[:, None]
        free = pole[pair[:, 2]]
        found = cls(patch, mesh.pair_vertex[pair], uv, free)
        found._unfold(np.asarray(periods.period[patch]))
        return found

    def _unfold(self, period: _Floats) -> None:
        """Take sides that cover much of a period the way round that suits the patch.

        All triangles of a patch turn the same way in (u, v). Of the ways round with which one
        does, it is the one of the shortest sides: area says nothing, as a shear keeps it. A
        triangle that turns the wrong way may have a shorter side that goes round the other way
        near a pole: at the tip of a cone two triangles may share the whole turn.
        """
        sides = np.abs(_sides(self.uv, self.free))  # (f, 3, 2)
        wide: _Bools = np.any(sides >= _WIDE * period[:, None], axis=1)  # (f, 2)
        turn = self.turn
        way = np.sign(np.bincount(self.patch, np.where(wide.any(axis=1), 0.0, turn)))
        box = sides.max(axis=1).prod(axis=1)
        has_pole = np.bincount(self.patch, self.free.any(axis=1)) > 0
        wrong = has_pole[self.patch] & (turn * way[self.patch] < -_TURNED[1] * box)
        wide |= wrong[:, None] & np.any(sides >= _TURNED[0] * period[:, None], axis=1)
        for axis in (0, 1):
            rows = np.flatnonzero(wide[:, axis])
            self.uv[rows] = self._shortest(rows, axis, period[rows, axis], way[self.patch[rows]])

    def _shortest(self, rows: _Ints, axis: int, period: _Floats, way: _Floats) -> _Floats:
        """Return triangles with the shortest sides of those that turn the right way, or as is."""
        chosen, best = self.uv[rows].copy(), np.full(len(rows), np.inf)
        free = self.free[rows]
        for one, two in product((0, -1, 1), repeat=2):
            uv = self.uv[rows].copy()
            uv[:, 1, axis] += one * period
            uv[:, 2, axis] += two * period
            length = (_sides(uv, free)[:, :, axis] ** 2).sum(axis=1)
            better = (_turn(uv, free) * way > 0) & (length < best * (1 - 1e-9))
            chosen[better], best[better] = uv[better], length[better]
        return chosen

    def folded(self, n_patches: int) -> _Floats:
        """Return which share of each patch turns the wrong way, by area in (u, v), ``(p,)``."""
        turn = self.turn
        whole = np.bincount(self.patch, np.abs(turn), minlength=n_patches)
        net = np.abs(np.bincount(self.patch, turn, minlength=n_patches))
        return np.asarray((whole - net) / 2 / np.where(whole > 0, whole, 1.0))

    def ranges(
        self, geometry: ExactGeometry, seams: _Floats, n_patches: int
    ) -> tuple[_Floats, _Floats]:
        """Return least and greatest parameters of patches, ``(p, 2)`` each.

        Around a period a patch begins at its seam ``(p, 2)`` or, where that is NaN, behind the
        widest gap between its triangles.
        """
        low, high = np.full((n_patches, 2), np.inf), np.full((n_patches, 2), -np.inf)
        for patch in np.unique(self.patch):
            uv = self.uv[self.patch == patch].copy()  # (f, 3, 2)
            for axis in (0, 1):
                period = geometry.periods.period[patch, axis]
                if np.isfinite(period):
                    middle = uv[:, :, axis].mean(axis=1)
                    start = seams[patch, axis]
                    start = _behind_gap(middle, period) if np.isnan(start) else start
                    turns = np.floor((middle - start) / period)
                    uv[:, :, axis] -= (turns * period)[:, None]
            low[patch], high[patch] = uv.min(axis=(0, 1)), uv.max(axis=(0, 1))
        return low, high

    @property
    def turn(self) -> _Floats:
        """Twice the area of each triangle in (u, v), negative if clockwise, ``(f,)``."""
        return _turn(self.uv, self.free)

    def at(self, row: _Ints, s: _Floats, t: _Floats) -> tuple[_Floats, _Floats]:
        """Map s along the first side and t from there to the last corner; see `_Maps`."""
        one, two, last = (self.uv[row, i] for i in range(3))
        free, s, t = self.free[row], s[:, None], t[:, None]
        base = two - one
        at_base = one + s * base
        to_last = np.where(free, at_base, last) - at_base
        along = base * np.where(free, 1.0, 1 - t)
        return at_base + t * to_last, cross(along, to_last)


def _turn(uv: _Floats, free: _Bools) -> _Floats:
    """Return twice the area of triangles ``(f, 3, 2)``; of free corners, the square's."""
    base = uv[:, 1] - uv[:, 0]
    to_last = np.where(free, 0.0, uv[:, 2] - uv[:, 0])
    return cross(base, to_last)


def _sides(uv: _Floats, free: _Bools) -> _Floats:
    """Return the sides ``(f, 3, 2)`` of triangles; a free corner is where its neighbour is."""
    corners = uv.copy()
    corners[:, 2] = np.where(free, uv[:, 1], uv[:, 2])
    return np.asarray(np.roll(corners, -1, axis=1) - corners)


def _behind_gap(values: _Floats, period: float) -> float:
    """Return the first of values around a period behind their widest gap, less half of it."""
    ordered = np.unique(np.mod(values, period))
    gaps = np.diff(ordered, prepend=ordered[-1] - period)
    widest = int(gaps.argmax())
    return float(ordered[widest] - gaps[widest] / 2)


def cross(a: _Floats, b: _Floats) -> _Floats:
    """Return the cross products ``(n,)`` of vectors ``(n, 2)``."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
