"""What a finished file holds: size and hash, rows, and which models."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq

from breplake.errors import CommitConflictError, UsageError
from breplake.schema.contract import Table
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry
from breplake.schema.storage import file_hash, folder_files, folder_hash

__all__ = [
    "FileProblem",
    "check_models",
    "compare",
    "describe_arrays",
    "describe_table",
    "measure",
]


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


def measure(path: Path) -> tuple[int, str]:
    """Return size in bytes and SHA-256 of a file, or of a folder with all its files."""
    if path.is_dir():
        return sum((path / name).stat().st_size for name in folder_files(path)), folder_hash(path)
    return path.stat().st_size, file_hash(path)


def compare(root: Path, entry: FileEntry) -> FileProblem | None:
    """Return what is wrong with the file that `entry` describes, or None."""
    path = root / entry.path
    if not (path.is_dir() if entry.table == ARRAYS_TABLE else path.is_file()):
        return FileProblem(entry.path, "missing", "the file is not there")
    size, digest = measure(path)
    if size != entry.bytes:
        return FileProblem(entry.path, "size", f"{size} bytes instead of {entry.bytes}")
    if digest != entry.sha256:
        return FileProblem(entry.path, "sha256", f"hash {digest} instead of {entry.sha256}")
    return None


def describe_table(path: Path, table: Table) -> tuple[int, tuple[int | None, int | None]]:
    """Return rows and range of ``model_id`` of a Parquet file, from its footer.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    UsageError
        If its columns are not those of `table`, or the footer lacks statistics.
    """
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


def describe_arrays(path: Path) -> int:
    """Return the rows of ``position`` in a folder of arrays.

    Raises
    ------
    FileNotFoundError
        If the folder or its array ``position`` is not there.
    """
    return int(json.loads((path / "position" / "zarr.json").read_text())["shape"][0])


def check_models(root: Path, new: Sequence[FileEntry], old: Sequence[FileEntry]) -> None:
    """Check that no model of the files `new` is among those of `old`, or twice in `new`.

    A model is in a lake when it has a row in ``models`` or a fatal one in ``failures``.

    Raises
    ------
    CommitConflictError
        If one is: the same model was added twice, or two names share an id.
    """
    seen: dict[int, tuple[str, str]] = {}
    for identity, name, path in _identities(root, new):
        if identity in seen:
            _refuse(identity, seen[identity], (name, path))
        seen[identity] = (name, path)
    if not seen:
        return
    near = [e for e in old if _overlaps(e, min(seen), max(seen))]
    for identity, name, path in _identities(root, near):
        if identity in seen:
            _refuse(identity, seen[identity], (name, path))


def _identities(root: Path, files: Sequence[FileEntry]) -> Iterator[tuple[int, str, str]]:
    """Yield (model_id, collection/name, path) of every model in `files`."""
    names = ["model_id", "collection", "name"]
    for entry in files:
        if entry.table not in ("models", "failures"):
            continue
        fatal = ["fatal"] if entry.table == "failures" else []
        with pq.ParquetFile(root / entry.path) as file:
            rows = file.read(columns=names + fatal)
        if fatal:
            rows = rows.filter(rows.column("fatal"))
        columns = (rows.column(name).to_pylist() for name in names)
        for identity, collection, name in zip(*columns, strict=True):
            yield identity, f"{collection}/{name}", entry.path


def _overlaps(entry: FileEntry, low: int, high: int) -> bool:
    if entry.min_model_id is None or entry.max_model_id is None:
        return False
    return entry.min_model_id <= high and low <= entry.max_model_id


def _refuse(identity: int, first: tuple[str, str], second: tuple[str, str]) -> None:
    if first[0] == second[0]:
        raise CommitConflictError(
            f"model {first[0]} is in both {first[1]} and {second[1]}: a model is added once, "
            "replace its file to add it anew"
        )
    raise CommitConflictError(
        f"models {first[0]} and {second[0]} share the id {identity}: rename one of them"
    )
