"""Queries of many points on rows of many kinds: checked, sorted by kind, put together again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from breplake.errors import UsageError
from breplake.schema.namespace import Array, namespace, slices

__all__ = ["Work", "grouped", "query", "selected"]

_DEVICE_BATCH = 2**22  # points on an accelerator, whose temporaries fit its memory

Work: TypeAlias = Callable[[int, Any], Sequence[Array]]
"""Takes a group and which of the points (an index or a slice), returns arrays ``(k, m)``."""


def query(rows: int, like: Array, row: Any, *parameters: Any) -> tuple[Array, list[Array]]:
    """Check a query and bring its parts to one length.

    Parameters
    ----------
    rows : int
        Number of rows of the table.
    like : array
        Its numbers: what is asked becomes arrays of the same library, type and device.
    row : array_like
        ``(n,)`` integers, or one for all.
    *parameters : array_like
        ``(n,)`` numbers, or one for all.

    Returns
    -------
    row : array
        ``(n,)``, or ``(1,)`` where one was given for all.
    parameters : list of array
        Each ``(n,)``.

    Raises
    ------
    UsageError
        If a row is outside the table, is no integer, or the shapes do not match.
    """
    xp = namespace(like)
    if xp is np:
        foreign = [p for p in (row, *parameters) if hasattr(p, "requires_grad")]
        if foreign:
            raise UsageError(
                "these parameters are numpy arrays but the query is a torch tensor; "
                "move them first, as with surfaces.to(tensor)"
            )
        index: Array = np.asarray(row)
        given: list[Array] = [np.asarray(p, dtype=np.float64) for p in parameters]
        whole = np.issubdtype(index.dtype, np.integer)
    else:
        index = xp.as_tensor(row, device=like.device)
        given = [xp.as_tensor(p, dtype=like.dtype, device=like.device) for p in parameters]
        whole = not (index.dtype.is_floating_point or index.dtype is xp.bool)
    if any(p.ndim > 1 for p in (index, *given)):
        shape = next(tuple(p.shape) for p in (index, *given) if p.ndim > 1)
        raise UsageError(f"rows and parameters are one-dimensional, got {shape}")
    many = {len(p) for p in (index, *given) if p.ndim}
    if len(many - {1}) > 1:
        raise UsageError(f"rows and parameters must have one length, got {sorted(many)}")
    count = max(many - {1}, default=1) if 0 not in many else 0
    index = index.reshape(-1)
    if len(index) and not whole:
        raise UsageError(f"rows are integers, not {index.dtype}")
    if len(index) and not (int(index.min()) >= 0 and int(index.max()) < rows):
        raise UsageError(f"rows lie in 0..{rows - 1}, got {index.min()}..{index.max()}")
    index = index[:count].astype(np.int64) if xp is np else index[:count].to(xp.int64)
    return index, [xp.broadcast_to(p.reshape(-1)[:count], (count,)) for p in given]


def selected(row: Array, index: Any) -> Array:
    """Return ``row[index]``, ``(m,)``, or ``(1,)`` where it is the same for all of them."""
    if len(row) == 1:
        return row
    some = row[index]
    same = isinstance(some, np.ndarray) and some[0] == some[-1] and bool((some == some[0]).all())
    return some[:1] if same else some


def grouped(
    group: Array, count: int, sizes: Sequence[int], work: Work, height: int, like: Array
) -> Array:
    """Evaluate points group by group.

    Parameters
    ----------
    group : array
        ``(count,)`` group of each point, or ``(1,)`` where all are of one; negative ones
        are not evaluated.
    count : int
        Number of points.
    sizes : sequence of int
        Points in a batch of each group, so that it fits the cache.
    work : callable
        Evaluates a batch of one group; the arrays that it returns have `height` rows together.
    height : int
        Numbers for each point.
    like : array
        The result is an array of the same library, type and device.

    Returns
    -------
    array
        ``(height, count)`` in the order of the query, NaN for negative groups.
    """
    order, parts = _sorted(group, count)
    if namespace(like) is np:
        return _filled(order, parts, sizes, work, height, count)
    xp, blocks = namespace(like), []
    for kind, start, stop in parts:
        if kind < 0:
            shape = (height, stop - start)
            blocks.append(xp.full(shape, xp.nan, dtype=like.dtype, device=like.device))
            continue
        size = sizes[kind] if like.device.type == "cpu" else _DEVICE_BATCH
        for part in slices(stop - start, size):
            place = slice(start + part.start, start + part.stop)
            values = work(kind, place if order is None else order[place])
            rows = [a if a.ndim == 2 else a[None] for a in values]
            blocks.append(xp.cat([a.expand(-1, part.stop - part.start) for a in rows]))
    if not blocks:
        return xp.zeros((height, 0), dtype=like.dtype, device=like.device)
    whole = blocks[0] if len(blocks) == 1 else xp.cat(blocks, dim=-1)
    return whole if order is None else whole.index_select(-1, xp.argsort(order))


def _sorted(group: Array, count: int) -> tuple[Array | None, list[tuple[int, int, int]]]:
    """Return an order by group, None for the present one, and group, start and stop of each run."""
    if not count:
        return None, []
    low, high = int(group.min()), int(group.max())
    if low == high:
        return None, [(low, 0, count)]
    if isinstance(group, np.ndarray):
        # numpy sorts short integers by their digits, in a sixth of the time
        order = np.argsort(group.astype(np.int16) if high < 2**15 else group, kind="stable")
        counts = np.bincount(group - low).tolist()
    else:
        order = group.argsort(stable=True)
        counts = (group - low).bincount().tolist()
    ends = np.cumsum(counts).tolist()
    runs = [(low + i, stop - n, stop) for i, (n, stop) in enumerate(zip(counts, ends, strict=True))]
    return order, [run for run in runs if run[1] < run[2]]


def _filled(
    order: Array | None,
    parts: list[tuple[int, int, int]],
    sizes: Sequence[int],
    work: Work,
    height: int,
    count: int,
) -> Array:
    """Write the results of all batches into one array, and bring them into the query's order."""
    out = np.empty((height, count))
    for kind, start, stop in parts:
        if kind < 0:
            out[:, start:stop] = np.nan
            continue
        for part in slices(stop - start, sizes[kind]):
            place = slice(start + part.start, start + part.stop)
            top = 0
            for values in work(kind, place if order is None else order[place]):
                high = top + (len(values) if values.ndim == 2 else 1)
                out[top:high, place] = values
                top = high
    if order is None:
        return out
    inverse = np.empty_like(order)
    inverse[order] = np.arange(count)
    return np.take(out, inverse, axis=-1)
