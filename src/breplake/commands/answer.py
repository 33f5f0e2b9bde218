"""How the answer to a query is printed or written to a file."""

from __future__ import annotations

import csv
import json
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date, datetime, time
from decimal import Decimal
from enum import StrEnum
from itertools import islice
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any

import typer

from breplake.commands.options import console, shown
from breplake.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

    import duckdb

__all__ = ["Format", "FormatOption", "OutputOption", "RowsOption", "answer", "replaced"]


class Format(StrEnum):
    """How an answer is written."""

    table = "table"
    csv = "csv"
    json = "json"
    parquet = "parquet"


FormatOption = Annotated[
    Format | None,
    typer.Option("--format", "-f", help="Default: by the ending of FILE, else table."),
]
"""``--format``."""

OutputOption = Annotated[
    Path | None, typer.Option("--output", "-o", help="Write to FILE.", metavar="FILE")
]
"""``--output``."""

RowsOption = Annotated[
    int, typer.Option("--rows", min=1, help="Rows that a table on the terminal shows.")
]
"""``--rows``."""


_EXACT = 2**53
"""Whole numbers up to here are exact as doubles."""


def answer(
    ask: Callable[[], duckdb.DuckDBPyRelation],
    chosen: Format | None,
    output: Path | None,
    rows: int,
) -> None:
    """Ask, and print the answer or write it to a file.

    Parameters
    ----------
    ask : callable
        Returns what is to be written; not called if it could not be written.
    chosen : Format, optional
        How; by the ending of `output` if not given.
    output : pathlib.Path, optional
        File that is replaced when the answer is complete; None is stdout.
    rows : int
        Rows that a table on the terminal shows.

    Raises
    ------
    UsageError
        If the query is wrong or the file cannot be written.
    """
    import duckdb

    chosen = chosen or _format_of(output)
    if chosen is Format.parquet and output is None and sys.stdout.isatty():
        raise UsageError("Parquet is not for a terminal: name a file with -o FILE")
    try:
        relation = ask()
        if chosen in (Format.json, Format.parquet):
            _require_distinct(relation.columns, chosen)
        if output is None:
            _write(relation, chosen, sys.stdout, rows)
        else:
            with replaced(output) as stream:
                _write(relation, chosen, stream, None)
    except duckdb.Error as error:
        raise UsageError(str(error)) from error


def _require_distinct(names: list[str], chosen: Format) -> None:
    """Refuse columns of one name where they are known by it."""
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise UsageError(
            f"several columns are called {twice[0]!r}, and {chosen} has one of each name: "
            "give them other names with AS"
        )


def _format_of(output: Path | None) -> Format:
    """Return the format that a file's ending stands for."""
    if output is None:
        return Format.table
    ending = output.suffix.lstrip(".").lower()
    if ending in ("txt", ""):
        return Format.table
    if ending not in set(Format):
        raise UsageError(f"cannot tell the format of {output}: say it with --format")
    return Format(ending)


@contextmanager
def replaced(path: Path) -> Iterator[IO[str]]:
    """Open a file that takes the place of `path` only when it is complete."""
    if path.exists() and not path.is_file():  # a pipe or /dev/null must not be replaced
        with _opened(path) as stream:
            yield stream
        return
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with _opened(part) as stream:
            yield stream
        os.replace(part, path.resolve())
    finally:
        part.unlink(missing_ok=True)


def _opened(path: Path) -> IO[str]:
    try:
        return path.open("w", encoding="utf-8", newline="")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def _write(
    relation: duckdb.DuckDBPyRelation, chosen: Format, stream: IO[str], limit: int | None
) -> None:
    match chosen:
        case Format.table:
            _write_table(relation, stream, limit)
        case Format.csv:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(relation.columns)
            writer.writerows([_cell(v) for v in row] for row in relation.iter_rows())
        case Format.json:
            _write_json(relation, stream)
        case Format.parquet:
            _write_parquet(relation, stream.buffer)  # type: ignore[attr-defined]  # of a text file


def _write_table(relation: duckdb.DuckDBPyRelation, stream: IO[str], limit: int | None) -> None:
    """Print a table; into a file, all of it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD)
    for name, kind in zip(relation.columns, relation.types, strict=True):
        table.add_column(Text(shown(name)), justify="right" if _is_number(str(kind)) else "left")
    rows = relation.iter_rows()
    for row in islice(rows, limit):
        table.add_row(*(Text(shown(value), overflow="fold") for value in row))
    target = console() if limit is not None else Console(file=stream, width=console().width)
    target.print(table)
    if limit is not None and next(rows, None) is not None:
        console(error=True).print(
            f"These are the first {limit:,} rows; for all of them: "
            "--rows N, --format csv or -o FILE"
        )


def _is_number(kind: str) -> bool:
    return (
        kind.startswith(("DECIMAL", "FLOAT", "DOUBLE")) or kind.endswith("INT") or kind == "INTEGER"
    )


def _write_json(relation: duckdb.DuckDBPyRelation, stream: IO[str]) -> None:
    """Write an array of objects, one on each line; 64-bit ids are text."""
    names = relation.columns
    opening = "[\n"
    for row in relation.iter_rows():
        line = json.dumps(dict(zip(names, map(_plain, row), strict=True)), ensure_ascii=False)
        stream.write(opening + line)
        opening = ",\n"
    stream.write("[]\n" if opening == "[\n" else "\n]\n")


def _write_parquet(relation: duckdb.DuckDBPyRelation, stream: IO[bytes]) -> None:
    import pyarrow.parquet as pq

    reader = relation.to_arrow_reader()
    with pq.ParquetWriter(stream, reader.schema, compression="zstd") as writer:
        for batch in reader:
            writer.write_batch(batch)


def _cell(value: Any) -> Any:
    """Return a value as a CSV cell: nested ones as JSON, truth as SQL writes it."""
    if isinstance(value, dict | list | tuple):
        return json.dumps(_plain(value), ensure_ascii=False)
    if isinstance(value, bool):
        return "true" if value else "false"
    return value


def _plain(value: Any) -> Any:
    """Return a value as JSON can hold it.

    Numbers that are not finite are null; whole ones that readers who have nothing but doubles
    would round are text.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Decimal):
        if value != value.to_integral_value():
            return float(value)
        value = int(value)
    if isinstance(value, int) and abs(value) > _EXACT:
        return str(value)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    return value.hex() if isinstance(value, bytes) else str(value)
