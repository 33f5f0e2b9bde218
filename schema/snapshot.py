"""A snapshot: the exact files of a lake after one commit, as an immutable document.

The document is JSON, compact because a lake of a million models has 30,000 files, and laid out
in lines: first what the commit says of itself, then one line for each shard, so that
``head -1``, ``grep`` and ``diff`` are of use::

    {"snapshot":{"number":42,"parent":41,"message":"...",...,"models":2,"files":11,"bytes":81520},
    "columns":["rows","bytes","sha256","min_model_id","max_model_id"],
    "shards":{
    "4a5b":{"arrays":[16,9120,"0f3c...",17,29],"models":[2,5120,"77ab...",17,29],...}
    },
    "contracts":{
    "dab8298fa09be326":["4a5b",...]
    }}

The last part is there where shards differ in the contract of their tables. Readers that know
nothing of it ignore it, as everything at this level but what they look for.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Final, NamedTuple

from breplake.errors import LakeFormatError
from breplake.schema.tables import SCHEMA_VERSION

__all__ = ["ARRAYS_TABLE", "FileEntry", "Header", "Snapshot", "read_header"]

ARRAYS_TABLE: Final = "arrays"
"""Value of `FileEntry.table` for a folder of arrays."""

_COLUMNS: Final = ["rows", "bytes", "sha256", "min_model_id", "max_model_id"]


class FileEntry(NamedTuple):
    """A write-once file (or folder of arrays) that a snapshot names.

    Parameters
    ----------
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

    table: str
    shard: str
    rows: int
    bytes: int
    sha256: str
    min_model_id: int | None
    max_model_id: int | None

    @property
    def path(self) -> str:
        """Relative POSIX path: ``tables/<table>/<shard>.parquet`` or ``arrays/<shard>.zarr``."""
        if self.table == ARRAYS_TABLE:
            return f"arrays/{self.shard}.zarr"
        return f"tables/{self.table}/{self.shard}.parquet"


@dataclass(frozen=True, slots=True)
class Header:
    """What a snapshot says of itself, without its list of files.

    Parameters
    ----------
    number, parent, message, time, schema_version, tools, config_hash
        As in `Snapshot`.
    contract : str
        As in `Snapshot`.
    models, files, bytes : int
        Rows of ``models``, number of files (a folder of arrays is one), size of all files.
    """

    number: int
    parent: int | None
    message: str
    time: str
    schema_version: int
    tools: Mapping[str, str]
    config_hash: str
    models: int
    files: int
    bytes: int
    contract: str = ""


@dataclass(frozen=True)
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
        All files of the snapshot, sorted.
    contract : str
        Hash of the tables' columns (`breplake.schema.older`) that every file has; empty if files
        differ, as those do that were written before a column was added.
    contracts : mapping
        Where files differ: the contract of each shard by its name, as far as it is known.
    """

    number: int
    parent: int | None
    message: str
    time: str
    schema_version: int
    tools: Mapping[str, str]
    config_hash: str
    files: tuple[FileEntry, ...] = field(repr=False)
    contract: str = ""
    contracts: Mapping[str, str] = field(default_factory=dict, repr=False)

    @cached_property
    def _by_table(self) -> dict[str, dict[str, FileEntry]]:
        """The files by table and shard; both are looked up for every shard that is read."""
        found: dict[str, dict[str, FileEntry]] = {}
        for entry in self.files:
            found.setdefault(entry.table, {})[entry.shard] = entry
        return found

    def table_files(self, name: str) -> list[FileEntry]:
        """Return the files of the table `name` (or of ``arrays``), sorted by shard."""
        return list(self._by_table.get(name, {}).values())

    def file(self, table: str, shard: str) -> FileEntry | None:
        """Return the file of `table` in `shard`, if there is one."""
        return self._by_table.get(table, {}).get(shard)

    def contract_of(self, shard: str) -> str:
        """Return by which contract the files of a shard were written; empty if not known."""
        return self.contract or self.contracts.get(shard, "")

    @property
    def header(self) -> Header:
        """What the snapshot says of itself, with totals."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        del values["files"], values["contracts"]
        return Header(
            **values,
            models=sum(entry.rows for entry in self.table_files("models")),
            files=len(self.files),
            bytes=sum(entry.bytes for entry in self.files),
        )

    def to_json(self) -> bytes:
        """Return the document: stable, sorted, one line for each shard."""
        shards: dict[str, dict[str, Sequence[object]]] = {}
        for entry in self.files:
            shards.setdefault(entry.shard, {})[entry.table] = entry[2:]
        header = asdict(self.header) | {"tools": dict(sorted(self.tools.items()))}
        lines = ",\n".join(f"{_compact(name)}:{_compact(shards[name])}" for name in sorted(shards))
        head = f'{{"snapshot":{_compact(header)},\n"columns":{_compact(_COLUMNS)},\n"shards":{{'
        return f"{head}\n{lines}\n}}{self._contract_lines()}}}\n".encode()

    def _contract_lines(self) -> str:
        """Return what the document says of contracts; nothing where all shards are of one."""
        shards: dict[str, list[str]] = {}
        for shard, contract in sorted(self.contracts.items()):
            shards.setdefault(contract, []).append(shard)
        if not shards:
            return ""
        lines = ",\n".join(f"{_compact(name)}:{_compact(shards[name])}" for name in sorted(shards))
        return f',\n"contracts":{{\n{lines}\n}}'

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
            header: dict[str, Any] = document["snapshot"]
            version = int(header["schema_version"])
            if version > SCHEMA_VERSION:
                raise LakeFormatError(
                    f"{source} has schema version {version}, this breplake reads up to "
                    f"{SCHEMA_VERSION}: upgrade with pip install -U breplake"
                )
            if document["columns"] != _COLUMNS:
                raise ValueError(f"columns {document['columns']}")
            files = [
                FileEntry(table, shard, *values)
                for shard, tables in document["shards"].items()
                for table, values in tables.items()
            ]
            contracts = {
                shard: contract
                for contract, shards in document.get("contracts", {}).items()
                for shard in shards
            }
            totals = {name: header.pop(name) for name in ("models", "files", "bytes")}
            snapshot = cls(**header, files=tuple(sorted(files)), contracts=contracts)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            if isinstance(error, LakeFormatError):
                raise
            raise LakeFormatError(f"{source} is not a snapshot: {error!r}") from error
        if totals["files"] != len(files):
            raise LakeFormatError(f"{source} names {len(files)} files instead of {totals['files']}")
        return snapshot


def read_header(first_line: bytes, source: str) -> Header:
    """Read the first line of a snapshot's document.

    Parameters
    ----------
    first_line : bytes
        Of what `Snapshot.to_json` wrote.
    source : str
        Where it is from, for messages.

    Raises
    ------
    LakeFormatError
        If it is not that of a snapshot.
    """
    try:
        # the line ends with the comma before the next member
        document = json.loads(first_line.rstrip().removesuffix(b",") + b"}")
        return Header(**document["snapshot"])
    except (KeyError, TypeError, ValueError) as error:
        raise LakeFormatError(f"{source} is not a snapshot: {error!r}") from error


def _compact(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)
