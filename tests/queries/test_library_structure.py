"""Structure of models by the query library: genus, symmetry, copies, the largest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import breplake
from breplake.queries.session import Lake

from .library import ask, by


def test_genus(samples: Lake):
    rows = by(ask(samples, "genus"))
    assert rows["ball_steel"]["genus"] == rows["weight_lemon"]["genus"] == 0
    assert rows["mug"]["genus"] == rows["gear_spur"]["genus"] == 1
    assert rows["base_plate_mm"]["genus"] == 5  # its holes
    assert "duct_surface" not in rows  # open
    assert min(row["genus"] for row in ask(samples, "genus", min_genus=2)) == 2


def test_genus_where_loops_touch(tmp_path: Path):
    """A boss whose corner is on the block's edge: an inner loop of the top shares its corner."""
    cq = pytest.importorskip("cadquery")
    from breplake.ingest.run import ingest
    from breplake.ingest.settings import Settings

    boss = cq.Workplane().workplane(offset=1).polyline([(2, 0), (1, 1), (1, -1)]).close().extrude(1)
    other = cq.Workplane().workplane(offset=1).polyline([(-2, 0), (-1, 1), (-1, -1)]).close()
    parts = {
        "one": (one := cq.Workplane().box(4, 6, 2).union(boss)),
        "two": (two := one.union(other.extrude(1))),
        "drilled": two.faces("<Z").workplane().center(0, -2).hole(0.5),
    }
    (tmp_path / "parts").mkdir()
    for name, part in parts.items():
        cq.exporters.export(part, str(tmp_path / "parts" / f"{name}.step"))
    ingest([tmp_path / "parts"], tmp_path / "lake", settings=Settings(max_edge=0.2), message="m")
    lake = breplake.open(tmp_path / "lake")
    query = (
        "SELECT m.name, max(n_loops) FROM patches JOIN models AS m USING (model_id) GROUP BY ALL"
    )
    assert dict(lake.sql(query).fetchall()) == {"one": 2, "two": 3, "drilled": 4}
    found = {name: row["genus"] for name, row in by(ask(lake, "genus")).items()}
    assert found == {"one": 0, "two": 0, "drilled": 1}


def test_mirror_images_are_sought_by_distance(tiny_lake: Path):
    """Wherever the grid lies, corners count that are off by less than the tolerance."""
    lake = breplake.open(tiny_lake)
    identity = lake.model("big")["model_id"]
    rng = np.random.default_rng(5)
    half = rng.uniform([1, -1, -1], [3, 1, 1], (200, 3))
    off = rng.normal(size=half.shape)
    off /= np.linalg.norm(off, axis=1, keepdims=True)
    ends = np.array([[-3, -2, -2], [3, 2, 2]])  # decide where the middle is
    for share, planes in ((0.9, 1), (1.1, 0)):
        image = (half + share * 1e-5 * 6 * off) * [-1, 1, 1]
        points = np.concatenate([ends, ends * [-1, 1, 1], half, image])
        rows = {"corner_id": np.arange(len(points)), **dict(zip("xyz", points.T, strict=True))}
        lake.connection.register("given", pa.table(rows))
        lake.connection.execute(
            f"CREATE OR REPLACE TABLE spots AS SELECT {identity}::BIGINT AS model_id, corner_id, "
            "{'x': x, 'y': y, 'z': z} AS point FROM given;"
            "CREATE OR REPLACE VIEW corners AS FROM spots"
        )
        assert [row["planes"] for row in ask(lake, "mirror_symmetry")] == [1] * planes
        (row,) = ask(lake, "mirror_symmetry", min_share=0.0)
        assert row["x"] == (1 if planes else 4 / len(points))


def test_mirror_symmetry(samples: Lake):
    rows = by(ask(samples, "mirror_symmetry"))
    assert rows["trough_parabolic"]["x"] == rows["trough_parabolic"]["y"] == 1
    assert rows["trough_parabolic"]["z"] is None
    assert "ball_steel" not in rows  # too few corners
    assert "gear_spur" in rows


def test_repeated_parts(samples: Lake):
    rows = {row["part"]: row for row in ask(samples, "repeated_parts", model="flange_joint")}
    assert (rows["bolt"]["copies"], rows["nut"]["copies"], rows["flange"]["copies"]) == (8, 8, 2)
    mirrored = ask(samples, "repeated_parts", model="shelf_brackets")
    assert {row["copies"] for row in mirrored} == {2}
    assert len(ask(samples, "repeated_parts", model="ball_steel", min_copies=1)) == 1


def test_largest_models(samples: Lake):
    rows = ask(samples, "largest_models", limit=3)
    values = [n for (n,) in samples.sql("SELECT n_patches FROM models").fetchall()]
    assert [row["value"] for row in rows] == sorted(values, reverse=True)[:3]
    assert len(ask(samples, "largest_models", by="volume")) <= 20
    with pytest.raises(Exception, match="by is patches, curves"):
        ask(samples, "largest_models", by="weight")


def test_duplicates(samples: Lake):
    (cluster,) = ask(samples, "duplicates")
    assert cluster["names"] == ["base_plate_inch", "base_plate_mm"]
    assert cluster["models"] == 2
    assert ask(samples, "duplicates", min_models=3) == []
