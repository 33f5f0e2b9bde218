"""The rows of one model: read from its shard's files and row groups alone."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from breplake.errors import LakeFormatError, NameNotFoundError
from breplake.schema.identities import read_ids
from breplake.schema.older import conform
from breplake.schema.snapshot import FileEntry, Snapshot
from breplake.schema.storage import Storage
from breplake.schema.tables import TABLES

__all__ = ["RowReader"]

_FOOTERS = 256
"""Footers of files that are kept in memory."""


@dataclass(frozen=True, slots=True)
class _Footer:
    """A file's metadata and the models in each of its row groups."""

    metadata: Any
    low: npt.NDArray[np.int64]  # (groups,)
    high: npt.NDArray[np.int64]  # (groups,)


class RowReader:
    """Read rows by model from the files of a snapshot.

    Parameters
    ----------
    storage : Storage
        The lake.
    snapshot : Snapshot
        Whose files are read.
    """

    def __init__(self, storage: Storage, snapshot: Snapshot) -> None:
        self._storage = storage
        self._snapshot = snapshot
        self._files = {(entry.table, entry.shard): entry for entry in snapshot.files}
        self._footers: OrderedDict[str, _Footer] = OrderedDict()
        self._ids: npt.NDArray[np.int64] | None = None  # (models,) ascending
        self._shards: npt.NDArray[np.str_] | None = None  # (models,)

    def __reduce__(self) -> tuple[type[RowReader], tuple[Storage, Snapshot]]:
        """Pickle without what was cached."""
        return type(self), (self._storage, self._snapshot)

    def shard_of(self, model_id: int) -> str | None:
        """Return the shard that holds a model, or None if it is not in ``models``."""
        if self._ids is None or self._shards is None:
            self._ids, self._shards = self._read_index()
        at = int(np.searchsorted(self._ids, model_id))
        if at == len(self._ids) or self._ids[at] != model_id:
            return None
        return str(self._shards[at])

    def read(self, table: str, model_id: int, columns: Sequence[str] | None = None) -> pa.Table:
        """Return one model's rows of `table`, sorted by the table's key.

        Raises
        ------
        NameNotFoundError
            If the snapshot has neither the model nor a failure of that id.
        """
        shard = self.shard_of(model_id)
        if table == "failures" or shard is None:
            # the failure of an input may lie in another shard than its model
            entries = [e for e in self._snapshot.table_files("failures") if _covers(e, model_id)]
            found = [self._read_file(entry, model_id, None) for entry in entries]
            known = shard is not None or any(part.num_rows for part in found)
            if not known:
                raise NameNotFoundError(f"snapshot {self._snapshot.number} has no model {model_id}")
        if table != "failures":
            entry = self._files.get((table, shard)) if shard is not None else None
            found = [self._read_file(entry, model_id, columns)] if entry else []
        schema = TABLES[table].schema
        rows = pa.concat_tables(found) if found else schema.empty_table()
        rows = rows.sort_by(
            [(key, "ascending") for key in TABLES[table].key if key in rows.schema.names]
        )
        return rows.select(columns) if columns else rows

    def _read_index(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.str_]]:
        entries = self._snapshot.table_files("models")
        ids = read_ids(self._storage, entries)
        names = np.array([entry.shard for entry in entries], np.str_)
        order = np.argsort(ids)
        return ids[order], np.repeat(names, [entry.rows for entry in entries])[order]

    def _read_file(
        self, entry: FileEntry, model_id: int, columns: Sequence[str] | None
    ) -> pa.Table:
        footer = self._footer(entry)
        groups = np.flatnonzero((footer.low <= model_id) & (model_id <= footer.high))
        wanted = None if columns is None else list(dict.fromkeys([*columns, "model_id"]))
        with pq.ParquetFile(self._storage.reader(entry.path), metadata=footer.metadata) as file:
            rows = file.read_row_groups(groups.tolist(), columns=wanted)
        schema = TABLES[entry.table].schema
        if wanted is not None:
            schema = pa.schema([schema.field(name) for name in wanted])
        return conform(rows.filter(pc.equal(rows.column("model_id"), model_id)), schema)

    def _footer(self, entry: FileEntry) -> _Footer:
        """Return the file's footer; the least recently used ones are forgotten."""
        if entry.path in self._footers:
            self._footers.move_to_end(entry.path)
            return self._footers[entry.path]
        try:
            metadata = pq.read_metadata(self._storage.reader(entry.path))
        except (OSError, pa.ArrowInvalid) as error:
            raise LakeFormatError(f"{entry.path}: {error}; run breplake check") from error
        at = metadata.schema.to_arrow_schema().get_field_index("model_id")
        groups = [metadata.row_group(g) for g in range(metadata.num_row_groups)]
        statistics = [g.column(at).statistics if g.num_rows else None for g in groups]
        footer = _Footer(
            metadata,
            # the range of a group without rows holds no id
            np.array([s.min if s else 0 for s in statistics], np.int64),
            np.array([s.max if s else -1 for s in statistics], np.int64),
        )
        self._footers[entry.path] = footer
        if len(self._footers) > _FOOTERS:
            self._footers.popitem(last=False)
        return footer


def _covers(entry: FileEntry, model_id: int) -> bool:
    if entry.min_model_id is None or entry.max_model_id is None:
        return False
    return entry.min_model_id <= model_id <= entry.max_model_id
