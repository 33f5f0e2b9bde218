"""Delta Lake logs over the files of a snapshot: one Delta table for each table, no copies.

Readers of Delta (delta-rs, polars, Spark, Trino, Daft) take paths in a log to be relative to the
table's folder; only some resolve absolute ones.  So the exported folder links to the lake's
files: by hard links, or by symbolic ones where it is on another file system.  What Delta tools
write, or remove by a vacuum, are their own files and these links, never the lake.

Exporting a later snapshot to the same folder adds a version to each log: its readers see the
history of the lake, as far as it was exported.
"""

from __future__ import annotations

import json
import os
import time
import uuid
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa

from breplake.errors import UsageError
from breplake.schema.contract import Column, Table
from breplake.schema.snapshot import FileEntry
from breplake.schema.storage import Storage
from breplake.schema.tables import TABLES

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["DeltaTable", "delta_schema", "export_delta"]

_TYPES: Final = {
    pa.int64(): "long",
    pa.int32(): "integer",
    pa.int16(): "short",
    pa.int8(): "byte",
    pa.float64(): "double",
    pa.float32(): "float",
    pa.bool_(): "boolean",
    pa.string(): "string",
}

_LAKE_KEY: Final = "breplake.lake_id"


@dataclass(frozen=True, slots=True)
class DeltaTable:
    """An exported table.

    Parameters
    ----------
    path : pathlib.Path
        Folder that Delta readers open.
    version : int
        Delta version that holds the snapshot.
    files : int
        Files of the table.
    """

    path: Path
    version: int
    files: int


@dataclass(slots=True)
class _Log:
    """What an existing log says: its next version, the active files and the metadata."""

    next: int
    active: set[str]
    metadata: dict[str, Any] | None


def export_delta(lake: Lake, folder: str | Path) -> list[DeltaTable]:
    """Write Delta tables of a snapshot, or bring those of an earlier export up to it.

    Parameters
    ----------
    lake : Lake
        A local lake at a snapshot.
    folder : path
        Where the tables go, ``<folder>/<table>``.

    Returns
    -------
    list of DeltaTable
        One for each table, also for those without rows.

    Raises
    ------
    UsageError
        If the folder is inside the lake, holds an export of another lake, or a log that another
        tool has compacted or is writing to at the same time.
    """
    root = Path(folder).resolve()
    if root.is_relative_to(lake.root):
        raise UsageError(f"{folder} is inside the lake {lake.root}: export to a folder outside it")
    return [_export_table(lake, table, root / table.name) for table in TABLES.values()]


def delta_schema(table: Table) -> str:
    """Return the schema of a table as the text that a Delta log holds."""
    fields = [
        _field(column.name, column.type, nullable=column.nullable)
        | {"metadata": {"comment": _comment(column)}}
        for column in table.columns
    ]
    return json.dumps({"type": "struct", "fields": fields})


def _comment(column: Column) -> str:
    return f"{column.description} [{column.unit}]" if column.unit else column.description


def _field(name: str, kind: pa.DataType, *, nullable: bool) -> dict[str, Any]:
    return {"name": name, "type": _delta_type(kind), "nullable": nullable, "metadata": {}}


def _delta_type(kind: pa.DataType) -> Any:
    if pa.types.is_struct(kind):
        fields = [_field(f.name, f.type, nullable=f.nullable) for f in kind]
        return {"type": "struct", "fields": fields}
    if pa.types.is_list(kind):
        inner = kind.value_field
        return {
            "type": "array",
            "elementType": _delta_type(inner.type),
            "containsNull": inner.nullable,
        }
    if pa.types.is_map(kind):
        return {
            "type": "map",
            "keyType": _delta_type(kind.key_type),
            "valueType": _delta_type(kind.item_type),
            "valueContainsNull": kind.item_field.nullable,
        }
    return _TYPES[kind]


def _export_table(lake: Lake, table: Table, folder: Path) -> DeltaTable:
    (folder / "_delta_log").mkdir(parents=True, exist_ok=True)
    log = _read_log(folder)
    entries = {f"{e.shard}.parquet": e for e in lake.snapshot.table_files(table.name)}
    actions = _metadata_actions(lake, table, log)
    now = round(time.time() * 1000)
    actions += [
        {"remove": {"path": path, "deletionTimestamp": now, "dataChange": True}}
        for path in sorted(log.active - entries.keys())
    ]
    for path in sorted(entries.keys() - log.active):
        source = lake.root / entries[path].path
        _link(source, folder / path)
        actions.append({"add": _add(path, entries[path], source)})
    if not actions:
        return DeltaTable(folder, log.next - 1, len(entries))
    info = {
        "timestamp": now,
        "operation": "WRITE",
        "operationParameters": {"mode": "Overwrite"},
        "userMetadata": f"snapshot {lake.snapshot.number} of lake {lake.store.lake_id}",
    }
    lines = "".join(json.dumps(action) + "\n" for action in [{"commitInfo": info}, *actions])
    if not Storage(folder).create(f"_delta_log/{log.next:020d}.json", lines.encode()):
        raise UsageError(f"another writer added version {log.next} to {folder}: export again")
    return DeltaTable(folder, log.next, len(entries))


def _metadata_actions(lake: Lake, table: Table, log: _Log) -> list[dict[str, Any]]:
    """Return what starts a log, or what a change of the columns needs."""
    lake_id, schema = lake.store.lake_id, delta_schema(table)
    if log.metadata is None:
        started: list[dict[str, Any]] = [
            {"protocol": {"minReaderVersion": 1, "minWriterVersion": 2}}
        ]
    elif log.metadata.get("configuration", {}).get(_LAKE_KEY) != lake_id:
        raise UsageError("the folder holds Delta tables of another lake: name a new folder")
    elif log.metadata["schemaString"] == schema:
        return []
    else:
        started = []
    metadata = {
        "id": str(uuid.uuid5(uuid.NAMESPACE_OID, f"{lake_id}/{table.name}")),
        "name": table.name,
        "description": f"a row is {table.row}",
        "format": {"provider": "parquet", "options": {}},
        "schemaString": schema,
        "partitionColumns": [],
        "configuration": {_LAKE_KEY: lake_id},
        "createdTime": round(time.time() * 1000),
    }
    return [*started, {"metaData": metadata}]


def _add(path: str, entry: FileEntry, source: Path) -> dict[str, Any]:
    stats: dict[str, Any] = {"numRecords": entry.rows}
    if entry.min_model_id is not None:
        stats["minValues"] = {"model_id": entry.min_model_id}
        stats["maxValues"] = {"model_id": entry.max_model_id}
        stats["nullCount"] = {"model_id": 0}
    return {
        "path": path,  # names of shards need no escaping in a URI
        "partitionValues": {},
        "size": entry.bytes,
        "modificationTime": round(source.stat().st_mtime * 1000),
        "dataChange": True,
        "stats": json.dumps(stats),
    }


def _read_log(folder: Path) -> _Log:
    """Replay a log that was written here."""
    storage = Storage(folder)
    names = [name for name in storage.names("_delta_log") if name.endswith(".json")]
    if names != [f"{version:020d}.json" for version in range(len(names))]:
        raise UsageError(f"the log in {folder} was compacted by another tool: name a new folder")
    log = _Log(len(names), set(), None)
    for name in names:
        for action in _actions(storage.read(f"_delta_log/{name}")):
            if "metaData" in action:
                log.metadata = action["metaData"]
            elif "add" in action:
                log.active.add(action["add"]["path"])
            elif "remove" in action:
                log.active.discard(action["remove"]["path"])
    return log


def _actions(data: bytes) -> Iterable[dict[str, Any]]:
    return (json.loads(line) for line in data.splitlines() if line.strip())


def _link(source: Path, target: Path) -> None:
    """Make `target` another name of `source`."""
    if target.exists() and os.path.samefile(source, target):
        return
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError:  # another file system, or one without hard links
        target.symlink_to(os.path.relpath(source, target.parent))
