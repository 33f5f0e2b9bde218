"""The command ``breplake query``."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from breplake.cli import app
from breplake.queries.named import TOPICS

from .library import QUERIES


@pytest.fixture
def call(tiny_lake: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("BREPLAKE", str(tiny_lake))
    return lambda *arguments: CliRunner().invoke(app, ["query", *map(str, arguments)])


def test_command_lists_all(call):
    for arguments in ((), ("--list",)):
        text = call(*arguments).stdout
        assert all(f"  {name} " in text for name in QUERIES)
        assert all(title in text for title in TOPICS.values())


def test_command_describes(call):
    text = call("fillets", "--describe").stdout
    assert "least_radius" in text
    assert re.search(r"min_radius +DOUBLE = 0 \(mm\) +least radius", text)
    assert re.search(r"max_radius +DOUBLE = NULL \(mm\)", text)
    assert call("fillets", "--sql").stdout == QUERIES["fillets"].sql


def test_command_runs(call):
    result = call("largest_models", "-p", "by=volume", "--param", "limit=1", "-f", "csv")
    assert [line.split(",")[1:4] for line in result.stdout.splitlines()] == [
        ["collection", "name", "value"], ["boxes", "big", "120.0"],
    ]  # fmt: skip
    result = call("largest_models", "--where", "name <> 'big'", "-p", "limit=1", "-f", "csv")
    assert ",big," not in result.stdout
    assert call("collections", "--at", 1, "-f", "csv").stdout.splitlines()[1].startswith("boxes,2,")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("filets",), "did you mean fillets"),
        (("fillets", "-p", "radius=1"), "no parameter 'radius': did you mean"),
        (("fillets", "-p", "min_radius"), "--param takes NAME=VALUE"),
        (("fillets", "-p", "min_radius=x"), "min_radius is a number, got 'x'"),
        (("largest_models", "-p", "by=weight"), "by is patches, curves"),
        (("patches_per_model", "-p", "bin=0"), "bin must be at least 1"),
        (("holes", "--where", "nme = 1"), "nme"),
        (("holes", "--lake", "/nowhere"), "there is no lake"),
    ],
)
def test_command_errors(call, arguments: tuple[str, ...], message: str):
    result = call(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert message in line
