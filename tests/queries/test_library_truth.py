"""Queries of the library recomputed with polars from the files, by other means."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

import breplake
from breplake.queries.session import Lake


@pytest.fixture(scope="module")
def lake(sample_lake: Path) -> Lake:
    return breplake.open(sample_lake)


def ask(lake: Lake, name: str, **given) -> pl.DataFrame:
    return lake.query(name, **given).pl()


def same(answer: pl.DataFrame, expected: pl.DataFrame, key: str | list[str]) -> None:
    """Compare the columns of `expected`, whatever the order of the rows."""
    columns = expected.columns
    assert answer.height == expected.height > 0
    left, right = answer.select(columns).sort(key), expected.sort(key)
    for name in columns:
        one, two = left[name].to_list(), right[name].to_list()
        approx = left[name].dtype.is_float() or right[name].dtype.is_float()
        assert one == (pytest.approx(two, rel=1e-12, nan_ok=True) if approx else two), name


def test_surface_types(lake: Lake):
    patches = lake.scan("patches").collect()
    expected = patches.group_by("type").agg(
        pl.len().alias("patches"),
        pl.col("model_id").n_unique().alias("models"),
        pl.col("area").sum(),
    )
    expected = expected.with_columns(
        share=pl.col("patches") / patches.height,
        area_share=pl.col("area") / patches["area"].sum(),
        model_share=pl.col("models") / lake.scan("models").collect().height,
    )
    same(ask(lake, "surface_types"), expected, "type")


def test_patches_per_model(lake: Lake):
    counts = lake.scan("patches").group_by("model_id").len().collect()["len"]
    lows = [max(low for low in range(0, 151, 5) if low <= count) for count in counts]
    expected = (
        pl.DataFrame({"low": lows})
        .group_by("low")
        .agg(pl.len().alias("models"))
        .with_columns(share=pl.col("models") / counts.len())
    )
    same(ask(lake, "patches_per_model").filter(pl.col("models") > 0), expected, "low")


def test_sharp_share(lake: Lake):
    edges = lake.scan("curves").filter(~pl.col("kind").is_in(["seam", "degenerate"])).collect()
    expected = edges.group_by("model_id").agg(
        pl.col("sharp").sum().alias("sharp_curves"),
        (pl.col("length") * pl.col("sharp")).sum().alias("sharp_length"),
        pl.col("length").sum(),
    )
    expected = expected.with_columns(share=pl.col("sharp_length") / pl.col("length"))
    same(ask(lake, "sharp_share"), expected, "model_id")


def test_freeform_share(lake: Lake):
    basis = pl.col("curve").struct.field("type").is_in(["BSpline", "Other"])
    free = pl.col("type").is_in(["BSpline", "Other"]) | (
        pl.col("type").is_in(["Extrusion", "Revolution"]) & basis
    )
    patches = lake.scan("patches").with_columns(free=free.fill_null(False)).collect()
    areas = patches.group_by("model_id").agg(pl.col("area").sum().alias("whole"))
    expected = (
        patches.filter("free")
        .group_by("model_id")
        .agg(pl.len().alias("freeform_patches"), pl.col("area").sum().alias("freeform_area"))
        .join(areas, on="model_id")
        .with_columns(share=pl.col("freeform_area") / pl.col("whole"))
        .filter(pl.col("share") >= 0.25)
        .drop("whole")
    )
    same(ask(lake, "freeform_share", min_share=0.25), expected, "model_id")


def test_neighbours(lake: Lake):
    """From the two sides that `curves` names, where the view goes through the coedges."""
    types = lake.scan("patches").select("model_id", "patch_id", "type").collect()
    pairs = (
        lake.scan("curves")
        .filter(pl.col("left_patch") != pl.col("right_patch"), pl.col("n_patches") == 2)
        .select("model_id", "left_patch", "right_patch", "kind", "length", "angle_min", "angle_max")
        .collect()
        .join(types, left_on=["model_id", "left_patch"], right_on=["model_id", "patch_id"])
        .join(
            types,
            left_on=["model_id", "right_patch"],
            right_on=["model_id", "patch_id"],
            suffix="_b",
        )
        .with_columns(
            type_a=pl.min_horizontal("type", "type_b"),
            type_c=pl.max_horizontal("type", "type_b"),
            turn=(pl.col("angle_min") + pl.col("angle_max")) / 2 * pl.col("length"),
            known=pl.when(pl.col("angle_max").is_not_null()).then("length"),
        )
    )
    expected = (
        pairs.group_by("type_a", type_b="type_c")
        .agg(
            pl.len().alias("pairs"),
            pl.col("length").sum(),
            (pl.col("kind") == "smooth").sum().alias("smooth"),
            (pl.col("turn").sum() / pl.col("known").sum()).alias("mean_angle"),
        )
    )  # fmt: skip
    nonmanifold = lake.scan("curves").filter(pl.col("kind") == "nonmanifold").collect()
    assert nonmanifold.is_empty()
    same(ask(lake, "neighbours"), expected, ["type_a", "type_b"])


def test_duplicates(lake: Lake):
    models = lake.scan("models").select("duplicate_group", "name", "bytes", "fingerprint").collect()
    expected = (
        models.group_by("duplicate_group")
        .agg(
            pl.len().alias("models"),
            pl.col("bytes").sum(),
            pl.col("name").sort().alias("names"),
            pl.col("fingerprint").n_unique(),
        )
        .filter(pl.col("models") > 1)
    )
    assert expected["fingerprint"].to_list() == [1]
    same(ask(lake, "duplicates"), expected.drop("fingerprint"), "duplicate_group")


def test_holes_from_the_cylinders(lake: Lake):
    """In the base plates every concave cylinder is one hole."""
    identity = lake.model("base_plate_mm")["model_id"]
    cylinders = (
        lake.scan("patches")
        .filter(pl.col("model_id") == identity, pl.col("type") == "Cylinder", pl.col("reversed"))
        .filter(pl.col("u_max") - pl.col("u_min") > 6.28)
        .select("patch_id", "radius", depth=pl.col("v_max") - pl.col("v_min"))
        .collect()
    )
    query = "SELECT unnest(patches) AS patch_id, radius, depth, kind FROM holes WHERE model_id = ?"
    holes = lake.sql(query, [identity]).pl()
    same(holes, cylinders, "patch_id")
    assert set(holes["kind"]) == {"through"}
