"""Lists as sources: a CSV or Parquet file whose rows say where the CAD files are."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final
from urllib.parse import unquote, urlsplit
from urllib.request import url2pathname

import pyarrow as pa
import pyarrow.parquet as pq

from breplake.errors import InputError, UsageError
from breplake.ingest.failure import Failure, advise
from breplake.ingest.inputs import FORMATS, Input, cad_format, model_name, read_input
from breplake.ingest.printable import printable
from breplake.ingest.sources.downloads import SCHEMES, Downloads
from breplake.ingest.sources.facts import Facts
from breplake.ingest.sources.origin import UriOrigin
from breplake.ingest.sources.web import public_address
from breplake.schema.identity import model_id

__all__ = ["LISTS", "Row", "list_inputs", "read_list"]

LISTS: Final = (".csv", ".parquet")
"""Endings of lists, in lower case."""

_ADDRESS: Final = ("uri", "url", "path")
_LICENCE: Final = ("licence", "license")
_KNOWN: Final = frozenset(
    {*_ADDRESS, *_LICENCE, "name", "collection", "format", "owner", "source_url", "sha256"}
)
"""Columns with a meaning; all others become metadata."""

_SHA256: Final = re.compile(r"[0-9a-f]{64}")
_AT_ONCE: Final = 16
"""Addresses that are looked up at the same time."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a list.

    Parameters
    ----------
    number : int
        Counted from 1; the header of a CSV file does not count.
    values : dict
        Its cells that are not empty, by column.
    problem : str, optional
        What is wrong with the row as a whole.
    """

    number: int
    values: dict[str, str]
    problem: str | None = None

    @property
    def address(self) -> str:
        """Where the CAD file is; empty if the row does not say."""
        return next((self.values[name] for name in _ADDRESS if name in self.values), "")

    @property
    def facts(self) -> Facts:
        """What the row says of the model."""
        licence = next((self.values[name] for name in _LICENCE if name in self.values), None)
        more = tuple((k, v) for k, v in self.values.items() if k not in _KNOWN)
        return Facts(licence, self.values.get("owner"), self.values.get("source_url"), more)


def read_list(path: Path) -> Iterator[Row]:
    """Yield the rows of a list.

    Raises
    ------
    UsageError
        If it cannot be parsed, or has no column that says where the files are.
    """
    try:
        rows = _read_parquet(path) if path.suffix.lower() == ".parquet" else _read_csv(path)
        yield from rows
    except (csv.Error, UnicodeDecodeError, pa.ArrowInvalid) as error:
        raise UsageError(f"the list {path} cannot be read: {error}") from error


def _check_columns(path: Path, columns: Iterable[str]) -> None:
    if not set(_ADDRESS) & set(columns):
        raise UsageError(
            f"the list {path} has no column {', '.join(_ADDRESS)}: one of them must say where the "
            f"CAD files are; it has {', '.join(columns) or 'no columns'}"
        )


def _read_csv(path: Path) -> Iterator[Row]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file, restkey="", restval=None, strict=True)
        _check_columns(path, reader.fieldnames or ())
        for number, cells in enumerate(reader, 1):
            surplus = cells.pop("", None)
            values = {name.strip(): cell.strip() for name, cell in cells.items() if cell}
            values = {name: cell for name, cell in values.items() if cell}
            yield Row(number, values, "it has more cells than the header" if surplus else None)


def _read_parquet(path: Path) -> Iterator[Row]:
    with pq.ParquetFile(path) as file:
        _check_columns(path, file.schema_arrow.names)
        number = 0
        for batch in file.iter_batches():
            for cells in batch.to_pylist():
                number += 1
                values = {name: _text(cell) for name, cell in cells.items() if cell is not None}
                yield Row(number, {name: text for name, text in values.items() if text})


def _text(cell: Any) -> str:
    return cell.isoformat() if hasattr(cell, "isoformat") else str(cell).strip()


def list_inputs(
    path: Path,
    rows: Iterable[Row],
    collection: str | None,
    downloads: Callable[[], Downloads],
    whole: set[int],
) -> list[Input]:
    """Return the CAD files of a list as inputs, in the order of its rows.

    Every row gives one input. A row that cannot be used, and an address that cannot be fetched,
    is an input that failed.

    Parameters
    ----------
    path : Path
        The list; relative paths in it count from its folder.
    rows : iterable of Row
        Of the list, without those of Onshape documents.
    collection : str, optional
        Collection of rows that name none; by default the name of the list.
    downloads : callable
        Gives what fetches addresses; only called if there are some.
    whole : set of int
        Takes the ids that rows have as inputs where they cannot be used, of those that can.
    """
    names = _Names(path, printable(collection or path.stem or "list"), whole)
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        return list(pool.map(lambda row: _input(path, row, names, downloads), names.given(rows)))


class _Names:
    """Gives every row its collection and name."""

    def __init__(self, path: Path, collection: str, whole: set[int]) -> None:
        self._path, self._collection, self._whole = path, collection, whole
        self._used: dict[tuple[str, str], int] = {}
        self.of: dict[int, tuple[str, str]] = {}

    def given(self, rows: Iterable[Row]) -> Iterator[Row]:
        """Yield the rows, whose names then are in `of`; one that has a name again is faulty."""
        for row in rows:
            group = printable(row.values.get("collection") or self._collection)
            name = printable(row.values.get("name") or _name(row.address))
            problem = row.problem or _problem(row)
            if "/" in group:
                problem = problem or f"its collection {group!r} holds a slash"
                group = self._collection
            first = self._used.get((group, name))
            if first is not None:
                problem = problem or f"it is model {group}/{name}, as row {first} is"
            faulty = printable(f"{self._path.name}, row {row.number}")
            if problem:
                name = faulty
            else:
                self._whole.add(model_id(group, faulty))
            self._used[group, name] = row.number
            self.of[row.number] = group, name
            yield replace(row, problem=problem)


def _name(address: str) -> str:
    parts = urlsplit(address)
    place = unquote(parts.path) if parts.scheme in (*SCHEMES, "file") else address
    kept = [part for part in PurePosixPath(place).parts if part not in ("/", ".", "..")]
    return model_name(PurePosixPath(*kept)) if kept else ""


def _problem(row: Row) -> str | None:
    """Return why a row cannot be used; None if it can."""
    address = row.address
    if not address:
        return f"it has no {' or '.join(_ADDRESS)}"
    parts = urlsplit(address)
    scheme = parts.scheme if "://" in address else ""
    if scheme and scheme not in (*SCHEMES, "file"):
        return f"addresses {scheme}:// are not known, only {', '.join((*SCHEMES, 'file'))}"
    if "@" in parts.netloc:
        return "its address holds a user or password, which have no place in a list"
    if _format(row) is None:
        known = ", ".join(FORMATS)
        return f"{public_address(address)} does not end in {known}, and it has no column format"
    sha256 = row.values.get("sha256")
    if sha256 is not None and not _SHA256.fullmatch(sha256.lower()):
        return "its sha256 is not 64 hexadecimal digits"
    return None


def _format(row: Row) -> str | None:
    given = row.values.get("format")
    if given is not None:
        return given.lower() if given.lower() in FORMATS.values() else None
    parts = urlsplit(row.address)
    return cad_format(parts.path if parts.scheme in (*SCHEMES, "file") else row.address)


def _input(path: Path, row: Row, names: _Names, downloads: Callable[[], Downloads]) -> Input:
    group, name = names.of[row.number]
    shown = public_address(row.address) if "://" in row.address else row.address
    if row.problem is not None:
        message = advise("bad-row", f"{path}, row {row.number}: {row.problem}")
        failure = Failure("plan", "bad-row", message, fatal=True)
        return Input(path, group, name, "list", failure=failure, shown=shown)
    kind = _format(row) or "step"
    scheme = urlsplit(row.address).scheme if "://" in row.address else ""
    if scheme in SCHEMES:
        return _remote(path, row, shown, names, downloads())
    return _local(path, row, group, name, kind)


def _local(path: Path, row: Row, group: str, name: str, kind: str) -> Input:
    place = row.address
    if place.startswith("file://"):
        place = url2pathname(urlsplit(place).path)
    item = read_input(path.parent / place, group, name)
    item = replace(item, format=kind, facts=row.facts)
    wanted = row.values.get("sha256", "").lower()
    if wanted and item.sha256 is not None and item.sha256 != wanted:
        detail = f"it has {item.sha256[:12]}…, row {row.number} says {wanted[:12]}…"
        message = advise("hash-mismatch", detail)
        return replace(item, failure=Failure("plan", "hash-mismatch", message, fatal=True))
    return item


def _remote(path: Path, row: Row, shown: str, names: _Names, downloads: Downloads) -> Input:
    group, name = names.of[row.number]
    uri = row.address
    facts = row.facts.over(Facts(source_url=shown))
    sha256, size, failure = row.values.get("sha256", "").lower() or None, None, None
    if sha256 is None:
        try:
            download = downloads.find_out(uri)
            sha256, size = download.sha256, download.bytes
            if not size:
                failure = Failure("plan", "empty-file", advise("empty-file", ""), fatal=True)
        except InputError as error:
            failure = Failure("fetch", error.kind, str(error), fatal=True)
    return Input(
        path,
        group,
        name,
        _format(row) or "step",
        size,
        sha256,
        failure,
        shown=shown,
        origin=UriOrigin(uri),
        facts=facts,
    )
