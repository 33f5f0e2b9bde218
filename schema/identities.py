"""Which models a lake holds: no model twice, no two names with one id."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq

from breplake.errors import CommitConflictError, LakeFormatError
from breplake.schema.snapshot import FileEntry
from breplake.schema.storage import Storage

__all__ = ["IdentityIndex", "read_ids"]


class IdentityIndex:
    """The ids of a lake's models, kept from commit to commit.

    A model is in a lake when it has a row in ``models`` or a fatal one in ``failures``.

    Parameters
    ----------
    storage : Storage
        The lake.
    """

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self._forget()

    def _forget(self) -> None:
        self._paths: frozenset[str] = frozenset()
        self._ids: npt.NDArray[np.int64] = np.empty(0, np.int64)  # (models,) in no order

    def check(self, new: Sequence[FileEntry], old: Sequence[FileEntry]) -> None:
        """Check that no model of the files `new` is among those of `old`, or twice in `new`.

        Raises
        ------
        CommitConflictError
            If one is: the same model was added twice, or two names share an id.
        """
        seen: dict[int, tuple[str, str]] = {}
        for identity, name, path in _identities(self._storage, new):
            if identity in seen:
                _refuse(identity, seen[identity], (name, path))
            seen[identity] = (name, path)
        if not seen:
            return
        self._update(old)
        wanted = np.sort(np.fromiter(seen, np.int64))
        place = np.searchsorted(wanted, self._ids).clip(max=len(wanted) - 1)
        both = self._ids[wanted[place] == self._ids]
        if not len(both):
            return
        first = int(both.min())
        near = [entry for entry in old if _covers(entry, first)]
        for identity, name, path in _identities(self._storage, near):
            if identity == first:
                _refuse(identity, seen[identity], (name, path))

    def _update(self, entries: Sequence[FileEntry]) -> None:
        """Read the ids of the files that were not read before."""
        paths = frozenset(entry.path for entry in entries)
        if not self._paths <= paths:  # a file was replaced: its ids count no more
            self._forget()
        fresh = [entry for entry in entries if entry.path not in self._paths]
        self._ids = np.concatenate([self._ids, read_ids(self._storage, fresh)])
        self._paths = paths


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
    found: list[npt.NDArray[np.int64]] = [np.empty(0, np.int64)]
    for table in ("models", "failures"):
        paths = [e.path for e in files if e.table == table and e.rows]
        if not paths:
            continue
        try:
            # polars reads 2,000 files twice as fast, but its threads do not survive a fork
            read = _read_by_polars if storage.is_local and not _is_forked else _read_by_arrow
            found.append(read(storage, paths, only_fatal=table == "failures"))
        except (OSError, ValueError, RuntimeError) as error:
            raise LakeFormatError(
                f"cannot read the models of {storage.name} ({error}): run breplake verify"
            ) from error
    return np.concatenate(found)


def _read_by_polars(
    storage: Storage, paths: Sequence[str], *, only_fatal: bool
) -> npt.NDArray[np.int64]:
    import polars as pl

    frame = pl.scan_parquet(
        [storage.path(path) for path in paths], glob=False, hive_partitioning=False,
        missing_columns="insert", extra_columns="ignore",
    )  # fmt: skip
    if only_fatal:
        frame = frame.filter(pl.col("fatal"))
    try:
        return frame.select("model_id").collect().to_series().to_numpy()
    except pl.exceptions.PolarsError as error:
        raise ValueError(str(error)) from error


def _read_by_arrow(
    storage: Storage, paths: Sequence[str], *, only_fatal: bool
) -> npt.NDArray[np.int64]:
    columns = ["model_id", "fatal"] if only_fatal else ["model_id"]

    def read(path: str) -> npt.NDArray[np.int64]:
        with pq.ParquetFile(storage.open(path)) as file:
            rows = file.read(columns=columns, use_threads=False)
        rows = rows.filter(rows.column("fatal")) if only_fatal else rows
        ids: npt.NDArray[np.int64] = rows.column("model_id").to_numpy()
        return ids

    with ThreadPoolExecutor(8) as pool:
        return np.concatenate(list(pool.map(read, paths)))


_is_forked = False


def _note_fork() -> None:
    global _is_forked
    _is_forked = True


os.register_at_fork(after_in_child=_note_fork)


def _identities(storage: Storage, files: Sequence[FileEntry]) -> Iterator[tuple[int, str, str]]:
    """Yield (model_id, collection/name, path) of every model in `files`."""
    names = ["model_id", "collection", "name"]
    for entry in files:
        if entry.table not in ("models", "failures"):
            continue
        fatal = ["fatal"] if entry.table == "failures" else []
        with pq.ParquetFile(storage.open(entry.path)) as file:
            rows = file.read(columns=names + fatal)
        if fatal:
            rows = rows.filter(rows.column("fatal"))
        columns = (rows.column(name).to_pylist() for name in names)
        for identity, collection, name in zip(*columns, strict=True):
            yield identity, f"{collection}/{name}", entry.path


def _covers(entry: FileEntry, identity: int) -> bool:
    if entry.min_model_id is None or entry.max_model_id is None:
        return False
    return entry.min_model_id <= identity <= entry.max_model_id


def _refuse(identity: int, first: tuple[str, str], second: tuple[str, str]) -> None:
    if first[0] == second[0]:
        raise CommitConflictError(
            f"model {first[0]} is in both {first[1]} and {second[1]}: a model is added once, "
            "replace its file to add it anew"
        )
    raise CommitConflictError(
        f"models {first[0]} and {second[0]} share the id {identity}: rename one of them"
    )
