"""Files with all kinds of faults: a run ends, and each of its inputs is accounted for."""

import random
import tempfile
from pathlib import Path

import pytest

pytest.importorskip("OCP")

import typer
from typer.testing import CliRunner

import breplake
from breplake.bench.robustness import fuzz, kills
from breplake.bench.robustness.mutations import FAULTS, mutated
from breplake.ingest.samples import write_samples

CORPUS = Path(__file__).parents[3] / "shared/corpus"
HANG = "abc_skoch9/conversion_failure__00100003_35809b42367c59ffb8aca25e_step_001.step"
"""A model whose areas take Open CASCADE 90 s."""


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    (path,) = write_samples(tmp_path_factory.mktemp("part"), ["ring_o"])
    return path


@pytest.mark.parametrize("fault", FAULTS)
def test_mutants(part, fault):
    data = part.read_bytes()
    found = {mutated(data, fault, seed) for seed in range(5)}
    assert data not in found
    assert len(found) > 1
    assert mutated(data, fault, 3) == mutated(data, fault, 3)


@pytest.fixture
def scratch():
    """A folder with a short path: sockets lie in it."""
    with tempfile.TemporaryDirectory() as place:
        yield Path(place)


def test_mutants_are_all_accounted_for(part, tmp_path, scratch):
    (tmp_path / "in").mkdir()
    fuzz.write_mutants(tmp_path / "in", [part], len(FAULTS))
    options = ("--max-edge", "0.1", "--jobs", "2")
    lake = tmp_path / "lake"
    assert fuzz.run_ingest(tmp_path / "in", lake, scratch, *options) == []
    opened = breplake.open(lake)
    assert fuzz.account(opened, tmp_path / "in") == []
    ((fatal,),) = opened.sql("SELECT count(*) FROM failures WHERE fatal").fetchall()
    assert fatal >= 3  # the faults are faults
    lost = random.Random(0).choice(sorted((tmp_path / "in").iterdir()))
    (tmp_path / "in/another.step").write_bytes(b"")
    lost.unlink()
    wrong = fuzz.account(opened, tmp_path / "in")
    assert [line.split()[0] for line in wrong] == ["another.step", lost.name]


@pytest.mark.slow
@pytest.mark.skipif(not CORPUS.is_dir(), reason="needs the corpus")
def test_mutants_of_the_corpus():
    command = [str(CORPUS), "--hang", str(CORPUS / HANG)]

    app = typer.Typer()
    app.command()(fuzz.main)
    result = CliRunner().invoke(app, command)
    print(result.output)
    assert result.exit_code == 0
    assert "502 files" in result.output
    assert "timeout in stage brep" in result.output


def test_kills_show_nowhere(part, tmp_path):
    options = ("--max-edge", "0.1", "--jobs", "1")
    rng = random.Random(1)
    kills.disturbed([part], tmp_path / "whole", kills=0, longest=0, rng=rng, options=options)
    whole = kills.contents(tmp_path / "whole")
    assert len(whole["models"]) == 1
    lake = tmp_path / "lake"
    done = kills.disturbed([part], lake, kills=2, longest=4, rng=rng, options=options)
    assert 0 < done <= 2
    assert kills.differences(lake, whole) == []
    stray = lake / "tables/models/stray.parquet"
    stray.write_bytes(b"left by a writer")
    assert kills.differences(lake, whole) == []  # gc removes it
    assert not stray.exists()
    changed = whole | {"patches": whole["patches"].head(0)}
    assert kills.differences(lake, changed) == ["lake: patches differ"]


@pytest.mark.slow
@pytest.mark.skipif(not CORPUS.is_dir(), reason="needs the corpus")
def test_kills_on_the_corpus():
    app = typer.Typer()
    app.command()(kills.main)
    result = CliRunner().invoke(app, [str(CORPUS)])
    print(result.output)
    assert result.exit_code == 0
    assert "50 kills" in result.output
