"""The sandbox: what it answers, and what it refuses, stops and leaves untouched."""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pyarrow as pa
import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.errors import BreplakeError, LakeFormatError, LimitError, UsageError
from breplake.queries import sandbox
from breplake.queries.sandbox import Sandbox
from breplake.queries.session import Lake
from breplake.schema.storage import Storage, folder_hash

SECRET = "song of the canary"


@pytest.fixture(scope="module")
def lake(tiny_lake: Path) -> Lake:
    return breplake.open(tiny_lake)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with files that no query may read or change."""
    folder = tmp_path_factory.mktemp("canaries")
    for name in ("canary.txt", "canary.csv", "canary.json", "canary.sql"):
        (folder / name).write_text(f'"{SECRET}"\n')
    import duckdb

    duckdb.sql(f"COPY (SELECT '{SECRET}' AS song) TO '{folder}/canary.parquet'")
    with duckdb.connect(str(folder / "canary.duckdb")) as database:
        database.execute(f"CREATE TABLE songs AS SELECT '{SECRET}' AS song")
    return folder


def state(lake: Lake, place: Path) -> tuple:
    """All that a query might change: the lake, other files, this process."""
    limits = tuple(
        resource.getrlimit(limit)
        for limit in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE, resource.RLIMIT_CPU)
    )
    return (
        folder_hash(lake.root),
        folder_hash(place),
        sorted(os.listdir(place)),
        sorted(p.name for p in Path("/").iterdir()),
        {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"},
        os.getcwd(),
        limits,
    )


@pytest.fixture
def untouched(lake: Lake, place: Path) -> Iterator[None]:
    before = state(lake, place)
    yield
    assert state(lake, place) == before
    assert lake.sql("SELECT count(*) FROM models").fetchall() == [(5,)]


# What it answers


@pytest.mark.parametrize(
    "query",
    [
        "SELECT name, n_plane, bbox_max, metadata FROM models ORDER BY name",
        "FROM adjacency ORDER BY ALL",
        "SELECT type, count(*) AS n, sum(area) AS area FROM patches GROUP BY type",
        "WITH big AS (SELECT * FROM models WHERE volume > 100) SELECT name FROM big ORDER BY name",
        "WITH RECURSIVE r AS (SELECT 1 AS a UNION ALL SELECT a + 1 FROM r WHERE a < 9) FROM r",
        "SELECT kind, message FROM failures ORDER BY kind -- no ; here",
        "FROM range(3)",
        "SELECT 1 AS a WHERE false",
        "DESCRIBE models",
        "SELECT count(*) AS n FROM shapes",
    ],
)
def test_it_answers_as_the_owner_is_answered(lake: Lake, query: str):
    answer = lake.sandbox(timeout=60).sql(query)
    assert isinstance(answer, pa.Table)
    assert answer.to_pylist() == lake.sql(query).to_arrow_table().to_pylist()


def test_it_stays_at_its_snapshot(lake: Lake):
    answer = lake.at(1).sandbox(timeout=60).sql("SELECT count(*) AS n FROM models")
    assert answer.to_pylist() == [{"n": 2}]


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("SELEC 1", "syntax error"),
        ("SELECT nme FROM models", '"name"'),
        ("FROM model", "models"),
        ("SELECT error('mine')", "mine"),
        ("", "the query is empty"),
        ("-- nothing", "the query is empty"),
        ("SELECT " + "(" * 5000 + "1" + ")" * 5000, "depth"),
    ],
    ids=lambda text: text[:20],
)
def test_mistakes_are_told(lake: Lake, query: str, message: str):
    with pytest.raises(UsageError, match=message):
        lake.sandbox(timeout=60).sql(query)


def test_answers_are_limited(lake: Lake):
    with pytest.raises(LimitError, match="more than 100 rows: add LIMIT"):
        lake.sandbox(timeout=60, max_rows=100).sql("FROM range(101)")
    assert lake.sandbox(timeout=60, max_rows=100).sql("FROM range(100)").num_rows == 100
    with pytest.raises(LimitError, match="larger than 10,000 bytes"):
        lake.sandbox(timeout=60, max_bytes=10_000).sql("SELECT repeat('x', 20000) AS x")
    with pytest.raises(UsageError, match="at most 1000000 characters"):
        lake.sandbox().sql("SELECT " + "1" * 1_000_000)


@pytest.mark.parametrize("name", ["timeout", "memory", "max_rows", "max_bytes"])
def test_limits_are_positive(lake: Lake, name: str):
    for value in (0, -1, float("nan")):
        with pytest.raises(UsageError, match=f"{name} of a sandbox must be positive"):
            Sandbox(lake, **{name: value})


def test_damage_is_told(own_lake: Path):
    lake = breplake.open(own_lake)
    (own_lake / "tables/faces/s1.parquet").unlink()
    with pytest.raises(LakeFormatError, match=r"s1\.parquet"):
        lake.sandbox(timeout=60).sql("SELECT sum(v0) FROM faces")


def test_modules_are_found_from_any_folder(lake: Lake, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "path", [os.path.relpath(place) for place in sys.path])
    assert lake.sandbox(timeout=60).sql("SELECT 1 AS a").to_pylist() == [{"a": 1}]


@pytest.mark.parametrize(
    ("program", "how", "memory"),
    [
        ("raise SystemExit(3)", "exit code 3", False),
        ("import os; os.kill(os.getpid(), 9)", "signal SIGKILL", True),
        ("import os; os.abort()", "signal SIGABRT", True),
        ("import os; os.kill(os.getpid(), 15)", "signal SIGTERM", False),
    ],
)
def test_an_end_without_an_answer(
    lake: Lake, monkeypatch: pytest.MonkeyPatch, program: str, how: str, memory: bool
):
    monkeypatch.setattr(sandbox, "_RUN", program)
    with pytest.raises(LimitError, match=how) as caught:
        lake.sandbox(timeout=60).sql("SELECT 1")
    assert ("for want of memory" in str(caught.value)) == memory


# What it refuses

WRITES = [
    "COPY models TO '{0}/new'",
    "COPY (SELECT 1) TO '{0}/new' (FORMAT csv)",
    "WITH x AS (COPY (SELECT 1) TO '{0}/new') SELECT 1",
    "SELECT * FROM (WITH x AS (COPY (SELECT 1) TO '{0}/new') FROM x)",
    "EXPLAIN ANALYZE COPY models TO '{0}/new'",
    "EXPLAIN ANALYZE WITH x AS (COPY (SELECT 1) TO '{0}/new') SELECT 1",
    "EXPORT DATABASE '{0}/new'",
    "IMPORT DATABASE '{0}'",
    "COPY FROM DATABASE memory TO memory",
    "CREATE TABLE t AS SELECT 1",
    "CREATE TEMP TABLE t (a INT)",
    "CREATE VIEW v AS SELECT 1",
    "CREATE OR REPLACE VIEW models AS SELECT 1",
    "CREATE MACRO m() AS 1",
    "CREATE MACRO m() AS TABLE FROM read_text('{0}/canary.txt')",
    "CREATE SECRET s (TYPE s3, KEY_ID 'a', SECRET 'b')",
    "CREATE SEQUENCE s",
    "CREATE SCHEMA s",
    "INSERT INTO models SELECT * FROM models",
    "DELETE FROM models",
    "UPDATE models SET name = 'x'",
    "WITH x AS (DELETE FROM models RETURNING 1) FROM x",
    "TRUNCATE models",
    "DROP VIEW models",
    "ALTER TABLE models RENAME TO m",
    "VACUUM",
    "CHECKPOINT",
    "FROM checkpoint()",
    "ANALYZE",
    "FROM enable_logging(storage = 'file', storage_path = '{0}/new')",
    "CALL enable_logging()",
    "FROM enable_profiling(save_location = '{0}/new')",
    "PRAGMA enable_profiling = 'json'",
    "BEGIN",
    "PREPARE p AS SELECT 1",
    "EXECUTE p",
    "FROM json_execute_serialized_sql(json_serialize_sql('SELECT 1'))",
]
READS = [
    "FROM '{0}/canary.csv'",
    'FROM "{0}/canary.parquet"',
    "FROM read_csv('{0}/canary.csv', header = false)",
    "FROM read_csv_auto('{0}/canary.csv')",
    "FROM sniff_csv('{0}/canary.csv')",
    "FROM read_text('{0}/canary.txt')",
    "FROM read_blob('{0}/*')",
    "FROM glob('{0}/*')",
    "FROM read_json('{0}/canary.json')",
    "FROM read_ndjson_objects('{0}/canary.json')",
    "FROM read_parquet('{0}/canary.parquet')",
    "FROM parquet_scan('{0}/canary.parquet')",
    "FROM parquet_metadata('{0}/canary.parquet')",
    "FROM parquet_schema('{0}/canary.parquet')",
    "FROM read_duckdb('{0}/canary.duckdb', table_name = 'songs')",
    "SELECT (SELECT count(*) FROM read_text('{0}/canary.txt'))",
    "SELECT read_text('{0}/canary.txt')",
    "FROM models, LATERAL (FROM read_text('{0}/canary.txt'))",
    "WITH RECURSIVE r AS (FROM read_text('{0}/canary.txt') UNION ALL FROM r) FROM r",
    "SELECT 1 UNION ALL (SELECT length(content) FROM read_text('{0}/canary.txt'))",
    "SELECT 1 /* ; */ FROM /* x */ read_text /* y */ ('{0}/canary.txt')",
    "FROM query('FROM read_text(''{0}/canary.txt'')')",
    "FROM query_table('{0}/canary.csv')",
    "COPY models FROM '{0}/canary.csv'",
    "ATTACH '{0}/canary.duckdb' AS c",
    "ATTACH '{0}/canary.duckdb' (READ_ONLY)",
    "USE memory",
    "DETACH memory",
    ".read {0}/canary.sql",
    "FROM '/proc/self/environ'",
    "FROM read_blob('/proc/self/mem')",
    "SELECT getenv('PATH')",
    "FROM duckdb_secrets()",
    "FROM which_secret('s3://a', 's3')",
    "FROM 'https://example.com/x.parquet'",
    "FROM 's3://bucket/x.parquet'",
    "FROM read_csv('http://127.0.0.1:1/x.csv')",
    "FROM place",
    "FROM lake",
    "FROM arrow_scan(1, 2, 3)",
    "FROM pandas_scan(1)",
    "FROM python_map_function(1)",
    "FROM python_arrow_scan(1)",
]
SETTINGS = [
    "SET memory_limit = '100GB'",
    "SET threads = 64",
    "SET enable_external_access = true",
    "SET lock_configuration = false",
    "SET temp_directory = '{0}/new'",
    "SET allowed_directories = ['{0}']",
    "SET python_enable_replacements = true",
    "SET VARIABLE x = 1",
    "RESET memory_limit",
    "RESET ALL",
    "PRAGMA memory_limit = '100GB'",
    "PRAGMA temp_directory = '{0}/new'",
    "CALL pragma_version()",
    "FROM create_external_resource('a', 'b')",
    "INSTALL httpfs",
    "FORCE INSTALL spatial FROM community",
    "LOAD httpfs",
    "LOAD '{0}/canary.txt'",
    "UPDATE EXTENSIONS",
]
SEVERAL = [
    "SELECT 1; SELECT 2",
    "SELECT 1; COPY models TO '{0}/new'",
    "SELECT 1;; SET threads = 64",
    "/* */ SELECT 1; -- a\nDROP VIEW models",
    "SELECT ';' ; SELECT 2",
]
ATTEMPTS = [*WRITES, *READS, *SETTINGS, *SEVERAL]


def test_there_are_many_attempts():
    assert len(set(ATTEMPTS)) == len(ATTEMPTS) > 100


@pytest.mark.parametrize("attempt", ATTEMPTS)
@pytest.mark.usefixtures("untouched")
def test_attempts_fail(lake: Lake, place: Path, attempt: str):
    with pytest.raises(BreplakeError) as caught:
        lake.sandbox(timeout=60).sql(attempt.format(place))
    assert not isinstance(caught.value, LimitError), "it was refused, not stopped"
    assert SECRET not in str(caught.value)


WALLS = """
import json, sys
import breplake
from breplake.queries import sandbox_worker as worker

root, attempts = json.load(sys.stdin)
lake = breplake.open(root)
tables = worker._tables({table: lake.files(table) for table in worker.TABLES})
connection = worker._connect(tables, 10**9, 2)
worker._drop_rights(10**9, 60)
for attempt in attempts:
    try:
        rows = str(connection.execute(attempt).fetchall())[:10_000]
    except Exception as error:
        rows = f"{type(error).__name__}: {error}"
    sys.stdout.write(json.dumps([attempt, rows]) + "\\n")
"""


@pytest.mark.usefixtures("untouched")
def test_the_session_holds_without_the_check_of_statements(lake: Lake, place: Path):
    """Behind the first wall: DuckDB itself lets no attempt read or write a file."""
    attempts = [attempt.format(place) for attempt in (*READS, *SETTINGS, *WRITES)]
    done = subprocess.run(
        [sys.executable, "-P", "-c", WALLS], input=json.dumps([str(lake.root), attempts]),
        capture_output=True, text=True, cwd="/", check=True,
    )  # fmt: skip
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(said) == len(attempts)
    assert SECRET not in done.stdout
    refused = {attempt for attempt, rows in said if "Permission Error" in rows}
    assert {
        f"FROM read_text('{place}/canary.txt')",
        f"COPY models TO '{place}/new'",
        f"WITH x AS (COPY (SELECT 1) TO '{place}/new') SELECT 1",
        f"ATTACH '{place}/canary.duckdb' AS c",
        f"FROM query('FROM read_text(''{place}/canary.txt'')')",
    } <= refused
    locked = [rows for attempt, rows in said if attempt.startswith(("SET m", "SET e", "RESET m"))]
    assert all("locked" in rows for rows in locked), locked


@pytest.mark.usefixtures("untouched")
def test_the_process_holds_without_duckdb(place: Path):
    """The last wall: the process cannot write a byte, and has no environment."""
    code = (
        "import os\nfrom breplake.queries.sandbox_worker import _drop_rights\n"
        "_drop_rights(10**8, 60)\nassert not os.environ\n"
        f"file = os.open({str(place / 'canary.txt')!r}, os.O_RDWR | os.O_APPEND)\n"
        "try:\n    os.write(file, b'x')\n"
        "except OSError as error:\n    print(error.errno)\n"
        "try:\n    bytearray(2 * 10**9)\nexcept MemoryError:\n    print('memory')\n"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["27", "memory"]  # EFBIG


# What it stops

ENDLESS = [
    "WITH RECURSIVE r AS (SELECT 1 AS a UNION ALL SELECT a FROM r) SELECT count(*) FROM r",
    "SELECT count(*) FROM vertices a, vertices b, vertices c, vertices d, vertices e",
    "SELECT sum(hash(a.range) % 7) FROM range(1000000000) a, range(1000000000)",
    "SELECT max(md5(range::VARCHAR)) FROM range(100000000000)",
    "SELECT sleep_ms(100000)",
    "SELECT count(*) FROM range(100000000000) WHERE range::VARCHAR SIMILAR TO '(1*)*2'",
]
GREEDY = [
    "SELECT repeat('x', 3000000000)",
    "SELECT length(repeat('x', 3000000000))",
    "SELECT list(range) FROM range(10000000000)",
    "SELECT string_agg(range::VARCHAR, ',') FROM range(10000000000)",
    "SELECT range(1000000000)",
    "SELECT count(DISTINCT hash(range)) FROM range(10000000000)",
    "SELECT * FROM range(1000000000) ORDER BY hash(range) DESC",
    "WITH RECURSIVE r AS (SELECT 'x' AS a UNION ALL SELECT a || a FROM r) SELECT max(a) FROM r",
    "WITH x AS MATERIALIZED (SELECT repeat('x', 1000) FROM range(100000000)) FROM x, x AS y",
    "SELECT bitstring('1', 2000000000)",
    "SELECT lpad('x', 2000000000, 'y') || lpad('x', 2000000000, 'y')",
]


@pytest.mark.parametrize("query", ENDLESS)
@pytest.mark.usefixtures("untouched")
def test_time_is_limited(lake: Lake, query: str):
    start = time.monotonic()
    with pytest.raises(LimitError, match=r"longer than 3 s|memory"):
        lake.sandbox(timeout=3, memory=0.3).sql(query)
    assert time.monotonic() - start < 6


ALONE = """
import json, resource, sys
import breplake
from breplake.errors import BreplakeError

root, query = json.load(sys.stdin)
try:
    breplake.open(root).sandbox(timeout=20, memory=0.3).sql(query)
except BreplakeError as error:
    said = type(error).__name__, str(error)
else:
    said = "", "it was answered"
print(json.dumps([*said, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024]))
"""
"""Asks a sandbox in a process whose only child it is: the largest child that this process ever
had, and this process itself, would count for it otherwise."""


@pytest.mark.parametrize("query", GREEDY)
@pytest.mark.usefixtures("untouched")
def test_memory_is_limited(lake: Lake, query: str):
    done = subprocess.run(
        [sys.executable, "-P", "-c", ALONE], input=json.dumps([str(lake.root), query]),
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    kind, message, peak = json.loads(done.stdout)
    assert kind in ("LimitError", "UsageError"), message
    assert re.search(r"memory|longer than|larger than|out of range", message), message
    assert peak < 0.9e9  # the process itself has about 0.2 GB


@pytest.mark.usefixtures("untouched")
def test_nothing_goes_on_after_a_stop(lake: Lake):
    with pytest.raises(LimitError):
        lake.sandbox(timeout=2).sql("SELECT sleep_ms(3600000)")
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    commands = [Path(f"/proc/{child}/cmdline").read_bytes() for child in children]
    assert not any(b"sandbox_worker" in command for command in commands)


# The command


def test_command(tiny_lake: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("BREPLAKE", str(tiny_lake))

    def run(*arguments: str):
        return CliRunner().invoke(app, ["sql", *arguments])

    query = "SELECT name, volume FROM models ORDER BY name"
    for form in ("csv", "json", "table"):
        plain = run(query, "-f", form)
        boxed = run(query, "-f", form, "--sandbox", "--timeout", "60", "--memory", "0.5")
        assert (boxed.exit_code, boxed.stdout) == (0, plain.stdout)
    assert "the sandbox runs SELECT alone" in run("DROP VIEW models", "--sandbox").stderr
    result = run("SELECT sleep_ms(60000)", "--sandbox", "--timeout", "2")
    assert result.exit_code == 2
    assert "longer than 2 s" in result.stderr
    assert "limits of --sandbox" in run("SELECT 1", "--timeout", "2").stderr


def test_a_lake_in_object_storage_is_refused() -> None:
    """By a check of its own: assertions may be switched off."""
    elsewhere = SimpleNamespace(store=SimpleNamespace(storage=Storage("http://127.0.0.1:1/lake")))
    with pytest.raises(UsageError, match=r"breplake pull http://127\.0\.0\.1:1/lake"):
        Sandbox(elsewhere).sql("SELECT 1")
