"""The proof of areas and samples holds on sample parts, and sees a wrong sampler."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("OCP")
pytest.importorskip("scipy")

import breplake
from breplake.bench.accuracy import sampling
from breplake.bench.accuracy.sampling import Found, holds, judge, report
from breplake.schema.trimming.sampling import UniformSampler

UNLIKELY = 1e-6


@pytest.fixture(scope="module")
def lake(sample_lake):
    return breplake.open(sample_lake)


@pytest.mark.parametrize("name", ["base_plate_mm", "mug"])
def test_a_right_sampler_passes(lake, name):
    found = judge(lake, lake.model(name)["model_id"], 3000)
    assert found.excuse == ""
    assert found.off < sampling.SAME
    assert (found.points, found.outside) == (3000, 0)
    assert len(found.chances) > 1
    assert min(found.chances) > UNLIKELY
    assert holds([found])


def test_a_wrong_sampler_is_seen(lake, monkeypatch):
    """One that keeps the more of its points the higher their v is."""
    draw = UniformSampler.draw

    def crowded(self, count, random):
        row, u, v = draw(self, 4 * count, random)
        low, high = self.patches.window[2:, row]
        kept = random.random(len(v)) < ((v - low) / (high - low)) ** 2
        assert kept.sum() >= count
        return row[kept][:count], u[kept][:count], v[kept][:count]

    monkeypatch.setattr(UniformSampler, "draw", crowded)
    found = judge(lake, lake.model("mug")["model_id"], 3000)
    assert min(found.chances) < UNLIKELY
    assert not holds([found])


def test_points_outside_are_seen(lake, monkeypatch):
    draw = UniformSampler.draw

    def shifted(self, count, random):
        row, u, v = draw(self, count, random)
        return row, u + 0.3, v

    monkeypatch.setattr(UniformSampler, "draw", shifted)
    plate = lake.model("base_plate_mm")["model_id"]
    found = judge(lake, plate, 500)
    assert found.outside > 0
    assert not holds([found])


def test_the_report():
    lines = report(
        [
            Found("good", 1e-9, 100, 0, [0.5, 0.2]),
            Found("off", 1e-3, 100, 2, [0.0]),
            Found("partly", np.nan, 100, 0, []),
            Found("gone", excuse="no such file"),
        ]
    )
    assert lines[0] == "4 models, 3 judged"
    assert lines[1].startswith("1 of 2 have the area")
    assert lines[1].endswith("1 hold a patch that is unknown")
    assert lines[2].startswith("2 of 300 points are outside")
    assert lines[3].startswith("1 of 3 chi-square tests")
    assert [line.strip() for line in lines[4:]] == [
        "area off by 1.0e-03: off",
        "2 points outside: off",
        "left out gone: no such file",
    ]
