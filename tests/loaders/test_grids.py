"""UV-grids of real parts: what is in the arrays, in samples, and what the check says of them."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.loaders import GridDataset, Loader, MeshDataset, collate_ragged
from breplake.queries.check import check_lake
from breplake.queries.versions.extract import Selection, extract
from breplake.schema.arrays import GRID_ARRAYS

SIZE = 10
PARTS = ("ball_steel", "base_plate_inch", "mug")
"""A sphere; planes with holes, cylinders and tori; a body with a handle of splines."""


@pytest.fixture(scope="module")
def grid_lake(tmp_path_factory):
    pytest.importorskip("OCP")
    from breplake.ingest.samples import write_samples

    folder = tmp_path_factory.mktemp("grids")
    write_samples(folder / "parts", PARTS)
    command = ["ingest", folder / "parts", "--lake", folder / "lake", "--uv-grid", SIZE]
    done = CliRunner().invoke(app, [str(word) for word in [*command, "--max-edge", 0.02]])
    assert done.exit_code == 0, done.output
    return folder / "lake"


def grids(lake, name):
    """The grids of a model: `(patches, n, n, 7)` and `(curves, n, 6)`."""
    row = lake.model(name)
    reader = lake.arrays(row["shard"])
    assert reader.grid == SIZE
    spans = [(row["patch_offset"], row["n_patches"]), (row["curve_offset"], row["n_curves"])]
    return [
        reader.read(array, start, start + count)
        for array, (start, count) in zip(GRID_ARRAYS, spans, strict=True)
    ]


def rows(lake, table, name):
    return lake.read(table, lake.model(name)["model_id"]).to_pylist()


def vector(value):
    return np.array([value["x"], value["y"], value["z"]])


def test_a_sphere(grid_lake):
    lake = breplake.open(grid_lake)
    (sphere,) = rows(lake, "patches", "ball_steel")
    (grid,), _ = grids(lake, "ball_steel")
    point, normal, mask = grid[..., :3], grid[..., 3:6], grid[..., 6]
    assert grid.shape == (SIZE, SIZE, 7)
    assert (mask == 1).all()
    away = point - vector(sphere["location"])
    np.testing.assert_allclose(np.linalg.norm(away, axis=-1), sphere["radius"], rtol=1e-6)
    defined = ~np.isnan(normal).any(axis=-1)
    np.testing.assert_allclose(normal[defined], away[defined] / sphere["radius"], atol=1e-6)
    # the first axis is u, once around; the second is v, from pole to pole
    np.testing.assert_allclose(point[0], point[-1], atol=1e-4)
    for pole in (point[:, 0], point[:, -1]):
        np.testing.assert_allclose(pole, np.tile(pole[0], (SIZE, 1)), atol=1e-4)


def test_the_mask_is_where_the_mesh_of_a_plane_is(grid_lake):
    lake = breplake.open(grid_lake)
    found, _ = grids(lake, "base_plate_inch")
    mesh = MeshDataset(lake, where="name = 'base_plate_inch'")[0]
    corners = mesh.positions[mesh.triangles].numpy()  # (faces, 3, 3)
    seen = agreeing = 0
    for patch in rows(lake, "patches", "base_plate_inch"):
        if patch["type"] != "Plane":
            continue
        grid = found[patch["patch_id"]].reshape(-1, 7)
        axes = np.stack([vector(patch["x_axis"]), vector(patch["y_axis"])], axis=1)
        flat = (grid[:, :3] - vector(patch["location"])) @ axes  # (points, 2)
        own = mesh.triangle_patch.numpy() == patch["patch_id"]
        a, b, c = np.moveaxis((corners[own] - vector(patch["location"])) @ axes, 1, 0)
        sides = [
            (q[:, 0] - p[:, 0]) * (flat[:, None, 1] - p[:, 1])
            - (q[:, 1] - p[:, 1]) * (flat[:, None, 0] - p[:, 0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        least, most = np.minimum.reduce(sides), np.maximum.reduce(sides)  # (points, triangles)
        covered = ((least > -1e-2) | (most < 1e-2)).any(axis=1)
        seen += len(grid)
        agreeing += int((covered == (grid[:, 6] == 1)).sum())
        assert np.abs((grid[:, :3] - vector(patch["location"])) @ np.cross(*axes.T)).max() < 1e-4
    masks = found[..., 6]
    assert set(np.unique(masks)) == {0, 1}  # both: there are holes
    # a hole of the mesh is a polygon: a point may lie between it and the circle
    assert agreeing / seen > 0.99


def test_curves_go_from_corner_to_corner(grid_lake):
    lake = breplake.open(grid_lake)
    for name in PARTS:
        corners = [vector(row["point"]) for row in rows(lake, "corners", name)]
        _, found = grids(lake, name)
        for curve, grid in zip(rows(lake, "curves", name), found, strict=True):
            if curve["kind"] == "degenerate":
                assert np.isnan(grid[:, 3:]).all()
                continue
            np.testing.assert_allclose(np.linalg.norm(grid[:, 3:], axis=1), 1, atol=1e-6)
            ends = [curve["start_corner"], curve["end_corner"]]
            for at, corner in zip((0, -1), ends, strict=True):
                assert np.linalg.norm(grid[at, :3] - corners[corner]) < 1e-3
            steps = np.linalg.norm(np.diff(grid[:, :3], axis=0), axis=1)
            if curve["type"] == "Line":
                np.testing.assert_allclose(steps, curve["length"] / (SIZE - 1), rtol=1e-3)
            else:
                assert steps.sum() <= curve["length"] * 1.0001


def test_samples_hold_the_arrays(grid_lake):
    lake = breplake.open(grid_lake)
    dataset = GridDataset(MeshDataset(lake))
    assert len(dataset) == len(PARTS)
    for sample in dataset:
        patches, curves = grids(lake, sample.name)
        np.testing.assert_array_equal(sample.patch_grids, patches)
        np.testing.assert_array_equal(sample.curve_grids, curves)
        query = """
            SELECT patch_a, patch_b, curve_id FROM adjacency WHERE model_id = ?
            ORDER BY curve_id, patch_a, patch_b
        """
        pairs = lake.sql(query, [sample.model_id]).fetchall()
        half = len(pairs)
        both = np.column_stack([sample.edge_index.T.numpy(), sample.curves.numpy()])
        assert both[:half].tolist() == [list(pair) for pair in pairs]
        np.testing.assert_array_equal(both[half:, :2], both[:half, 1::-1])
    batch = next(iter(Loader(dataset, len(PARTS), shuffle=False)))
    most = max(lake.model(name)["n_patches"] for name in PARTS)
    assert batch.samples.patch_grids.shape == (len(PARTS), most, SIZE, SIZE, 7)
    for at, sample in enumerate(dataset):
        edges = batch.samples.edge_index[at][:, batch.mask("edge_index")[at]]
        assert edges.tolist() == sample.edge_index.tolist()
        assert batch.lengths["edge_index"][at] == batch.lengths["curves"][at] == len(sample.curves)
    joined = collate_ragged(list(dataset))
    first, last = joined.offsets["edge_index"][-2:].tolist()
    assert joined.samples.edge_index[:, first:last].tolist() == sample.edge_index.tolist()


def test_they_are_copied_with_the_models(grid_lake, tmp_path):
    lake = breplake.open(grid_lake)
    extract(lake.store, tmp_path / "some", lake.snapshot, Selection(where="name = 'mug'"))
    some = breplake.open(tmp_path / "some")
    for one, other in zip(grids(some, "mug"), grids(lake, "mug"), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_check_holds(grid_lake):
    report = check_lake(breplake.open(grid_lake))
    assert report.broken == ()
    (rule,) = (rule for rule in report.rules if rule.name == "uv-grids")
    assert rule.checked > 50  # every patch and every curve


@pytest.mark.parametrize("array", GRID_ARRAYS)
def test_the_check_sees_a_change(grid_lake, tmp_path, array):
    import zarr

    shutil.copytree(grid_lake, tmp_path / "lake")
    lake = breplake.open(tmp_path / "lake")
    path = lake.root / f"arrays/{lake.model('mug')['shard']}.zarr"
    stored = zarr.open_array(path / array, mode="r+")
    values = stored[...]
    at = np.unravel_index(np.flatnonzero(~np.isnan(values))[0], values.shape)
    values[at] += 0.01
    stored[...] = values
    broken = {rule.name for rule in check_lake(lake).broken}
    assert broken == {"files", "uv-grids"}
