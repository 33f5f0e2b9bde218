"""Trimmed patches of a model, from its tables alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from breplake.schema import ragged
from breplake.schema.grouping import query
from breplake.schema.namespace import Bools, Floats
from breplake.schema.periods import surface_kinds, surface_periods
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.trimming.area import areas
from breplake.schema.trimming.density import Density
from breplake.schema.trimming.loops import Arcs, chained, closed, coedge_arcs, natural
from breplake.schema.trimming.nesting import oriented, settled
from breplake.schema.trimming.outline import Outlines
from breplake.schema.trimming.pieces import Pieces, cut
from breplake.schema.trimming.wraps import unwrapped
from breplake.schema.types import SURFACE_TYPES

__all__ = ["AREA_ERROR", "TrimmedPatches"]

AREA_ERROR = 1e-9
"""Relative error asked of areas if none is given."""

_SLACK = 1e-6  # of a period, by which a patch may be wider than one


@dataclass(frozen=True, slots=True)
class TrimmedPatches:
    """What of the surfaces of a model's patches their loops leave.

    Build one with :meth:`from_tables`. Patches are addressed by their row in the table.

    Attributes
    ----------
    density : Density
        The surfaces.
    pieces : Pieces
        The boundaries, with the patch to their left in the parameter plane.
    window : numpy.ndarray
        ``(4, n)`` least and greatest u, least and greatest v of each patch; NaN if unknown.
    period : numpy.ndarray
        ``(2, n)`` by which u and v may differ and be the same place; infinite where not.
    known : numpy.ndarray
        ``(n,)`` bool: the surface and all curves around it can be evaluated.
    turned : numpy.ndarray
        ``(n,)`` bool: a loop of the patch ran the wrong way, with the patch to its right.
    """

    density: Density
    pieces: Pieces
    window: Floats
    period: Floats
    known: Bools
    turned: Bools

    @property
    def surfaces(self) -> SurfaceSet:
        """The surfaces that are trimmed."""
        return self.density.surfaces

    @staticmethod
    def from_tables(
        patches: pa.Table, curves: pa.Table, coedges: pa.Table, pcurves: pa.Table
    ) -> TrimmedPatches:
        """Read the rows of one model.

        Parameters
        ----------
        patches, curves, coedges, pcurves : pyarrow.Table
            All its rows of these tables. Loops lie whole periods apart where pcurves do;
            gaps between neighbours are closed by straight segments. A patch without loops has
            its natural bounds, those in ``u_min`` to ``v_max``.

        Raises
        ------
        UsageError
            If a table lacks a column that says what a row is.
        """
        surfaces = SurfaceSet.from_patches(patches)
        density = Density(surfaces, surface_kinds(patches))
        period = surface_periods(patches, surfaces)
        outlines = Outlines.from_tables(patches, curves, coedges, pcurves)
        arcs, known = coedge_arcs(outlines, patches, curves, coedges, surfaces.known)
        arcs, turns = chained(arcs, period)
        outlines, arcs = closed(outlines, arcs, turns, period)
        winds = np.zeros(len(known), dtype=bool)
        winding = np.any(turns != 0, axis=0)
        winds[arcs.patch[winding[arcs.loop]]] = True
        outlines, bare = _bare(outlines, patches, known, arcs)
        plain = Arcs.joined([arcs.take(~winds[arcs.patch]), bare]).renumbered()
        pieces = settled(cut(outlines, plain, len(known)), period)
        pieces, turned = oriented(pieces)
        window = _windows(pieces)
        fits = window[1::2] - window[::2] <= (1 + _SLACK) * period
        trimmed = TrimmedPatches(
            density, pieces, window, np.where(fits, period, np.inf), known, turned
        )
        for row in np.flatnonzero(winds):
            mine = arcs.take(arcs.patch == row)
            trimmed = trimmed._with_winding(int(row), mine, turns, period[:, row])
        return trimmed

    def _with_winding(self, row: int, arcs: Arcs, turns: Floats, period: Floats) -> TrimmedPatches:
        """Add a patch with loops that wind around it."""
        turns = turns[:, np.unique(arcs.loop)]
        window = self.window.copy()
        box = _windows(cut(self.pieces.outlines, replace(arcs, patch=0 * arcs.patch), 1))[:, 0]
        window[:, row] = _reach(self.density, row, box, period)
        outlines, found = unwrapped(self.pieces.outlines, arcs, turns, period, window[:, row])
        joined = Arcs.joined([self.pieces.arcs, found])
        pieces = Pieces.of(outlines, joined, len(self.known))
        return replace(self, pieces=pieces, window=window)

    def inside(self, patch: ArrayLike, u: ArrayLike, v: ArrayLike) -> Bools:
        """Tell which points of surfaces are on the trimmed patches.

        Parameters
        ----------
        patch : array_like
            ``(n,)`` row of the patch, or one for all.
        u, v : array_like
            ``(n,)`` parameters; of closed surfaces in any period.

        Returns
        -------
        numpy.ndarray
            ``(n,)`` bool, False for patches that are not `known`. A point on the border may
            count as either.

        Raises
        ------
        UsageError
            If a row is outside the table or the shapes do not match.
        """
        row, place = query(len(self.known), self.window, patch, u, v)
        within = np.stack(place)
        rows = np.broadcast_to(row, within.shape[1])
        low, high = self.window[::2, rows], self.window[1::2, rows]
        closed_ = np.isfinite(self.period[:, rows])
        span = np.where(closed_, self.period[:, rows], 1.0)
        within = np.where(closed_, within - np.floor((within - low) / span) * span, within)
        near = np.flatnonzero(((within >= low) & (within <= high)).all(axis=0))
        found = np.zeros(len(rows), dtype=bool)
        found[near] = self.pieces.winding(rows[near], *within[:, near]) % 2 == 1
        return found

    def area(self, relative: float = AREA_ERROR) -> Floats:
        """Return the exact area of each patch, ``(n,)`` mm^2; NaN if not `known`.

        Parameters
        ----------
        relative : float
            Error asked for, as a share of each area.
        """
        found = areas(self.density, self.pieces, self.window, relative)
        return np.where(self.known, found, np.nan)


def _bare(outlines: Outlines, patches: pa.Table, known: Bools, arcs: Arcs) -> tuple[Outlines, Arcs]:
    """Return the natural bounds of patches without loops, numbered after the other loops."""
    names = ("u_min", "u_max", "v_min", "v_max")
    bounds = np.stack([ragged.scalars(patches, name) for name in names])
    bare = known & (np.bincount(arcs.patch, minlength=len(known)) == 0)
    rows = np.flatnonzero(bare & np.isfinite(bounds).all(axis=0))
    return natural(outlines, rows, bounds[:, rows], int(arcs.loop.max(initial=-1)) + 1)


def _windows(pieces: Pieces) -> Floats:
    """Return the bounds ``(4, n_patches)`` of the pieces of each patch, NaN without any."""
    window = np.full((4, len(pieces.first) - 1), np.nan)
    some = np.flatnonzero(np.diff(pieces.first))
    if len(some):
        box, heads = pieces.box(), pieces.first[some]
        for side, extreme in enumerate((np.minimum, np.maximum, np.minimum, np.maximum)):
            window[side, some] = extreme.reduceat(box[side], heads)
    return window


def _reach(density: Density, row: int, box: Floats, period: Floats) -> Floats:
    """Return the window ``(4,)`` of a patch with winding loops.

    That is a period where the surface is closed, else as far as it goes; where it goes on for
    ever, no further than the loops, whose bounds are `box`.
    """
    surfaces, kind = density.surfaces, SURFACE_TYPES[density.kind[row]]
    low, high = box[::2].copy(), box[1::2].copy()
    if kind == "Sphere":
        low[1], high[1] = -np.pi / 2, np.pi / 2
    elif kind == "Cone":
        apex = -surfaces.size[0, row] / surfaces.size[1, row]
        low[1], high[1] = (apex, high[1]) if apex <= low[1] else (low[1], max(apex, high[1]))
    elif kind == "BSpline":
        for axis, knots in enumerate((surfaces.splines.u_knots, surfaces.splines.v_knots)):
            low[axis], high[axis] = knots.low[row], knots.high[row]
    high = np.where(np.isfinite(period), low + period, high)
    return np.stack([low, high], axis=1).ravel()
