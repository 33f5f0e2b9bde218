"""Blue noise: which of many points to keep so that they stay apart from each other.

Weighted sample elimination (Yuksel, "Sample Elimination for Generating Poisson Disk Sample
Sets", Computer Graphics Forum 34(2), 2015): the point that crowds its neighbours most goes
first. Here all go at once that crowd more than any neighbour and than nine tenths of the
others: none of them is another's neighbour, so their order makes no difference to them.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from breplake.errors import MissingExtraError, UsageError

__all__ = ["MOST_POINTS", "disk_radius", "spread"]

MOST_POINTS: Final = 1_000_000
"""Points that can be kept at once: pairs of neighbours fill some gigabytes then."""

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

_CROWDED: Final = 0.9  # share of the points that must be crowded less
_OPPOSED: Final = -np.sqrt(0.5)  # cosine of the angle between normals beyond which sides differ
_ALPHA, _BETA, _GAMMA = 8, 0.65, 1.5  # the paper's parameters


def disk_radius(area: float, count: int) -> float:
    """Return the greatest radius of `count` disks that cover an area without overlap, mm.

    That of a hexagonal lattice: points can be no further than two radii from each other.
    """
    return float(np.sqrt(area / (2 * np.sqrt(3) * count)))


def spread(points: _Floats, normals: _Floats, count: int, area: float) -> _Ints:
    """Choose points that keep their distance.

    Parameters
    ----------
    points, normals : numpy.ndarray
        ``(m, 3)`` uniform points on a surface, mm, and its unit normals there. Points whose
        normals are more than 135 degrees apart, as on both sides of a thin wall, do not mind
        each other.
    count : int
        How many to keep, less than m.
    area : float
        Area of the surface, mm^2.

    Returns
    -------
    numpy.ndarray
        ``(count,)`` indices of the points, ascending.

    Raises
    ------
    MissingExtraError
        If SciPy is not installed.
    UsageError
        If more than `MOST_POINTS` are asked for.
    """
    if count > MOST_POINTS:
        raise UsageError(
            f"method poisson gives at most {MOST_POINTS:,} points, got {count:,}: "
            "take method uniform"
        )
    first, second, weight = _crowding(points, normals, count, area)
    return _eliminated(len(points), first, second, weight, count)


def _crowding(
    points: _Floats, normals: _Floats, count: int, area: float
) -> tuple[_Ints, _Ints, _Floats]:
    """Return pairs of neighbours ``(k,)`` and how much they crowd each other."""
    radius = disk_radius(area, count)
    least = radius * (1 - (count / len(points)) ** _GAMMA) * _BETA
    pairs = _tree(points).query_pairs(2 * radius, output_type="ndarray")
    first, second = pairs.T
    opposed = np.einsum("ij,ij->i", normals[first], normals[second]) < _OPPOSED
    first, second = first[~opposed], second[~opposed]
    distance = np.linalg.norm(points[first] - points[second], axis=1)
    return first, second, (1 - np.maximum(distance, 2 * least) / (2 * radius)) ** _ALPHA


def _tree(points: _Floats) -> Any:
    try:
        from scipy.spatial import cKDTree
    except ImportError as error:
        raise MissingExtraError("sample", "sampling by method poisson") from error
    return cKDTree(points)


def _eliminated(size: int, first: _Ints, second: _Ints, weight: _Floats, count: int) -> _Ints:
    """Drop the most crowded points until `count` are left."""
    alive = np.ones(size, dtype=bool)
    crowd = np.bincount(first, weight, size) + np.bincount(second, weight, size)
    left = size
    while left > count:
        more = np.where(crowd[first] > crowd[second], second, first)  # the less crowded of a pair
        peak = alive.copy()
        peak[more] = False
        limit = np.quantile(crowd[alive], _CROWDED)
        gone = np.flatnonzero(peak & (crowd >= limit))
        if len(gone) > left - count:
            gone = gone[np.argsort(-crowd[gone], kind="stable")[: left - count]]
        alive[gone] = False
        left -= len(gone)
        for mine, other in ((first, second), (second, first)):
            freed = alive[mine] & ~alive[other]
            crowd -= np.bincount(mine[freed], weight[freed], size)
        both = alive[first] & alive[second]
        first, second, weight = first[both], second[both], weight[both]
    return np.flatnonzero(alive)
