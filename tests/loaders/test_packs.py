"""Packs: the same clouds, read at memory speed, by any reader of Zarr."""

from __future__ import annotations

import json
import pickle
import shutil

import numpy as np
import pytest
import torch
import zarr

from breplake.errors import LakeFormatError, UsageError
from breplake.loaders import Drop, Loader, MeshDataset, PackedClouds, write_pack
from breplake.loaders.packs import FIELDS
from breplake.queries.subsets import create_subset
from breplake.schema.raw_arrays import RawArray

pytestmark = pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")


@pytest.fixture(scope="module")
def clouds(tiny_lake):
    return MeshDataset(tiny_lake).points(16, seed=2, per_model=20)


@pytest.fixture(scope="module")
def pack(clouds, tmp_path_factory):
    return write_pack(clouds, tmp_path_factory.mktemp("packs") / "pack", tuple(FIELDS))


@pytest.fixture
def small_files(monkeypatch):
    monkeypatch.setattr("breplake.loaders.packs._FILE_BYTES", 7 * 16 * 12)


def test_a_pack_holds_the_clouds_of_its_dataset(clouds, pack):
    assert len(pack) == 80
    batch = pack.batch(np.arange(80), epoch=5)
    for index in (0, 1, 37, 79):
        sample = clouds[index]
        for field in FIELDS:
            assert torch.equal(
                getattr(batch, field)[index].to(torch.float64),
                getattr(sample, field).to(torch.float64),
            )
        assert (batch.name[index], batch.model_id[index]) == (sample.name, sample.model_id)
    assert batch.snapshot == clouds.snapshot


def test_batches_do_not_share_memory(pack):
    batch = pack[3]
    batch.positions.fill_(0)
    assert pack[-77].positions.any()


def test_any_reader_of_zarr_opens_it(clouds, pack):
    group = zarr.open_group(str(pack.path), mode="r")
    np.testing.assert_array_equal(group["positions"][7], clouds[7].positions)
    assert group.attrs["breplake"]["fingerprint"] == clouds.fingerprint
    assert group.attrs["breplake"]["source"] == "vertices"


def test_many_files(clouds, tmp_path, small_files):
    made = write_pack(clouds, tmp_path / "pack", workers=2)
    files = sorted((made.path / "positions" / "c").iterdir())
    assert len(files) == 12
    order = np.random.default_rng(0).permutation(80)
    batch = made.batch(order, 0)
    assert batch.curvatures is None
    for place, index in enumerate(order[:20].tolist()):
        assert torch.equal(batch.positions[place], clouds[index].positions)
        assert torch.equal(batch.types[place], clouds[index].types)


def test_runs_are_draws(pack):
    few = PackedClouds(pack.path, n=5, seed=1)
    whole = pack.batch(np.arange(80), 0).positions
    kinds = set()
    for epoch in range(6):
        batch = few.batch(np.arange(80), epoch)
        assert batch.positions.shape == (80, 5, 3)
        assert torch.equal(few.batch(np.arange(80), epoch).positions, batch.positions)
        for index in (0, 55):
            row = whole[index]
            same = (torch.equal(batch.positions[index], row.roll(-s, 0)[:5]) for s in range(16))
            starts = [start for start, equal in enumerate(same) if equal]
            assert starts
            kinds.add((index, starts[0]))
        # all fields of a point stay together
        at = few._starts(epoch)[3]
        assert torch.equal(batch.normals[3], pack[3].normals[0].roll(-int(at), 0)[:5])
    assert len(kinds) > 6
    other = PackedClouds(pack.path, n=5, seed=2)
    assert not torch.equal(
        other.batch(np.arange(80), 0).positions, few.batch(np.arange(80), 0).positions
    )


@pytest.mark.parametrize("context", [None, "fork", "spawn"])
def test_a_loader_reads_a_pack(pack, context):
    few = PackedClouds(pack.path, n=5)
    workers = 0 if context is None else 2
    timeout = 60 if workers else 0
    found = list(Loader(few, 9, workers=workers, context=context, timeout=timeout))
    expected = list(Loader(few, 9, threads=0))
    assert len(found) == len(expected) == 9
    for a, b in zip(found, expected, strict=True):
        assert torch.equal(a.positions, b.positions)
        assert a.name == b.name
    assert sum(len(batch.name) for batch in found) == 80
    loader = Loader(few, 9)
    loader.load_state_dict({**loader.state_dict(), "cursor": 18})
    assert torch.equal(next(iter(loader)).positions, expected[2].positions)


def test_it_says_where_it_is_from(own_lake, tmp_path):
    meshes = MeshDataset(own_lake)
    frozen = create_subset(meshes.index.lake, "a", where="volume > 1", split={"x": 1.0})
    chosen = MeshDataset(own_lake, subset="a", split="x")
    made = write_pack(chosen.points(8, source="triangles"), tmp_path / "deep" / "pack")
    assert made.facts["subset"] == "a"
    assert made.facts["subset_hash"] == frozen.hash
    assert (made.facts["split"], made.facts["source"]) == ("x", "triangles")
    assert made.facts["lake_id"] == frozen.lake_id


def test_mistakes(clouds, pack, tmp_path):
    with pytest.raises(UsageError, match="written once"):
        write_pack(clouds, pack.path)
    with pytest.raises(UsageError, match="no field 'colour'"):
        write_pack(clouds, tmp_path / "p", ["colour"])
    with pytest.raises(UsageError, match="no clouds"):
        write_pack(MeshDataset(clouds.index.lake, where="false").points(4), tmp_path / "p")
    with pytest.raises(UsageError, match="from 1 to the 16"):
        PackedClouds(pack.path, n=17)
    with pytest.raises(LakeFormatError, match="not a pack"):
        PackedClouds(tmp_path)
    with pytest.raises(IndexError):
        pack[80]
    dropping = clouds.meshes.points(9, transforms=[Drop(0.5)])
    with pytest.raises(Exception, match=r"Drop|stack"):
        write_pack(dropping, tmp_path / "q")
    assert not (tmp_path / "q").exists()


def test_damage_is_named(clouds, tmp_path):
    made = write_pack(clouds, tmp_path / "pack")
    (made.path / "types/c/0/0").write_bytes(b"short")
    with pytest.raises(LakeFormatError, match="write the pack anew"):
        PackedClouds(made.path).batch(np.arange(3), 0)
    place = made.path / "normals/zarr.json"
    document = json.loads(place.read_text())
    place.write_text(json.dumps(document | {"codecs": [*document["codecs"], {"name": "zstd"}]}))
    with pytest.raises(LakeFormatError, match="not raw"):
        RawArray(made.path / "normals")


def test_lost_files_are_named(clouds, tmp_path):
    made = write_pack(clouds, tmp_path / "pack")
    (made.path / "types/c/0/0").unlink()
    with pytest.raises(LakeFormatError, match=r"types/c/0/0 is damaged.*write the pack anew"):
        PackedClouds(made.path).batch(np.arange(3), 0)
    shutil.rmtree(made.path / "normals")
    with pytest.raises(LakeFormatError, match=r"normals is not a raw array"):
        PackedClouds(made.path)


@pytest.mark.parametrize("row", [80, -1])
def test_rows_outside_are_no_fill_values(pack, small_files, row):
    with pytest.raises(IndexError, match="0 to 79"):
        RawArray(pack.path / "positions").take(np.array([3, row]))


def test_pickle(pack):
    pack[0]
    copy = pickle.loads(pickle.dumps(pack))
    assert torch.equal(copy[5].positions, pack[5].positions)
    assert len(pickle.dumps(pack)) < 20_000  # no mapped file travels along
