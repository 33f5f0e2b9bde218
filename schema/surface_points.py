"""Points, normals and principal curvatures of many surfaces at once, the short way.

What the caller gets is 64 bytes a point, where all derivatives would be 144. Elementary
surfaces are evaluated in their own axes; queries that hold long runs of one row, as most do,
then take one small matrix product a run into the model's axes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from breplake.schema.closed_forms import CLOSED_FORMS, Local, moved_along_normal
from breplake.schema.forms import principal_values, unit_normal
from breplake.schema.grouping import grouped, selected
from breplake.schema.namespace import Array, Floats, Ints, gather, namespace

if TYPE_CHECKING:
    from breplake.schema.surfaces import SurfaceSet

__all__ = ["HEIGHT", "surface_points"]

HEIGHT: Final = 8
"""Numbers for a point: point, normal, k_min, k_max."""

_LONG: Final = 64  # points of one row that are worth a matrix product of their own


def surface_points(
    surfaces: SurfaceSet, row: Array, u: Array, v: Array, sizes: Sequence[int]
) -> Array:
    """Return points, normals and principal curvatures, ``(8, n)``; see `SurfaceSet.points`.

    Parameters
    ----------
    surfaces : SurfaceSet
    row, u, v : array
        A query that was checked.
    sizes : sequence of int
        Points in a batch of each kind.
    """
    if isinstance(u, np.ndarray):
        starts = _runs(row, len(u))
        if len(starts) * _LONG <= len(u):
            return _by_runs(surfaces, row, u, v, starts, sizes)

    def work(group: int, index: Any) -> list[Array]:
        return _general(surfaces, group, selected(row, index), u[index], v[index])

    return grouped(gather(surfaces.group, row), len(u), sizes, work, HEIGHT, surfaces.size)


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
        normal = unit_normal(du, dv, least)
        k_min, k_max = principal_values(du, dv, tuple(seconds), normal, least)
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


def _by_runs(
    surfaces: SurfaceSet, row: Ints, u: Floats, v: Floats, starts: Ints, sizes: Sequence[int]
) -> Floats:
    """Evaluate a query of long runs, without bringing its points into another order."""
    out = np.empty((HEIGHT, len(u)))
    rows = row if len(row) == 1 else row[starts]
    groups, stops = surfaces.group[rows], np.append(starts[1:], len(u))
    for group in np.unique(groups).tolist():
        size, mine = sizes[group] if group >= 0 else len(u), groups == group
        runs = zip(*(part[mine].tolist() for part in (rows, starts, stops)), strict=True)
        pieces = [(r, a, min(a + size, b)) for r, s, b in runs for a in range(s, b, size)]
        for batch in _batches(pieces, size):
            places = [slice(a, b) for _, a, b in batch]
            if group < 0:
                _spread(out, places, [np.full((HEIGHT, 1), np.nan)])
                continue
            some = np.array([r for r, _, _ in batch])
            _evaluate(surfaces, group, some, places, _joined(u, places), _joined(v, places), out)
    return out


def _evaluate(
    surfaces: SurfaceSet,
    group: int,
    rows: Ints,
    places: list[slice],
    u: Floats,
    v: Floats,
    out: Floats,
) -> None:
    """Evaluate runs of one group into their places in `out`.

    Parameters
    ----------
    rows : numpy.ndarray
        ``(n_places,)`` row of each run.
    u, v : numpy.ndarray
        ``(m,)`` parameters of all runs.
    """
    kind = surfaces.kinds[group]
    if kind.closed and not kind.offset and kind.name == "Plane":
        side = gather(surfaces.side, rows)
        points = np.stack([np.ones_like(u), u, v])
        _into_space(out, places, gather(surfaces.axes, rows), points, side)
        _spread(out[6:8], places, [np.zeros((2, 1))])
        return
    each = rows
    if len(rows) > 1:
        each = np.repeat(rows, [place.stop - place.start for place in places])
    if kind.closed and not kind.offset:
        local = _local(surfaces, group, each, u, v)
        points = np.stack([np.ones_like(u), *local.point])
        normals, bends = np.stack(np.broadcast_arrays(*local.normal)), np.stack(local.bends)
        if local.defined is not None and not local.defined.all():
            normals[:, ~local.defined] = bends[:, ~local.defined] = np.nan
        _into_space(out, places, gather(surfaces.axes, rows), points, normals)
        _spread(out[6:8], places, [bends])
    else:
        _spread(out, places, _general(surfaces, group, each, u, v))


def _batches(pieces: list[tuple[int, int, int]], size: int) -> Iterator[list[tuple[int, int, int]]]:
    """Collect pieces (row, start, stop) until they hold about `size` points."""
    batch, points = list[tuple[int, int, int]](), 0
    for piece in pieces:
        batch.append(piece)
        points += piece[2] - piece[1]
        if points >= size:
            yield batch
            batch, points = [], 0
    if batch:
        yield batch


def _joined(values: Floats, places: list[slice]) -> Floats:
    if len(places) == 1:
        return values[places[0]]
    return np.concatenate([values[place] for place in places])


def _spread(out: Floats, places: list[slice], blocks: list[Floats]) -> None:
    """Write blocks ``(k, m)`` or ``(k, 1)``, one below the other, to the places in `out`."""
    top = 0
    for block in blocks:
        rows = block[None] if block.ndim == 1 else block
        target, start = out[top : top + len(rows)], 0
        for place in places:
            stop = start + place.stop - place.start
            target[:, place] = rows[:, start:stop] if rows.shape[1] > 1 else rows
            start = stop
        top += len(rows)


def _into_space(
    out: Floats, places: list[slice], axes: Floats, points: Floats, normals: Floats
) -> None:
    """Bring elementary surfaces into the model's axes, run by run.

    Parameters
    ----------
    axes : numpy.ndarray
        ``(12, n_places)``.
    points : numpy.ndarray
        ``(3 or 4, m)`` ones, then coordinates along the x, y and maybe z axis.
    normals : numpy.ndarray
        ``(3, m)`` in the same axes, or ``(n_places,)`` along the z axis.
    """
    frames = np.ascontiguousarray(axes.reshape(4, 3, -1).transpose(2, 1, 0))  # (n_places, 3, 4)
    start = 0
    for i, place in enumerate(places):
        stop = start + place.stop - place.start
        np.matmul(frames[i, :, : len(points)], points[:, start:stop], out=out[0:3, place])
        if normals.ndim == 2:
            np.matmul(frames[i, :, 1:], normals[:, start:stop], out=out[3:6, place])
        start = stop
    if normals.ndim == 1:
        upright = normals[:, None] * frames[:, :, 3]
        for place, normal in zip(places, upright[:, :, None], strict=True):
            out[3:6, place] = normal
