"""Datasets: the same samples whatever the workers, typed, and clear when misused."""

from __future__ import annotations

import pickle
import subprocess
import sys
from operator import itemgetter

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import breplake
from breplake.errors import LakeFormatError, MissingExtraError, UsageError
from breplake.loaders import (
    MeshBatch,
    MeshDataset,
    MeshSample,
    PointCloudDataset,
    PointCloudSample,
    collate_meshes,
)
from breplake.loaders.points import draw

# torch forks its workers although duckdb and polars have threads: that is what is tested
pytestmark = pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")


@pytest.fixture
def dataset(tiny_lake):
    return MeshDataset(tiny_lake)


first = itemgetter(0)
"""Collation that keeps a sample as it is, and that spawned workers can import."""


def assert_same(a, b):
    assert type(a) is type(b)
    for left, right in zip(a, b, strict=True):
        if isinstance(left, torch.Tensor):
            assert left.dtype == right.dtype
            torch.testing.assert_close(left, right, rtol=0, atol=0, equal_nan=True)
        else:
            assert left == right


def test_samples_are_typed(dataset):
    sample = dataset[0]
    assert isinstance(sample, MeshSample)
    shapes = {
        "positions": ((8, 3), torch.float32),
        "normals": ((24, 3), torch.float32),
        "curvatures": ((24, 2), torch.float32),
        "normal_patch": ((24,), torch.int64),
        "triangles": ((12, 3), torch.int64),
        "triangle_normals": ((12, 3), torch.int64),
        "triangle_patch": ((12,), torch.int64),
        "features": ((8,), torch.uint8),
    }
    for name, (shape, dtype) in shapes.items():
        tensor = getattr(sample, name)
        assert (tuple(tensor.shape), tensor.dtype) == (shape, dtype), name
        tensor.add_(1)  # a sample is the caller's own
    assert sample.snapshot == dataset.snapshot == 2


def test_samples_agree_with_the_tables(dataset, tiny_lake):
    lake = breplake.open(tiny_lake)
    for sample in (dataset[i] for i in range(len(dataset))):
        assert lake.model(sample.name)["model_id"] == sample.model_id
        vertices = lake.read("vertices", sample.model_id)
        faces = lake.read("faces", sample.model_id)
        at = vertices.column("vertex_id").to_numpy().copy()  # torch wants it writable
        for i, axis in enumerate("xyz"):
            np.testing.assert_array_equal(vertices.column(axis), sample.positions[at, i])
            np.testing.assert_array_equal(vertices.column(f"n{axis}"), sample.normals[:, i])
            np.testing.assert_array_equal(faces.column(f"v{i}"), sample.triangles[:, i])
            np.testing.assert_array_equal(faces.column(f"n{i}"), sample.triangle_normals[:, i])
        np.testing.assert_array_equal(vertices.column("patch_id"), sample.normal_patch)
        np.testing.assert_array_equal(faces.column("patch_id"), sample.triangle_patch)


def test_models_with_a_mesh_in_order_of_id(dataset, tiny_lake):
    names = {dataset[i].name for i in range(len(dataset))}
    assert names == {"small", "long/flat", "big", "wide"}
    assert (np.diff(dataset.model_ids) > 0).all()
    assert dataset[-1].model_id == dataset.model_ids[-1]
    with pytest.raises(IndexError, match="sample 4 of 4"):
        dataset[4]
    assert "4 meshes at 2" in repr(dataset)
    assert len(MeshDataset(breplake.open(tiny_lake, at=1))) == 2


@pytest.mark.parametrize(
    ("where", "names"),
    [
        ("volume > 50", {"big", "wide"}),
        ("volume > 50 -- large ones", {"big", "wide"}),
        ("false OR name = 'small'", {"small"}),
        ("n_torus > 30", set()),
        ("model_id IN (SELECT model_id FROM curves WHERE length = 9)", {"long/flat"}),
        ("mesh_kind IS NULL OR true", {"big", "wide", "small", "long/flat"}),
    ],
)
def test_where(tiny_lake, where, names):
    dataset = MeshDataset(tiny_lake, where=where)
    assert {dataset[i].name for i in range(len(dataset))} == names


@pytest.mark.parametrize(
    "where", ["n_torsu > 30", "", "1); DROP VIEW models; --", "name / 'x'", "n_torus >"]
)
def test_a_wrong_where_is_named(tiny_lake, where):
    with pytest.raises(UsageError, match="is no condition on models"):
        MeshDataset(tiny_lake, where=where)


@pytest.mark.parametrize("context", [None, "fork", "spawn"])
def test_workers_change_nothing(dataset, context):
    expected = [dataset[i] for i in range(len(dataset))]  # the parent reads, then forks
    workers = 0 if context is None else 2
    loader = DataLoader(
        dataset,
        num_workers=workers,
        collate_fn=first,
        multiprocessing_context=context,
        timeout=60 if context else 0,
    )
    found = list(loader)
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        assert_same(a, b)


def test_fork_after_everything_was_used_in_the_parent(tiny_lake):
    """Other libraries' threads die in a fork; a worker must not wait for them."""
    lake = breplake.open(tiny_lake)
    lake.sql("FROM models").fetchall()
    lake.scan("vertices").collect()
    lake.read("faces", lake.model("big")["model_id"])
    dataset = MeshDataset(lake)
    points = dataset.points(16)
    expected = points[3]
    loader = DataLoader(
        points, num_workers=2, collate_fn=first, multiprocessing_context="fork", timeout=60
    )
    assert_same(list(loader)[3], expected)


def test_pickle(dataset):
    dataset[0]
    assert_same(pickle.loads(pickle.dumps(dataset))[1], dataset[1])


def test_ragged_batches(dataset):
    batch = next(iter(DataLoader(dataset, batch_size=3, collate_fn=collate_meshes)))
    assert isinstance(batch, MeshBatch)
    assert batch.vertex_offsets.tolist() == [0, 8, 16, 24]
    assert batch.normal_offsets.tolist() == [0, 24, 48, 72]
    assert batch.face_offsets.tolist() == [0, 12, 24, 36]
    assert batch.names == tuple(dataset[i].name for i in range(3))
    assert batch.model_ids.tolist() == dataset.model_ids[:3].tolist()
    for i in range(3):
        rows = slice(*batch.face_offsets[i : i + 2].tolist())
        one = dataset[i]
        assert torch.equal(batch.positions[batch.triangles[rows]], one.positions[one.triangles])
        assert torch.equal(
            batch.normals[batch.triangle_normals[rows]], one.normals[one.triangle_normals]
        )
    with pytest.raises(UsageError, match="one snapshot"):
        collate_meshes([])
    with pytest.raises(UsageError, match="one snapshot"):
        collate_meshes([dataset[0], dataset[1]._replace(snapshot=1)])


@pytest.mark.parametrize("n", [1, 10, 24, 100])
def test_point_clouds_have_exactly_n_points(dataset, n):
    points = dataset.points(n)
    assert isinstance(points, PointCloudDataset)
    assert len(points) == len(dataset)
    batch = next(iter(DataLoader(points, batch_size=4)))
    assert isinstance(batch, PointCloudSample)
    assert batch.positions.shape == batch.normals.shape == (4, n, 3)
    assert batch.patches.shape == batch.features.shape == (4, n)
    assert batch.model_id.tolist() == dataset.model_ids.tolist()


def test_points_lie_on_their_patches(dataset):
    """Of a box: the patch's number tells axis and side."""
    sample = dataset.points(24)[0]
    size = dataset[0].positions.max(dim=0).values
    axis, side = sample.patches // 2, sample.patches % 2
    rows = torch.arange(24)
    assert torch.equal(sample.positions[rows, axis], size[axis] * side)
    assert torch.equal(sample.normals[rows, axis], 2.0 * side - 1)
    assert len(torch.unique(torch.cat([sample.positions, sample.normals], dim=1), dim=0)) == 24


def test_draws_depend_on_seed_model_and_epoch_alone(dataset):
    def cloud(seed, epoch, index=0):
        points = dataset.points(12, seed)
        points.set_epoch(epoch)
        return points[index].positions

    assert torch.equal(cloud(0, 0), cloud(0, 0))
    assert not torch.equal(cloud(0, 0), cloud(1, 0))
    assert not torch.equal(cloud(0, 0), cloud(0, 1))
    assert draw(50, 20, (0, 1, 0)).tolist() != draw(50, 20, (0, 2, 0)).tolist()
    for bad in ({"n": 0}, {"n": 5, "seed": -1}):
        with pytest.raises(UsageError, match="at least"):
            dataset.points(**bad)
    with pytest.raises(UsageError, match="epoch"):
        dataset.points(4).set_epoch(-1)


def test_draws_repeat_only_where_they_must():
    for count, n in [(10, 10), (10, 3), (10, 25), (1, 4)]:
        numbers = draw(count, n, (0, 0, 0))
        times = np.bincount(numbers, minlength=count)
        assert len(numbers) == n
        assert times.max() - times.min() <= 1


def test_workers_that_live_on_see_the_epoch(dataset):
    points = dataset.points(12)
    loader = DataLoader(
        points,
        num_workers=2,
        persistent_workers=True,
        collate_fn=first,
        multiprocessing_context="fork",
        timeout=60,
    )
    epochs = []
    for epoch in range(2):
        points.set_epoch(epoch)
        epochs.append(list(loader))
        assert_same(epochs[epoch][2], points[2])
    assert not torch.equal(epochs[0][2].positions, epochs[1][2].positions)


def test_points_without_a_normal_are_left_out(own_lake, new_shard, monkeypatch):
    dataset = MeshDataset(own_lake)
    real = dataset.index.read

    def read(array, index):
        rows = real(array, index)
        if array == "normal":
            rows[4:] = np.nan
        return rows

    monkeypatch.setattr(dataset.index, "read", read)
    assert dataset.points(50)[0].patches.unique().tolist() == [0]


def test_lost_arrays_are_no_zeros(own_lake):
    for file in own_lake.glob("arrays/s1.zarr/*/c/**/*"):
        if file.is_file():
            file.unlink()
    dataset = MeshDataset(own_lake)
    read = set()
    for i in range(len(dataset)):
        if dataset.name(i) in ("big", "wide"):
            with pytest.raises(LakeFormatError, match=r"s1\.zarr/.* is lost: run breplake verify"):
                dataset[i]
        else:
            assert dataset[i].positions.any()
            read.add(dataset.name(i))
    assert read == {"small", "long/flat"}


def test_without_torch_the_extra_is_named(monkeypatch):
    import breplake.loaders

    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingExtraError, match=r"breplake\[torch\]"):
        breplake.loaders.MeshDataset  # noqa: B018
    with pytest.raises(AttributeError):
        breplake.loaders.Nothing  # noqa: B018


def test_importing_the_package_loads_no_torch():
    code = "import sys, breplake.loaders; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-P", "-c", code]).returncode == 0
