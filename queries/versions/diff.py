"""What changed between two snapshots: models, and the columns of each table."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from breplake.errors import UsageError
from breplake.schema.snapshot import FileEntry
from breplake.schema.tables import TABLES

if TYPE_CHECKING:
    import duckdb

    from breplake.queries.session import Lake

__all__ = ["ColumnChange", "Diff", "TableChange", "diff"]

_MAKING: Final = frozenset(
    {
        *("shard", "vertex_offset", "normal_offset", "face_offset", "patch_offset", "curve_offset"),
        *("occt_version", "gmsh_version", "breplake_version", "config_hash"),
        *("seconds", "cpu_load", "cpu_brep", "cpu_mesh", "cpu_truth", "cpu_write", "cpu_kernel"),
        *("cpu_total", "peak_memory"),
    }
)
"""Columns that tell how and where a model was made, not what it is."""


@dataclass(frozen=True, slots=True)
class TableChange:
    """Rows of a table that were added, removed or changed; a row is known by its key."""

    table: str
    added: int
    removed: int
    changed: int


@dataclass(frozen=True, slots=True)
class ColumnChange:
    """A column that changed in rows that are in both snapshots.

    Parameters
    ----------
    table, column : str
        Which.
    rows, models : int
        Rows with another value, and the models they belong to.
    content : bool
        False if the column only tells how or where a model was made.
    note : str
        ``added``, ``removed`` or the two types, if the column itself changed.
    """

    table: str
    column: str
    rows: int
    models: int
    content: bool
    note: str = ""


@dataclass(frozen=True, slots=True)
class Diff:
    """What changed from snapshot `old` to `new`.

    Parameters
    ----------
    old, new : int
        Numbers of the snapshots.
    added, removed, changed : list of str
        Models by ``collection/name``, sorted. Changed ones differ in more than how they were
        made.
    rewritten : int
        Models whose files were written anew with the same content.
    tables : list of TableChange
        Tables with any change.
    columns : list of ColumnChange
        Columns with any change.
    """

    old: int
    new: int
    added: list[str]
    removed: list[str]
    changed: list[str]
    rewritten: int
    tables: list[TableChange]
    columns: list[ColumnChange]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, fit for JSON."""
        return asdict(self)


def diff(old: Lake, new: Lake) -> Diff:
    """Compare two snapshots of one lake, or of lakes that hold the same models.

    Files that both name are equal, since files are written once; only the others are read.

    Parameters
    ----------
    old, new : Lake
        The snapshots.

    Raises
    ------
    UsageError
        If a file cannot be read, or one of two lakes is not in a local folder.
    """
    import duckdb

    if old.place != new.place:
        assert old.root  # raises for a lake elsewhere: a session reads over the network
        assert new.root  # from one lake only
    cursor = new.connection.cursor()
    try:
        return _diff(cursor, old, new)
    except duckdb.Error as error:
        raise UsageError(f"cannot compare the snapshots: {error}") from error
    finally:
        cursor.close()


def _diff(cursor: duckdb.DuckDBPyConnection, old: Lake, new: Lake) -> Diff:
    names = [_names(cursor, *pair) for pair in ((old, new), (new, old))]
    tables: list[TableChange] = []
    columns: list[ColumnChange] = []
    touched: set[int] = set()
    for table in TABLES:
        sides = _relation(old, new, table), _relation(new, old, table)
        if sides == ("", ""):
            continue
        change, found, models = _compare(cursor, table, sides)
        if change.added or change.removed or change.changed:
            tables.append(change)
        columns += found
        touched |= models
    both = names[0].keys() & names[1].keys()
    return Diff(
        old=old.snapshot.number,
        new=new.snapshot.number,
        added=sorted(names[1][i] for i in names[1].keys() - both),
        removed=sorted(names[0][i] for i in names[0].keys() - both),
        changed=sorted(names[1][i] for i in both & touched),
        rewritten=len(both - touched),
        tables=tables,
        columns=columns,
    )


def _own_files(lake: Lake, other: Lake, table: str) -> list[FileEntry]:
    """Return the files that `lake` has and `other` has not."""
    there = set(other.snapshot.table_files(table))
    return [entry for entry in lake.snapshot.table_files(table) if entry not in there]


def _relation(lake: Lake, other: Lake, table: str) -> str:
    """Return SQL of the rows that only `lake` may have; empty without any file."""
    paths = [lake.sql_path(entry) for entry in _own_files(lake, other, table)]
    quoted = ", ".join("'" + path.replace("'", "''") + "'" for path in paths)
    return f"read_parquet([{quoted}], union_by_name=true)" if paths else ""


def _names(cursor: duckdb.DuckDBPyConnection, lake: Lake, other: Lake) -> dict[int, str]:
    relation = _relation(lake, other, "models")
    if not relation:
        return {}
    query = f"SELECT model_id, concat(collection, '/', name) FROM {relation}"
    return dict(cursor.execute(query).fetchall())


def _described(
    cursor: duckdb.DuckDBPyConnection, sides: tuple[str, str]
) -> list[tuple[str, dict[str, str]]]:
    """Return SQL and column types of both sides; one without files takes the other's types."""
    found = []
    for side, other in (sides, sides[::-1]):
        relation = side or f"(FROM {other} LIMIT 0)"
        columns = cursor.execute(f"DESCRIBE FROM {relation}").fetchall()
        found.append((relation, {row[0]: row[1] for row in columns}))
    return found


def _compare(
    cursor: duckdb.DuckDBPyConnection, table: str, sides: tuple[str, str]
) -> tuple[TableChange, list[ColumnChange], set[int]]:
    """Compare the rows of a table; return also the models whose content differs."""
    (old, old_types), (new, new_types) = _described(cursor, sides)
    key = TABLES[table].key
    names = [n for n, kind in new_types.items() if old_types.get(n) == kind and n not in key]
    tests = [f'o."{name}" IS DISTINCT FROM n."{name}"' for name in names]
    both = "o.model_id IS NOT NULL AND n.model_id IS NOT NULL AND"
    counts = "".join(
        f", count(*) FILTER ({both} ({test})) AS c{i}"
        for i, test in enumerate([" OR ".join(tests) or "false", *tests])
    )
    on = " AND ".join(f'o."{name}" = n."{name}"' for name in key)
    cursor.execute(f"""
        CREATE OR REPLACE TEMP TABLE difference AS
        SELECT coalesce(o.model_id, n.model_id) AS model_id,
               count(*) FILTER (o.model_id IS NULL) AS added,
               count(*) FILTER (n.model_id IS NULL) AS removed{counts}
        FROM {old} AS o FULL JOIN {new} AS n ON {on}
        GROUP BY 1
    """)
    totals = "".join(f", sum(c{i}), count(*) FILTER (c{i} > 0)" for i in range(1, len(names) + 1))
    row = cursor.execute(f"SELECT sum(added), sum(removed), sum(c0){totals} FROM difference")
    sums = [int(value or 0) for value in row.fetchall()[0]]
    content = [f"c{i} > 0" for i, name in enumerate(names, 1) if name not in _MAKING]
    condition = " OR ".join(["added > 0", "removed > 0", *content])
    touched = cursor.execute(f"SELECT model_id FROM difference WHERE {condition}").fetchall()
    cursor.execute("DROP TABLE difference")
    changes = [
        ColumnChange(table, name, rows, models, name not in _MAKING)
        for name, rows, models in zip(names, sums[3::2], sums[4::2], strict=True)
        if rows
    ]
    altered = _altered(table, old_types, new_types)
    return TableChange(table, *sums[:3]), changes + altered, {int(row[0]) for row in touched}


def _altered(table: str, old: dict[str, str], new: dict[str, str]) -> list[ColumnChange]:
    """Return the columns that only one side has, or has with another type."""
    notes = {name: "removed" for name in old if name not in new}
    notes |= {name: "added" for name in new if name not in old}
    notes |= {n: f"{old[n]} -> {kind}" for n, kind in new.items() if old.get(n, kind) != kind}
    return [ColumnChange(table, name, 0, 0, True, note) for name, note in notes.items()]
