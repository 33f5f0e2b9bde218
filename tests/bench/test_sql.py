"""The SQL benchmark: its synthetic lake is like its source, and all peers agree on small sizes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import breplake
from breplake.bench.speed import sql
from breplake.bench.speed.sql_lake import Source, make_lake
from breplake.errors import UsageError
from breplake.queries.session import Lake


@pytest.fixture(scope="module")
def source(sample_lake: Path) -> Lake:
    return breplake.open(sample_lake)


@pytest.fixture(scope="module")
def made(source: Lake, tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return make_lake(source, tmp_path_factory.mktemp("sql") / "lake", 600, 9000)


def test_models_and_patches_agree(made: Lake):
    count = "SELECT count(*), count(DISTINCT model_id), count(DISTINCT name) FROM models"
    assert made.sql(count).fetchall() == [(600, 600, 600)]
    assert len(made.files("models")) == 3  # shards as ingest makes them
    wrong = made.sql(
        """
        SELECT name FROM models
        JOIN (
            SELECT
                model_id, count(*) AS n, count(*) FILTER (type = 'Torus') AS tori,
                sum(area) AS a, max(patch_id) + 1 AS ids
            FROM patches GROUP BY model_id
        ) USING (model_id)
        WHERE n <> n_patches OR tori <> n_torus OR ids <> n OR abs(a / area - 1) > 1e-3
        """
    ).fetchall()
    assert wrong == []
    assert made.sql("SELECT count(DISTINCT model_id) FROM patches").fetchall() == [(600,)]
    total = made.sql("SELECT count(*) FROM patches").fetchall()[0][0]
    assert total == pytest.approx(9000, rel=0.2)


def test_no_two_models_are_equal(made: Lake):
    areas = [area for (area,) in made.sql("SELECT area FROM models").fetchall()]
    assert len(set(areas)) == 600
    # directions are not scaled
    axes = made.sql(
        "SELECT max(abs(z_axis.x ** 2 + z_axis.y ** 2 + z_axis.z ** 2 - 1)) FROM patches"
    ).fetchall()
    assert axes[0][0] < 1e-9


@pytest.mark.parametrize("mean", [3.0, 20.0, 150.0])
def test_weights_have_the_mean(source: Lake, mean: float):
    rows = Source.of(source)
    weights = rows.weights(mean)
    assert weights.sum() == pytest.approx(1)
    assert weights @ rows.count == pytest.approx(mean)
    order = np.argsort(rows.count)
    logs = np.log(weights[order])
    assert np.all(np.diff(logs) <= 1e-9) or np.all(
        np.diff(logs) >= -1e-9
    )  # monotonous in the count


def test_means_out_of_reach(source: Lake):
    with pytest.raises(UsageError, match="patches a model"):
        Source.of(source).weights(0.5)


def test_benchmark(source: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    asked = []

    def cold(*arguments: object) -> float:
        asked.append(arguments)
        return real(*arguments) if len(asked) == 1 else 1.0  # one process stands for all

    real = sql._cold
    monkeypatch.setattr(sql, "_cold", cold)
    app = typer.Typer()
    app.command()(sql.main)
    result = CliRunner().invoke(
        app,
        [str(source.root), "--work", str(tmp_path), "--models", "300", "--patches", "6000",
         "--repeat", "1"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert len(asked) == 18
    assert "300 models" in result.stdout
    assert "2 shards" in result.stdout
    assert "torus-rich models, warm:" in result.stdout.splitlines()[-1]
    assert (tmp_path / "lake.sqlite").exists()
