"""A lake in object storage, read in place: SQL, rows, frames, arrays, pictures and datasets."""

from __future__ import annotations

import multiprocessing
import pickle
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
import zarr
from obstore.store import from_url
from typer.testing import CliRunner
from zarr.storage import ObjectStore

import breplake
from breplake.cli import app
from breplake.errors import LakeFormatError, LakeNotFoundError, UsageError
from breplake.queries.subsets import create_subset
from breplake.queries.versions.mirror import mirror
from breplake.schema.arrays import MESH_ARRAYS
from breplake.schema.lake import LakeStore
from breplake.schema.ranges import RangeReader
from breplake.schema.storage import Storage
from breplake.schema.tables import TABLES

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of botocore and moto


def published(lake, place):
    store = LakeStore.open(lake)
    for number in store.numbers():
        mirror(store, place, store.snapshot(number))
    return breplake.open(place)


def test_tables(own_lake, bucket):
    here, there = breplake.open(own_lake), published(own_lake, bucket)
    assert there.place == bucket
    assert there.files("faces")[0].startswith(f"{bucket}/tables/faces/")
    for name, table in TABLES.items():
        query = f"SELECT * FROM {name} ORDER BY {', '.join(table.key)}"
        assert there.sql(query).fetchall() == here.sql(query).fetchall(), name
        frame = here.scan(name).sort(table.key).collect()
        assert there.scan(name).sort(table.key).collect().equals(frame), name
        for (model_id,) in here.sql("SELECT model_id FROM models").fetchall():
            assert there.read(name, model_id).equals(here.read(name, model_id)), name
    query = "SELECT count(*) FROM models"
    assert there.at(1).sql(query).fetchall() == here.at(1).sql(query).fetchall()
    assert there.query("surface_types").fetchall() == here.query("surface_types").fetchall()
    assert pickle.loads(pickle.dumps(there)).model("big") == here.model("big")


def test_sql_reads_only_what_it_needs(own_lake, bucket, monkeypatch):
    there = published(own_lake, bucket)
    opened = []
    init = RangeReader.__init__

    def note(self, storage, path):
        opened.append(path)
        init(self, storage, path)

    monkeypatch.setattr(RangeReader, "__init__", note)
    there.connection.execute("SELECT 1")
    opened.clear()
    assert there.sql("SELECT sum(area) FROM models").fetchall()
    assert {path.split("/")[1] for path in opened} == {"models"}


def rows_of(reader):
    return reader.rows("normal")


def test_arrays_and_datasets(own_lake, bucket):
    torch = pytest.importorskip("torch")
    from breplake.loaders import Loader, MeshDataset

    here, there = breplake.open(own_lake), published(own_lake, bucket)
    for entry in here.snapshot.table_files("arrays"):
        ours, theirs = here.arrays(entry.shard), there.arrays(entry.shard)
        assert ours.grid == theirs.grid
        for name in MESH_ARRAYS:
            rows = ours.rows(name)
            np.testing.assert_array_equal(theirs.read(name, 0, rows), ours.read(name, 0, rows))
            np.testing.assert_array_equal(theirs.read(name, 3, 5), ours.read(name, 3, 5))
        stored = zarr.open_group(ObjectStore(from_url(f"{bucket}/{entry.path}")), mode="r")
        np.testing.assert_array_equal(stored["normal"][:], ours.read("normal", 0, rows_of(ours)))
    mine, remote = MeshDataset(own_lake), MeshDataset(bucket)
    assert len(mine) == len(remote) == 4
    for a, b in zip(mine, remote, strict=True):
        assert torch.equal(a.positions, b.positions)
        assert torch.equal(a.triangles, b.triangles)
    loader = Loader(remote, 2, shuffle=False, workers=1)
    names = [name for batch in loader for name in batch.names]
    assert names == [sample.name for sample in mine]


def _read_in_fork(lake, answer):
    try:
        lake.arrays("s0").read("position", 0, 1)
        answer.put("read")
    except Exception as error:
        answer.put(f"{type(error).__name__}: {error}")


def test_a_forked_process_is_told_why_it_cannot_read(own_lake, bucket):
    there = published(own_lake, bucket)
    there.arrays("s0").read("position", 0, 1)
    context = multiprocessing.get_context("fork")
    answer = context.Queue()
    process = context.Process(target=_read_in_fork, args=[there, answer])
    process.start()
    said = answer.get(timeout=30)
    process.join()
    assert said.startswith("UsageError:")
    assert "forkserver" in said


def test_commands(own_lake, bucket, tmp_path):
    pytest.importorskip("matplotlib")
    published(own_lake, bucket)

    def call(*arguments):
        result = CliRunner().invoke(app, [str(a) for a in arguments])
        assert result.exit_code == 0, result.output
        return result.stdout

    for command in (["info"], ["sql", "SELECT count(*) AS n FROM models"], ["files", "models"]):
        said = call(*command, "--lake", bucket).replace(bucket, "L").split()
        assert said == call(*command, "--lake", own_lake).replace(str(own_lake), "L").split()
    images = [tmp_path / "a.png", tmp_path / "b.png"]
    for place, image in zip((own_lake, bucket), images, strict=True):
        call("show", "big", "--lake", place, "-o", image)
    assert images[0].read_bytes() == images[1].read_bytes()
    call("tag", "v1", "--lake", bucket)
    assert "v1" in call("snapshots", "--lake", bucket)
    assert call("diff", 1, 2, "--lake", bucket) == call("diff", 1, 2, "--lake", own_lake)
    result = CliRunner().invoke(app, ["check", bucket])
    assert (result.exit_code, "breplake pull" in result.stderr) == (2, True)
    result = CliRunner().invoke(app, ["pull", str(own_lake), "--lake", bucket])
    assert (result.exit_code, "to a folder of this machine" in result.stderr) == (2, True)
    result = CliRunner().invoke(app, ["info", "--lake", "s3://no-such-bucket-here/x"])
    assert result.exit_code == 2
    assert result.stderr.startswith("breplake: ")


def test_subsets(own_lake, bucket):
    there = published(own_lake, bucket)
    made = create_subset(there, "large", where="area > 100")
    assert breplake.open(bucket).subset("large") == made
    assert (
        made.ids().tolist()
        == create_subset(breplake.open(own_lake), "large", where="area > 100").ids().tolist()
    )


def test_damage(own_lake, bucket):
    there = published(own_lake, bucket)
    storage = there.store.storage
    with pytest.raises(LakeNotFoundError):
        breplake.open(bucket.replace("one", "none"))
    storage.overwrite("arrays/s0.zarr/position/c/0/0", b"short")
    with pytest.raises(LakeFormatError, match=r"position in s3://.*/s0\.zarr is damaged"):
        breplake.open(bucket).arrays("s0").read("position", 0, 1)
    storage.remove("arrays/s0.zarr/normal/c/0/0")
    assert not breplake.open(bucket).arrays("s0").read("curvature", 0, 9).any()  # never written
    with pytest.raises(LakeFormatError, match=r"s3://.*/s0\.zarr/normal/c/0/0 is lost.* verify"):
        breplake.open(bucket).arrays("s0").read("normal", 0, 1)
    with pytest.raises(UsageError, match="breplake pull"):
        there.sandbox().sql("SELECT 1")


def test_reads_of_parts(bucket):
    storage = Storage(bucket)
    data = bytes(range(256)) * 1024
    storage.overwrite("file", data)
    reader = RangeReader(storage, "file")
    for start, size in [(0, 10), (len(data) - 5, 10), (len(data) - 70_000, 70_000), (len(data), 3)]:
        reader.seek(start)
        assert reader.read(size) == data[start : start + size]
    reader.seek(-4, 2)
    assert reader.read() == data[-4:]
    reader.seek(1)
    buffer = bytearray(6)
    assert reader.readinto(buffer) == 6
    assert (bytes(buffer), reader.tell()) == (data[1:7], 7)


class _Ranges(SimpleHTTPRequestHandler):
    """A web server that answers range requests, as most do but Python's own."""

    def log_message(self, *_):
        pass

    def do_GET(self):
        path = Path(self.translate_path(self.path))
        if not path.is_file():
            self.send_error(404)
            return
        data, asked = path.read_bytes(), self.headers["Range"]
        if asked is None:
            self.send_response(200)
        else:
            first, _, last = asked.removeprefix("bytes=").partition("-")
            start = int(first) if first else max(0, len(data) - int(last))
            end = min(int(last), len(data) - 1) if first and last else len(data) - 1
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{end}/{len(data)}")
            data = data[start : end + 1]
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)


def test_over_http(own_lake):
    here = breplake.open(own_lake)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Ranges, directory=own_lake)) as server:
        threading.Thread(target=server.serve_forever).start()
        try:
            there = breplake.open(f"http://127.0.0.1:{server.server_port}")
            query = "SELECT name, area FROM models ORDER BY name"
            assert there.snapshot == here.snapshot
            assert there.sql(query).fetchall() == here.sql(query).fetchall()
            assert there.read("patches", there.model("big")["model_id"]).num_rows == 6
            assert there.scan("faces").collect().equals(here.scan("faces").collect())
            np.testing.assert_array_equal(
                there.arrays("s0").read("position", 2, 9), here.arrays("s0").read("position", 2, 9)
            )
        finally:
            server.shutdown()
