"""Which models a dataset has, where their rows are, and reading them."""

from __future__ import annotations

import copy
import hashlib
from collections import OrderedDict
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from breplake.errors import UsageError
from breplake.queries.session import Lake
from breplake.schema.array_reader import ArrayShardReader
from breplake.schema.arrays import ARRAYS
from breplake.schema.older import conform
from breplake.schema.subset import Subset
from breplake.schema.tables import TABLES
from breplake.schema.types import SURFACE_TYPES

__all__ = ["ModelIndex"]

_KEPT_TABLES: Final = 64
"""Shards' tables that a process keeps in memory, some megabytes each."""

_OFFSETS: Final = {
    "vertex": ("vertex_offset", "n_vertices"),
    "normal": ("normal_offset", "n_normals"),
    "face": ("face_offset", "n_faces"),
    "patch": ("patch_offset", "n_patches"),
    "curve": ("curve_offset", "n_curves"),
}
"""What a row of an array may be -> columns of ``models`` with its first row and their number."""


class ModelIndex:
    """The models of a lake that have a mesh and meet a condition, in the order of their ids.

    Everything is numbers in arrays and text in one Arrow array: Python objects would be copied
    into every forked worker as their reference counts are touched. A process opens files when it
    first reads, and reading keeps no thread, lock or open file.

    Parameters
    ----------
    lake : Lake, str or pathlib.Path
        A lake at a snapshot, or the folder or URL of one (then its newest snapshot).
    where : str, optional
        SQL condition on columns of ``models``.
    subset : Subset or str, optional
        Instead of `where`: a subset of the lake, or its name. The lake is then read at the
        subset's snapshot.
    split : str, optional
        Take one split of the subset.

    Raises
    ------
    UsageError
        If `where` is no condition on ``models``, or the arguments do not go together.
    NameNotFoundError
        If there is no such subset or split.

    Attributes
    ----------
    lake : Lake
        The lake at the snapshot that is read.
    subset : Subset or None
        The subset, if one was given.
    model_ids : numpy.ndarray
        ``(len,)`` int64, ascending.
    left_out : int
        Models of the subset that have no mesh.
    """

    def __init__(
        self,
        lake: Lake | str | Path,
        where: str | None = None,
        subset: Subset | str | None = None,
        split: str | None = None,
    ) -> None:
        if subset is not None and where is not None:
            raise UsageError("a subset says which models: leave out where, or filter its SQL")
        if subset is None and split is not None:
            raise UsageError(f"split={split!r} is a split of a subset: name the subset, too")
        opened = lake if isinstance(lake, Lake) else Lake(lake)
        self.where, self.split = where, split
        self.subset = opened.subset(subset) if isinstance(subset, str) else subset
        if self.subset is not None:
            if self.subset.lake_id != opened.store.lake_id:
                raise UsageError(
                    f"subset {self.subset.name} is of another lake: export it there and import it "
                    "here with breplake subset create --from"
                )
            if self.subset.snapshot != opened.snapshot.number:
                opened = opened.at(self.subset.snapshot)
        self.lake = opened
        table = _select(opened, where)
        self.left_out = 0
        if self.subset is not None:
            wanted = self.subset.ids(split)
            kept = np.isin(table.column("model_id").to_numpy(), wanted, assume_unique=True)
            table = table.filter(kept)
            self.left_out = len(wanted) - table.num_rows
        self._take(table)
        self._readers: dict[int, ArrayShardReader] = {}
        self._tables: OrderedDict[tuple[str, ...], tuple[npt.NDArray[np.int64], Any]]
        self._tables = OrderedDict()

    def _take(self, table: Any) -> None:
        self.model_ids: npt.NDArray[np.int64] = table.column("model_id").to_numpy()
        self._names = table.column("name").combine_chunks()
        shards = table.column("shard").combine_chunks().dictionary_encode()
        self._shards: list[str] = shards.dictionary.to_pylist()
        self._shard = shards.indices.to_numpy(zero_copy_only=False)  # (len,)
        # (len, 2) first row and number of rows
        self._rows = {
            axis: np.stack([_numbers(table, first), _numbers(table, count)], axis=1)
            for axis, (first, count) in _OFFSETS.items()
        }

    def __len__(self) -> int:
        return len(self.model_ids)

    def __getstate__(self) -> dict[str, Any]:
        # a process opens its own
        return self.__dict__ | {"_readers": {}, "_tables": OrderedDict()}

    def __repr__(self) -> str:
        return f"ModelIndex({self.described}): {len(self)} models"

    @property
    def described(self) -> str:
        """The lake and what was chosen from it, as an argument list."""
        parts = [repr(self.lake.place)]
        if self.where:
            parts.append(f"where={self.where!r}")
        if self.subset is not None:
            parts.append(f"subset={self.subset.name!r}")
        if self.split is not None:
            parts.append(f"split={self.split!r}")
        return ", ".join(parts)

    @property
    def snapshot(self) -> int:
        """Number of the snapshot that is read."""
        return self.lake.snapshot.number

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the ids: equal for the same models, in every lake."""
        return hashlib.sha256(self.model_ids.astype("<i8").tobytes()).hexdigest()

    def name(self, index: int) -> str:
        """Return the name of the model number `index`."""
        name: str = self._names[index].as_py()
        return name

    def names(self, indices: npt.NDArray[np.int64]) -> tuple[str, ...]:
        """Return the names of several models."""
        return tuple(self._names.take(indices).to_pylist())

    def counts(self, axis: str) -> npt.NDArray[np.int64]:
        """Return ``(len,)`` numbers of rows along an axis: vertex, normal, face, patch, curve."""
        return self._rows[axis][:, 1]

    def stored(self, axis: str) -> npt.NDArray[np.bool_]:
        """Return ``(len,)``: which models have arrays along an axis."""
        return self._rows[axis][:, 0] >= 0

    def part(self, rows: npt.NDArray[np.int64]) -> ModelIndex:
        """Return an index of some of the models.

        Parameters
        ----------
        rows : numpy.ndarray
            ``(k,)`` int64, their numbers here, ascending.
        """
        other = copy.copy(self)
        for cached in ("fingerprint", "_types"):
            other.__dict__.pop(cached, None)
        other.model_ids = self.model_ids[rows]
        other._names = self._names.take(rows)
        other._shard = self._shard[rows]
        other._rows = {axis: pairs[rows] for axis, pairs in self._rows.items()}
        return other

    def read(self, array: str, index: int) -> npt.NDArray[Any]:
        """Return one array of the model number `index`, in memory of its own.

        Raises
        ------
        UsageError
            If the model has no such rows: its lake was made without them.
        LakeFormatError
            If the files are damaged.
        """
        start, count = self._rows[ARRAYS[array].axis][index].tolist()
        if start < 0:
            raise UsageError(
                f"model {self.name(index)} has no array {array}: it was ingested without"
            )
        return self._reader(int(self._shard[index])).read(array, start, start + count)

    def table(self, name: str, index: int, columns: list[str]) -> Any:
        """Return columns of a table's rows of the model number `index`, as an Arrow table.

        The columns of a shard are kept, those of the shard that was used longest ago are
        forgotten: a row group has the rows of many models and is decoded as a whole.
        """
        shard = self._shards[int(self._shard[index])]
        key = (name, shard, *columns)
        if key in self._tables:
            self._tables.move_to_end(key)
        else:
            self._tables[key] = _read_shard(self.lake, name, shard, columns)
            if len(self._tables) > _KEPT_TABLES:
                self._tables.popitem(last=False)
        ids, rows = self._tables[key]
        low, high = np.searchsorted(ids, self.model_ids[index] + np.array([0, 1])).tolist()
        return rows.slice(low, high - low)

    def patch_types(self, index: int) -> npt.NDArray[np.uint8]:
        """Return ``(n_patches,)`` uint8: each patch's place in `SURFACE_TYPES`."""
        first, codes = self._types
        start = int(first[index])
        return codes[start : start + int(self._rows["patch"][index, 1])]

    def load_types(self) -> None:
        """Read the types of all patches now, a byte for each, before workers are started."""
        assert self._types is not None

    @cached_property
    def _types(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.uint8]]:
        """``(len,)`` first patch of each model, and the types of all patches."""
        order = ", ".join(f"'{name}'" for name in SURFACE_TYPES)
        table = self.lake.sql(
            f"SELECT model_id, (list_position([{order}], type) - 1)::UTINYINT AS code "
            "FROM patches ORDER BY model_id, patch_id"
        ).to_arrow_table()
        ids = table.column("model_id").to_numpy()  # (patches of the lake,) ascending
        codes = table.column("code").to_numpy()
        begin = np.searchsorted(ids, self.model_ids)
        count = self.counts("patch")
        first = np.concatenate([[0], np.cumsum(count)[:-1]]).astype(np.int64)
        rows = np.repeat(begin - first, count) + np.arange(int(count.sum()))
        return first, codes[rows]

    def _reader(self, shard: int) -> ArrayShardReader:
        if shard not in self._readers:
            self._readers[shard] = self.lake.arrays(self._shards[shard])
        return self._readers[shard]


def _read_shard(
    lake: Lake, name: str, shard: str, columns: list[str]
) -> tuple[npt.NDArray[np.int64], Any]:
    """Return the ids and columns of all rows of a shard's table, sorted by model."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    entry = lake.snapshot.file(name, shard)
    if entry is None:
        raise UsageError(f"shard {shard} has no table {name}: its models were ingested without")
    # without threads: a worker may have been forked from a process that has some
    with pq.ParquetFile(lake.store.storage.reader(entry.path)) as file:
        rows = file.read([*columns, "model_id"], use_threads=False)
    schema = TABLES[name].schema
    rows = conform(rows, pa.schema([schema.field(column) for column in [*columns, "model_id"]]))
    return rows.column("model_id").to_numpy(), rows.select(columns)


def _numbers(table: Any, name: str) -> npt.NDArray[np.int64]:
    """Return a column as int64, -1 where it is null."""
    values: npt.NDArray[np.int64] = (
        table.column(name).fill_null(-1).combine_chunks().to_numpy(zero_copy_only=False)
    ).astype(np.int64)
    return values


def _select(lake: Lake, where: str | None) -> Any:
    """Return the index of the models with a mesh as an Arrow table."""
    import duckdb

    columns = ", ".join(name for pair in _OFFSETS.values() for name in pair)
    condition = "true" if where is None else where
    # the line break ends a comment in the condition
    query = (
        f"SELECT model_id, name, shard, {columns} FROM models "
        f"WHERE n_faces > 0 AND ({condition}\n) ORDER BY model_id"
    )
    try:
        return lake.sql(query).to_arrow_table()
    except (UsageError, duckdb.Error) as error:
        raise UsageError(f"where={where!r} is no condition on models: {error}") from error
