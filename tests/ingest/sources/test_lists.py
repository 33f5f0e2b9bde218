"""Lists of addresses: what rows become, what is downloaded, and how often."""

from __future__ import annotations

import contextlib
import csv
import gzip
import hashlib
import socket
import socketserver
import ssl
import threading
from pathlib import Path
from typing import ClassVar

import obstore
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

pytest.importorskip("urllib3")

from breplake.errors import InputError, UsageError
from breplake.ingest.sources.downloads import Downloads
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.resolve import Sources
from breplake.ingest.sources.web import Web, public_address

STEP = b"ISO-10303-21; not much more"
HASH = hashlib.sha256(STEP).hexdigest()


def write_csv(path, rows):
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
    return path


def faulty(path, row):
    """The name of a row that cannot be used: of two lists of one name, too, no two are the same."""
    return f"{path.name} {hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]}, row {row}"


def find(*sources, **options):
    with Sources.open() as opened:
        return opened.find(sources, **options)


def fetch(tmp_path, item):
    """What a run gets of an input, by the time its turn comes."""
    target = tmp_path / "target"
    target.mkdir(exist_ok=True)
    with Sources.open() as opened, opened.fetcher([item], tmp_path / "ahead") as fetcher:
        return fetcher.take(item, target).result(60)


@pytest.fixture
def downloads():
    with Ledger.open() as ledger:
        opened = Downloads(ledger, Limits(), backoff=0.001)
        yield opened
        opened.close()


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


def test_addresses_are_downloaded_once(tmp_path, serve):
    def answer(_server, _method, _path, headers, _body):
        if headers.get("if-none-match") == '"v1"':
            return 304, {"ETag": '"v1"'}, b""
        return 200, {"ETag": '"v1"'}, STEP

    server = serve(answer)
    path = write_csv(
        tmp_path / "list.csv",
        [{"uri": f"{server.url}/parts/a%20b.step?token=secret#x", "licence": "MIT", "id": "7"}],
    )
    (item,) = find(path)
    assert (item.name, item.sha256, item.bytes) == ("parts/a b", HASH, len(STEP))
    assert item.shown == item.facts.source_url == f"{server.url}/parts/a%20b.step"
    assert dict(item.facts.metadata) == {"id": "7"}
    assert fetch(tmp_path, item).path.read_bytes() == STEP
    assert len(server.asked) == 1
    assert server.asked[0][1] == "/parts/a%20b.step?token=secret"
    assert find(path) == [item]
    assert len(server.asked) == 2
    assert server.asked[1][2]["if-none-match"] == '"v1"'
    kept = [p for p in (tmp_path / "cache").rglob("*") if p.is_file()]
    assert not [p for p in kept if b"secret" in p.read_bytes()]


def test_what_changed_is_downloaded_again(downloads, serve):
    bodies = [STEP, b"other"]

    def answer(server, *_):
        return (
            200,
            {"Last-Modified": "Mon, 01 Jan 2024 00:00:00 GMT"},
            bodies[len(server.asked) - 1],
        )

    server = serve(answer)
    assert downloads.find_out(f"{server.url}/a.step").sha256 == HASH
    second = downloads.find_out(f"{server.url}/a.step")
    assert second.sha256 == hashlib.sha256(b"other").hexdigest()
    assert "if-modified-since" in server.asked[1][2]


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


def test_kept_downloads_may_be_removed(tmp_path, downloads, serve):
    server = serve(lambda *_: (200, {"ETag": '"1"'}, STEP))
    uri = f"{server.url}/a.step"
    downloads.find_out(uri)
    downloads.kept(HASH).unlink()
    target = tmp_path / "t.step"
    assert downloads.fetch(uri, HASH, target) == target
    assert target.read_bytes() == STEP


def test_what_fails_for_now_is_tried_again(downloads, serve):
    def answer(server, *_):
        return {
            1: (503, {}, b""),
            2: (429, {"Retry-After": "1"}, b"slow down"),
            3: (200, {"Content-Length": "1000"}, b"breaks off"),
            4: (500, {}, b""),
        }.get(len(server.asked), (200, {}, STEP))

    server = serve(answer)
    assert downloads.find_out(f"{server.url}/a.step").sha256 == HASH
    assert len(server.asked) == 5


def test_what_fails_for_good_is_one_failure(tmp_path, downloads, serve):
    server = serve(lambda *_: (404, {}, b"no"))
    good = write_csv(tmp_path / "list.csv", [{"uri": f"{server.url}/a.step?key=secret"}])
    (item,) = find(good)
    assert (item.failure.stage, item.failure.kind) == ("fetch", "download-failed")
    assert "answers 404" in item.failure.message
    assert "secret" not in item.failure.message
    assert len(server.asked) == 1, "what is not there is not asked for again"
    down = serve(lambda *_: (503, {}, b""))
    with pytest.raises(InputError, match="too many 503"):
        downloads.find_out(f"{down.url}/a.step")
    assert 5 <= len(down.asked) <= 15
    with pytest.raises(InputError, match=r"127\.0\.0\.1:1/a\.step") as caught:
        downloads.find_out("http://127.0.0.1:1/a.step")
    assert caught.value.kind == "download-failed"


@pytest.mark.parametrize("address", ["http://h:99999/a.step?key=secret", "http://a b/x.step"])
def test_what_is_no_address_is_told_at_once(downloads, address):
    with pytest.raises(InputError, match="it is no address") as caught:
        downloads.find_out(address)
    assert caught.value.kind == "download-failed"
    assert "secret" not in str(caught.value)


def test_unknown_hosts_and_false_certificates_are_not_tried_again(downloads, serve, monkeypatch):
    calls = []

    def unknown(*_, **__):
        calls.append("look-up")
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    def false(*_, **__):
        calls.append("handshake")
        raise ssl.SSLCertVerificationError("certificate has expired")

    server = serve(lambda *_: (200, {}, STEP))
    monkeypatch.setattr(ssl.SSLContext, "wrap_socket", false)
    with pytest.raises(InputError, match="certificate has expired"):
        downloads.find_out(server.url.replace("http:", "https:") + "/a.step")
    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(InputError, match="Name or service not known"):
        downloads.find_out("http://nowhere.invalid/a.step")
    assert calls == ["handshake", "look-up"]


def test_nobody_waits_longer_than_five_minutes(downloads, serve):
    server = serve(lambda *_: (503, {"Retry-After": "3600"}, b""))
    with pytest.raises(InputError, match="answers 503, and the next try, in 3600 s, is too late"):
        downloads.find_out(f"{server.url}/a.step")
    assert len(server.asked) == 1


def test_the_body_of_an_excuse_may_have_no_end():
    class Endless(socketserver.BaseRequestHandler):
        def handle(self):
            self.request.recv(2**16)
            self.request.sendall(b"HTTP/1.1 503 Busy\r\n\r\n")
            with contextlib.suppress(OSError):  # the client's end
                while True:
                    self.request.sendall(bytes(2**16))

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Endless) as server:
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        web = Web(backoff=0.001)
        with pytest.raises(InputError, match="too many 503"):
            web.ask("GET", f"http://127.0.0.1:{server.server_address[1]}/a.step")
        web.close()
        server.shutdown()


@pytest.mark.parametrize("encoding", ["gzip", None])
def test_a_packed_file_stays_packed(tmp_path, serve, encoding):
    """Many servers call the file's own compression an encoding of the transfer."""
    packed = gzip.compress(STEP)
    server = serve(lambda *_: (200, {"Content-Encoding": encoding} if encoding else {}, packed))
    (item,) = find(write_csv(tmp_path / "l.csv", [{"url": f"{server.url}/a.STEP.gz?v=1"}]))
    assert item.sha256 == hashlib.sha256(packed).hexdigest()
    assert fetch(tmp_path, item).path.read_bytes() == packed


def test_large_objects_are_told_without_the_query(downloads, monkeypatch, tmp_path):
    class Large:
        meta: ClassVar = {"size": 2**62}

    monkeypatch.setattr(obstore, "get", lambda *_, **__: Large)
    uri = "s3://bucket/a.step?key=secret"
    with pytest.raises(InputError, match=r"s3://bucket/a\.step has") as caught:
        downloads.find_out(uri)
    assert "secret" not in str(caught.value)

    def silent(*_, **__):
        raise ValueError

    monkeypatch.setattr(obstore, "get", silent)
    with pytest.raises(InputError, match=r"s3://bucket/a\.step: ValueError"):
        downloads.find_out(uri)


def test_large_answers_are_cut_short(serve):
    server = serve(lambda *_: (200, {}, bytes(5000)))
    with Ledger.open() as ledger:
        opened = Downloads(ledger, Limits(member=4999))
        with pytest.raises(InputError) as caught:
            opened.find_out(f"{server.url}/a.step")
        opened.close()
        assert caught.value.kind == "too-large"
        assert [p for p in ledger.folder.rglob("*") if p.is_file()] == [
            ledger.folder / "sources.sqlite"
        ]


def test_redirections_are_followed_within_reason(downloads, serve):
    def answer(_server, _method, path, *_):
        if path == "/loop.step":
            return 302, {"Location": "/loop.step"}, b""
        if path == "/a.step":
            return 307, {"Location": "/b.step"}, b""
        if path == "/file.step":
            return 302, {"Location": "file:///etc/passwd"}, b""
        return 200, {}, STEP

    server = serve(answer)
    assert downloads.find_out(f"{server.url}/a.step").sha256 == HASH
    with pytest.raises(InputError, match="too many redirects"):
        downloads.find_out(f"{server.url}/loop.step")
    with pytest.raises(InputError, match="redirects from http to file"):
        downloads.find_out(f"{server.url}/file.step")


def test_an_empty_file_is_told(tmp_path, serve):
    server = serve(lambda *_: (200, {}, b""))
    (item,) = find(write_csv(tmp_path / "list.csv", [{"url": f"{server.url}/a.step"}]))
    assert item.failure.kind == "empty-file"


def test_objects_of_s3(tmp_path, serve, monkeypatch):
    """A server that answers as S3 does for one object."""

    def answer(_server, _method, path, headers, _body):
        if path != "/bucket/parts/a%20b.step":
            return 404, {}, b"<Error><Code>NoSuchKey</Code></Error>"
        more = {"ETag": '"e1"', "Last-Modified": "Mon, 01 Jan 2024 00:00:00 GMT"}
        if headers.get("if-none-match") == '"e1"':
            return 304, more, b""
        return 200, more, STEP

    server = serve(answer)
    for name, value in {
        "AWS_ENDPOINT": server.url,
        "AWS_ALLOW_HTTP": "true",
        "AWS_SKIP_SIGNATURE": "true",
        "AWS_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    rows = [{"uri": "s3://bucket/parts/a%20b.step"}, {"uri": "s3://bucket/none.step"}]
    good, gone = sorted(
        find(write_csv(tmp_path / "list.csv", rows)), key=lambda item: bool(item.failure)
    )
    assert (good.name, good.sha256) == ("parts/a b", HASH)
    assert gone.failure.kind == "download-failed"
    assert fetch(tmp_path, good).path.read_bytes() == STEP
    before = len(server.asked)
    (again, _) = sorted(find(tmp_path / "list.csv"), key=lambda item: bool(item.failure))
    assert again == good
    assert ("if-none-match", '"e1"') in server.asked[before][2].items() or (
        "if-none-match",
        '"e1"',
    ) in server.asked[before + 1][2].items()


def test_addresses_are_shown_without_secrets():
    assert public_address("https://u:p@h:1/a/b.step?sig=1#f") == "https://h:1/a/b.step"


def test_many_connections_at_once(serve, tmp_path):
    server = serve(lambda _s, _m, path, *_: (200, {"ETag": path}, path.encode()))
    rows = [{"uri": f"{server.url}/{i}.step"} for i in range(50)]
    found = find(write_csv(tmp_path / "list.csv", rows))
    assert {item.name: item.sha256 for item in found} == {
        str(i): hashlib.sha256(f"/{i}.step".encode()).hexdigest() for i in range(50)
    }


def test_a_client_without_urllib3_says_what_to_install(monkeypatch):
    import sys

    from breplake.errors import MissingExtraError

    monkeypatch.setitem(sys.modules, "urllib3", None)
    with pytest.raises(MissingExtraError, match=r"breplake\[sources\]"):
        Web()


def test_a_ledger_needs_a_folder(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("BREPLAKE_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(UsageError, match="BREPLAKE_CACHE"), Ledger.open():
        pass


def test_waiting_ends_when_it_is_asked_to(tmp_path, serve):
    """A server that wants us to come back in an hour does not keep Ctrl-C waiting."""
    server = serve(lambda *_: (503, {"Retry-After": "3600"}, b""))
    path = write_csv(tmp_path / "list.csv", [{"uri": f"{server.url}/a.step"}])
    with pytest.raises(KeyboardInterrupt), Sources.open(stop=lambda: bool(server.asked)) as opened:
        opened.find([path])
