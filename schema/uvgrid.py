"""UV-grids: patches and curves as points at equal steps of their parameters.

The input of UV-Net (Jayaraman et al., CVPR 2021) and of networks like it. A grid spans the
bounds of the patch, ends included; what its loops cut away is masked, not left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.schema import ragged
from breplake.schema.curves import CurveSet
from breplake.schema.namespace import Bools, Floats, Ints
from breplake.schema.shape_tables import PCURVES
from breplake.schema.tables import COEDGES, CURVES, PATCHES
from breplake.schema.trimming.patches import TrimmedPatches

__all__ = ["curve_grids", "patch_grids", "uv_grids"]

_Grids = npt.NDArray[np.float32]

_LEAST: Final = 1e-7  # of a side: how near to the border counts as on it
_MOST: Final = 0.25  # of a step, which the border is never wider than
_AROUND: Final = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j)


def uv_grids(tables: Mapping[str, pa.Table], size: int) -> dict[str, _Grids]:
    """Return the arrays ``patch_grid`` and ``curve_grid`` of one model.

    Parameters
    ----------
    tables : mapping
        Its rows of ``patches``, ``curves``, ``coedges`` and ``pcurves``; a missing table has
        none.
    size : int
        Points along a side, at least 2.
    """
    patches, curves, coedges, pcurves = (
        tables.get(table.name, table.empty()) for table in (PATCHES, CURVES, COEDGES, PCURVES)
    )
    return {
        "patch_grid": patch_grids(patches, curves, coedges, pcurves, size),
        "curve_grid": curve_grids(curves, size),
    }


def patch_grids(
    patches: pa.Table, curves: pa.Table, coedges: pa.Table, pcurves: pa.Table, size: int
) -> _Grids:
    """Sample all patches of one model.

    Returns
    -------
    numpy.ndarray
        ``(n_patches, size, size, 7)`` float32: position (3) mm, outward unit normal (3), and
        1 where the point is inside the patch or on its border (within the tolerance of the
        patch), 0 outside. The second axis is u, the third v. NaN where a quantity is not
        defined, or the geometry cannot be evaluated.
    """
    trimmed = TrimmedPatches.from_tables(patches, curves, coedges, pcurves)
    bounds = np.stack([ragged.scalars(patches, n) for n in ("u_min", "u_max", "v_min", "v_max")])
    steps = np.linspace(0, 1, size)
    u, v = (low + steps[:, None] * (high - low) for low, high in (bounds[:2], bounds[2:]))
    shape = (patches.num_rows, size, size)
    row, i, j = (a.ravel() for a in np.indices(shape))
    u, v = u[i, row], v[j, row]
    found = trimmed.surfaces.points(row, u, v)
    side = np.where(ragged.flags(patches, "reversed"), -1.0, 1.0)
    mask = _mask(trimmed, row, u, v, _reach(trimmed, patches, row, u, v, bounds / (size - 1)))
    columns = (found.point, side[row, None] * found.normal, mask[:, None])
    return np.concatenate(columns, axis=1).astype(np.float32).reshape(*shape, 7)


def _reach(
    trimmed: TrimmedPatches, patches: pa.Table, row: Ints, u: Floats, v: Floats, scaled: Floats
) -> Floats:
    """Return by how much u and v may miss the border and count as on it, ``(2, n)``."""
    jet = trimmed.surfaces.evaluate(row, u, v)
    tolerance = ragged.scalars(patches, "tolerance")[row]
    step = (scaled[1::2] - scaled[::2])[:, row]
    speed = np.stack([np.linalg.norm(d, axis=1) for d in (jet.du, jet.dv)])
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.fmax(tolerance / speed, _LEAST * step)
    return np.asarray(np.fmin(reach, _MOST * step))


def _mask(trimmed: TrimmedPatches, row: Ints, u: Floats, v: Floats, reach: Floats) -> Floats:
    """Return 1 inside a patch and on its border, 0 outside, NaN where that is not known."""
    inside: Bools = trimmed.inside(row, u, v)
    for i, j in _AROUND:
        rest = np.flatnonzero(~inside)
        near = u[rest] + i * reach[0, rest], v[rest] + j * reach[1, rest]
        inside[rest] = trimmed.inside(row[rest], *near)
    return np.where(trimmed.known[row], inside.astype(np.float64), np.nan)


def curve_grids(curves: pa.Table, size: int) -> _Grids:
    """Sample all curves of one model.

    Returns
    -------
    numpy.ndarray
        ``(n_curves, size, 6)`` float32: position (3) mm and unit tangent (3) towards growing
        parameters, from ``t_min`` to ``t_max``. NaN where a curve is degenerate, cannot be
        evaluated or stands still.
    """
    low, high = ragged.scalars(curves, "t_min"), ragged.scalars(curves, "t_max")
    t = low[:, None] + np.linspace(0, 1, size) * (high - low)[:, None]
    jet = CurveSet.from_curves(curves).evaluate(np.repeat(np.arange(len(t)), size), t.ravel())
    with np.errstate(divide="ignore", invalid="ignore"):
        tangent = jet.d1 / np.linalg.norm(jet.d1, axis=1, keepdims=True)
    found = np.concatenate([jet.point, tangent], axis=1)
    return found.astype(np.float32).reshape(len(t), size, 6)
