"""Which models a lake holds: no model twice, no two names with one id."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, NamedTuple, NoReturn

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq

from breplake.errors import CommitConflictError, LakeFormatError
from breplake.schema.snapshot import FileEntry
from breplake.schema.storage import Storage
from breplake.schema.tables import FAILURES, MODELS

__all__ = ["IdentityIndex", "read_ids"]

_TABLES: Final = (MODELS.name, FAILURES.name)
"""The tables that say which models there are."""


class _Rows(NamedTuple):
    """The models of a file, as its rows name them."""

    ids: npt.NDArray[np.int64]  # (rows,)
    counts: npt.NDArray[np.bool_]  # (rows,) a failure that is not fatal does not hold its model


class IdentityIndex:
    """The ids of a lake's models, kept from commit to commit: each file is read once.

    A model is in a lake when it has a row in ``models`` or a fatal one in ``failures``.

    Parameters
    ----------
    storage : Storage
        The lake.
    """

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self._rows: dict[FileEntry, _Rows] = {}  # by entry: a name that is free is used again

    def check(self, new: Sequence[FileEntry], old: Sequence[FileEntry]) -> None:
        """Check that no model of the files `new` is among those of `old`, or twice in `new`.

        Raises
        ------
        CommitConflictError
            If one is: the same model was added twice, or two names share an id.
        LakeFormatError
            If a file cannot be read.
        """
        fresh = _with_ids(new)
        if not fresh:
            return
        known = _with_ids(old)
        rows = self._read([*known, *fresh])
        wanted = np.sort(_held(rows, fresh))
        twice = wanted[1:][wanted[1:] == wanted[:-1]]
        if not len(twice) and len(wanted):
            held = _held(rows, known)
            twice = held[_among(held, wanted)]
        if len(twice):
            first = int(twice.min())
            near = [entry for entry in (*fresh, *known) if first in _held(rows, [entry])]
            self._explain(first, near)

    def shards(self, files: Sequence[FileEntry], ids: Collection[int]) -> list[str]:
        """Return the sorted shards that have rows of some models, failures of any kind included.

        Parameters
        ----------
        files : sequence of FileEntry
            Files of any tables.
        ids : collection of int
            The models.

        Raises
        ------
        LakeFormatError
            If a file cannot be read.
        """
        known = _with_ids(files)
        if not ids or not known:
            return []
        rows = self._read(known)
        parts = [rows[entry].ids for entry in known]
        wanted = np.sort(np.fromiter(ids, np.int64, len(ids)))
        places = np.flatnonzero(_among(np.concatenate(parts), wanted))
        ends = np.cumsum([len(part) for part in parts])
        found = np.unique(np.searchsorted(ends, places, "right"))
        return sorted({known[number].shard for number in found.tolist()})

    def _read(self, entries: Sequence[FileEntry]) -> Mapping[FileEntry, _Rows]:
        """Return the rows of files; forget those of others, and read what was not read yet."""
        rows = {entry: self._rows[entry] for entry in entries if entry in self._rows}
        for table in _TABLES:
            files = [entry for entry in entries if entry.table == table and entry not in rows]
            if not files:
                continue
            read = _read(self._storage, files)
            ends = np.cumsum([entry.rows for entry in files])[:-1]
            parts = zip(np.split(read.ids, ends), np.split(read.counts, ends), strict=True)
            rows |= {entry: _Rows(*part) for entry, part in zip(files, parts, strict=True)}
        self._rows = rows
        return rows

    def _explain(self, identity: int, files: Sequence[FileEntry]) -> NoReturn:
        """Raise an error that names the first two rows of a model that is there twice."""
        named = _identities(self._storage, files)
        first, second, *_ = [(name, path) for found, name, path in named if found == identity]
        _refuse(identity, first, second)


def _held(rows: Mapping[FileEntry, _Rows], entries: Iterable[FileEntry]) -> npt.NDArray[np.int64]:
    """Return the ids of the models that files hold, in their order."""
    parts = (rows[entry] for entry in entries)
    return np.concatenate([np.empty(0, np.int64), *(part.ids[part.counts] for part in parts)])


def read_ids(storage: Storage, files: Sequence[FileEntry]) -> npt.NDArray[np.int64]:
    """Return the ids of the models in `files`, those of fatal failures included.

    Parameters
    ----------
    storage : Storage
        The lake.
    files : sequence of FileEntry
        Files of any tables; only those of ``models`` and ``failures`` are read.

    Returns
    -------
    numpy.ndarray
        ``(models,)`` int64, in the order of the files, ``models`` first.

    Raises
    ------
    LakeFormatError
        If a file cannot be read.
    """
    known = _with_ids(files)
    found: list[npt.NDArray[np.int64]] = []
    for table in _TABLES:
        rows = _read(storage, [entry for entry in known if entry.table == table])
        found.append(rows.ids[rows.counts])
    return np.concatenate(found)


def _with_ids(files: Sequence[FileEntry]) -> list[FileEntry]:
    """Return the files that say which models there are."""
    return [entry for entry in files if entry.table in _TABLES and entry.rows]


def _among(ids: npt.NDArray[np.int64], wanted: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Return which of `ids` are among `wanted`, which are sorted and few."""
    place = np.searchsorted(wanted, ids).clip(max=len(wanted) - 1)
    found: npt.NDArray[np.bool_] = wanted[place] == ids
    return found


def _read(storage: Storage, files: Sequence[FileEntry]) -> _Rows:
    """Return the rows of files of one table, in their order.

    Raises
    ------
    LakeFormatError
        If a file cannot be read, or has other rows than the snapshot says.
    """
    if not files:
        return _Rows(np.empty(0, np.int64), np.empty(0, np.bool_))
    is_models = files[0].table == MODELS.name
    columns = ["model_id"] if is_models else ["model_id", "fatal"]
    paths = [entry.path for entry in files]
    try:
        # polars reads 2,000 files twice as fast, but its threads do not survive a fork
        read = _read_by_polars if storage.is_local and not _is_forked else _read_by_arrow
        ids, *fatal = read(storage, paths, columns)
        if len(ids) != sum(entry.rows for entry in files):
            raise ValueError("they have other rows than the snapshot says")
    except (OSError, ValueError, RuntimeError) as error:
        raise LakeFormatError(
            f"cannot read the models of {storage.name} ({error}): run breplake verify"
        ) from error
    return _Rows(ids, np.ones(len(ids), np.bool_) if is_models else fatal[0])


def _read_by_polars(
    storage: Storage, paths: Sequence[str], columns: Sequence[str]
) -> list[npt.NDArray[Any]]:
    import polars as pl

    frame = pl.scan_parquet(
        [storage.path(path) for path in paths], glob=False, hive_partitioning=False,
        missing_columns="insert", extra_columns="ignore",
    )  # fmt: skip
    try:
        rows = frame.select(columns).collect()
    except pl.exceptions.PolarsError as error:
        raise ValueError(str(error)) from error
    return [rows[name].to_numpy() for name in columns]


def _read_by_arrow(
    storage: Storage, paths: Sequence[str], columns: Sequence[str]
) -> list[npt.NDArray[Any]]:
    def read(path: str) -> list[npt.NDArray[Any]]:
        with pq.ParquetFile(storage.open(path)) as file:
            rows = file.read(columns=columns, use_threads=False)
        return [rows.column(name).to_numpy() for name in columns]

    with ThreadPoolExecutor(8) as pool:
        return [np.concatenate(parts) for parts in zip(*pool.map(read, paths), strict=True)]


_is_forked = False


def _note_fork() -> None:
    global _is_forked
    _is_forked = True


os.register_at_fork(after_in_child=_note_fork)


def _identities(storage: Storage, files: Sequence[FileEntry]) -> Iterator[tuple[int, str, str]]:
    """Yield (model_id, collection/name, path) of every model in `files`."""
    names = ["model_id", "collection", "name"]
    for entry in files:
        if entry.table not in _TABLES:
            continue
        fatal = ["fatal"] if entry.table == FAILURES.name else []
        with pq.ParquetFile(storage.open(entry.path)) as file:
            rows = file.read(columns=names + fatal)
        if fatal:
            rows = rows.filter(rows.column("fatal"))
        columns = (rows.column(name).to_pylist() for name in names)
        for identity, collection, name in zip(*columns, strict=True):
            yield identity, f"{collection}/{name}", entry.path


def _refuse(identity: int, first: tuple[str, str], second: tuple[str, str]) -> NoReturn:
    if first[0] == second[0]:
        raise CommitConflictError(
            f"model {first[0]} is in both {first[1]} and {second[1]}: a model is added once, "
            "replace its file to add it anew"
        )
    raise CommitConflictError(
        f"models {first[0]} and {second[0]} share the id {identity}: rename one of them"
    )
