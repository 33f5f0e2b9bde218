"""A snapshot: the exact files of a lake after one commit, as an immutable document."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from breplake.errors import LakeFormatError
from breplake.schema.tables import SCHEMA_VERSION

__all__ = ["ARRAYS_TABLE", "FileEntry", "Snapshot"]

ARRAYS_TABLE = "arrays"
"""Value of `FileEntry.table` for a folder of arrays."""


@dataclass(frozen=True, slots=True, order=True)
class FileEntry:
    """A write-once file (or folder of arrays) that a snapshot names.

    Parameters
    ----------
    path : str
        Relative POSIX path: ``tables/<table>/<shard>.parquet`` or ``arrays/<shard>.zarr``.
    table : str
        Name of the table, or ``arrays``.
    shard : str
        Name of the shard.
    rows : int
        Rows of the table; of an arrays folder, rows of ``position``.
    bytes : int
        Size; of a folder, of all its files.
    sha256 : str
        Hash of the bytes, or of a folder as `breplake.schema.storage.folder_hash` takes it.
    min_model_id, max_model_id : int or None
        Range of the models in it; None if it has no rows.
    """

    path: str
    table: str
    shard: str
    rows: int
    bytes: int
    sha256: str
    min_model_id: int | None
    max_model_id: int | None


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of a lake after one commit.

    Parameters
    ----------
    number : int
        1 for the first commit.
    parent : int or None
        Number of the snapshot before it.
    message : str
        What the commit did.
    time : str
        UTC, ISO 8601.
    schema_version : int
        Version of the tables and arrays.
    tools : mapping
        Versions of the tools that made the commit.
    config_hash : str
        Hash of the settings that decide the content.
    files : tuple of FileEntry
        All files of the snapshot, sorted by path.
    """

    number: int
    parent: int | None
    message: str
    time: str
    schema_version: int
    tools: Mapping[str, str]
    config_hash: str
    files: tuple[FileEntry, ...] = field(repr=False)

    def table_files(self, name: str) -> list[FileEntry]:
        """Return the files of the table `name` (or of ``arrays``), sorted by path."""
        return [entry for entry in self.files if entry.table == name]

    def file(self, table: str, shard: str) -> FileEntry | None:
        """Return the file of `table` in `shard`, if there is one."""
        for entry in self.files:
            if entry.shard == shard and entry.table == table:
                return entry
        return None

    def to_json(self) -> bytes:
        """Return the document: stable, sorted, fit for ``diff``."""
        document = asdict(self) | {"tools": dict(self.tools)}
        return (json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode()

    @classmethod
    def from_json(cls, data: bytes, source: str) -> Snapshot:
        """Read a document.

        Parameters
        ----------
        data : bytes
            What `to_json` wrote.
        source : str
            Where it is from, for messages.

        Raises
        ------
        LakeFormatError
            If it is of a higher schema version, or no snapshot at all.
        """
        try:
            document: dict[str, Any] = json.loads(data)
            version = int(document["schema_version"])
            if version > SCHEMA_VERSION:
                raise LakeFormatError(
                    f"{source} has schema version {version}, this breplake reads up to "
                    f"{SCHEMA_VERSION}: upgrade with pip install -U breplake"
                )
            files = tuple(sorted(FileEntry(**entry) for entry in document["files"]))
            return cls(**(document | {"files": files}))
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, LakeFormatError):
                raise
            raise LakeFormatError(f"{source} is not a snapshot: {error!r}") from error
