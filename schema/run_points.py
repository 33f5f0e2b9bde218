"""Points, normals and curvatures of queries that hold long runs of points on one row.

Most surfaces are linear in few functions of (u, v): a run costs these functions, which all runs
of a batch share, and one small matrix product that writes position and normal where they
belong. numpy only: its matrix product works on parts of arrays in place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from breplake.schema.namespace import Floats, Ints, gather
from breplake.schema.spline_cells import Place, SplineCells

if TYPE_CHECKING:
    from breplake.schema.surfaces import SurfaceSet

__all__ = ["HEIGHT", "by_runs"]

HEIGHT: Final = 8
"""Numbers for a point: point, normal, k_min, k_max."""

General: TypeAlias = Callable[[int, Ints, Floats, Floats], Sequence[Floats]]
"""Takes a group, rows, u and v, returns blocks ``(k, m)`` of `HEIGHT` rows together."""

_CHUNK: Final = 2**18  # points whose cells are prepared together


def by_runs(
    surfaces: SurfaceSet, row: Ints, u: Floats, v: Floats, starts: Ints, general: General
) -> Floats:
    """Evaluate a query run by run.

    Parameters
    ----------
    surfaces : SurfaceSet
    row, u, v : numpy.ndarray
        The query, as ``grouping.query`` returns it.
    starts : numpy.ndarray
        Where each run begins.
    general : callable
        Evaluates any points of one group.

    Returns
    -------
    numpy.ndarray
        ``(8, n)``.
    """
    out = np.empty((HEIGHT, len(u)))
    rows = row if len(row) == 1 else row[starts]
    groups, stops = surfaces.group[rows], np.append(starts[1:], len(u))
    for group in np.unique(groups).tolist():
        mine = groups == group
        runs = zip(*(part[mine].tolist() for part in (rows, starts, stops)), strict=True)
        size = surfaces.batches[group] if group >= 0 else len(u)
        pieces = [(r, slice(a, min(a + size, b))) for r, s, b in runs for a in range(s, b, size)]
        if group < 0:
            for _, place in pieces:
                out[:, place] = np.nan
            continue
        for chunk in _batches(pieces, _CHUNK):
            special = _special(surfaces, group, chunk, u, v, out)
            for batch in _batches(chunk, size):
                rest = special(batch)
                if rest:
                    _generally(general, group, rest, u, v, out)
    return out


def _special(
    surfaces: SurfaceSet, group: int, chunk: list[Place], u: Floats, v: Floats, out: Floats
) -> Callable[[list[Place]], list[Place]]:
    """Return what evaluates runs of a group in the shortest way, and returns those it cannot."""
    kind = surfaces.kinds[group]
    if kind.closed and not kind.offset:
        return lambda batch: _elementary(surfaces, kind.name, batch, u, v, out)
    if kind.name == "BSpline" and not kind.offset:
        cells = SplineCells.build(surfaces, kind, chunk)
        return lambda batch: cells.evaluate(batch, u, v, out)
    return lambda batch: batch


def _generally(
    general: General, group: int, runs: list[Place], u: Floats, v: Floats, out: Floats
) -> None:
    places = [place for _, place in runs]
    rows = np.array([row for row, _ in runs])
    if len(rows) > 1:
        rows = np.repeat(rows, [place.stop - place.start for place in places])
    _spread(out, places, general(group, rows, _joined(u, places), _joined(v, places)))


def _batches(pieces: list[Place], size: int) -> Iterator[list[Place]]:
    """Collect pieces until they hold about `size` points."""
    batch, points = list[Place](), 0
    for piece in pieces:
        batch.append(piece)
        points += piece[1].stop - piece[1].start
        if points >= size:
            yield batch
            batch, points = [], 0
    if batch:
        yield batch


def _joined(values: Floats, places: list[slice]) -> Floats:
    if len(places) == 1:
        return values[places[0]]
    return np.concatenate([values[place] for place in places])


def _spread(out: Floats, places: list[slice], blocks: Sequence[Floats]) -> None:
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


def _functions(name: str, u: Floats, v: Floats) -> Floats:
    """Return the functions ``(k, m)`` in which position and normal of a type are linear.

    They begin with 1, the cosine and the sine of u. The last one is v or, of a sphere or
    torus, the cosine of v, which `_bend` needs.
    """
    found = np.empty((_HEIGHTS[name], len(u)))
    found[0], found[-1] = 1.0, v
    if name == "Plane":
        found[1] = u
        return found
    np.cos(u, out=found[1])
    np.sin(u, out=found[2])
    if name == "Cone":
        np.multiply(found[1:3], v, out=found[3:5])
    elif name in ("Sphere", "Torus"):
        np.cos(v, out=found[-1])
        np.multiply(found[1:3], found[-1], out=found[-4:-2])
        np.sin(v, out=found[-2])
    return found


_HEIGHTS: Final = {"Plane": 3, "Cylinder": 4, "Cone": 6, "Sphere": 7, "Torus": 7}


def _matrices(surfaces: SurfaceSet, name: str, rows: Ints) -> Floats:
    """Return what turns `_functions` into position and normal, ``(n_rows, 6, k)``."""
    axes, size, side = (gather(p, rows) for p in (surfaces.axes, surfaces.size, surfaces.side))
    o, x, y, z = axes.reshape(4, 3, -1)
    none, (a, b, c) = 0 * o, size
    point, normal = {
        "Plane": ([o, x, y], [side * z, none, none]),
        "Cylinder": ([o, a * x, a * y, z], [none, side * x, side * y, none]),
        "Cone": (
            [o, a * x, a * y, b * x, b * y, c * z],
            [-side * b * z, side * c * x, side * c * y, none, none, none],
        ),
        "Sphere": (
            [o, none, none, a * x, a * y, a * z, none],
            [none, none, none, side * x, side * y, side * z, none],
        ),
        "Torus": (
            [o, a * x, a * y, b * x, b * y, b * z, none],
            [none, none, none, side * x, side * y, side * z, none],
        ),
    }[name]
    both = np.concatenate([np.stack(point), np.stack(normal)], axis=1)  # (k, 6, n_rows)
    return np.ascontiguousarray(both.transpose(2, 1, 0))


def _elementary(
    surfaces: SurfaceSet, name: str, batch: list[Place], u: Floats, v: Floats, out: Floats
) -> list[Place]:
    """Evaluate runs of one elementary type; return those that touch a singular place."""
    places = [place for _, place in batch]
    functions = _functions(name, _joined(u, places), _joined(v, places))
    matrices = _matrices(surfaces, name, np.array([row for row, _ in batch]))
    left, start = list[Place](), 0
    for piece, matrix in zip(batch, matrices, strict=True):
        row, place = piece
        stop = start + place.stop - place.start
        if _bend(surfaces, name, row, functions[-1, start:stop], out[6:8, place]):
            np.matmul(matrix, functions[:, start:stop], out=out[0:6, place])
        else:
            left.append(piece)
        start = stop
    return left


def _bend(surfaces: SurfaceSet, name: str, row: int, last: Floats, out: Floats) -> bool:
    """Write k_min and k_max of a run, ``(2, m)``; return False where it is not regular.

    Regular: on this side of the poles and apexes, and well away from them.
    """
    if name == "Plane":
        out[:] = 0.0
        return True
    side, least = float(surfaces.side[row]), float(surfaces.least[0, row])
    a, b, c = surfaces.size[:, row].tolist()
    tube, around = out if side > 0 else out[::-1]  # the curvature of a cross section, and across
    if name == "Cylinder":
        tube[:], around[:] = -side / a, 0.0
        return True
    if name == "Sphere":
        out[:] = -side / a
        return bool(last.min() > 0.0)
    distance = np.multiply(last, b, out=tube)  # from the axis
    distance += a
    if not distance.min() > least:
        return False
    if name == "Cone":
        np.divide(-side * c, distance, out=tube)
        around[:] = 0.0
        return bool(c > 0.0)
    np.divide(last, distance, out=around)
    around *= -side
    tube[:] = -side / b
    return True
