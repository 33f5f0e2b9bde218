"""Which SQL statements only read.

`require_reading` prevents accidents of a lake's owner. It is no sandbox: a reading statement may
read any file the process can. `require_select` is the first of several walls of
`breplake.queries.sandbox`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any, Final

import duckdb

from breplake.errors import UsageError

__all__ = ["require_reading", "require_select"]

_ALLOWED = (
    "a lake is read by SELECT, FROM, VALUES, WITH, DESCRIBE, SUMMARIZE, SHOW and EXPLAIN; "
    "write results with -o FILE or with the methods of the returned relation"
)

_READING_NODES = frozenset({"SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE"})
"""Query nodes that do not write. DuckDB gives the others to INSERT, COPY ... inside a WITH."""

_PURE_TABLE_FUNCTIONS: Final = frozenset(
    {"generate_series", "json_each", "json_tree", "range", "unnest"}
)
"""Table functions that look at nothing but their arguments."""

_CHANGING_TABLE_FUNCTIONS: Final = frozenset(
    {
        *("checkpoint", "force_checkpoint"),
        *("enable_logging", "disable_logging", "truncate_duckdb_logs"),
        *("enable_profiling", "disable_profiling"),
        *("create_external_resource", "destroy_external_resource"),
        *("register_external_resource", "deregister_external_resource"),
        "register_external_resource_type",
        # these run a statement that is a text to the parser, or a serialised tree
        *("query", "query_table", "json_execute_serialized_sql"),
    }
)
"""Table functions that change the session or files, or may."""

_COMMENT = r"(?:\s|--[^\n]*(?:\n|$)|/\*.*?\*/)*"
_EXPLAIN = re.compile(
    rf"{_COMMENT}EXPLAIN\b{_COMMENT}(?:ANALYZE\b{_COMMENT})?(?P<options>\([^()]*\))?(?P<rest>.*)",
    re.IGNORECASE | re.DOTALL,
)


def require_reading(connection: duckdb.DuckDBPyConnection, query: str) -> None:
    """Refuse SQL that does anything but read.

    Parameters
    ----------
    connection : duckdb.DuckDBPyConnection
        Any connection, for its parser.
    query : str
        One or more statements.

    Raises
    ------
    UsageError
        If `query` is empty, no SQL, or holds a statement that writes or changes settings.
    """
    for statement in _statements(connection, query):
        kind = _kind(statement)
        if kind == "EXPLAIN":
            _require_reading_explain(connection, statement.query)
        elif kind == "MULTI":
            raise UsageError("PIVOT needs its values here: PIVOT ... ON column IN (value, ...)")
        elif kind != "SELECT":
            raise UsageError(f"{kind} is no reading statement: {_ALLOWED}")
        else:
            tree = _reading_tree(connection, statement.query)
            if changing := sorted(_CHANGING_TABLE_FUNCTIONS & set(_table_functions(tree))):
                raise UsageError(f"{changing[0]}() does more than read: {_ALLOWED}")


def require_select(connection: duckdb.DuckDBPyConnection, query: str) -> None:
    """Refuse anything but one SELECT over tables by their names.

    ``FROM``, ``VALUES``, ``WITH``, ``DESCRIBE``, ``SUMMARIZE`` and ``SHOW`` count as SELECT.

    Parameters
    ----------
    connection : duckdb.DuckDBPyConnection
        Any connection, for its parser.
    query : str
        The statement.

    Raises
    ------
    UsageError
        If `query` is empty, no SQL, holds another or a second statement, or calls a table function
        that looks at more than its arguments.
    """
    found = _statements(connection, query)
    if len(found) > 1:
        raise UsageError(f"the sandbox runs one statement at a time, got {len(found)}")
    (statement,) = found
    if (kind := _kind(statement)) != "SELECT":
        raise UsageError(f"the sandbox runs SELECT alone, got {kind}")
    tree = _reading_tree(connection, statement.query)
    if others := sorted(set(_table_functions(tree)) - _PURE_TABLE_FUNCTIONS):
        raise UsageError(
            f"the sandbox has no table function {others[0]}(): tables are read by their names, "
            f"functions are {', '.join(sorted(_PURE_TABLE_FUNCTIONS))}"
        )


def _statements(connection: duckdb.DuckDBPyConnection, query: str) -> list[duckdb.Statement]:
    try:
        found = connection.extract_statements(query)
    except duckdb.Error as error:
        raise UsageError(str(error)) from error
    if not found:
        raise UsageError(f"the query is empty: {_ALLOWED}")
    return found


def _kind(statement: duckdb.Statement) -> str:
    """Return the type of a statement as DuckDB names it."""
    try:
        return str(statement.type.name)
    except ValueError:  # a type that DuckDB's Python package does not know, as UPDATE EXTENSIONS
        return statement.query.split(maxsplit=1)[0].upper()


def _require_reading_explain(connection: duckdb.DuckDBPyConnection, query: str) -> None:
    """Check what is explained: EXPLAIN ANALYZE executes it."""
    match = _EXPLAIN.fullmatch(query)
    if match is None:
        raise UsageError(f"cannot tell what this EXPLAIN executes: {query!r}")
    # "(FORMAT json)" holds options, "(SELECT 1)" is the statement itself
    require_reading(connection, match["rest"].strip(" \n\t;") or match["options"] or "")


def _reading_tree(connection: duckdb.DuckDBPyConnection, query: str) -> Any:
    """Return the parsed tree: ``WITH x AS (COPY ...) SELECT`` is of type SELECT, and writes."""
    ((text,),) = connection.execute("SELECT json_serialize_sql(?)", [query]).fetchall()
    tree = json.loads(text)
    if tree["error"]:
        raise UsageError(f"cannot tell whether this statement only reads: {query!r}")
    for node in _nodes(tree):
        # these may have a WITH clause, so they are queries
        if "cte_map" in node and node.get("type") not in _READING_NODES:
            kind = str(node.get("type")).split("_")[0]
            raise UsageError(f"{kind} inside a query writes: {_ALLOWED}")
    return tree


def _table_functions(tree: Any) -> Iterator[str]:
    for node in _nodes(tree):
        if node.get("type") == "TABLE_FUNCTION":
            yield str(node["function"].get("function_name")).lower()


def _nodes(tree: Any) -> Iterator[dict[str, Any]]:
    """Yield every node of a parsed tree."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, dict):
            yield node
            waiting.extend(node.values())
        elif isinstance(node, list):
            waiting.extend(node)
