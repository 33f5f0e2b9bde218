"""Which SQL statements only read.

This prevents accidents of a lake's owner.  It is no sandbox: a reading statement may read any
file the process can, and DuckDB has table functions with effects on its own session.
"""

from __future__ import annotations

import json
import re
from typing import Any

import duckdb

from breplake.errors import UsageError

__all__ = ["require_reading"]

_ALLOWED = (
    "a lake is read by SELECT, FROM, VALUES, WITH, DESCRIBE, SUMMARIZE, SHOW and EXPLAIN; "
    "write results with -o FILE or with the methods of the returned relation"
)

_READING_NODES = frozenset({"SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE"})
"""Query nodes that do not write. DuckDB gives the others to INSERT, COPY ... inside a WITH."""

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
    try:
        statements = connection.extract_statements(query)
    except duckdb.Error as error:
        raise UsageError(str(error)) from error
    if not statements:
        raise UsageError(f"the query is empty: {_ALLOWED}")
    for statement in statements:
        if statement.type == duckdb.StatementType.EXPLAIN:
            _require_reading_explain(connection, statement.query)
        elif statement.type == duckdb.StatementType.MULTI:
            raise UsageError("PIVOT needs its values here: PIVOT ... ON column IN (value, ...)")
        elif statement.type != duckdb.StatementType.SELECT:
            raise UsageError(f"{statement.type.name} is no reading statement: {_ALLOWED}")
        else:
            _require_reading_select(connection, statement.query)


def _require_reading_explain(connection: duckdb.DuckDBPyConnection, query: str) -> None:
    """Check what is explained: EXPLAIN ANALYZE executes it."""
    match = _EXPLAIN.fullmatch(query)
    if match is None:
        raise UsageError(f"cannot tell what this EXPLAIN executes: {query!r}")
    # "(FORMAT json)" holds options, "(SELECT 1)" is the statement itself
    require_reading(connection, match["rest"].strip(" \n\t;") or match["options"] or "")


def _require_reading_select(connection: duckdb.DuckDBPyConnection, query: str) -> None:
    """Check the parsed tree: ``WITH x AS (COPY ...) SELECT`` is of type SELECT, and writes."""
    ((text,),) = connection.execute("SELECT json_serialize_sql(?)", [query]).fetchall()
    tree = json.loads(text)
    if tree["error"]:
        raise UsageError(f"cannot tell whether this statement only reads: {query!r}")
    for kind in _query_nodes(tree):
        if kind not in _READING_NODES:
            raise UsageError(f"{kind.split('_')[0]} inside a query writes: {_ALLOWED}")


def _query_nodes(tree: Any) -> list[str]:
    """Return the types of all query nodes: those that may have a WITH clause."""
    found: list[str] = []
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, dict):
            if "cte_map" in node:
                found.append(str(node.get("type")))
            waiting.extend(node.values())
        elif isinstance(node, list):
            waiting.extend(node)
    return found
