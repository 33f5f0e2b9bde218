"""The proof over a lake: it passes where nothing was lost, and sees what was."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path
from types import SimpleNamespace

import pyarrow as pa
import pytest

pytest.importorskip("OCP")

from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.ingest.lossless.compare import compare_model
from breplake.ingest.lossless.proof import compare_models
from breplake.ingest.run import ingest
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with a lake of two models and their files, which tests copy."""
    folder = tmp_path_factory.mktemp("compare")
    write_samples(folder / "files", ["ball_steel", "weight_lemon"])
    ingest([folder / "files"], folder / "lake", settings=Settings(max_edge=0.1), message="two")
    return folder


@pytest.fixture
def lake(place):
    return breplake.open(place / "lake")


class Changed:
    """A lake that lies about one value, or about where a model came from."""

    def __init__(self, lake, *, model=None, table=None, column=None, change=None):
        self.lake, self.row = lake, model or {}
        self.table, self.column, self.change = table, column, change

    def model(self, name):
        return self.lake.model(name) | self.row

    def read(self, table, model_id):
        rows = self.lake.read(table, model_id)
        if table != self.table:
            return rows
        at = rows.schema.get_field_index(self.column)
        field = rows.schema.field(at)
        values = self.change(rows.column(at).to_pylist())
        return rows.set_column(at, field, pa.array(values, field.type))


def ball(lake):
    return lake.model("ball_steel")["model_id"]


def test_equal(lake):
    result = compare_model(lake, ball(lake))
    assert (result.verdict, result.reasons) == ("equal", [])
    assert result.is_exact
    assert result.source == result.rebuilt
    assert result.rebuilt.counts == {
        "solid": 1, "shell": 1, "face": 1, "wire": 1, "edge": 3, "vertex": 2,
    }  # fmt: skip
    assert result.rebuilt.is_valid


def test_a_radius_a_billionth_off_is_seen(lake):
    grown = Changed(
        lake,
        table="surfaces",
        column="radius",
        change=lambda values: [v * (1 + 1e-9) for v in values],
    )
    result = compare_model(grown, ball(lake))
    assert result.verdict == "different"
    assert [reason.split()[0] for reason in result.reasons] == ["volume", "area"]


def test_a_lost_wire_is_seen(lake):
    def without(values):
        return [[c for c in children if c["shape"] != 4] for children in values]

    shapes = lake.read("shapes", ball(lake)).to_pylist()
    assert shapes[4]["type"] == "wire"
    result = compare_model(
        Changed(lake, table="shapes", column="children", change=without), ball(lake)
    )
    assert result.verdict == "different"
    assert "0 wires, not 1" in result.reasons
    assert "0 vertices, not 2" in result.reasons


def test_damage_is_no_crash(lake):
    bad = Changed(
        lake, table="shapes", column="surface", change=lambda v: [9 if x == 0 else x for x in v]
    )
    result = compare_model(bad, ball(lake))
    assert result.verdict == "failed"
    assert "no surface 9" in result.reasons[0]


@pytest.mark.parametrize(
    ("row", "reason"),
    [({"path": "/no/such/file.step"}, "cannot be read"), ({"sha256": "0" * 64}, "other content")],
)
def test_sources_that_are_gone_or_changed(lake, row, reason):
    result = compare_model(Changed(lake, model=row), ball(lake))
    assert result.verdict == "no-source"
    assert reason in result.reasons[0]


def test_models_without_shapes(tiny_lake):
    lake = breplake.open(tiny_lake)
    assert compare_model(lake, lake.model("small")["model_id"]).verdict == "no-shapes"


def test_a_model_that_hangs_costs_itself_alone():
    """Asked for the model of this id, the lake sleeps for as many seconds."""
    lake = SimpleNamespace(model=time.sleep)
    (result,) = compare_models(lake, {600: "slow"}, jobs=1, timeout=2.0)
    assert (result.verdict, result.name) == ("failed", "slow")
    assert "longer than 2 s" in result.reasons[0]


def run(*words):
    return CliRunner().invoke(app, ["rebuild", *map(str, words)])


def test_an_error_of_the_kernel_costs_its_model_alone(lake, monkeypatch):
    from breplake.ingest.lossless import compare

    def fault(*_):
        raise ValueError("Geom_BSplineCurve: weights too small")

    monkeypatch.setattr(compare, "rebuilt_shapes", fault)
    result = compare_model(lake, ball(lake))
    assert (result.verdict, result.reasons) == (
        "failed",
        ["ValueError: Geom_BSplineCurve: weights too small"],
    )


def test_the_command_proves_a_lake(place, tmp_path):
    report = tmp_path / "report.json"
    done = run("--compare", "--lake", place / "lake", "-j", 1, "-o", report)
    assert done.exit_code == 0, done.output
    assert "2 of 2 rebuilt models have the very bits" in done.output
    found = json.loads(report.read_text())["models"]
    assert [row["name"] for row in found] == ["ball_steel", "weight_lemon"]
    assert {row["verdict"] for row in found} == {"equal"}


def test_the_command_lists_exceptions(place, tmp_path):
    """A source that changed is no difference; that nothing could be compared is no proof."""
    folder = tmp_path / "copy"
    shutil.copytree(place, folder)
    write_samples(folder / "other", ["ball_steel"])
    ingest([folder / "other"], folder / "lake", settings=Settings(max_edge=0.1), message="more")
    (folder / "other" / "ball_steel.step").write_text("changed")
    where = "collection = 'other'"
    only = run("--compare", "--lake", folder / "lake", "-j", 1, "--where", where)
    assert only.exit_code == 1
    assert "no-source" in only.output
    assert "other content" in only.output
    both = run("--compare", "--lake", folder / "lake", "-j", 1)
    assert both.exit_code == 0
    assert "no-source" in both.output


def test_the_command_writes_a_file(place, tmp_path):
    target = tmp_path / "ball.step"
    done = run("ball_steel", "--lake", place / "lake", "-o", target)
    assert done.exit_code == 0, done.output
    assert target.read_text().startswith("ISO-10303-21;")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "which MODEL"),
        (("ball_steel",), "which MODEL"),
        (("ball_steel", "-o", "a.step", "--where", "true"), "--where goes with --compare"),
        (("ball_steel", "-o", "a.step", "--step"), "--step goes with --compare"),
        (("ball_steel", "--compare", "--where", "true"), "either a MODEL or --where"),
        (("--compare", "--where", "false"), "no model meets"),
    ],
)
def test_usage(place, words, message):
    done = run(*words, "--lake", place / "lake")
    assert done.exit_code == 2
    assert message in done.output


def test_the_proof_through_step(tmp_path):
    """What STEP itself does not carry is an exception with the columns named, and no fault."""
    write_samples(tmp_path / "files", ["ball_steel", "float_ellipsoid"])
    ingest([tmp_path / "files"], tmp_path / "lake", settings=Settings(max_edge=0.1))
    plain = run("--compare", "--lake", tmp_path / "lake", "-j", 1)
    assert plain.exit_code == 0, plain.output
    report = tmp_path / "report.json"
    done = run("--compare", "--step", "--lake", tmp_path / "lake", "-j", 1, "-o", report)
    assert done.exit_code == 0, done.output
    found = {row["name"]: row for row in json.loads(report.read_text())["models"]}
    assert found["ball_steel"]["verdict"] == "equal"
    assert found["float_ellipsoid"]["verdict"] == "step-loses"
    reasons = " ".join(found["float_ellipsoid"]["reasons"])
    assert "parts.volume differs" in reasons or "rows, not" in reasons
