"""Sources as a whole: from archives, lists and Onshape to rows of a lake."""

from __future__ import annotations

import hashlib
import shutil
import threading
from pathlib import Path

import pytest

pytest.importorskip("OCP")
pytest.importorskip("pebble")
pytest.importorskip("py7zr")
pytest.importorskip("urllib3")

import breplake
from breplake.errors import UsageError
from breplake.ingest.run import ingest
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings
from breplake.ingest.sources.facts import NO_FACTS
from breplake.ingest.sources.resolve import Sources

COARSE = Settings(max_edge=0.2, timeout=120)
NAMES = ("base_plate_mm", "ring_o", "hinge")
TRUTH = Path(__file__).parents[4] / "shared" / "abc_groundtruth"
KEYS = tuple(f"0000005{i}_80d90bfdd2e74e709956122{i}" for i in range(3))

METADATA = """\
createdAt: 2014-08-19T22:01:17.637+0000
defaultWorkspace:
  href: https://cad.onshape.com/api/documents/d/80d90bfdd2e74e709956122a/workspaces/d9b4
  id: d9b4ecf3490b4deea493695f
id: 80d90bfdd2e74e709956122a
href: https://cad.onshape.com/api/documents/80d90bfdd2e74e709956122a
name: Mark's First Document
owner:
  id: 53ea424de4b081074c6499bc
  name: Mark Gibson
public: true
tags: []
description: null
"""


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_samples(folder, NAMES)
    return {name: (folder / f"{name}.step").read_bytes() for name in NAMES}


@pytest.fixture
def chunk(tmp_path, parts, pack):
    """Chunks in the original layout of ABC: ``00000050/00000050_<document>_step_000.step``."""
    steps = {
        f"{key[:8]}/{key}_step_000.step": parts[name] for key, name in zip(KEYS, NAMES, strict=True)
    }
    texts = {f"{key[:8]}/{key}_metadata_000.yml": METADATA.encode() for key in KEYS[:2]}
    pack(tmp_path / "abc_0000_meta_v00.7z", texts)
    return pack(tmp_path / "abc_0000_step_v00.7z", steps)


def run(lake, *sources, **options):
    return ingest(sources, lake, settings=COARSE, jobs=2, **options)


def models(lake, *columns):
    names = ", ".join(columns)
    query = f"SELECT {names} FROM models ORDER BY collection, name"
    return breplake.open(lake).sql(query).fetchall()


def facts(folder, *sources):
    """What comes along with the bytes of each input, without ingesting them."""
    target = folder / "target"
    target.mkdir()
    with Sources.open() as opened:
        inputs = opened.find(sources)
        with opened.fetcher(inputs, folder / "ahead") as fetcher:
            found = [fetcher.take(item, target).result(60).facts for item in inputs]
    shutil.rmtree(target)
    return found


def test_metadata_beside_a_chunk_of_abc(tmp_path, chunk):
    first, second, third = facts(tmp_path, chunk)
    assert first == second
    assert third == NO_FACTS
    url = "https://cad.onshape.com/documents/80d90bfdd2e74e709956122a"
    known = ("LicenseRef-Onshape-ToU-1.g.ii", "Mark Gibson", url)
    assert (first.licence, first.owner, first.source_url) == known
    more = dict(first.metadata)
    assert more["document"] == "Mark's First Document"
    assert more["created"].startswith("2014-08-19")
    assert "description" not in more


def test_an_archive_gives_the_same_rows_as_its_files(tmp_path, parts, pack):
    folder = tmp_path / "box"
    folder.mkdir()
    for name, data in parts.items():
        (folder / f"{name}.step").write_bytes(data)
    archive = pack(tmp_path / "box.tar.gz", {f"{name}.step": data for name, data in parts.items()})
    run(tmp_path / "one", folder)
    brought = []

    def look(_plan, summary):
        if summary.n_done == len(parts):  # not committed yet
            brought.extend((tmp_path / "two").rglob("source.*"))

    run(tmp_path / "two", archive, progress=look)
    assert brought == [], "a model's own file is gone as soon as it is finished"
    for table in ("parts", "patches", "curves", "vertices", "faces"):
        one, two = (breplake.open(tmp_path / lake).scan(table).collect() for lake in ("one", "two"))
        assert one.height > 0
        assert one.equals(two), table
    columns = ("name", "model_id", "sha256", "bytes", "fingerprint")
    assert models(tmp_path / "one", *columns) == models(tmp_path / "two", *columns)


def test_metadata_given_by_name_wherever_it_lies(tmp_path, chunk):
    other = tmp_path / "elsewhere"
    other.mkdir()
    meta = shutil.move(tmp_path / "abc_0000_meta_v00.7z", other / "abc_0000_meta_v00.7z")
    assert facts(tmp_path, chunk) == [NO_FACTS] * 3
    owners = [found.owner for found in facts(tmp_path, chunk, meta)]
    assert owners == ["Mark Gibson", "Mark Gibson", None], "metadata are no models"


def test_damaged_metadata_are_told_before_anything_is_done(tmp_path, chunk):
    meta = tmp_path / "abc_0000_meta_v00.7z"
    meta.write_bytes(meta.read_bytes()[:-10])
    with pytest.raises(UsageError, match=r"meta_v00\.7z cannot be read.*no owner"):
        run(tmp_path / "lake", chunk)


def test_metadata_of_one_model_that_is_no_yaml(tmp_path, chunk, pack):
    (tmp_path / "abc_0000_meta_v00.7z").unlink()
    pack(
        tmp_path / "abc_0000_meta_v00.7z",
        {
            f"x/{KEYS[0]}_metadata_000.yml": b"a: " + b"[" * 100_000,
            f"x/{KEYS[1]}_metadata_000.yml": b"- 1",
        },
    )
    first, second, third = (dict(found.metadata) for found in facts(tmp_path, chunk))
    assert "YAML" in first["metadata_error"]
    assert "no summary" in second["metadata_error"]
    assert third == {}


def test_metadata_that_nest_a_gigabyte_in_a_few_lines(tmp_path, chunk, pack):
    (tmp_path / "abc_0000_meta_v00.7z").unlink()
    lines = ["a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 10)]
    bomb = "\n".join([*lines, "name: *a9", "tags: [good, *a9]", "owner: {name: Ada}", ""])
    pack(tmp_path / "abc_0000_meta_v00.7z", {f"x/{KEYS[0]}_metadata_000.yml": bomb.encode()})
    found = facts(tmp_path, chunk)[0]
    assert (found.owner, found.metadata) == ("Ada", (("tags", "good"),))


def test_metadata_beside_a_file_in_a_folder(tmp_path, parts):
    folder = tmp_path / "abc"
    folder.mkdir()
    (folder / f"{KEYS[0]}_step_000.step").write_bytes(parts["ring_o"])
    (folder / f"{KEYS[0]}_metadata_000.yml").write_text(METADATA)
    run(tmp_path / "lake", folder)
    assert models(tmp_path / "lake", "owner", "name") == [("Mark Gibson", f"{KEYS[0]}_000")]


@pytest.mark.skipif(not TRUTH.exists(), reason="needs the ABC ground truth")
def test_a_real_file_with_its_real_metadata(tmp_path, pack):
    key = "00000050_80d90bfdd2e74e709956122a"
    for kind, part in (("step", "step_000.step"), ("meta", "metadata_000.yml")):
        data = (TRUTH / f"{key}_{part}").read_bytes()
        pack(tmp_path / f"abc_0000_{kind}_v00.7z", {f"{key[:8]}/{key}_{part}": data})
    run(tmp_path / "lake", tmp_path / "abc_0000_step_v00.7z")
    columns = ("name", "licence", "owner", "n_patches > 1")
    assert models(tmp_path / "lake", *columns) == [
        (f"{key}_000", "LicenseRef-Onshape-ToU-1.g.ii", "Mark Gibson", True)
    ]


def test_bad_members_are_rows_of_failures(tmp_path, parts, pack):
    files = {"good.step": parts["ring_o"], "empty.step": b"", "torn.step": b"ISO-10303-21;"}
    summary = run(tmp_path / "lake", pack(tmp_path / "mixed.zip", files))
    assert (summary.n_models, summary.n_fatal) == (1, 2)
    query = "SELECT name, stage, kind, fatal FROM failures ORDER BY name"
    rows = breplake.open(tmp_path / "lake").sql(query).fetchall()
    assert rows[0] == ("empty", "plan", "empty-file", True)
    assert rows[1][0] == "torn"
    assert rows[1][3]


def test_an_archive_that_changes_during_a_run(tmp_path, parts, pack):
    path = pack(tmp_path / "a.zip", {f"{name}.step": data for name, data in parts.items()})

    def change(plan, summary):
        if not summary.n_done:
            pack(path, {f"{name}.step": data + b" " for name, data in parts.items()})

    summary = run(tmp_path / "lake", path, progress=change)
    assert (summary.n_models, summary.n_fatal) == (0, 3)
    assert dict(summary.kinds) == {("fetch", "hash-mismatch"): 3}


def test_a_list_of_files_and_addresses(tmp_path, parts, serve):
    server = serve(lambda *_: (200, {"ETag": '"1"'}, parts["hinge"]))
    (tmp_path / "ring.step").write_bytes(parts["ring_o"])
    path = tmp_path / "models.csv"
    path.write_text(
        "uri,name,licence,owner,source_url,material\n"
        "ring.step,ring,MIT,Ada,https://example.org/ring,rubber\n"
        f"{server.url}/x/hinge.step?key=secret,,CC0-1.0,,,steel\n"
        f"{server.url}/none.txt,,,,,\n",
        encoding="utf-8",
    )
    summary = run(tmp_path / "lake", path)
    assert (summary.n_models, summary.n_fatal) == (2, 1)
    rows = models(tmp_path / "lake", "name", "licence", "owner", "source_url", "metadata", "path")
    assert rows == [
        ("ring", "MIT", "Ada", "https://example.org/ring", {"material": "rubber"},
         str(tmp_path / "ring.step")),
        ("x/hinge", "CC0-1.0", None, f"{server.url}/x/hinge.step", {"material": "steel"},
         f"{server.url}/x/hinge.step"),
    ]  # fmt: skip
    again = run(tmp_path / "lake", path)
    assert (len(again.plan.unchanged), again.snapshot) == (3, None)
    assert len(server.asked) == 2
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("none.txt", "none.step"), encoding="utf-8")
    assert run(tmp_path / "lake", path).n_models == 1
    rows = breplake.open(tmp_path / "lake").sql("SELECT name FROM failures").fetchall()
    assert rows == [], "the row is in order now"


def test_a_download_that_is_stopped_costs_nothing_that_is_finished(tmp_path, parts, serve):
    """Its thread may see that the run is to stop before the run itself does."""
    finished, main = threading.Event(), threading.current_thread()

    def answer(*_):
        assert finished.wait(120)
        return 200, {}, parts["hinge"]

    (tmp_path / "ring.step").write_bytes(parts["ring_o"])
    digest = hashlib.sha256(parts["hinge"]).hexdigest()
    path = tmp_path / "models.csv"
    path.write_text(f"uri,sha256\nring.step,\n{serve(answer).url}/hinge.step,{digest}\n")

    def progress(_plan, summary):
        if summary.n_done:
            finished.set()

    def stop():
        return finished.is_set() and threading.current_thread() is not main

    summary = run(tmp_path / "lake", path, progress=progress, stop=stop)
    assert summary.stopped
    assert models(tmp_path / "lake", "name") == [("ring",)]
    assert run(tmp_path / "lake", path).n_models == 1


def test_a_download_that_fails_first_and_is_there_later(tmp_path, parts, serve):
    from breplake.ingest.plan import Redo

    answers = {"status": 404}
    server = serve(lambda *_: (answers["status"], {}, parts["ring_o"]))
    path = tmp_path / "models.csv"
    path.write_text(f"uri\n{server.url}/ring.step\n", encoding="utf-8")
    first = run(tmp_path / "lake", path)
    assert dict(first.kinds) == {("fetch", "download-failed"): 1}
    answers["status"] = 200
    second = run(tmp_path / "lake", path, redo=Redo(failed=True))
    assert (second.n_models, second.n_fatal) == (1, 0)
    assert breplake.open(tmp_path / "lake").sql("SELECT count(*) FROM failures").fetchall() == [
        (0,)
    ]
