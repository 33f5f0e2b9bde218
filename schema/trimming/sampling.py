"""Points uniform by area on trimmed patches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from breplake.errors import UsageError
from breplake.schema.namespace import Floats, Ints
from breplake.schema.trimming.cells import Cells, bounded, narrowed
from breplake.schema.trimming.patches import TrimmedPatches

__all__ = ["UniformSampler"]

_BATCH: Final = 262_144  # proposals at once
_PATIENCE: Final = 1e-5  # share of proposals that must be kept, after a million of them
_ROUGHLY: Final = 1e-3  # relative error of the areas that say where cells are worth cutting


@dataclass(frozen=True, slots=True)
class UniformSampler:
    """Draws points on the patches of a model, every piece of area alike.

    Attributes
    ----------
    patches : TrimmedPatches
    cells : Cells
        Where points are proposed.
    """

    patches: TrimmedPatches
    cells: Cells

    @staticmethod
    def of(patches: TrimmedPatches) -> UniformSampler:
        """Prepare to sample all known patches."""
        cells = bounded(patches.density, patches.window)
        area = np.abs(np.nan_to_num(patches.area(_ROUGHLY)))
        return UniformSampler(patches, narrowed(cells, patches.pieces, area))

    def draw(self, count: int, random: np.random.Generator) -> tuple[Ints, Floats, Floats]:
        """Draw points by rejection.

        A point is proposed by the bounds of the cells and kept with the chance of its density
        over its bound, if it is inside: what is kept is independent and uniform by area. The
        first points are the same however many are drawn.

        Parameters
        ----------
        count : int
            Number of points.
        random : numpy.random.Generator
            Gives four numbers for each proposal.

        Returns
        -------
        patch : numpy.ndarray
            ``(count,)`` row of the patch.
        u, v : numpy.ndarray
            ``(count,)``.

        Raises
        ------
        UsageError
            If there is no area to sample.
        """
        ends = np.cumsum(self.cells.mass)
        if not len(ends) or not ends[-1] > 0:
            raise UsageError("no patch of the model has an area that could be sampled")
        kept: list[Floats] = []
        found = proposed = 0
        while found < count:
            expected = (count - found) * (proposed + 1) / (found + 1) if proposed else 1.5 * count
            size = int(min(_BATCH, 1.1 * expected + 64))
            kept.append(self._round(random.random((size, 4)), ends))
            found, proposed = found + kept[-1].shape[1], proposed + size
            if proposed > 1_000_000 and found < _PATIENCE * proposed:
                raise UsageError("the patches of the model enclose next to no area to sample")
        cell, u, v = np.concatenate(kept, axis=1)[:, :count]
        return self.cells.patch[cell.astype(np.int64)], u, v

    def _round(self, random: Floats, ends: Floats) -> Floats:
        """Return cell, u and v ``(3, k)`` of the proposals ``(n, 4)`` that are kept."""
        cell = np.minimum(np.searchsorted(ends, random[:, 0] * ends[-1], "right"), len(ends) - 1)
        box = self.cells.box[:, cell]
        u = box[0] + random[:, 1] * (box[1] - box[0])
        v = box[2] + random[:, 2] * (box[3] - box[2])
        keep = ~self.cells.border[cell]
        test = np.flatnonzero(~keep)
        patch = self.cells.patch[cell]
        keep[test] = self.patches.pieces.winding(patch[test], u[test], v[test]) % 2 == 1
        at = np.flatnonzero(keep)
        density = self.patches.density.at(patch[at], u[at], v[at])
        at = at[random[at, 3] * self.cells.bound[cell[at]] < density]
        return np.stack([cell[at].astype(np.float64), u[at], v[at]])
