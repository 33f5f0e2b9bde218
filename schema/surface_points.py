"""Points, normals and principal curvatures of many surfaces at once, the short way.

What the caller gets is 64 bytes a point, where all derivatives would be 144.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from breplake.schema.closed_forms import CLOSED_FORMS, Local, moved_along_normal
from breplake.schema.forms import bent
from breplake.schema.grouping import grouped, selected
from breplake.schema.namespace import Array, Ints, gather, namespace
from breplake.schema.run_points import HEIGHT, by_runs

if TYPE_CHECKING:
    from breplake.schema.surfaces import SurfaceSet

__all__ = ["surface_points"]

_LONG: Final = 64  # points of one row that are worth being evaluated as a run


def surface_points(surfaces: SurfaceSet, row: Array, u: Array, v: Array) -> Array:
    """Return points, normals and principal curvatures, ``(8, n)``; see ``SurfaceSet.points``.

    Parameters
    ----------
    surfaces : SurfaceSet
    row, u, v : array
        A query that was checked.
    """

    def general(group: int, row: Array, u: Array, v: Array) -> list[Array]:
        return _general(surfaces, group, row, u, v)

    if isinstance(u, np.ndarray):
        starts = _runs(row, len(u))
        if len(starts) * _LONG <= len(u):
            return by_runs(surfaces, row, u, v, starts, general)

    def work(group: int, index: Any) -> list[Array]:
        return _general(surfaces, group, selected(row, index), u[index], v[index])

    groups = gather(surfaces.group, row)
    return grouped(groups, len(u), surfaces.batches, work, HEIGHT, surfaces.size)


def _general(surfaces: SurfaceSet, group: int, row: Array, u: Array, v: Array) -> list[Array]:
    """Evaluate points of one group."""
    kind, xp = surfaces.kinds[group], namespace(u)
    least = gather(surfaces.least, row)
    if kind.closed:
        local = _local(surfaces, group, row, u, v)
        axes = gather(surfaces.axes, row)
        x, y, z = axes[3:6], axes[6:9], axes[9:12]
        point = axes[0:3] + sum(a * axis for a, axis in zip(local.point, (x, y, z), strict=True))
        normal = sum(a * axis for a, axis in zip(local.normal, (x, y, z), strict=True))
        k_min, k_max = local.bends
        if local.defined is not None:
            normal, k_min, k_max = (
                xp.where(local.defined, part, xp.nan) for part in (normal, k_min, k_max)
            )
    else:
        point, du, dv, *seconds = surfaces.basis_jet(group, row, u, v, 2)
        normal, k_min, k_max = bent(du, dv, (seconds[0], seconds[1], seconds[2]), least)
    if kind.offset:
        distance = gather(surfaces.offset, row)
        return list(moved_along_normal(point, normal, k_min, k_max, distance))
    return [point, normal, k_min, k_max]


def _local(surfaces: SurfaceSet, group: int, row: Array, u: Array, v: Array) -> Local:
    form = CLOSED_FORMS[surfaces.kinds[group].name]
    size, side, least = (
        gather(part, row) for part in (surfaces.size, surfaces.side, surfaces.least)
    )
    return form(size, side, least, u, v)


def _runs(row: Array, count: int) -> Ints:
    """Return where each run of one row begins."""
    if len(row) == 1:
        return np.zeros(min(count, 1), dtype=np.int64)
    return np.append(0, np.flatnonzero(row[1:] != row[:-1]) + 1)
