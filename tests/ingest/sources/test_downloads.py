"""Downloads: what is fetched, how often, and what is told where it cannot be had."""

from __future__ import annotations

import contextlib
import gzip
import hashlib
import os
import socket
import socketserver
import ssl
import sys
import threading
from typing import ClassVar

import obstore
import pytest

pytest.importorskip("urllib3")

from breplake.errors import InputError, MissingExtraError, UsageError
from breplake.ingest.sources.downloads import Downloads
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.web import Web, public_address

from .found import find
from .lists import HASH, STEP, fetch, write_csv


@pytest.fixture
def downloads():
    with Ledger.open() as ledger:
        opened = Downloads(ledger, Limits(), backoff=0.001)
        yield opened
        opened.close()


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


def test_kept_downloads_may_be_removed(tmp_path, downloads, serve):
    server = serve(lambda *_: (200, {"ETag": '"1"'}, STEP))
    uri = f"{server.url}/a.step"
    downloads.find_out(uri)
    downloads.kept(HASH).unlink()
    target = tmp_path / "t.step"
    assert downloads.fetch(uri, HASH, target) == target
    assert target.read_bytes() == STEP


def test_a_kept_download_that_was_damaged_is_fetched_again(tmp_path, downloads, serve):
    server = serve(lambda *_: (200, {"ETag": '"1"'}, STEP))
    uri = f"{server.url}/a.step"
    downloads.find_out(uri)
    kept = downloads.kept(HASH)
    assert downloads.fetch(uri, HASH, tmp_path / "t.step") == kept
    kept.write_bytes(bytes(len(STEP)))  # as a power cut leaves it
    target = tmp_path / "t.step"
    assert downloads.fetch(uri, HASH, target) == target
    assert target.read_bytes() == STEP
    assert downloads.kept(HASH) is None


def test_downloads_are_on_the_disk_before_they_have_their_name(tmp_path, downloads, monkeypatch):
    flushed = []

    def replace(source, place):
        assert os.stat(source).st_ino in flushed
        whole(source, place)

    whole = os.replace
    monkeypatch.setattr(os, "fsync", lambda number: flushed.append(os.fstat(number).st_ino))
    monkeypatch.setattr(os, "replace", replace)
    (tmp_path / "new").write_bytes(STEP)
    assert downloads.keep(tmp_path / "new").sha256 == HASH
    assert downloads.kept(HASH).read_bytes() == STEP


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


def test_a_client_without_urllib3_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "urllib3", None)
    with pytest.raises(MissingExtraError, match=r"breplake\[sources\]"):
        Web()


def test_a_ledger_needs_a_folder(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("BREPLAKE_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(UsageError, match="BREPLAKE_CACHE"), Ledger.open():
        pass
