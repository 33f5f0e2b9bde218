"""The command line: what it prints, how it fails, what it leaves behind."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app

BREPLAKE = Path(sys.executable).with_name("breplake")


@pytest.fixture
def call(tiny_lake, monkeypatch):
    monkeypatch.setenv("BREPLAKE", str(tiny_lake))

    def run(*arguments, stdin=None):
        return CliRunner().invoke(app, [str(a) for a in arguments], input=stdin)

    return run


def fails(result, message, code=2):
    assert result.exit_code == code
    (line,) = result.stderr.splitlines()
    assert line.startswith("breplake: ")
    assert message in line
    assert result.stdout == ""


def test_version_and_help(call):
    assert call("--version").stdout == f"breplake {breplake.__version__}\n"
    assert call().exit_code == 2  # help, and a reminder that a command is missing
    for command in app.registered_commands:
        result = call(command.name, "--help")
        assert result.exit_code == 0
        assert command.callback.__doc__.splitlines()[0][:40] in result.stdout


def test_sql_as_table(call):
    result = call("sql", "SELECT name, area FROM models WHERE area > 100 ORDER BY name")
    assert result.exit_code == 0
    lines = [line.split() for line in result.stdout.splitlines()]
    assert [line for line in lines if line and line[0] in ("big", "wide", "small")] == [
        ["big", "148"],
        ["wide", "172"],
    ]


def test_a_long_table_says_how_to_get_the_rest(call):
    result = call("sql", "FROM range(500)", "--rows", 10)
    assert result.stdout.split() == ["range", result.stdout.split()[1], *map(str, range(10))]
    assert "--format csv" in result.stderr
    assert call("sql", "FROM range(10)", "--rows", 10).stderr == ""


QUERY = "SELECT name, area, bbox_max, is_closed, licence, metadata FROM models ORDER BY name"


def test_sql_as_csv_and_json_are_exact(call, tiny_lake):
    expected = breplake.open(tiny_lake).sql(QUERY).to_dicts()
    rows = list(csv.DictReader(io.StringIO(call("sql", QUERY, "-f", "csv").stdout)))
    assert [float(row["area"]) for row in rows] == [row["area"] for row in expected]
    assert rows[0]["is_closed"] == "true"
    assert rows[0]["licence"] == ""
    assert json.loads(rows[1]["bbox_max"]) == expected[1]["bbox_max"]
    assert json.loads(call("sql", QUERY, "-f", "json").stdout) == expected
    assert json.loads(call("sql", "SELECT 1 WHERE false", "-f", "json").stdout) == []


def test_json_holds_what_json_can(call):
    query = "SELECT 'nan'::DOUBLE AS a, sum(n_plane) AS b, DATE '2020-01-02' AS c FROM models"
    assert json.loads(call("sql", query, "-f", "json").stdout) == [
        {"a": None, "b": 30, "c": "2020-01-02"}
    ]


def test_json_has_ids_that_no_reader_rounds(call, tiny_lake):
    ids = [i for (i,) in breplake.open(tiny_lake).sql("SELECT model_id FROM models").fetchall()]
    assert any(abs(i) > 2**53 for i in ids)
    query = f"SELECT model_id AS a, [model_id] AS b, {2**53} AS c FROM models"
    rows = json.loads(call("sql", query, "-f", "json").stdout)
    expected = [str(i) if abs(i) > 2**53 else i for i in ids]
    assert sorted(map(str, expected)) == sorted(str(row["a"]) for row in rows)
    assert {type(row["a"]) for row in rows} == {type(i) for i in expected}
    assert all(row["b"] == [row["a"]] and row["c"] == 2**53 for row in rows)


def test_columns_of_one_name(call, tmp_path):
    query = "SELECT 1 AS n, 2 AS n"
    assert call("sql", query, "-f", "csv").stdout == "n,n\n1,2\n"
    fails(call("sql", query, "-f", "json"), "several columns are called 'n'")
    fails(call("sql", query, "-o", tmp_path / "x.parquet"), "give them other names with AS")
    assert os.listdir(tmp_path) == []


def test_a_lake_in_the_wrong_place(call, tiny_lake, tmp_path):
    for command in (["info"], ["snapshots"], ["subset", "list"]):
        result = call(*command, tiny_lake)
        assert result.exit_code == 2
        said = "".join(re.findall(r"[^\s│╭╮╰╯─]+", result.stderr))
        assert f"namethelakewith--lake{tiny_lake}" in said
    assert "--lake" not in call("info", tmp_path).stderr


@pytest.mark.parametrize("ending", ["csv", "json", "parquet", "txt"])
def test_sql_into_a_file(call, tmp_path, ending):
    file = tmp_path / f"out.{ending}"
    file.write_text("older")
    result = call("sql", QUERY, "-o", file)
    assert (result.exit_code, result.stdout, os.listdir(tmp_path)) == (0, "", [file.name])
    if ending == "parquet":
        assert pq.read_table(file).column("name").to_pylist()[0] == "bare"
    else:
        assert "long/flat" in file.read_text()


def test_a_failed_query_leaves_the_file_as_it_was(call, tmp_path):
    file = tmp_path / "out.csv"
    file.write_text("older")
    query = "SELECT CASE WHEN range < 90000 THEN 1 ELSE error('late') END FROM range(100000)"
    fails(call("sql", query, "-o", file), "late")
    assert file.read_text() == "older"
    assert os.listdir(tmp_path) == [file.name]


def test_special_files_are_written_not_replaced(call):
    assert call("sql", QUERY, "-o", "/dev/null", "-f", "csv").exit_code == 0
    assert Path("/dev/null").is_char_device()


def test_sql_from_stdin_and_at_a_snapshot(call):
    assert (
        call("sql", "-", "-f", "csv", stdin="SELECT count(*) AS n FROM models").stdout == "n\n5\n"
    )
    result = call("sql", "SELECT count(*) AS n FROM models", "--at", 1, "-f", "csv")
    assert result.stdout == "n\n2\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("sql", "SELECT nam FROM models"), 'Candidate bindings: "name"'),
        (("sql", "SELEC 1"), "syntax error"),
        (("sql", "DROP VIEW models"), "no reading statement"),
        (("sql", "COPY models TO 'x.csv'"), "no reading statement"),
        (("sql", "SELECT 1", "--at", "v9"), "no snapshot or tag 'v9'"),
        (("sql", "SELECT 1", "--lake", "/nowhere"), "there is no lake"),
        (("sql", "SELECT 1", "-o", "x.docx"), "cannot tell the format"),
        (("sql", "SELECT 1", "-o", "/nowhere/x.csv"), "No such file or directory"),
        (("sql", "SELECT 1", "-o", "/tmp", "-f", "csv"), "Is a directory"),
        (("files", "model"), "did you mean models?"),
        (("show", "bigg", "-o", "x.png"), "did you mean big"),
        (("tag", "7"), "must not be a number"),
        (("info", "--at", "3"), "snapshots are 1 to 2"),
    ],
)
def test_errors_are_one_clear_line(call, arguments, message):
    fails(call(*arguments), message)


def test_debug_lets_the_error_through(call):
    result = call("--debug", "sql", "SELEC 1")
    assert isinstance(result.exception, breplake.errors.UsageError)


def test_files(call, tiny_lake):
    expected = [str(tiny_lake / f"tables/faces/{shard}.parquet") for shard in ("s0", "s1")]
    assert call("files", "faces").stdout.split() == expected
    assert call("files", "arrays", "--at", 1).stdout.split() == [str(tiny_lake / "arrays/s0.zarr")]


def test_info(call):
    text = call("info").stdout
    for part in ("2 of 2", "5 (boxes 5)", "read/not-cad 1", "Plane 30", "Line 60", "48 triangles"):
        assert part in text
    assert json.loads(call("info", "--json").stdout)["patches"]["Plane"] == 30


def test_snapshots_and_tags(own_lake):
    def run(*arguments):
        return CliRunner().invoke(app, [*arguments, "--lake", str(own_lake)])

    assert run("tag", "paper", "--at", "1").stdout == "paper names snapshot 1\n"
    lines = [line.split() for line in run("snapshots").stdout.splitlines()]
    assert [line[:2] for line in lines if line and line[0].isdigit()] == [["1", "2"], ["2", "5"]]
    assert "paper" in run("snapshots").stdout
    assert "2 of 2" in run("info").stdout
    assert run("info", "--at", "paper").stdout.count("(paper)") == 1


def test_check_of_a_damaged_lake_fails(own_lake):
    file = own_lake / "tables/faces/s0.parquet"
    file.write_bytes(file.read_bytes()[:-1])
    for arguments in (["check", str(own_lake)], ["check", "--lake", str(own_lake)]):
        assert CliRunner().invoke(app, arguments).exit_code == 1


def test_names_do_not_move_the_cursor(call):
    result = call("sql", "SELECT chr(27) || '[31mred' AS \"a[b]\"")
    assert "\x1b" not in result.stdout
    assert r"\x1b[31mred" in result.stdout
    assert "a[b]" in result.stdout


def test_as_a_process(tiny_lake):
    """Once for real: the entry point, a pipe that closes early, an error."""
    environment = os.environ | {"BREPLAKE": str(tiny_lake)}
    command = f"{BREPLAKE} sql 'FROM range(1000000)' -f csv | head -n 2"
    done = subprocess.run(command, shell=True, env=environment, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("range\n0\n", "")
    done = subprocess.run(
        [BREPLAKE, "sql", "SELEC"], env=environment, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("breplake: Parser Error")


def test_help_imports_nothing_heavy():
    code = (
        "import sys, breplake.cli; "
        "print([m for m in ('duckdb', 'polars', 'pyarrow', 'zarr', 'torch', 'OCP', 'gmsh') "
        "if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert done.stdout == "[]\n"
