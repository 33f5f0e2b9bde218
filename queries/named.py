"""Named queries: the ``.sql`` files of ``queries/library``, which say in a header what they do.

A file begins with comments of this form, and then holds one SELECT statement::

    -- Title in a few words
    -- Topic: features
    --
    -- What it answers, in sentences.
    --
    -- Parameters:
    --   min_radius DOUBLE = 0 (mm): least radius
    --   model VARCHAR: without a default it must be given
    -- Columns:
    --   name: the model
    --   radius (mm): of the fillet;
    --     longer texts go on further in

A parameter is a ``$name`` of the statement; its type and default come from the header.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any, Final

from breplake.errors import NameNotFoundError, UsageError
from breplake.queries.names import did_you_mean

__all__ = ["TOPICS", "NamedQuery", "OutputColumn", "Parameter", "named_queries", "named_query"]

TOPICS: Final = {
    "statistics": "Statistics",
    "features": "Features and shapes",
    "structure": "Structure",
    "quality": "Quality",
    "records": "Records",
}
"""Topics of the library in their order, with their titles."""

_TYPES: Final = {"BIGINT": int, "DOUBLE": float, "BOOLEAN": bool, "VARCHAR": str}
_WORDS: Final = {"BIGINT": "whole number", "DOUBLE": "number", "BOOLEAN": "true or false"}
_BOOLEANS: Final = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}

_PARAMETER: Final = re.compile(
    r"(?P<name>\w+) (?P<type>[A-Z]+)(?: = (?P<default>\S+|'[^']*'))?(?: \((?P<unit>[^)]+)\))?"
    r": (?P<meaning>.+)"
)
_COLUMN: Final = re.compile(r"(?P<name>\w+)(?: \((?P<unit>[^)]+)\))?: (?P<meaning>.+)")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of a named query.

    Parameters
    ----------
    name : str
        As in ``$name``.
    type : str
        ``BIGINT``, ``DOUBLE``, ``BOOLEAN`` or ``VARCHAR``.
    default : object
        Its value if none is given; None is NULL.
    required : bool
        There is no default.
    unit : str
        Unit, or empty.
    meaning : str
        What it does.
    """

    name: str
    type: str
    default: Any
    required: bool
    unit: str
    meaning: str

    @property
    def default_text(self) -> str:
        """The default as SQL writes it."""
        if self.default is None:
            return "NULL"
        if isinstance(self.default, str):
            return f"'{self.default}'"
        return str(self.default).lower() if isinstance(self.default, bool) else f"{self.default:g}"

    def value(self, given: Any) -> Any:
        """Return a given value as this parameter's type; text is read, NULL and None are None.

        Raises
        ------
        UsageError
            If it is no value of that type.
        """
        kind = _TYPES[self.type]
        if given is None or (isinstance(given, str) and given.strip().upper() == "NULL"):
            return None
        if isinstance(given, str) and kind is not str:
            found = self._read(given.strip())
        elif kind is float and isinstance(given, int) and not isinstance(given, bool):
            found = float(given)
        else:
            found = given
        if type(found) is not kind:
            wanted = _WORDS.get(self.type, "text")
            raise UsageError(f"parameter {self.name} is a {wanted}, got {given!r}: {self.meaning}")
        return found

    def _read(self, text: str) -> Any:
        """Return the value that `text` stands for, or `text` itself if it stands for none."""
        if self.type == "BOOLEAN":
            return _BOOLEANS.get(text.lower(), text)
        try:
            return _TYPES[self.type](text)
        except ValueError:
            return text


@dataclass(frozen=True, slots=True)
class OutputColumn:
    """A column of a named query's answer.

    Parameters
    ----------
    name : str
        Its name.
    unit : str
        Its unit, or empty.
    meaning : str
        What it holds.
    """

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class NamedQuery:
    """A query of the library.

    Parameters
    ----------
    name : str
        Name of its file without ``.sql``.
    title : str
        What it is in a few words.
    topic : str
        One of `TOPICS`.
    description : str
        What it answers; paragraphs are parted by an empty line.
    parameters : tuple of Parameter
        What can be set.
    columns : tuple of OutputColumn
        What comes out.
    sql : str
        The whole file.
    """

    name: str
    title: str
    topic: str
    description: str
    parameters: tuple[Parameter, ...]
    columns: tuple[OutputColumn, ...]
    sql: str

    def bind(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return a typed value for each parameter, the defaults filled in.

        Parameters
        ----------
        given : mapping
            Values by name: Python values, or text as typed on a command line.

        Returns
        -------
        dict
            ``duckdb.Value`` by name, so that the statement sees the header's types.

        Raises
        ------
        NameNotFoundError
            If there is no such parameter; the message names the nearest.
        UsageError
            If a value is not of its parameter's type, or a required one is missing.
        """
        import duckdb

        known = {parameter.name: parameter for parameter in self.parameters}
        for name in given:
            if name not in known:
                near = did_you_mean(name, list(known))
                raise NameNotFoundError(
                    f"query {self.name} has no parameter {name!r}{near}; "
                    f"parameters are {', '.join(known) or 'none'}"
                )
        bound = {}
        for name, parameter in known.items():
            if parameter.required and given.get(name) is None:
                raise UsageError(f"query {self.name} needs {name}: {parameter.meaning}")
            value = parameter.value(given.get(name, parameter.default))
            bound[name] = duckdb.Value(value, getattr(duckdb.sqltypes, parameter.type))
        return bound


def named_queries() -> list[NamedQuery]:
    """Return all queries of the library, by topic and name."""
    order = list(TOPICS)
    return sorted(map(named_query, _names()), key=lambda q: (order.index(q.topic), q.name))


@lru_cache
def named_query(name: str) -> NamedQuery:
    """Return a query of the library.

    Raises
    ------
    NameNotFoundError
        If there is none of that name; the message names the nearest.
    UsageError
        If the header of its file breaks the rules of this module.
    """
    if name not in _names():
        near = did_you_mean(name, _names())
        raise NameNotFoundError(
            f"there is no query {name!r}{near}; breplake query --list shows all"
        )
    text = resources.files("breplake.queries").joinpath("library", f"{name}.sql").read_text()
    return parse(name, text)


def parse(name: str, text: str) -> NamedQuery:
    """Read the header of a query.

    Raises
    ------
    UsageError
        If it breaks the rules of this module; the message has the line.
    """
    lines: list[str] = []
    for line in text.splitlines():
        if not line.startswith("--"):
            break
        lines.append(line[2:].removeprefix(" ").rstrip())
    sections = _sections(name, lines)
    prose = sections["prose"]
    topic = prose[1].removeprefix("Topic: ") if len(prose) > 1 else ""
    if topic not in TOPICS or not prose[0]:
        raise UsageError(f"{name}.sql: begin with a title and '-- Topic: {'|'.join(TOPICS)}'")
    return NamedQuery(
        name=name,
        title=prose[0],
        topic=topic,
        description=_paragraphs(prose[2:]),
        parameters=tuple(_parameter(name, line) for line in sections["Parameters:"]),
        columns=tuple(_column(name, line) for line in sections["Columns:"]),
        sql=text,
    )


def _sections(name: str, lines: list[str]) -> dict[str, list[str]]:
    """Return prose and entries of a header, lines that are indented further joined."""
    found: dict[str, list[str]] = {"prose": [], "Parameters:": [], "Columns:": []}
    section = "prose"
    for line in lines:
        if line in found:
            section = line
        elif section == "prose":
            found[section].append(line)
        elif line.startswith("    ") and found[section]:
            found[section][-1] += " " + line.strip()
        elif line.startswith("  "):
            found[section].append(line.strip())
        elif line:
            raise UsageError(f"{name}.sql: {line!r} is no entry of {section}")
    return found


def _paragraphs(lines: list[str]) -> str:
    text = "\n".join(lines).strip()
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def _parameter(query: str, line: str) -> Parameter:
    match = _PARAMETER.fullmatch(line)
    if match is None or match["type"] not in _TYPES:
        raise UsageError(f"{query}.sql: {line!r} is not 'name TYPE = default (unit): meaning'")
    raw = match["default"]
    entry = Parameter(
        match["name"], match["type"], None, raw is None, match["unit"] or "", match["meaning"]
    )
    if raw is None:
        return entry
    default = None if raw == "NULL" else entry.value(raw.strip("'"))
    return Parameter(entry.name, entry.type, default, False, entry.unit, entry.meaning)


def _column(query: str, line: str) -> OutputColumn:
    match = _COLUMN.fullmatch(line)
    if match is None:
        raise UsageError(f"{query}.sql: {line!r} is not 'name (unit): meaning'")
    return OutputColumn(match["name"], match["unit"] or "", match["meaning"])


@lru_cache
def _names() -> tuple[str, ...]:
    folder = resources.files("breplake.queries").joinpath("library")
    return tuple(
        sorted(
            entry.name.removesuffix(".sql")
            for entry in folder.iterdir()
            if entry.name.endswith(".sql")
        )
    )
