"""Export in ABC's formats, import, export again: all files are the same, byte by byte."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("OCP")

import yaml

import breplake
from breplake.ingest.run import ingest
from breplake.ingest.settings import Settings
from breplake.queries.abc import export
from breplake.schema.abc import file_name

ABC = Path(__file__).parents[3] / "shared" / "abc_groundtruth"
MODEL = "00000050_80d90bfdd2e74e709956122a_000"
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

SOME = ("gasket_wave", "weight_lemon", "handwheel", "screw_countersunk", "plumb_bob")


def assert_same_files(one: Path, two: Path) -> None:
    names = sorted(path.name for path in one.iterdir())
    assert names == sorted(path.name for path in two.iterdir())
    assert [n for n in names if (one / n).read_bytes() != (two / n).read_bytes()] == []


def assert_round_trip(lake, models, folder: Path) -> None:
    first = export(lake, models, folder / "first")
    done = ingest([folder / "first"], folder / "lake", collection="back", jobs=1)
    assert (done.n_models, done.n_fatal) == (first.written, 0)
    back = breplake.open(folder / "lake")
    repaired = "SELECT name, import_repairs FROM models WHERE len(import_repairs) > 0"
    assert back.sql(repaired).fetchall() == []
    export(back, None, folder / "second")
    assert_same_files(folder / "first", folder / "second")


def test_export_import_export_is_identical(sample_lake, tmp_path):
    assert_round_trip(breplake.open(sample_lake), SOME, tmp_path)


@pytest.mark.slow
def test_export_import_export_of_all_samples_is_identical(sample_lake, tmp_path):
    assert_round_trip(breplake.open(sample_lake), None, tmp_path)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """The lake of an original STEP file, and what was published of it."""
    if not ABC.is_dir():
        pytest.skip("the original ABC models are not here")
    folder = tmp_path_factory.mktemp("original")
    step = ABC / MODEL.replace("_000", "_step_000.step")
    ingest([step], folder / "lake", collection="abc", settings=Settings(max_edge=0.03), jobs=1)
    published = ABC / MODEL.replace("_000", "_features_000.zero_based.yml")
    return breplake.open(folder / "lake"), yaml.load(published.read_text(), LOADER)


def test_inventory_of_an_original_model(original, tmp_path):
    lake, published = original
    export(lake, None, tmp_path)
    ours = yaml.load((tmp_path / file_name(MODEL, "features")).read_text(), LOADER)
    compared = Counter()
    for part in ("curves", "surfaces"):
        assert [row["type"] for row in ours[part]] == [row["type"] for row in published[part]]
        for mine, theirs in zip(ours[part], published[part], strict=True):
            assert theirs.keys() <= mine.keys()
            for key in theirs.keys() - {"vert_indices", "vert_parameters", "face_indices"}:
                if isinstance(theirs[key], float) or (part, key) == ("surfaces", "location"):
                    np.testing.assert_allclose(mine[key], theirs[key], atol=1e-6)
                    compared[key] += 1
    assert compared["radius"] > 50
    assert compared["location"] == 43
    stats = yaml.safe_load((tmp_path / file_name(MODEL, "stats")).read_text())
    theirs = yaml.safe_load((ABC / MODEL.replace("_000", "_stats_000.yml")).read_text())
    assert theirs.keys() <= stats.keys()
    for key in ("#parts", "#surfs", "#edges", "#points", "surfs", "curves"):
        assert stats[key] == theirs[key]


def test_round_trip_of_an_original_model(original, tmp_path):
    assert_round_trip(original[0], None, tmp_path)
