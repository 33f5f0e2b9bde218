"""The views of a session: the tables of a snapshot, and what is derived from them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from typing import Final

import duckdb

from breplake.schema.contract import Table
from breplake.schema.tables import TABLES

__all__ = ["DERIVED", "create_views", "derived_sql"]

DERIVED: Final = ("vertex_normals", "adjacency", "fillets", "holes")
"""Views that are computed from the tables, each documented in ``queries/views/<name>.sql``; a later
one may read an earlier one."""


def derived_sql(name: str) -> str:
    """Return the definition of a derived view, comments included."""
    return resources.files("breplake.queries").joinpath("views", f"{name}.sql").read_text()


def create_views(connection: duckdb.DuckDBPyConnection, files: dict[str, Sequence[str]]) -> None:
    """Create a view for each table over exactly the given files, then the derived ones.

    Parameters
    ----------
    connection : duckdb.DuckDBPyConnection
        An empty session.
    files : dict of str to sequence of str
        Absolute paths by table; a table without files becomes an empty view.
    """
    for name, table in TABLES.items():
        paths = files.get(name, ())
        body = _over_files(table, paths) if paths else _empty(connection, table)
        connection.execute(f"CREATE VIEW {name} AS {body}")
    for name in DERIVED:
        connection.execute(f"CREATE VIEW {name} AS {derived_sql(name)}")


def _over_files(table: Table, paths: Sequence[str]) -> str:
    names = ", ".join(f'"{column.name}"' for column in table.columns)
    listed = ", ".join(_quoted(path) for path in paths)
    return f"SELECT {names} FROM read_parquet([{listed}], hive_partitioning = false)"


def _quoted(path: str) -> str:
    """Quote a path for DuckDB, which would take ``*``, ``?`` and ``[`` as wildcards."""
    literal = "".join(f"[{c}]" if c in "*?[" else c for c in path)
    return "'" + literal.replace("'", "''") + "'"


def _empty(connection: duckdb.DuckDBPyConnection, table: Table) -> str:
    relation = connection.from_arrow(table.empty())
    columns = zip(relation.columns, relation.types, strict=True)
    names = ", ".join(f'CAST(NULL AS {kind}) AS "{name}"' for name, kind in columns)
    return f"SELECT * FROM (SELECT {names}) WHERE false"
