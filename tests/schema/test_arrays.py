"""Arrays: what is written is read, by us and by others, and the bytes are always the same."""

from __future__ import annotations

import os
import pickle
import signal

import numpy as np
import pytest

from breplake.errors import LakeFormatError, UsageError
from breplake.schema.array_reader import ArrayShardReader
from breplake.schema.arrays import (
    ARRAYS,
    CHUNK_ROWS,
    FILE_ROWS,
    MESH_ARRAYS,
    ArrayShardWriter,
    Offsets,
)
from breplake.schema.ranges import LocalFolder
from breplake.schema.storage import folder_hash, folder_list


def random_model(rng, vertices, normals, faces):
    rows = {"vertex": vertices, "normal": normals, "face": faces}
    out = {}
    for name in MESH_ARRAYS:
        spec = ARRAYS[name]
        shape = spec.shape(rows[spec.axis])
        if np.dtype(spec.dtype).kind == "f":
            out[name] = rng.normal(size=shape).astype(spec.dtype)
        else:
            out[name] = rng.integers(0, 100, size=shape).astype(spec.dtype)
    return out


@pytest.fixture(scope="module")
def shard(tmp_path_factory):
    """Models of all sizes: empty, smaller than a chunk, larger than a file."""
    rng = np.random.default_rng(0)
    sizes = [(5, 7, 9), (0, 0, 0), (FILE_ROWS + 10, 3, CHUNK_ROWS), (CHUNK_ROWS - 5, 20_000, 1)]
    models = [random_model(rng, *size) for size in sizes]
    models[2]["position"][100_000:200_000] = 0  # whole chunks of the fill value
    path = tmp_path_factory.mktemp("arrays") / "s.zarr"
    with ArrayShardWriter(path) as writer:
        offsets = [writer.append(model) for model in models]
    return path, models, offsets


def test_offsets_are_running_sums(shard):
    _, models, offsets = shard
    assert offsets[0] == Offsets(0, 0, 0)
    assert offsets[3] == Offsets(FILE_ROWS + 15, 10, 9 + CHUNK_ROWS)
    assert len(models) == 4


def test_every_model_is_read_back(shard):
    path, models, offsets = shard
    reader = ArrayShardReader(path)
    for model, offset in zip(models, offsets, strict=True):
        for name in MESH_ARRAYS:
            spec = ARRAYS[name]
            start = getattr(offset, spec.axis)
            read = reader.read(name, start, start + len(model[name]))
            assert read.dtype == np.dtype(spec.dtype)
            np.testing.assert_array_equal(read, model[name])


def test_random_ranges(shard):
    path, models, _ = shard
    whole = np.concatenate([model["position"] for model in models])
    reader = ArrayShardReader(path)
    rng = np.random.default_rng(1)
    edges = [0, 1, CHUNK_ROWS - 1, CHUNK_ROWS, FILE_ROWS - 1, FILE_ROWS, FILE_ROWS + 1, len(whole)]
    pairs = [sorted(rng.choice(edges, 2)) for _ in range(40)]
    pairs += [sorted(rng.integers(0, len(whole) + 1, 2)) for _ in range(40)]
    for (start, stop), read in zip(
        pairs, reader.read_many([("position", int(a), int(b)) for a, b in pairs]), strict=True
    ):
        np.testing.assert_array_equal(read, whole[start:stop])


def test_other_readers_see_the_same(shard):
    import tensorstore
    import zarr

    path, models, _ = shard
    group = zarr.open_group(str(path), mode="r")
    for name in MESH_ARRAYS:
        whole = np.concatenate([model[name] for model in models])
        np.testing.assert_array_equal(group[name][:], whole)
        store = {"driver": "file", "path": str(path / name)}
        array = tensorstore.open({"driver": "zarr3", "kvstore": store}, read=True).result()
        np.testing.assert_array_equal(array.read().result(), whole)


def test_bytes_are_deterministic(shard, tmp_path):
    path, models, _ = shard
    with ArrayShardWriter(tmp_path / "again.zarr") as writer:
        for model in models:
            writer.append(model)
    assert folder_hash(tmp_path / "again.zarr") == folder_hash(path)


def test_nan_survives(tmp_path):
    model = random_model(np.random.default_rng(0), 4, 6, 2)
    model["normal"][2] = np.nan
    with ArrayShardWriter(tmp_path / "n.zarr") as writer:
        writer.append(model)
    read = ArrayShardReader(tmp_path / "n.zarr").read("normal", 0, 6)
    np.testing.assert_array_equal(read, model["normal"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": np.zeros((4, 2), np.float32)}, "shape"),
        ({"position": np.zeros((4, 3), complex)}, "must be <f4"),
        ({"feature": np.zeros(5, np.uint8)}, "5 rows"),
        ({"patch": np.full(6, 2**40)}, "beyond"),
        ({"colour": np.zeros(4)}, "exactly"),
    ],
)
def test_wrong_arrays_are_refused(tmp_path, change, message):
    model = random_model(np.random.default_rng(0), 4, 6, 2) | change
    with ArrayShardWriter(tmp_path / "w.zarr") as writer, pytest.raises(UsageError, match=message):
        writer.append(model)


def test_a_shard_is_written_once(shard):
    with pytest.raises(UsageError, match="written once"):
        ArrayShardWriter(shard[0])


def test_reads_outside_are_refused(shard):
    reader = ArrayShardReader(shard[0])
    with pytest.raises(UsageError, match="not in array"):
        reader.read("feature", 0, reader.rows("feature") + 1)
    with pytest.raises(UsageError, match="no array"):
        reader.read("colour", 0, 1)


def test_damage_is_named(tmp_path):
    with ArrayShardWriter(tmp_path / "d.zarr") as writer:
        writer.append(random_model(np.random.default_rng(0), 4, 6, 2))
    file = next((tmp_path / "d.zarr/position/c").rglob("0/0"))
    file.write_bytes(file.read_bytes()[10:])
    with pytest.raises(LakeFormatError, match="run breplake check"):
        ArrayShardReader(tmp_path / "d.zarr").read("position", 0, 4)
    with pytest.raises(LakeFormatError, match="not an array of a lake"):
        ArrayShardReader(tmp_path / "nothing").read("position", 0, 4)


def test_a_lost_file_is_no_file_of_zeros(tmp_path, monkeypatch):
    """A file of nothing but zeros is never written; the shard's list tells it from a lost one."""
    model = random_model(np.random.default_rng(0), 4, 6, 2)
    model["curvature"][:] = 0
    model["feature"][:] = 0
    path, lines = tmp_path / "d.zarr", tmp_path / "d.zarr.sha256"
    with ArrayShardWriter(path) as writer:
        writer.append(model)
    lines.write_text(folder_list(path))
    reads = []
    real = LocalFolder.read_list
    monkeypatch.setattr(LocalFolder, "read_list", lambda self: reads.append(0) or real(self))
    reader = ArrayShardReader(path)
    reader.read("position", 0, 4)
    assert not reads
    for _ in range(2):
        assert not reader.read("curvature", 0, 6).any()
        assert not reader.read("feature", 0, 4).any()
    assert len(reads) == 1
    (path / "normal/c/0/0").unlink()
    for _ in range(2):
        with pytest.raises(LakeFormatError, match=r"d\.zarr/normal/c/0/0 is lost.*breplake verify"):
            reader.read("normal", 0, 6)
    lines.unlink()
    with pytest.raises(LakeFormatError, match=r"curvature/c/0/0 is absent, and so is .*sha256"):
        ArrayShardReader(path).read("curvature", 0, 6)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")  # that is what is tested
def test_reader_survives_fork_and_pickle(shard):
    path, models, _ = shard
    reader = ArrayShardReader(path)
    reader.read("position", 0, 5)
    copy = pickle.loads(pickle.dumps(reader))
    np.testing.assert_array_equal(copy.read("position", 0, 5), models[0]["position"])
    pid = os.fork()
    if pid == 0:
        signal.alarm(20)  # a hang must become a failure
        same = np.array_equal(reader.read("position", 0, 5), models[0]["position"])
        os._exit(0 if same else 1)
    assert os.waitpid(pid, 0)[1] == 0
