"""Lists of addresses: what rows become, and which of them cannot be used."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

pytest.importorskip("urllib3")

from breplake.errors import InputError, UsageError
from breplake.ingest.sources.resolve import Sources

from .found import find
from .lists import HASH, STEP, fetch, write_csv


def faulty(path, row):
    """The name of a row that cannot be used: of two lists of one name, too, no two are the same."""
    return f"{path.name} {hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]}, row {row}"


@pytest.fixture
def parts(tmp_path):
    folder = tmp_path / "data"
    (folder / "sub").mkdir(parents=True)
    for name in ("a.step", "sub/b.igs"):
        (folder / name).write_bytes(STEP)
    return folder


ROWS = [
    {"path": "a.step", "licence": "CC-BY-4.0", "owner": "Ada", "material": "steel", "mass": "1.5"},
    {"path": "sub/b.igs", "name": "renamed", "collection": "other", "source_url": "https://x/y"},
]


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_rows_become_inputs_with_their_facts(parts, ending):
    path = parts / f"models.{ending}"
    if ending == "csv":
        write_csv(path, ROWS)
    else:
        names = dict.fromkeys(name for row in ROWS for name in row)
        columns = {name: [row.get(name) for row in ROWS] for name in names}
        columns["mass"] = pa.array([1.5, None])
        pq.write_table(pa.table(columns), path)
    a, b = find(path)
    assert (a.collection, a.name, a.format, a.sha256) == ("models", "a", "step", HASH)
    assert (a.facts.licence, a.facts.owner, a.facts.source_url) == ("CC-BY-4.0", "Ada", None)
    assert dict(a.facts.metadata) == {"material": "steel", "mass": "1.5"}
    assert (b.collection, b.name, b.format) == ("other", "renamed", "iges")
    assert b.facts.source_url == "https://x/y"
    assert b.facts.metadata == ()
    assert [item.path.read_bytes() for item in (a, b)] == [STEP, STEP]
    assert {item.collection for item in find(path, collection="mine")} == {"mine", "other"}


def test_bad_rows_are_one_failure_each(parts):
    path = parts / "list.csv"
    path.write_text(
        "path,name,sha256,format,note\n"
        f"a.step,good,{HASH},,fine\n"
        ",nameless,,,no address\n"
        "a.txt,text,,,no CAD file\n"
        "a.txt,forced,,step,is one by its format\n"
        "a.step,good,,,the name again\n"
        "a.step,short,abc,,no hash\n"
        f"a.step,other,{'0' * 64},,another hash\n"
        "missing.step,gone,,,not there\n"
        "ftp://host/a.step,ftp,,,unknown scheme\n"
        "https://me:secret@host/a.step,user,,,a password\n"
        "a.step,long,,,x,y,z\n"
        "sub,folder,,step,a folder\n",
        encoding="utf-8",
    )
    found = find(path)
    assert len(found) == 12
    bad = {item.name: item.failure for item in found if item.failure}
    assert {item.name for item in found} - set(bad) == {"good"}
    assert {name: failure.kind for name, failure in bad.items()} == {
        **{faulty(path, i): "bad-row" for i in (2, 3, 5, 6, 9, 10, 11)},
        "other": "hash-mismatch",
        "gone": "not-a-file",
        "forced": "not-a-file",
        "folder": "not-a-file",
    }
    assert all(failure.fatal and failure.stage == "plan" for failure in bad.values())
    assert "row 5: it is model list/good, as row 1 is" in bad[faulty(path, 5)].message
    assert not [item for item in found if "secret" in f"{item.shown} {item.failure}"]


def test_rows_that_no_parser_likes_are_one_failure_each(parts):
    path = parts / "list.csv"
    path.write_text(
        "path\na.step\nhttp://[bad/x.step\nonshape:https://cad.onshape.com/documents/zzz\n"
        "onshape:http://[bad\nonshape:public?limit=none\na\0.step\nhttps://me:secret@[x/a.step\n"
        f"{'x' * 300}.step\n",
        encoding="utf-8",
    )
    found = {item.name: item for item in find(path)}
    assert len(found) == 8
    assert found.pop("a").failure is None
    assert found.pop("x" * 300).failure.kind == "unreadable"
    assert set(found) == {faulty(path, i) for i in range(2, 8)}
    assert {item.failure.kind for item in found.values()} == {"bad-row"}
    assert "secret" not in f"{found}"


def test_no_row_of_two_lists_is_lost(tmp_path, parts, serve):
    """What is shown of an address has no query, which may be all that tells two files apart."""
    server = serve(lambda _s, _m, path, *_: (200, {}, path.encode()))
    lists = []
    for number in (1, 2):
        folder = tmp_path / f"{number}" / "a"
        folder.mkdir(parents=True)
        rows = [
            {"uri": f"{server.url}/part.step?id={number}"},
            {"uri": f"{server.url}/same.step?id=0", "sha256": ""},
            {"uri": "ftp://host/x.step"},
        ]
        lists.append(write_csv(folder / "models.csv", rows))
    found = {item.name: item for item in find(*lists, lists[0])}
    failed = {name: item.failure.message for name, item in found.items() if item.failure}
    assert set(found) - set(failed) == {"part", "same"}
    assert found["part"].sha256 == hashlib.sha256(b"/part.step?id=1").hexdigest()
    clash = faulty(lists[1], 1)
    assert set(failed) == {faulty(lists[0], 3), clash, faulty(lists[1], 3)}
    assert f"it is model models/part, as row 1 of {lists[0]} is" in failed[clash]
    assert len({item.model_id for item in found.values()}) == 5


def test_lists_that_are_none_are_refused(tmp_path):
    path = tmp_path / "list.csv"
    for text, reason in (
        ("", "no columns"),
        ("name,licence\na,b\n", "it has name, licence"),
        ('path\n"a.step', "cannot be read"),
        ("path\n\xff", "cannot be read"),
    ):
        path.write_bytes(text.encode("latin-1"))
        with pytest.raises(UsageError, match=reason):
            find(path)
    path = tmp_path / "list.parquet"
    path.write_bytes(b"PAR1 not")
    with pytest.raises(UsageError, match="cannot be read"):
        find(path)


def test_headers_are_read_with_care(parts, monkeypatch):
    path = parts / "list.csv"
    path.write_text(",path , owner\n0,a.step,Ada\n1, sub/b.igs\n\n", encoding="utf-8")
    a, b = find(path)
    assert (a.name, a.facts.owner, a.failure) == ("a", "Ada", None)
    assert (b.name, b.facts.owner, b.failure) == ("sub/b", None, None)
    path.write_text("path,owner,owner \na.step,Ada,Bob\n", encoding="utf-8")
    with pytest.raises(UsageError, match="more than one column owner"):
        find(path)

    def closed(*_, **__):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", closed)
    with pytest.raises(UsageError, match=r"list\.csv cannot be read: .*Permission denied"):
        find(path)


def test_a_hash_in_the_list_saves_looking(tmp_path, serve):
    server = serve(lambda *_: (200, {}, STEP))
    rows = [
        {"uri": f"{server.url}/good.step", "sha256": HASH.upper()},
        {"uri": f"{server.url}/bad.step", "sha256": "1" * 64},
    ]
    bad, good = find(write_csv(tmp_path / "list.csv", rows))
    assert server.asked == []
    assert (good.sha256, good.bytes) == (HASH, None)
    got = fetch(tmp_path, good)
    assert (got.path.read_bytes(), got.bytes) == (STEP, len(STEP))
    with pytest.raises(InputError, match="gives") as caught:
        fetch(tmp_path, bad)
    assert caught.value.kind == "hash-mismatch"
    assert not [p for p in (tmp_path / "target").iterdir() if p != got.path]


def test_an_empty_file_is_told(tmp_path, serve):
    server = serve(lambda *_: (200, {}, b""))
    (item,) = find(write_csv(tmp_path / "list.csv", [{"url": f"{server.url}/a.step"}]))
    assert item.failure.kind == "empty-file"


def test_many_connections_at_once(serve, tmp_path):
    server = serve(lambda _s, _m, path, *_: (200, {"ETag": path}, path.encode()))
    rows = [{"uri": f"{server.url}/{i}.step"} for i in range(50)]
    found = find(write_csv(tmp_path / "list.csv", rows))
    assert {item.name: item.sha256 for item in found} == {
        str(i): hashlib.sha256(f"/{i}.step".encode()).hexdigest() for i in range(50)
    }


def test_waiting_ends_when_it_is_asked_to(tmp_path, serve):
    """A server that wants us to come back in an hour does not keep Ctrl-C waiting."""
    server = serve(lambda *_: (503, {"Retry-After": "3600"}, b""))
    path = write_csv(tmp_path / "list.csv", [{"uri": f"{server.url}/a.step"}])
    with pytest.raises(KeyboardInterrupt), Sources.open(stop=lambda: bool(server.asked)) as opened:
        opened.find([path])
