"""Parameter planes cut into cells, each with a bound on the density of area in it.

Points that are uniform in a cell, and kept with a chance of their density over its bound, are
uniform by area: no patch's area has to be known, and no integral to be inverted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from breplake.schema.namespace import Bools, Floats, Ints, slices
from breplake.schema.trimming.density import Density
from breplake.schema.trimming.pieces import Pieces

__all__ = ["Cells", "bounded", "narrowed"]

_ORDER: Final = 6  # degree of the series in each direction
_NODES: Final = np.cos(np.pi * (np.arange(_ORDER + 1) + 0.5) / (_ORDER + 1))
_TO_SERIES: Final = np.linalg.inv(np.polynomial.chebyshev.chebvander(_NODES, _ORDER)).T
_CLEAR: Final = 0.01  # share of the last terms in a series below which it is the function
_MARGIN: Final = 4  # times its last terms are allowed for those that it lacks
_LOOSE: Final = 1.3  # times its mean that a bound may be
_SLIGHT: Final = 0.02  # share in the proposals of a patch that a cell may waste all the same
_DEEPEST: Final = 16  # halvings of a cell
_FULL: Final = 0.6  # share of its cells that a patch should fill
_CUTS: Final = 6  # times that cells are quartered to follow a boundary
_PAIRS: Final = 4_000_000  # pairs of cells and parts of pieces that are compared at once
_SLACK: Final = 1e-12  # of the coordinates, by which boxes around pieces are wider


@dataclass(frozen=True, slots=True)
class Cells:
    """Rectangles (u, v) of patches.

    Attributes
    ----------
    patch : numpy.ndarray
        ``(n,)`` row of the patch.
    box : numpy.ndarray
        ``(4, n)`` least and greatest u, least and greatest v.
    bound : numpy.ndarray
        ``(n,)`` density of area that no point of the cell exceeds.
    border : numpy.ndarray
        ``(n,)`` bool: the boundary of the patch may pass; else all of the cell is inside.
    """

    patch: Ints
    box: Floats
    bound: Floats
    border: Bools

    def __len__(self) -> int:
        return len(self.patch)

    @property
    def mass(self) -> Floats:
        """Area that the bound stands for, ``(n,)`` mm^2."""
        size = (self.box[1] - self.box[0]) * (self.box[3] - self.box[2])
        return np.asarray(self.bound * size)

    def take(self, index: Ints | Bools) -> Cells:
        """Return some of the cells."""
        return Cells(self.patch[index], self.box[:, index], self.bound[index], self.border[index])

    @staticmethod
    def joined(parts: list[Cells]) -> Cells:
        """Put cells behind each other."""
        return Cells(
            *(np.concatenate([getattr(p, n) for p in parts], axis=-1) for n in Cells.__slots__)
        )

    def halved(self, axis: Ints) -> Cells:
        """Cut each cell in two across u (axis 0) or v (axis 1)."""
        low = np.where(axis, self.box[2], self.box[0])
        high = np.where(axis, self.box[3], self.box[1])
        middle, at = (low + high) / 2, np.arange(len(self))
        first, second = self.box.copy(), self.box.copy()
        first[2 * axis + 1, at] = middle
        second[2 * axis, at] = middle
        return Cells.joined([replace(self, box=first), replace(self, box=second)])


def bounded(density: Density, window: Floats) -> Cells:
    """Cut windows at creases and further, until each cell's density is bounded well.

    The bound is the sum of the absolute terms of the Chebyshev series of the squared density
    on the cell, with a margin of `_MARGIN` times its last terms, which are small: on a cell
    without creases the squared density is a polynomial (of splines) or analytic, whose terms
    fall off as they do up to there.

    Parameters
    ----------
    density : Density
        The patches.
    window : numpy.ndarray
        ``(4, n_patches)`` least and greatest u and v; NaN for patches without cells.
    """
    cells, done = _grid(density, window), []
    scale: Floats = np.zeros(window.shape[1])
    for level in range(_DEEPEST + 1):
        square, tail, axis = _series(density, cells)
        bound = np.sqrt(square[0] + _MARGIN * tail)
        cells = replace(cells, bound=bound)
        if level == 0:
            scale = np.asarray(np.bincount(cells.patch, cells.mass, minlength=len(scale)), float)
        with np.errstate(divide="ignore", invalid="ignore"):
            waste = 1 - np.sqrt(square[1]) / bound
        unclear = tail > _CLEAR * square[0]
        loose = (bound > _LOOSE * np.sqrt(square[1])) & (
            waste * cells.mass > _SLIGHT * scale[cells.patch]
        )
        split = (unclear | loose) & (cells.mass > 1e-9 * scale[cells.patch]) & (level < _DEEPEST)
        done.append(cells.take(~split))
        if not split.any():
            break
        cells = cells.take(split).halved(axis[split])
    return Cells.joined(done)


def _grid(density: Density, window: Floats) -> Cells:
    """Return windows cut at all creases."""
    patch, box = [np.zeros(0, dtype=np.int64)], [np.zeros((4, 0))]
    for row in np.flatnonzero(np.isfinite(window).all(axis=0)).tolist():
        u0, u1, v0, v1 = window[:, row].tolist()
        u, v = (
            np.concatenate([[low], density.creases(row, axis, low, high), [high]])
            for axis, low, high in ((0, u0, u1), (1, v0, v1))
        )
        i, j = (a.ravel() for a in np.indices((len(u) - 1, len(v) - 1)))
        patch.append(np.full(len(i), row))
        box.append(np.stack([u[i], u[i + 1], v[j], v[j + 1]]))
    patches = np.concatenate(patch)
    border = np.ones(len(patches), dtype=bool)
    return Cells(patches, np.concatenate(box, axis=1), np.zeros(len(patches)), border)


def _series(density: Density, cells: Cells) -> tuple[Floats, Floats, Ints]:
    """Expand the squared density on each cell.

    Returns
    -------
    square : numpy.ndarray
        ``(2, n)`` sum of the absolute terms, which bounds the series, and its mean.
    tail : numpy.ndarray
        ``(n,)`` sum of the absolute last terms.
    axis : numpy.ndarray
        ``(n,)`` along which it varies most.
    """
    n = _ORDER + 1
    middle, half = (cells.box[1::2] + cells.box[::2]) / 2, (cells.box[1::2] - cells.box[::2]) / 2
    u, v = (middle[i][:, None] + half[i][:, None] * _NODES for i in (0, 1))
    places = np.repeat(u, n, axis=1).ravel(), np.tile(v, (1, n)).ravel()
    found = density.at(np.repeat(cells.patch, n * n), *places).reshape(-1, n, n) ** 2
    terms = np.abs(np.einsum("cij,ik,jl->ckl", found, _TO_SERIES, _TO_SERIES))
    tail = terms[:, -2:].sum(axis=(1, 2)) + terms[:, :-2, -2:].sum(axis=(1, 2))
    varies = np.stack([terms[:, 1:].sum(axis=(1, 2)), terms[:, :, 1:].sum(axis=(1, 2))])
    square = np.stack([terms.sum(axis=(1, 2)), found.mean(axis=(1, 2))])
    return square, tail, np.argmax(varies, axis=0)


def narrowed(cells: Cells, pieces: Pieces, area: Floats) -> Cells:
    """Drop what lies outside of the patches, cutting cells up until little of it is left.

    Cells that no piece of the boundary enters lie inside or outside as a whole. The others,
    of patches that fill less than `_FULL` of their cells, are quartered again and again.

    Parameters
    ----------
    cells : Cells
        All of whose `border` is True.
    pieces : Pieces
        The boundaries of the patches.
    area : numpy.ndarray
        ``(n_patches,)`` area of the patches, mm^2, roughly.
    """
    done: list[Cells] = []
    for level in range(_CUTS + 1):
        cells = _classified(cells, pieces, level)
        parts = [*done, cells]
        mass = sum(np.bincount(part.patch, part.mass, minlength=len(area)) for part in parts)
        wasteful = (mass * _FULL > area) & (mass - area > _SLIGHT * area.sum())
        split = wasteful[cells.patch] & cells.border & (level < _CUTS)
        done.append(cells.take(~split))
        if not split.any():
            break
        cells = cells.take(split)
        for axis in (0, 1):
            cells = cells.halved(np.full(len(cells), axis))
    return Cells.joined(done)


def _classified(cells: Cells, pieces: Pieces, level: int) -> Cells:
    """Find out which cells the boundary may enter, and drop those outside."""
    border = np.ones(len(cells), dtype=bool)
    patches, count = np.unique(cells.patch, return_counts=True)
    for row in patches[count > 1].tolist():  # a single cell holds the whole boundary
        mine = np.flatnonzero(cells.patch == row)
        boxes = _boxes(pieces, row, 2 ** (level + 2))
        for part in slices(len(mine), max(1, _PAIRS // max(1, boxes.shape[1]))):
            u0, u1, v0, v1 = cells.box[:, mine[part], None]
            apart = (boxes[0] > u1) | (boxes[1] < u0) | (boxes[2] > v1) | (boxes[3] < v0)
            border[mine[part]] = ~apart.all(axis=1)
    middle = (cells.box[::2] + cells.box[1::2]) / 2
    clear = np.flatnonzero(~border)
    keep = border.copy()
    keep[clear] = pieces.winding(cells.patch[clear], *middle[:, clear]) % 2 == 1
    return replace(cells, border=border).take(keep)


def _boxes(pieces: Pieces, row: int, parts: int) -> Floats:
    """Return boxes ``(4, k)`` around equal parts of all pieces of a patch, a little wider."""
    mine = np.arange(pieces.first[row], pieces.first[row + 1])
    low, high = pieces.arcs.t[:, mine]
    t = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, parts + 1)
    curve = np.repeat(pieces.arcs.curve[mine], parts + 1)
    point = pieces.outlines.evaluate(curve, t.ravel())[0].reshape(2, len(mine), parts + 1)
    point = point + pieces.arcs.shift[:, mine, None]
    ends = np.stack([point[:, :, :-1], point[:, :, 1:]])  # (2, 2, pieces, parts)
    slack = _SLACK * np.abs(point).max(axis=(1, 2))[:, None]
    u, v = np.moveaxis(ends.reshape(2, 2, -1), 1, 0)  # each (2, k)
    return np.stack(
        [
            u.min(axis=0) - slack[0],
            u.max(axis=0) + slack[0],
            v.min(axis=0) - slack[1],
            v.max(axis=0) + slack[1],
        ]
    )
