"""What a finished file holds: size and hash, rows, and which models."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq

from breplake.errors import UsageError
from breplake.schema.contract import Table
from breplake.schema.ranges import LIST
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry
from breplake.schema.storage import Storage
from breplake.schema.tables import TABLES

__all__ = ["FileProblem", "checked_name", "compare", "describe", "list_name"]

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True, slots=True)
class FileProblem:
    """A file that is not what its snapshot says.

    Parameters
    ----------
    path : str
        Relative path of the file.
    kind : str
        ``missing``, ``size`` or ``sha256``.
    message : str
        What was expected and what is there.
    """

    path: str
    kind: str
    message: str


def checked_name(name: str, what: str) -> str:
    """Return `name` if it is fit to name a `what` (a shard, a tag).

    Raises
    ------
    UsageError
        If it is not.
    """
    if not _NAME.fullmatch(name) or len(name) > 200:
        raise UsageError(
            f"a {what} is named by letters, digits, '.', '_' and '-', at most 200, got {name!r}"
        )
    return name


def list_name(path: str) -> str:
    """Return the path of the list of a folder's files and hashes, which lies beside it.

    It lets one copy the folder from where files cannot be listed, and check them one by one
    (``cd arrays/s0.zarr && sha256sum --check ../s0.zarr.sha256``). Its own hash is the folder's.
    """
    return path + LIST


def compare(storage: Storage, entry: FileEntry) -> FileProblem | None:
    """Return what is wrong with the file that `entry` describes, or None."""
    is_folder = entry.table == ARRAYS_TABLE
    size = _folder_size(storage, entry.path) if is_folder else storage.size(entry.path)
    if size is None:
        return FileProblem(entry.path, "missing", "the file is not there")
    if size != entry.bytes:
        return FileProblem(entry.path, "size", f"{size} bytes instead of {entry.bytes}")
    digest = _digest(_folder_list(storage, entry.path)) if is_folder else storage.hash(entry.path)
    if digest != entry.sha256:
        return FileProblem(entry.path, "sha256", f"hash {digest} instead of {entry.sha256}")
    return None


def _folder_size(storage: Storage, path: str) -> int | None:
    sizes = [file.bytes for file in storage.files(path)]
    return sum(sizes) if sizes else None


def _folder_list(storage: Storage, path: str) -> bytes:
    """Return the lines of `list_name` of a folder."""
    names = sorted(file.path for file in storage.files(path))
    lines = (f"{storage.hash(name)}  {name.removeprefix(path)[1:]}\n" for name in names)
    return "".join(lines).encode()


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def describe(storage: Storage, path: str) -> FileEntry:
    """Describe a finished file of a local lake; beside a folder, write its list.

    Parameters
    ----------
    storage : Storage
        The lake.
    path : str
        ``tables/<table>/<shard>.parquet`` or ``arrays/<shard>.zarr``.

    Raises
    ------
    UsageError
        If the path is none of these, or the file breaks its table's contract.
    FileNotFoundError
        If there is no such file.
    """
    absolute = storage.path(path)
    match path.split("/"):
        case ["tables", table, file] if table in TABLES and file.endswith(".parquet"):
            shard = checked_name(file.removesuffix(".parquet"), "shard")
            rows, ids = _describe_table(absolute, TABLES[table])
            size, digest = absolute.stat().st_size, storage.hash(path)
        case ["arrays", folder] if folder.endswith(".zarr"):
            table, shard = ARRAYS_TABLE, checked_name(folder.removesuffix(".zarr"), "shard")
            models = FileEntry("models", shard, 0, 0, "", None, None)
            _, ids = _describe_table(storage.path(models.path), TABLES["models"])
            rows = _describe_arrays(absolute)
            lines = _folder_list(storage, path)
            size, digest = _folder_size(storage, path) or 0, _digest(lines)
            storage.overwrite(list_name(path), lines)
        case _:
            raise UsageError(
                f"{path} is neither tables/<table>/<shard>.parquet nor arrays/<shard>.zarr"
            )
    return FileEntry(table, shard, rows, size, digest, *ids)


def _describe_table(path: Path, table: Table) -> tuple[int, tuple[int | None, int | None]]:
    """Return rows and range of ``model_id`` of a Parquet file, from its footer."""
    metadata = pq.read_metadata(path)
    schema = metadata.schema.to_arrow_schema()
    if not schema.equals(table.schema):
        wrong = sorted(set(map(str, schema)) ^ set(map(str, table.schema))) or "order of columns"
        raise UsageError(f"{path} breaks the contract of table {table.name}: {wrong}")
    column = schema.get_field_index("model_id")
    low: list[int] = []
    high: list[int] = []
    for group in range(metadata.num_row_groups):
        part = metadata.row_group(group)
        if part.num_rows == 0:
            continue
        statistics = part.column(column).statistics
        if statistics is None or not statistics.has_min_max:
            raise UsageError(f"{path} lacks statistics of model_id: write it with statistics")
        low.append(statistics.min)
        high.append(statistics.max)
    return metadata.num_rows, (min(low, default=None), max(high, default=None))


def _describe_arrays(path: Path) -> int:
    """Return the rows of ``position`` in a folder of arrays."""
    return int(json.loads((path / "position" / "zarr.json").read_text())["shape"][0])
