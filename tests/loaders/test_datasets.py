"""What samples hold: transforms, labels, local patches, graphs, batches of different sizes."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import breplake
from breplake.errors import MissingExtraError, NameNotFoundError, SampleError, UsageError
from breplake.loaders import (
    Drop,
    GraphDataset,
    GraphSample,
    GridDataset,
    Jitter,
    LabelledMeshDataset,
    Loader,
    LocalPatchDataset,
    MeshDataset,
    Normalise,
    Rotate,
    collate_padded,
    collate_ragged,
)
from breplake.loaders.graphs import EDGE_FEATURES, NODE_FEATURES
from breplake.loaders.local import grow
from breplake.queries.subsets import create_subset
from breplake.schema.types import SURFACE_TYPES


@pytest.fixture
def meshes(tiny_lake):
    return MeshDataset(tiny_lake)


@pytest.fixture(scope="module")
def samples(sample_lake):
    return MeshDataset(sample_lake)


def test_a_subset_and_its_splits(own_lake, new_shard):
    lake = breplake.open(own_lake, at=1)
    frozen = create_subset(lake, "all", where="true", split={"train": 0.5, "test": 0.5}, seed=1)
    newest = breplake.open(own_lake)
    dataset = MeshDataset(newest, subset="all")
    assert dataset.snapshot == frozen.snapshot == 1
    assert dataset.model_ids.tolist() == frozen.ids().tolist()
    splits = [MeshDataset(own_lake, subset=frozen, split=name) for name in frozen.splits]
    assert sorted(i for s in splits for i in s.model_ids.tolist()) == frozen.ids().tolist()
    assert "subset='all', split='train'" in repr(splits[0])
    whole = MeshDataset(newest, subset=create_subset(newest, "new", where="true"))
    assert (len(whole), whole.index.left_out) == (4, 1)  # one model has no mesh
    with pytest.raises(UsageError, match="leave out where"):
        MeshDataset(newest, where="true", subset="all")
    with pytest.raises(UsageError, match="name the subset"):
        MeshDataset(newest, split="train")
    with pytest.raises(NameNotFoundError, match="no split"):
        MeshDataset(newest, subset="all", split="validation")


def test_a_subset_of_another_lake_is_refused(own_lake, tiny_lake):
    frozen = create_subset(breplake.open(own_lake), "a", where="true")
    with pytest.raises(UsageError, match="of another lake"):
        MeshDataset(tiny_lake, subset=frozen)


def test_normalise(meshes):
    plain = meshes.points(50)[1]
    for centre in ("box", "mean"):
        cloud = meshes.points(50, transforms=[Normalise(centre)])[1]
        assert cloud.positions.norm(dim=1).max() == pytest.approx(1)
        scale = (plain.positions[0] - plain.positions[1]).norm() / (
            cloud.positions[0] - cloud.positions[1]
        ).norm()
        torch.testing.assert_close(cloud.curvatures, plain.curvatures * scale)
    with pytest.raises(UsageError, match="box or mean"):
        Normalise("median")


@given(seed=st.integers(0, 2**32), axis=st.sampled_from([None, "x", "y", "z"]))
def test_rotations_are_rotations(seed, axis):
    matrix = Rotate(axis).matrix(np.random.default_rng(seed))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1)
    if axis:
        unit = np.eye(3)["xyz".index(axis)]
        np.testing.assert_allclose(matrix @ unit, unit, atol=1e-12)


def test_rotations_are_even_over_all():
    """Turned directions have mean 0 and covariance 1/3."""
    generator = np.random.default_rng(0)
    turned = np.array([Rotate().matrix(generator)[:, 0] for _ in range(4000)])
    assert np.abs(turned.mean(axis=0)).max() < 0.04  # 4 sigma
    np.testing.assert_allclose(np.cov(turned.T), np.eye(3) / 3, atol=0.03)


def test_rotation_turns_normals_along(meshes):
    plain, turned = meshes.points(30)[0], meshes.points(30, transforms=[Rotate()])[0]
    torch.testing.assert_close(
        (plain.positions * plain.normals).sum(dim=1), (turned.positions * turned.normals).sum(dim=1)
    )
    assert not torch.allclose(plain.normals, turned.normals)


def test_jitter_and_drop(meshes):
    plain = meshes.points(2000)[0]
    noisy = meshes.points(2000, transforms=[Jitter(0.1)])[0]
    moved = noisy.positions - plain.positions
    assert moved.std() == pytest.approx(0.1, rel=0.05)
    dropped = meshes.points(2000, transforms=[Drop(0.25)])[0]
    assert len(dropped.positions) == len(dropped.types) == pytest.approx(1500, abs=80)
    assert len(meshes.points(3, transforms=[Drop(0.999)])[0].positions) >= 1
    with pytest.raises(UsageError, match="point clouds"):
        MeshDataset(meshes.index.lake, transforms=[Drop(0.5)])[0]
    for wrong in (lambda: Drop(1), lambda: Jitter(-1), lambda: Rotate("w")):
        with pytest.raises(UsageError):
            wrong()


def test_transforms_depend_on_seed_epoch_and_model_alone(meshes):
    def cloud(seed, epoch, index=0):
        dataset = meshes.points(8, seed, transforms=[Jitter(1.0), Rotate()])
        return dataset.sample(index, epoch).positions

    assert torch.equal(cloud(0, 0), cloud(0, 0))
    for other in ((1, 0), (0, 1), (0, 0, 1)):
        assert not torch.allclose(cloud(0, 0), cloud(*other))


def test_points_of_triangles_are_even_over_the_area(samples):
    index = next(i for i in range(len(samples)) if samples.name(i) == "weight_lemon")
    cloud = samples.points(20_000, source="triangles")[index]
    mesh = samples[index]
    corners = mesh.positions[mesh.triangles].double()
    area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = area.norm(dim=1) / 2
    expected = torch.zeros(len(samples.index.patch_types(index)), dtype=torch.float64)
    expected.index_add_(0, mesh.triangle_patch, area / area.sum())
    found = torch.bincount(cloud.patches, minlength=len(expected)) / len(cloud.patches)
    error = (found - expected).abs() / (expected * (1 - expected) / 20_000).sqrt().clamp_min(1e-9)
    assert error[expected < 1].max() < 5  # standard deviations
    torch.testing.assert_close(cloud.normals.norm(dim=1), torch.ones(20_000))
    assert (cloud.types == torch.from_numpy(samples.index.patch_types(index))[cloud.patches]).all()


def test_normals_of_triangles_are_nearly_the_surface(samples):
    """On a ball they are the direction from its centre, but for the sagitta of an edge."""
    index = next(i for i in range(len(samples)) if samples.name(i) == "ball_steel")
    cloud = samples.points(2000, source="triangles")[index]
    centre = samples[index].positions.double().mean(dim=0)
    direction = torch.nn.functional.normalize(cloud.positions.double() - centre)
    assert (direction * cloud.normals).sum(dim=1).min() > 0.999


def test_exact_points_are_those_of_the_lake(samples):
    clouds = samples.points(300, seed=5, source="exact")
    index = next(i for i in range(len(samples)) if samples.name(i) == "ball_steel")
    cloud = clouds[index]
    sphere = samples.index.table("patches", index, ["location", "radius"]).to_pylist()[0]
    offset = cloud.positions.double() - torch.tensor(list(sphere["location"].values()))
    np.testing.assert_allclose(offset.norm(dim=1), sphere["radius"], rtol=1e-6)
    np.testing.assert_allclose(offset / sphere["radius"], cloud.normals, atol=1e-6)
    np.testing.assert_allclose(cloud.curvatures, -1 / sphere["radius"], rtol=1e-6)
    assert torch.equal(clouds[index].positions, cloud.positions)
    assert not torch.equal(clouds.sample(index, 1).positions, cloud.positions)
    assert not torch.equal(
        samples.points(300, seed=6, source="exact")[index].positions, cloud.positions
    )
    with pytest.raises(UsageError, match="vertices or triangles or exact"):
        samples.points(3, source="surface")


def test_types_name_the_patches(samples):
    lake = samples.index.lake
    for index in range(0, len(samples), 5):
        names = lake.read("patches", int(samples.model_ids[index]), ["type"]).column("type")
        codes = samples.index.patch_types(index)
        assert [SURFACE_TYPES[code] for code in codes] == names.to_pylist()


def test_labelled_meshes(samples):
    labelled = LabelledMeshDataset(samples)
    for index in range(0, len(samples), 4):
        sample = labelled[index]
        assert torch.equal(sample.triangle_types, sample.patch_types[sample.triangle_patch])
        assert torch.equal(sample.normal_types, sample.patch_types[sample.normal_patch])
        on_sharp = torch.zeros(len(sample.positions), dtype=torch.bool)
        on_sharp[sample.sharp_edges.flatten()] = True
        assert torch.equal(on_sharp, sample.sharp_vertices)
        # interior vertices and those on smooth curves alone are on no sharp one
        features = samples[index].features
        assert not on_sharp[features < 2].any()
        assert on_sharp[features == 2].all()
        edges = set()
        for a, b, c in sample.triangles.tolist():
            edges |= {frozenset(pair) for pair in ((a, b), (b, c), (c, a))}
        assert all(frozenset(pair) in edges for pair in sample.sharp_edges.tolist())


@pytest.mark.parametrize("n", [3, 64, 200])
def test_local_patches_have_exactly_n_vertices(samples, n):
    local = samples.local_patches(n, per_model=2, seed=1)
    assert isinstance(local, LocalPatchDataset)
    assert len(local) == 2 * (samples.index.counts("vertex") >= n).sum()
    for index in range(0, len(local), 5):
        patch = local[index]
        mesh = samples[int(local._rows[index // 2])]
        assert len(patch.positions) == len(patch.normals) == n
        assert len(set(patch.vertices.tolist())) == n
        assert torch.equal(patch.positions, mesh.positions[patch.vertices])
        assert patch.triangles.unique().tolist() == list(range(n))  # connected: each in one
        length = patch.normals.norm(dim=1)
        assert ((length - 1).abs() < 1e-5)[~length.isnan()].all()
    assert not torch.equal(local[0].vertices, local[1].vertices)
    assert torch.equal(local[2].vertices, samples.local_patches(n, 2, seed=1)[2].vertices)


def test_local_patches_grow_in_rings():
    """On a grid: the nearest vertices first."""
    side = 21
    corner = np.arange(side * side).reshape(side, side)
    a, b, c, d = (
        x.ravel() for x in (corner[:-1, :-1], corner[1:, :-1], corner[:-1, 1:], corner[1:, 1:])
    )
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])
    middle = int(corner[10, 10])
    for n in (3, 7, 30, 100, 441):
        found = grow(triangles, middle, n)
        assert found[0] == middle
        assert len(set(found.tolist())) == n
        row, column = found // side - 10, found % side - 10
        # with diagonals one way, rings are hexagons
        ring = np.maximum(np.maximum(np.abs(row), np.abs(column)), np.abs(row + column))
        assert (np.diff(ring) >= 0).all()
    assert grow(triangles, middle, 442) is None


def test_a_triangle_that_does_not_fit_is_passed_over():
    """Around vertex 0: the first triangle brings two new vertices, room is for one more."""
    triangles = np.array([[0, 1, 2], [0, 3, 4], [0, 2, 5]])
    assert grow(triangles, 0, 4).tolist() == [0, 1, 2, 5]
    assert grow(triangles, 0, 3).tolist() == [0, 1, 2]
    assert grow(np.array([[0, 1, 2], [2, 3, 4]]), 0, 4) is None


def test_models_without_room_for_a_patch(samples, meshes):
    assert len(meshes.local_patches(9)) == 0
    with pytest.raises(UsageError, match="at least 3"):
        meshes.local_patches(2)
    index = samples.index
    several = [
        i for i in range(len(samples)) if index.table("models", i, ["n_parts"])[0][0].as_py() > 1
    ]
    name = index.name(several[0])
    whole = MeshDataset(index.lake, where=f"name = '{name}'")
    n = int(whole.index.counts("vertex")[0])
    with pytest.raises(SampleError, match=rf"model {name} .*no piece of {n} vertices"):
        list(Loader(whole.local_patches(n), 1))


def test_batches_of_local_patches(samples):
    batch = next(iter(Loader(samples.local_patches(100), 4)))
    assert batch.samples.positions.shape == (4, 100, 3)
    mask = batch.mask("triangles")
    assert mask.sum().item() == batch.lengths["triangles"].sum()
    assert (batch.samples.triangles[~mask] == -1).all()
    assert (batch.samples.triangles[mask] >= 0).all()


def test_padded_and_ragged_hold_the_same(meshes):
    clouds = meshes.points(40, transforms=[Drop(0.4)])
    parts = [clouds[i] for i in range(4)]
    padded, ragged = collate_padded(parts), collate_ragged(parts)
    for i, part in enumerate(parts):
        assert torch.equal(padded.samples.positions[i][padded.mask()[i]], part.positions)
        rows = slice(*ragged.offsets["positions"][i : i + 2].tolist())
        assert torch.equal(ragged.samples.normals[rows], part.normals)
    assert padded.samples.name == ragged.samples.name == tuple(p.name for p in parts)
    assert padded.samples.model_id.tolist() == clouds.model_ids.tolist()
    for collate in (collate_padded, collate_ragged):
        with pytest.raises(UsageError, match="at least one"):
            collate([])


def test_graphs_agree_with_the_view(samples):
    graphs = GraphDataset(samples, form="sample")
    lake = samples.index.lake
    for index in range(0, len(samples), 3):
        graph = graphs[index]
        assert isinstance(graph, GraphSample)
        rows = lake.sql(
            "SELECT patch_a, patch_b, curve_id, length, sharp FROM adjacency WHERE model_id = ? "
            "ORDER BY curve_id, patch_a, patch_b",
            [graph.model_id],
        ).fetchall()
        half = len(rows)
        assert graph.edge_index.shape == (2, 2 * half)
        assert graph.edge_index[:, :half].T.tolist() == [list(row[:2]) for row in rows]
        assert torch.equal(graph.edge_index[:, half:], graph.edge_index[:, :half].flip(0))
        assert graph.curves[:half].tolist() == [row[2] for row in rows]
        model = lake.model(graph.model_id)
        length = graph.edge_attr[:half, EDGE_FEATURES.index("length")] * model["diagonal"]
        np.testing.assert_allclose(length, [row[3] or 0 for row in rows], rtol=1e-5)
        assert graph.edge_attr[:half, -1].tolist() == [float(row[4]) for row in rows]
        assert graph.x.shape == (model["n_patches"], len(NODE_FEATURES))
        assert graph.edge_attr.shape[1] == len(EDGE_FEATURES)
        assert graph.x[:, NODE_FEATURES.index("area")].sum() == pytest.approx(1, rel=1e-4)
        assert (graph.x[:, :9].argmax(dim=1) == graph.patch_types).all()
        assert not graph.x.isnan().any()
        assert not graph.edge_attr.isnan().any()


def test_graphs_of_torch_geometric(samples):
    geometric = pytest.importorskip("torch_geometric.data")
    graphs = GraphDataset(samples, form="data")
    assert isinstance(graphs[0], geometric.Data)
    batch = next(iter(Loader(graphs, 3)))
    assert batch.num_graphs == 3
    assert batch.x.shape[1] == len(NODE_FEATURES)


def test_graphs_without_torch_geometric(meshes, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch_geometric", None)
    monkeypatch.setattr("breplake.loaders.graphs.find_spec", lambda name: None)
    assert isinstance(GraphDataset(meshes)[0], GraphSample)
    with pytest.raises(MissingExtraError, match=r"breplake\[graphs\]"):
        GraphDataset(meshes, form="data")
    with pytest.raises(UsageError, match="auto, data or sample"):
        GraphDataset(meshes, form="dgl")
    batch = next(iter(Loader(GraphDataset(meshes), 4)))
    assert batch.samples.x.shape == (4, 6, len(NODE_FEATURES))


def test_lakes_without_grids_say_so(meshes):
    with pytest.raises(UsageError, match=r"4 of 4 models have no UV-grids, .* --uv-grid N"):
        GridDataset(meshes)


def test_without_lightning_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "lightning", None)
    monkeypatch.delitem(sys.modules, "breplake.loaders.lightning", raising=False)
    with pytest.raises(MissingExtraError, match=r"breplake\[lightning\]"):
        import breplake.loaders.lightning  # noqa: F401
