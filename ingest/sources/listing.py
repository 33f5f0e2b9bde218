"""Lists as sources: a CSV or Parquet file whose rows say where the CAD files are."""

from __future__ import annotations

import csv
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final
from urllib.parse import unquote, urlsplit
from urllib.request import url2pathname

import pyarrow as pa
import pyarrow.parquet as pq

from breplake.errors import InputError, UsageError
from breplake.ingest.failure import Failure, advise
from breplake.ingest.hashing import Hasher
from breplake.ingest.inputs import FORMATS, Input, cad_format, model_name, read_input
from breplake.ingest.printable import printable
from breplake.ingest.sources.downloads import SCHEMES, Downloads
from breplake.ingest.sources.facts import Facts
from breplake.ingest.sources.origin import UriOrigin
from breplake.ingest.sources.web import public_address
from breplake.schema.identity import model_id

__all__ = ["LISTS", "Row", "Taken", "list_inputs", "read_list"]

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


@dataclass(frozen=True, slots=True)
class _Claim:
    """A row that took a name first.

    Parameters
    ----------
    list : Path
        Its list.
    number : int
        Its place there.
    address : str
        Where its file is: the full address, with its query, or the full path.
    sha256 : str
        What the row says of its bytes; empty if it does not say.
    """

    list: Path
    number: int
    address: str
    sha256: str

    def agrees(self, other: _Claim) -> bool:
        """Whether another row, of another list, asks for the same file."""
        if self.list == other.list and self.number != other.number:
            return False
        return self.address == other.address and (
            self.sha256 == other.sha256 or not self.sha256 or not other.sha256
        )


Taken = dict[tuple[str, str], _Claim]
"""The rows of all lists that have a model's collection and name."""


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
    except (csv.Error, UnicodeDecodeError, pa.ArrowInvalid, OSError) as error:
        raise UsageError(f"the list {path} cannot be read: {error}") from error


def _check_columns(path: Path, columns: Sequence[str]) -> None:
    if not set(_ADDRESS) & set(columns):
        raise UsageError(
            f"the list {path} has no column {', '.join(_ADDRESS)}: one of them must say where the "
            f"CAD files are; it has {', '.join(columns) or 'no columns'}"
        )
    again = sorted({name for name in columns if name and columns.count(name) > 1})
    if again:
        raise UsageError(
            f"the list {path} has more than one column {', '.join(again)}: rename or remove all "
            "but one, since a row would lose a cell"
        )


def _read_csv(path: Path) -> Iterator[Row]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file, strict=True)
        names = [name.strip() for name in next(reader, ())]
        _check_columns(path, names)
        for number, cells in enumerate((cells for cells in reader if cells), 1):
            pairs = zip(names, map(str.strip, cells), strict=False)  # the last cells may lack
            surplus = len(cells) > len(names)
            values = {name: cell for name, cell in pairs if name and cell}
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
    taken: Taken,
    hasher: Hasher,
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
    taken : Taken
        Of the lists before this one; those of this one are added.
    hasher : Hasher
        Reads the files that are here.
    """
    names = _Names(path, printable(collection or path.stem or "list"), whole, taken)

    def look_up(row: Row) -> Input:
        return _input(path, row, names, downloads, hasher)

    return hasher.over(list(names.given(rows)), look_up, f"reading {path}", _AT_ONCE)


class _Names:
    """Gives every row its collection and name."""

    def __init__(self, path: Path, collection: str, whole: set[int], taken: Taken) -> None:
        self._path, self._collection, self._whole = path, collection, whole
        self._taken = taken
        self._real = Path(os.path.realpath(path))
        # Lists in several folders often have one name, and each has its own row 3.
        self._mark = hashlib.sha256(os.fsencode(self._real)).hexdigest()[:8]
        self.of: dict[int, tuple[str, str]] = {}

    def given(self, rows: Iterable[Row]) -> Iterator[Row]:
        """Yield the rows, whose names then are in `of`; one that has a name again is faulty."""
        for row in rows:
            group = printable(row.values.get("collection") or self._collection)
            problem = row.problem or _problem(row)
            name = "" if problem else printable(row.values.get("name") or _name(row.address))
            if "/" in group:
                problem = problem or f"its collection {group!r} holds a slash"
                group = self._collection
            problem = problem or self._clash(group, name, row)
            faulty = printable(f"{self._path.name} {self._mark}, row {row.number}")
            if problem:
                name = faulty
            else:
                self._whole.add(model_id(group, faulty))
            self.of[row.number] = group, name
            yield replace(row, problem=problem)

    def _clash(self, group: str, name: str, row: Row) -> str | None:
        """Take a name; return why it cannot be had."""
        address = row.address
        if not _is_remote(address):
            address = os.path.realpath(_local_path(self._path, address))
        sha256 = row.values.get("sha256", "").lower()
        claim = _Claim(self._real, row.number, address, sha256)
        first = self._taken.setdefault((group, name), claim)
        if first.agrees(claim):
            return None
        where = "" if first.list == self._real else f" of {printable(first.list)}"
        return f"it is model {group}/{name}, as row {first.number}{where} is"


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
    if "\0" in address:
        return "its address holds a zero byte"
    try:
        parts = urlsplit(address)
    except ValueError as error:
        return f"its address cannot be understood: {error}"
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


def _input(
    path: Path, row: Row, names: _Names, downloads: Callable[[], Downloads], hasher: Hasher
) -> Input:
    group, name = names.of[row.number]
    if row.problem is not None:
        message = advise("bad-row", f"{path}, row {row.number}: {row.problem}")
        failure = Failure("plan", "bad-row", message, fatal=True)
        return Input(path, group, name, "list", failure=failure, shown=_shown(row.address))
    shown = _shown(row.address)
    kind = _format(row) or "step"
    if _is_remote(row.address):
        return _remote(path, row, shown, names, downloads())
    return _local(path, row, group, name, kind, hasher)


def _shown(address: str) -> str:
    """Return what may be shown of an address; nothing if it cannot be told what of it is secret."""
    try:
        return printable(public_address(address) if "://" in address else address)
    except ValueError:
        return ""


def _is_remote(address: str) -> bool:
    return "://" in address and urlsplit(address).scheme in SCHEMES


def _local_path(path: Path, address: str) -> Path:
    """Return the file of a row of the list at `path`."""
    is_address = address.startswith("file://")
    return path.parent / (url2pathname(urlsplit(address).path) if is_address else address)


def _local(path: Path, row: Row, group: str, name: str, kind: str, hasher: Hasher) -> Input:
    item = read_input(_local_path(path, row.address), group, name, hasher)
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
