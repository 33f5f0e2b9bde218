"""Parquet files of a lake, read in flat memory: their keys, and their rows model by model."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

__all__ = ["KeyScan", "ModelStream", "scan_keys"]

Ints = NDArray[np.int64]

_BATCH = 65_536


@dataclass(frozen=True, slots=True)
class KeyScan:
    """What the key columns of one file say.

    Parameters
    ----------
    rows : int
        Number of rows.
    ids, counts : numpy.ndarray
        ``(k,)`` distinct model ids, ascending, and the rows of each.
    disorder : int
        Rows whose key is less than that of the row before.
    first_disorder : int
        Index of the first such row.
    repeated : int
        Rows whose key another row before has.
    by_model : bool
        Whether the rows of every model stand together, ascending.
    """

    rows: int
    ids: Ints
    counts: Ints
    disorder: int
    first_disorder: int
    repeated: int
    by_model: bool


def scan_keys(path: Path, key: tuple[str, ...]) -> KeyScan:
    """Read the key columns of a file and find out whether they ascend strictly."""
    rows = disorder = equal = 0
    first, by_model = -1, True
    last: list[Ints] | None = None
    ids, counts = [], []
    with pq.ParquetFile(path) as file:
        for batch in file.iter_batches(_BATCH, columns=list(key)):
            columns = [_integers(batch.column(name)) for name in key]
            found, number = np.unique(columns[0], return_counts=True)
            ids.append(found)
            counts.append(number)
            if last is not None:
                columns = [np.concatenate([a[-1:], b]) for a, b in zip(last, columns, strict=True)]
            order = _compare(columns)  # (rows - 1,)
            down = np.flatnonzero(order < 0)
            if len(down) and first < 0:
                first = rows + int(down[0]) + (last is None)
            disorder += len(down)
            equal += int(np.count_nonzero(order == 0))
            by_model = by_model and bool(np.all(np.diff(columns[0]) >= 0))
            rows += batch.num_rows
            last = columns
    if disorder:  # equal keys need not stand together then
        table = pq.read_table(path, columns=list(key))
        equal = rows - table.group_by(list(key)).aggregate([]).num_rows
    merged, total = _merge(ids, counts)
    return KeyScan(rows, merged, total, disorder, first, equal, by_model)


class ModelStream:
    """Gives the rows of one model after the other, reading a file once from front to back.

    Parameters
    ----------
    path : pathlib.Path
        The Parquet file.
    by_model : bool
        Whether its rows ascend by model; if not, the file is sorted in memory.
    only : collection of int, optional
        Ids of the models wanted; row groups without any are not read.
    """

    def __init__(
        self, path: Path, *, by_model: bool = True, only: Collection[int] | None = None
    ) -> None:
        self._runs = _runs(path, by_model, only)
        self._next = next(self._runs, None)

    def take(self, model_id: int) -> pa.Table | None:
        """Return the rows of `model_id`, or None; ids must be asked for in ascending order."""
        while self._next is not None and self._next[0] < model_id:
            self._next = next(self._runs, None)
        if self._next is None or self._next[0] != model_id:
            return None
        table = self._next[1]
        self._next = next(self._runs, None)
        return table


def _runs(
    path: Path, by_model: bool, only: Collection[int] | None
) -> Iterator[tuple[int, pa.Table]]:
    """Yield id and rows of each model of a file."""
    pending: list[pa.RecordBatch] = []
    current = -1
    for batch in _batches(path, by_model, only):
        ids = _integers(batch.column("model_id"))
        cuts = [0, *(np.flatnonzero(np.diff(ids)) + 1).tolist(), len(ids)]
        for start, stop in pairwise(cuts):
            if pending and ids[start] != current:
                yield current, pa.Table.from_batches(pending)
                pending = []
            current = int(ids[start])
            if only is None or current in only:
                pending.append(batch.slice(start, stop - start))
    if pending:
        yield current, pa.Table.from_batches(pending)


def _batches(path: Path, by_model: bool, only: Collection[int] | None) -> Iterator[pa.RecordBatch]:
    """Yield the non-empty batches of a file in the order of the models."""
    with pq.ParquetFile(path) as file:
        if not by_model:
            table = file.read()
            order = pc.sort_indices(table, sort_keys=[("model_id", "ascending")])
            yield from table.take(order).combine_chunks().to_batches(_BATCH)
            return
        groups = list(range(file.metadata.num_row_groups))
        if only is not None:
            groups = [g for g in groups if _may_hold(file.metadata.row_group(g), only)]
        for batch in file.iter_batches(_BATCH, row_groups=groups):
            if batch.num_rows:
                yield batch


def _may_hold(group: pq.RowGroupMetaData, only: Collection[int]) -> bool:
    """Return whether the statistics of a row group allow any of the ids."""
    for index in range(group.num_columns):
        column = group.column(index)
        if column.path_in_schema == "model_id":
            statistics = column.statistics
            if statistics is None or not statistics.has_min_max:
                return True
            return any(statistics.min <= i <= statistics.max for i in only)
    return True


def _integers(column: pa.Array) -> Ints:
    return np.asarray(column.cast(pa.int64()).to_numpy(zero_copy_only=False), dtype=np.int64)


def _compare(columns: list[Ints]) -> NDArray[np.int8]:
    """Compare each row with the one before: 1 greater, 0 equal, -1 less."""
    order = np.zeros(max(len(columns[0]) - 1, 0), dtype=np.int8)
    for column in columns:
        step = (column[1:] > column[:-1]).astype(np.int8) - (column[1:] < column[:-1])
        order = np.where(order == 0, step, order).astype(np.int8)
    return order


def _merge(ids: list[Ints], counts: list[Ints]) -> tuple[Ints, Ints]:
    """Join the distinct ids of all batches."""
    if not ids:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    merged, inverse = np.unique(np.concatenate(ids), return_inverse=True)
    total = np.zeros(len(merged), dtype=np.int64)
    np.add.at(total, inverse, np.concatenate(counts))
    return merged, total
