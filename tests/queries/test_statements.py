"""Which statements the owner's session runs: those that read, however they are written."""

from __future__ import annotations

import os
from pathlib import Path

import duckdb
import pytest

import breplake
from breplake.errors import UsageError
from breplake.queries.statements import require_reading, require_select

CHANGING = [
    "FROM checkpoint()",
    "FROM force_checkpoint()",
    "FROM enable_logging(storage = 'file', storage_path = '{0}')",
    "SELECT (SELECT count(*) FROM ENABLE_LOGGING())",
    "FROM disable_logging()",
    "FROM truncate_duckdb_logs()",
    "FROM enable_profiling(save_location = '{0}')",
    "FROM disable_profiling()",
    "FROM create_external_resource('a', 'b')",
    "FROM query('WITH x AS (COPY (SELECT 1) TO ''{0}'') SELECT 1')",
    "FROM query_table('models')",
    "FROM json_execute_serialized_sql(json_serialize_sql('SELECT 1'))",
    "EXPLAIN ANALYZE FROM checkpoint()",
    "WITH x AS (FROM enable_logging()) SELECT 1",
    "UPDATE EXTENSIONS",
    "COPY FROM DATABASE memory TO memory",
    "VACUUM",
    "CHECKPOINT",
    "ANALYZE",
    "CREATE SECRET s (TYPE s3, KEY_ID 'a', SECRET 'b')",
    "CREATE MACRO m() AS 1",
    "CREATE SEQUENCE s",
    "ALTER VIEW models RENAME TO m",
    "TRUNCATE t",
    "DETACH memory",
    "RESET threads",
    "SET VARIABLE x = 1",
    "DEALLOCATE p",
    "EXECUTE p",
    "COMMIT",
    "IMPORT DATABASE '{0}'",
    "MERGE INTO t USING t AS s ON true WHEN MATCHED THEN DELETE",
    "INSERT OR REPLACE INTO t VALUES (1)",
    "SELECT 1;\n-- and\nDROP VIEW models",
]


@pytest.mark.parametrize("query", CHANGING)
def test_what_changes_anything_is_refused(query: str, tiny_lake: Path, tmp_path: Path):
    lake = breplake.open(tiny_lake)
    lake.connection.execute("CREATE TABLE t AS SELECT 1 AS a")
    settings = "SELECT name, value FROM duckdb_settings() ORDER BY name"
    before = lake.connection.execute(settings).fetchall()
    with pytest.raises(UsageError):
        lake.sql(query.format(tmp_path / "written")).fetchall()
    assert os.listdir(tmp_path) == []
    assert lake.connection.execute(settings).fetchall() == before
    assert lake.sql("SELECT sum(a) FROM t").fetchall() == [(1,)]


def test_refusals_name_what_is_refused(tiny_lake: Path):
    lake = breplake.open(tiny_lake)
    with pytest.raises(UsageError, match=r"enable_logging\(\) does more than read"):
        lake.sql("FROM enable_logging()")
    with pytest.raises(UsageError, match="UPDATE is no reading statement"):
        lake.sql("UPDATE EXTENSIONS")


@pytest.mark.parametrize(
    "query",
    [
        "FROM range(3)",
        "SELECT unnest([1, 2])",
        "FROM json_each('[1, 2]')",
        "FROM generate_series(1, 3) AS t (a), LATERAL (SELECT a + 1)",
        "FROM unnest([1, 2])",
        "DESCRIBE SELECT 1 AS a",
        "SUMMARIZE SELECT 1 AS a",
        "VALUES (1), (2)",
        "SELECT 'FROM read_text(''x'')' AS text",
        "PIVOT (SELECT 1 AS a, 'x' AS b) ON b IN ('x') USING sum(a)",
    ],
)
def test_one_select_over_tables(query: str):
    connection = duckdb.connect()
    require_select(connection, query)
    require_reading(connection, query)
    assert connection.sql(query).fetchall()


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("SELECT 1; SELECT 2", "one statement at a time, got 2"),
        ("EXPLAIN SELECT 1", "SELECT alone, got EXPLAIN"),
        ("COPY (SELECT 1) TO 'x'", "SELECT alone, got COPY"),
        ("WITH x AS (COPY (SELECT 1) TO 'x') SELECT 1", "COPY inside a query writes"),
        ("FROM read_csv('x')", r"no table function read_csv\(\)"),
        ("SELECT (SELECT count(*) FROM Glob('*'))", r"no table function glob\(\)"),
        ("FROM duckdb_settings()", r"no table function duckdb_settings\(\)"),
        ("FROM histogram('models', 'name')", r"no table function histogram\(\)"),
        ("SELEC", "syntax error"),
        (";", "empty"),
    ],
)
def test_other_than_one_select(query: str, message: str):
    with pytest.raises(UsageError, match=message):
        require_select(duckdb.connect(), query)
