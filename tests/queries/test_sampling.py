"""``lake.sample`` and ``breplake sample`` on sample parts, judged by OCCT."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import breplake
from breplake.errors import NameNotFoundError, UsageError
from breplake.queries.poisson import disk_radius
from breplake.schema.trimming.patches import TrimmedPatches

TABLES = ("patches", "curves", "coedges", "pcurves")
PARTS = ("base_plate_mm", "mug", "bottle", "gear_spur", "flange_joint", "ball_steel")


@pytest.fixture(scope="module")
def lake(sample_lake):
    return breplake.open(sample_lake)


def names(lake):
    query = "SELECT name FROM models WHERE n_patches > 0 ORDER BY name"
    return [row[0] for row in lake.sql(query).fetchall()]


def tables(lake, name):
    identity = lake.model(name)["model_id"]
    return {table: lake.read(table, identity) for table in TABLES}


def test_patches_sum_to_the_exact_area(lake):
    """OCCT's own areas are off by up to 1e-5 on some swept splines, as fine meshes show."""
    off = []
    for name in names(lake):
        found = TrimmedPatches.from_tables(**tables(lake, name))
        assert found.known.all(), name
        off.append(abs(found.area().sum() / lake.model(name)["area"] - 1))
    assert max(off) < 5e-5
    assert np.mean(np.array(off) < 1e-6) > 0.8


def test_no_point_is_outside_by_occt(lake):
    pytest.importorskip("OCP")
    from breplake.ingest.pointwise import faces_of, outside

    for name in PARTS:
        model = lake.model(name)
        faces = faces_of(Path(model["path"]), model["format"])
        drawn = lake.sample(name, 3000)
        assert not outside(faces, drawn.patch, drawn.u, drawn.v).any(), name
        # The judge itself can say no: far off the patch nothing is inside.
        assert outside(faces, drawn.patch[:5], drawn.u[:5] + 1e6, drawn.v[:5] + 1e6).any(), name


def test_points_and_normals(lake):
    drawn = lake.sample("ball_steel", 500)
    (sphere,) = lake.read("patches", lake.model("ball_steel")["model_id"]).to_pylist()
    centre = np.array(list(sphere["location"].values()))
    radius = np.linalg.norm(drawn.position - centre, axis=1)
    np.testing.assert_allclose(radius, radius[0], rtol=1e-9)
    np.testing.assert_allclose(drawn.normal, (drawn.position - centre) / radius[0], atol=1e-9)
    np.testing.assert_allclose(drawn.k_min, -1 / radius[0], rtol=1e-9)
    np.testing.assert_allclose(drawn.k_max, -1 / radius[0], rtol=1e-9)


def test_the_same_arguments_give_the_same_points(lake):
    first, again, longer, other = (
        lake.sample("mug", n, seed=s, curves=50)
        for n, s in ((300, 1), (300, 1), (900, 1), (300, 2))
    )
    for name in ("position", "normal", "patch", "u", "v"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
        # Sums of another length are vectorised otherwise, so their last bit may differ.
        np.testing.assert_allclose(
            getattr(first, name), getattr(longer, name)[:300], rtol=1e-12, atol=1e-12
        )
    np.testing.assert_array_equal(first.curves.position, longer.curves.position)
    assert not np.array_equal(first.position, other.position)


def test_poisson_points_keep_their_distance(lake):
    spatial = pytest.importorskip("scipy.spatial")
    count = 1000
    drawn = lake.sample("ball_steel", count, "poisson")
    assert len(drawn) == count
    nearest = spatial.cKDTree(drawn.position).query(drawn.position, 2)[0][:, 1]
    radius = disk_radius(lake.model("ball_steel")["area"], count)
    assert nearest.min() > 2 * radius * 0.6  # the paper reports 0.65 to 0.7
    uniform = lake.sample("ball_steel", count).position
    assert spatial.cKDTree(uniform).query(uniform, 2)[0][:, 1].min() < 2 * radius * 0.2


def test_points_along_sharp_curves(lake):
    drawn = lake.sample("base_plate_mm", 10, spacing=2.0).curves
    curves = lake.read("curves", lake.model("base_plate_mm")["model_id"]).to_pylist()
    sharp = {c["curve_id"]: c["length"] for c in curves if c["sharp"]}
    assert set(drawn.curve.tolist()) == set(sharp)
    counts = np.bincount(drawn.curve, minlength=len(curves))
    for curve, length in sharp.items():
        assert counts[curve] == np.ceil(length / 2)
    np.testing.assert_allclose(np.linalg.norm(drawn.tangent, axis=1), 1, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"n": 0}, "at least 1"),
        ({"n": 5, "method": "grid"}, "uniform or poisson"),
        ({"n": 5, "seed": -1}, "negative"),
        ({"n": 5, "spacing": 0.0}, "more than 0"),
        ({"n": 5, "curves": 5, "spacing": 1.0}, "not both"),
    ],
)
def test_wrong_arguments(lake, arguments, words):
    with pytest.raises(UsageError, match=words):
        lake.sample("mug", **arguments)


def test_unknown_models(lake):
    with pytest.raises(NameNotFoundError):
        lake.sample("mugg", 5)


def run(*words):
    from typer.testing import CliRunner

    from breplake.cli import app

    return CliRunner().invoke(app, ["sample", *map(str, words)])


def test_files(lake, tmp_path):
    base = ("mug", "--lake", lake.root, "-n", 100, "--curves", 20)
    wanted = lake.sample("mug", 100, curves=20)
    for ending in ("npz", "ply", "parquet"):
        assert run(*base, "-o", tmp_path / f"points.{ending}").exit_code == 0
    with np.load(tmp_path / "points.npz") as npz:
        np.testing.assert_array_equal(npz["position"], wanted.position)
        np.testing.assert_array_equal(npz["curve_tangent"], wanted.curves.tangent)
    rows = pq.read_table(tmp_path / "points.parquet")
    assert rows.num_rows == 120
    np.testing.assert_array_equal(rows["x"].to_numpy()[:100], wanted.position[:, 0])
    assert rows["patch_id"].null_count == 20
    data = (tmp_path / "points.ply").read_bytes()
    head, _, body = data.partition(b"end_header\n")
    assert b"element vertex 100\n" in head
    assert len(body) == 100 * (10 * 8 + 4) + 20 * (7 * 8 + 4)
    np.testing.assert_array_equal(np.frombuffer(body, "<f8", 3), wanted.position[0])


def test_many_models(lake, tmp_path):
    where = ("--where", "name IN ('mug', 'bottle')", "--lake", lake.root, "-n", 10)
    assert run(*where, "-o", tmp_path / "a.parquet").exit_code == 0
    rows = pq.read_table(tmp_path / "a.parquet")
    assert rows.num_rows == 20
    assert len(set(rows["model_id"].to_pylist())) == 2
    assert run(*where, "-o", tmp_path / "a.npz").exit_code == 2
    assert run("-o", tmp_path / "a.npz").exit_code == 2
