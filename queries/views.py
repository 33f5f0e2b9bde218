"""The views of a session: the tables of a snapshot, and what is derived from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import resources
from typing import Any, Final

import duckdb
import pyarrow as pa

from breplake.schema.contract import Table
from breplake.schema.older import CONTRACT, TableFile, by_schema
from breplake.schema.tables import TABLES

__all__ = ["DERIVED", "create_views", "derived_sql"]

DERIVED: Final = ("vertex_normals", "adjacency", "fillets", "holes")
"""Views that are computed from the tables, each documented in ``queries/views/<name>.sql``; a later
one may read an earlier one."""


def derived_sql(name: str) -> str:
    """Return the definition of a derived view, comments included."""
    return resources.files("breplake.queries").joinpath("views", f"{name}.sql").read_text()


def create_views(
    connection: duckdb.DuckDBPyConnection,
    files: Mapping[str, Sequence[TableFile]],
    opened: Callable[[str], Any] = str,
) -> None:
    """Create a view for each table over exactly the given files, then the derived ones.

    Parameters
    ----------
    connection : duckdb.DuckDBPyConnection
        An empty session.
    files : dict of str to sequence of TableFile
        What `connection` reads, by table: absolute paths, or URLs of a file system that is
        registered with it. A table without files becomes an empty view; a column that a file of
        an older contract lacks is null.
    opened : callable, optional
        Returns what pyarrow reads one of `files` from.

    Raises
    ------
    duckdb.Error, OSError, pyarrow.ArrowInvalid
        If a file cannot be read.
    """
    for name, table in TABLES.items():
        found = files.get(name, ())
        if not found:
            body = _empty(connection, table)
        elif all(file.contract == CONTRACT for file in found):
            body = _over_files(table, [file.path for file in found])
        else:
            body = _over_older(connection, table, found, opened)
        connection.execute(f"CREATE VIEW {name} AS {body}")
    for name in DERIVED:
        connection.execute(f"CREATE VIEW {name} AS {derived_sql(name)}")


def _over_files(table: Table, paths: Sequence[str]) -> str:
    return _select((f'"{column.name}"' for column in table.columns), paths)


def _over_older(
    connection: duckdb.DuckDBPyConnection,
    table: Table,
    files: Sequence[TableFile],
    opened: Callable[[str], Any],
) -> str:
    """Return SQL over files of which some may lack columns, or members of structures."""
    kinds = _kinds(connection, table)
    return " UNION ALL ".join(
        _select((_column(field, schema, kinds[field.name]) for field in table.schema), group)
        for schema, group in by_schema(table, files, opened)
    )


def _column(field: pa.Field, schema: pa.Schema, kind: str) -> str:
    """Return the column of a file with that schema; `kind` is its type in DuckDB."""
    at = schema.get_field_index(field.name)
    if at >= 0 and schema.field(at).type.equals(field.type):
        return f'"{field.name}"'
    value = f'"{field.name}"' if at >= 0 else "NULL"
    return f'CAST({value} AS {kind}) AS "{field.name}"'


def _select(columns: Iterable[str], paths: Sequence[str]) -> str:
    listed = ", ".join(_quoted(path) for path in paths)
    names = ", ".join(columns)
    return f"SELECT {names} FROM read_parquet([{listed}], hive_partitioning = false)"


def _quoted(path: str) -> str:
    """Quote a path for DuckDB, which would take ``*``, ``?`` and ``[`` as wildcards."""
    literal = "".join(f"[{c}]" if c in "*?[" else c for c in path)
    return "'" + literal.replace("'", "''") + "'"


def _empty(connection: duckdb.DuckDBPyConnection, table: Table) -> str:
    kinds = _kinds(connection, table)
    names = ", ".join(f'CAST(NULL AS {kind}) AS "{name}"' for name, kind in kinds.items())
    return f"SELECT * FROM (SELECT {names}) WHERE false"


def _kinds(connection: duckdb.DuckDBPyConnection, table: Table) -> dict[str, str]:
    """Return the columns of a table with their types in DuckDB."""
    relation = connection.from_arrow(table.empty())
    return dict(zip(relation.columns, map(str, relation.types), strict=True))
