"""What numpy arrays and torch tensors have in common, for geometry written once for both.

Kernels hold vectors components first, ``(3, n)``, so that every operation runs along
contiguous memory; the public interface transposes to ``(n, 3)`` without a copy.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "VANISHING",
    "Array",
    "Bools",
    "Floats",
    "Ints",
    "batches",
    "cross",
    "dot",
    "gather",
    "length",
    "namespace",
    "slices",
    "vanishing",
]

Array: TypeAlias = Any
"""A numpy array or torch tensor: what kernels take and return."""

VANISHING: Final = 1e-9
"""Share of its usual size at and below which rounding decides a number, in float64."""

_VANISHING_SINGLE: Final = 1e-5  # the same in float32
_SINGLE: Final = 1e-10  # no type of less than double precision has a smaller epsilon

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]


def namespace(array: Array) -> Any:
    """Return the module (``numpy`` or ``torch``) whose functions work on `array`."""
    return sys.modules[type(array).__module__.partition(".")[0]]


def dot(a: Array, b: Array) -> Array:
    """Return the dot products ``(n,)`` of two ``(dim, n)``."""
    total = a[0] * b[0]
    for i in range(1, len(a)):
        total = total + a[i] * b[i]
    return total


def length(a: Array) -> Array:
    """Return the lengths ``(n,)`` of ``(dim, n)``."""
    return namespace(a).sqrt(dot(a, a))


def cross(a: Array, b: Array) -> Array:
    """Return the cross products ``(3, n)`` of two ``(3, n)``."""
    return namespace(a).stack(
        (
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        )
    )


def gather(array: Array, index: Array) -> Array:
    """Return ``array[..., index]``, several times as fast."""
    if isinstance(array, np.ndarray):
        return np.take(array, index, axis=-1)
    return array.index_select(-1, index.reshape(-1)).reshape(*array.shape[:-1], *index.shape)


def vanishing(array: Array) -> float:
    """Return the share of its usual size at which rounding decides a number of that type."""
    return VANISHING if namespace(array).finfo(array.dtype).eps < _SINGLE else _VANISHING_SINGLE


def slices(count: int, size: int) -> Iterator[slice]:
    """Yield slices of at most `size` that cover ``range(count)``."""
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


def batches(group: Ints, size: int) -> Iterator[tuple[int, Any]]:
    """Split points by group, then into batches that fit the cache.

    Parameters
    ----------
    group : numpy.ndarray
        ``(n,)`` group of each point; points of a negative group are left out.
    size : int
        Points in a batch.

    Yields
    ------
    group : int
    index : slice or numpy.ndarray
        Which points: a slice where one group holds all of them.
    """
    if not len(group):
        return
    if group.min() == group.max():
        if group[0] >= 0:
            for part in slices(len(group), size):
                yield int(group[0]), part
        return
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    starts = np.flatnonzero(np.diff(ordered, prepend=ordered[0] - 1))
    for start, stop in zip(starts, [*starts[1:], len(ordered)], strict=True):
        if ordered[start] >= 0:
            for part in slices(int(stop - start), size):
                yield int(ordered[start]), _run(order[start + part.start : start + part.stop])


def _run(index: Ints) -> Any:
    """Return ascending indices as a slice if they leave no gap: copies are quicker then."""
    if index[-1] - index[0] == len(index) - 1:
        return slice(int(index[0]), int(index[-1]) + 1)
    return index
