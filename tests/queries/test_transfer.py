"""Copies of lakes: whole, checked, resumable, to folders and from a web server."""

from __future__ import annotations

import functools
import http.server
import threading
from datetime import timedelta

import numpy as np
import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.errors import LakeFormatError, NameNotFoundError, UsageError
from breplake.queries.subset_files import export_subset
from breplake.queries.subsets import create_subset
from breplake.queries.versions.extract import Selection, extract
from breplake.queries.versions.mirror import mirror
from breplake.schema.arrays import ARRAYS, AXES, MESH_ARRAYS
from breplake.schema.gc import Retention, collect
from breplake.schema.lake import LakeStore
from breplake.schema.tables import TABLES

META = {"message": "m", "tools": {}, "config_hash": "c"}
PLACED = ["shard", *(f"{axis}_offset" for axis in AXES)]
COUNTS = {"vertex": "n_vertices", "normal": "n_normals", "face": "n_faces"}
COUNTS |= {"patch": "n_patches", "curve": "n_curves"}


@pytest.fixture
def source(own_lake, new_shard):
    """Three snapshots; the second has a tag and a subset, the third supersedes shard s0."""
    store = LakeStore.open(own_lake)
    store.tag("v1", 2)
    create_subset(breplake.open(own_lake, 2), "large", where="area > 100")
    old = [entry.path for entry in store.head().files if entry.shard == "s0"]
    new_shard(store, "s2", {"small": (2, 2, 2), "long/flat": (9, 2, 1)})
    store.commit(store.register_shard("s2"), replaces=old, **META)
    return store


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture
def web(source):
    """The lake, served as a plain folder; names cannot be listed."""
    handler = functools.partial(Quiet, directory=source.root)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def document(store, number):
    return (store.root / f"snapshots/{number:08d}.json").read_bytes()


def copies(store):
    return len(list(store.root.glob("tables/*/*"))) + len(list(store.root.glob("arrays/**/*")))


def test_a_copy_is_the_same_snapshot_of_the_same_lake(source, tmp_path):
    done = mirror(source, tmp_path / "copy", source.snapshot(2))
    copy = LakeStore.open(tmp_path / "copy")
    assert copy.lake_id == source.lake_id
    assert document(copy, 2) == document(source, 2)
    assert copy.verify(copy.snapshot("v1")) == []
    assert breplake.open(copy.root).subset("large").hash == (
        breplake.open(source.root).subset("large").hash
    )
    assert (copy.numbers(), done.skipped) == ([2], 0)
    assert not list(copy.root.rglob("*.part"))
    again = mirror(source, tmp_path / "copy", source.snapshot(2))
    assert (again.files, again.bytes, again.skipped) == (0, 0, done.files)
    later = mirror(source, f"file://{tmp_path}/copy", source.snapshot())
    assert 0 < later.files < done.files
    assert copy.numbers() == [2, 3]
    assert copy.verify(copy.snapshot()) == []
    assert collect(copy, grace=timedelta(0)).garbage == []


def test_what_is_damaged_or_missing_is_copied_again(source, tmp_path):
    done = mirror(source, tmp_path / "copy", source.snapshot(2))
    copy = LakeStore.open(tmp_path / "copy")
    (copy.root / "tables/faces/s0.parquet").write_bytes(b"damaged")
    (copy.root / "arrays/s1.zarr/normal/c/0/0").unlink()
    (copy.root / "arrays/s1.zarr/normal/c/0/0.part").write_bytes(b"half")
    again = mirror(source, tmp_path / "copy", source.snapshot(2))
    assert (again.files, again.skipped) == (2, done.files - 2)
    assert copy.verify(copy.snapshot()) == []


def test_an_interrupted_copy_goes_on(source, tmp_path):
    left = 5

    def stop(_):
        nonlocal left
        left -= 1
        if left == 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mirror(source, tmp_path / "copy", source.snapshot(2), progress=stop)
    copy = LakeStore.open(tmp_path / "copy")
    assert copy.head() is None  # the snapshot comes last
    sizes: list[int] = []
    done = mirror(source, tmp_path / "copy", source.snapshot(2), progress=sizes.append)
    assert done.skipped >= 4
    assert done.files + done.skipped == len(sizes)
    assert copy.verify(copy.snapshot()) == []


@pytest.mark.parametrize("path", ["tables/faces/s0.parquet", "arrays/s1.zarr/normal/c/0/0"])
@pytest.mark.parametrize("missing", [True, False])
def test_a_damaged_source_is_not_copied(source, tmp_path, path, missing):
    file = source.root / path
    data = file.read_bytes()
    file.unlink() if missing else file.write_bytes(data[:-1] + b"?")
    with pytest.raises(LakeFormatError, match="run breplake verify"):
        mirror(source, tmp_path / "copy", source.snapshot(2))
    assert LakeStore.open(tmp_path / "copy").head() is None
    file.write_bytes(data)
    mirror(source, tmp_path / "copy", source.snapshot(2))
    copy = LakeStore.open(tmp_path / "copy")
    assert copy.verify(copy.snapshot()) == []


def test_lakes_that_are_not_copies_of_each_other(source, tiny_lake, tmp_path):
    with pytest.raises(UsageError, match="another lake"):
        mirror(source, tiny_lake, source.snapshot())
    mirror(source, tmp_path / "copy", source.snapshot(2))
    copy = LakeStore.open(tmp_path / "copy")
    copy.commit([], **META)  # both have a third snapshot now
    for number in (2, 3):
        with pytest.raises(UsageError, match=r"snapshot 3 of .* commits were made to both"):
            mirror(source, tmp_path / "copy", source.snapshot(number))
    copy.tag("mine", 2)
    source.tag("mine", 3)
    other = tmp_path / "other"
    mirror(source, other, source.snapshot(2))
    LakeStore.open(other).tag("mine", 2)
    with pytest.raises(UsageError, match=r"another tags/mine.json"):
        mirror(source, other, source.snapshot(3))


def test_from_a_web_server(source, web, tmp_path):
    remote = LakeStore.open(web)
    assert remote.snapshot() == source.snapshot()
    assert remote.snapshot("v1") == source.snapshot(2)
    with pytest.raises(NameNotFoundError):
        remote.snapshot(9)
    with pytest.raises(UsageError, match="cannot be listed"):
        remote.numbers()
    with pytest.raises(UsageError, match="not a local folder"):
        remote.register("tables/models/s0.parquet")
    mirror(remote, tmp_path / "copy", remote.snapshot("v1"), tag="v1")
    copy = LakeStore.open(tmp_path / "copy")
    assert copy.snapshot("v1") == source.snapshot(2)
    assert copy.verify(copy.snapshot()) == []
    (source.root / "tables/faces/s2.parquet").write_bytes(b"damaged")
    with pytest.raises(LakeFormatError, match="its hash is not that of the snapshot"):
        mirror(remote, tmp_path / "copy", remote.snapshot())
    assert not list(copy.root.rglob("*.part"))


@pytest.mark.parametrize("later", range(6))
def test_the_newest_snapshot_is_found_where_names_cannot_be_listed(source, web, later):
    remote = LakeStore.open(web)
    collect(source, Retention(keep=1), grace=timedelta(0))
    for _ in range(later):
        source.commit([], **META)
    assert remote.head().number == 3 + later


def rows(lake, table, ids):
    frame = lake.scan(table).collect().filter(is_one_of(ids)).sort(TABLES[table].key)
    return frame.drop(PLACED) if table == "models" else frame


def is_one_of(ids):
    import polars as pl

    return pl.col("model_id").is_in(ids)


def meshes(lake, identity):
    row = lake.read("models", identity).to_pylist()[0]
    if row["vertex_offset"] is None:
        return None
    reader = lake.arrays(row["shard"])
    names = MESH_ARRAYS if row["patch_offset"] is None else ARRAYS
    return {name: stored(reader, row, name) for name in names}


def stored(reader, row, name):
    axis = ARRAYS[name].axis
    start = row[f"{axis}_offset"]
    return reader.read(name, start, start + row[COUNTS[axis]])


def assert_same_models(source, target, ids):
    from polars.testing import assert_frame_equal

    for table in TABLES:
        assert_frame_equal(rows(target, table, ids), rows(source, table, ids))
    for identity in ids:
        one, other = meshes(source, identity), meshes(target, identity)
        assert (one is None) == (other is None)
        assert (one or {}).keys() == (other or {}).keys()
        for name in one or {}:
            np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.parametrize("where", ["name IN ('small', 'big', 'bare')", "true", "name = 'wide'"])
@pytest.mark.parametrize("remote", [False, True])
def test_chosen_models(source, web, tmp_path, where, remote):
    here = breplake.open(source.root)
    ids = [row[0] for row in here.sql(f"SELECT model_id FROM models WHERE {where}").fetchall()]
    store = LakeStore.open(web) if remote else source
    done = extract(store, tmp_path / "some", store.snapshot(), Selection(where=where))
    assert (done.models, done.present, done.snapshot.number) == (len(ids), 0, 1)
    some = breplake.open(tmp_path / "some")
    assert set(some.scan("models").collect()["model_id"]) == set(ids)
    assert set(some.scan("failures").collect()["model_id"]) <= set(ids)
    assert_same_models(here, some, ids)
    assert some.store.verify(some.snapshot) == []
    assert not (some.root / "extract").exists()
    extract(store, tmp_path / "again", store.snapshot(), Selection(where=where))
    again = LakeStore.open(tmp_path / "again")
    assert again.lake_id == some.store.lake_id  # the same choice is the same lake
    assert document(again, 1) == document(some.store, 1)


def test_a_sample_lake_in_parts(sample_lake, tmp_path):
    source = breplake.open(sample_lake)
    names = ("gear_spur", "mug", "weight_lemon")
    where = f"name IN {names}"
    extract(source.store, tmp_path / "some", source.snapshot, Selection(where=where))
    some = breplake.open(tmp_path / "some")
    ids = [some.model(name)["model_id"] for name in names]
    assert_same_models(source, some, ids)


def test_more_models_are_added(source, tmp_path):
    def get(where):
        return extract(source, tmp_path / "some", source.snapshot(), Selection(where=where))

    assert get("name = 'big'").models == 1
    done = get("name IN ('big', 'small')")
    assert (done.models, done.present, done.snapshot.number) == (1, 1, 2)
    done = get("name = 'small'")
    assert (done.models, done.present, done.snapshot.number) == (0, 1, 2)
    lake = breplake.open(tmp_path / "some")
    assert set(lake.scan("models").collect()["name"]) == {"big", "small"}


@pytest.fixture
def changed(tmp_path, new_shard, monkeypatch):
    """A lake whose model big comes of another source file than that of ``source``."""
    real = new_shard.__globals__["box_rows"]

    def other_file(name, size, shard):
        rows = real(name, size, shard)
        rows["models"][0]["sha256"] = "0" * 64
        return rows

    store = LakeStore.create(tmp_path / "changed")
    with monkeypatch.context() as patch:
        patch.setitem(new_shard.__globals__, "box_rows", other_file)
        new_shard(store, "t0", {"big": (2, 2, 2)})
    store.commit(store.register_shard("t0"), **META)
    return store


@pytest.mark.parametrize("remote", [False, True])
@pytest.mark.parametrize("choice", ["subset", "models", "where"])
def test_a_model_of_another_source_file_is_no_copy(source, changed, web, tmp_path, remote, choice):
    listed = tmp_path / "list.csv"
    here = breplake.open(source.root, 2)
    export_subset(here, here.subset("large"), listed)
    chosen = {"subset": "large", "models": listed, "where": "area > 100"}[choice]
    store = LakeStore.open(web) if remote else source
    with pytest.raises(UsageError, match=r"1 of 1 models .*boxes/big \(of another source file\)"):
        extract(store, changed.root, store.snapshot(2), Selection(**{choice: chosen}))
    assert changed.numbers() == [1]
    lake = breplake.open(changed.root)
    assert set(lake.scan("models").collect()["name"]) == {"big"}
    with pytest.raises(NameNotFoundError):
        lake.subset("large")


def test_a_list_of_other_source_files_is_refused(source, changed, tmp_path):
    here = breplake.open(source.root, 2)
    export_subset(here, here.subset("large"), tmp_path / "list.csv")
    chosen = Selection(models=tmp_path / "list.csv")
    with pytest.raises(UsageError, match=r"1 of 2 models .*boxes/big \(of another source file\)"):
        extract(changed, tmp_path / "some", changed.snapshot(), chosen)
    assert not (tmp_path / "some").exists()


def test_a_subset_goes_along(source, web, tmp_path):
    subset = breplake.open(source.root).subset("large")
    remote = LakeStore.open(web)
    for _ in range(2):
        extract(remote, tmp_path / "some", remote.snapshot(2), Selection(subset="large"))
    lake = breplake.open(tmp_path / "some")
    assert lake.subset("large").hash == subset.hash
    assert lake.subset("large").origin.lake_id == source.lake_id
    assert set(lake.scan("models").collect()["model_id"]) == set(subset.model_ids)
    assert lake.snapshot.number == 1


def test_an_interrupted_extraction_goes_on(source, tmp_path):
    class Killed(BaseException):
        pass

    def kill(done, _total):
        if done == 1:
            raise Killed

    chosen = Selection(where="name IN ('small', 'big')")
    with pytest.raises(Killed):
        extract(source, tmp_path / "some", source.snapshot(), chosen, progress=kill)
    store = LakeStore.open(tmp_path / "some")
    assert store.head() is None
    (finished,) = store.root.glob("tables/models/*")
    time = finished.stat().st_mtime_ns
    extract(source, tmp_path / "some", source.snapshot(), chosen)
    assert finished.stat().st_mtime_ns == time  # it was not written again
    assert len(store.head().table_files("models")) == 2
    assert collect(store, grace=timedelta(0)).garbage == []


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"where": "false"}, "lacks what matches"),
        ({"where": "area > 'x'"}, "Could not convert"),
        ({"subset": "small"}, "no subset small"),
        ({}, "give one"),
        ({"where": "true", "subset": "large"}, "give one"),
    ],
)
def test_choices_that_are_none(source, tmp_path, chosen, message):
    with pytest.raises((UsageError, NameNotFoundError), match=message):
        extract(source, tmp_path / "some", source.snapshot(), Selection(**chosen))


def test_a_list_of_models(source, tmp_path):
    here = breplake.open(source.root)
    file = tmp_path / "list.csv"
    file.write_text(f"model_id\n{here.model('big')['model_id']}\n")
    extract(source, tmp_path / "some", source.snapshot(), Selection(models=file))
    assert breplake.open(tmp_path / "some").model("big")["area"] == 148
    file.write_text("model_id\n12345\n")
    with pytest.raises(UsageError, match="1 chosen models, 12345 say"):
        extract(source, tmp_path / "some", source.snapshot(), Selection(models=file))


def test_tags_and_subsets_that_are_left_out_are_named(source, web, tmp_path):
    def call(*arguments):
        result = CliRunner().invoke(app, [str(a) for a in arguments])
        assert result.exit_code == 0, result.output
        return result.stdout

    place = tmp_path / "copy"
    said = call("publish", place, "--lake", source.root)
    assert "left out: subset large (of snapshot 2), tag v1 (of snapshot 2)\n" in said
    command = f"breplake publish {place} --lake {source.root}"
    assert f"{command} --at 2 copies a snapshot with what names it, --subset NAME" in said
    assert mirror(source, tmp_path / "two", source.snapshot()).left_out == {
        "subset large": 2, "tag v1": 2
    }  # fmt: skip
    # the commands that are named do it
    assert "left out" not in call(*command.split()[1:], "--at", "2")
    copy = LakeStore.open(place)
    assert copy.tags() == {"v1": 2}
    assert breplake.open(place).subset("large").snapshot == 2
    assert "left out" not in call("publish", place, "--lake", source.root)  # they are there now

    said = call("pull", web, "--lake", tmp_path / "pulled", "--at", "v1")
    command = f"breplake pull {web} --lake {tmp_path / 'pulled'}"
    assert "subsets, and tags other than --at, were left out" in said
    assert f"{command} --subset NAME copies a subset" in said
    assert LakeStore.open(tmp_path / "pulled").tags() == {"v1": 2}
    call(*command.split()[1:], "--subset", "large")
    assert len(breplake.open(tmp_path / "pulled").subset("large")) == 2


def test_commands(source, web, tmp_path):
    def call(*arguments):
        return CliRunner().invoke(app, [str(a) for a in arguments])

    place, here = tmp_path / "published", tmp_path / "here"
    result = call("publish", place, "--lake", source.root, "--at", "v1")
    assert result.stdout.startswith(f"{place} has snapshot 2: ")
    assert call("pull", place, "--lake", here, "--at", "v1").exit_code == 0
    assert breplake.open(here, "v1").snapshot == source.snapshot(2)
    result = call("pull", web, "--lake", tmp_path / "some", "--subset", "large")
    assert result.stdout == f"{tmp_path / 'some'} is at snapshot 1: 2 models copied\n"
    assert breplake.open(tmp_path / "some").subset("large").origin.snapshot == 2
    result = call("publish", tmp_path / "one", "--where", "name = 'big'", "--lake", source.root)
    assert result.stdout == f"{tmp_path / 'one'} is at snapshot 1: 1 model copied\n"
    result = call("pull", "http://127.0.0.1:9", "--lake", tmp_path / "none")
    assert result.exit_code == 2
    assert result.stderr.startswith("breplake: cannot copy between here and http://127.0.0.1:9: ")
