"""Onshape's API, played by a server that checks every signature and answers in its shapes."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import logging
import re
from email.utils import parsedate_to_datetime
from urllib.parse import parse_qs, urlsplit

import pytest

pytest.importorskip("urllib3")

from breplake.errors import InputError, UsageError
from breplake.ingest.sources.downloads import Downloads
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.onshape import Query
from breplake.ingest.sources.onshape_api import Keys, OnshapeApi, base_address, signature
from breplake.ingest.sources.onshape_parts import Document, Onshape
from breplake.ingest.sources.resolve import Sources
from breplake.ingest.sources.web import Web

from .found import find

ACCESS, SECRET = "accessKEY0123456789", "SECRETsecretSECRET0123456789"
DOC, SPACE, VERSION = "a" * 24, "b" * 24, "c" * 24
STUDIO, OTHER = "d" * 24, "e" * 24
STATE = "f" * 24

SUMMARY = {
    "id": DOC,
    "name": "Gearbox",
    "public": True,
    "createdAt": "2016-05-04T10:00:00.000+0000",
    "modifiedAt": "2017-05-04T10:00:00.000+0000",
    "owner": {"id": "1" * 24, "name": "Ada Lovelace", "type": 0},
    "defaultWorkspace": {"id": SPACE, "name": "Main"},
    "tags": [],
    "description": None,
}


def body(identity, studio=STUDIO, kind="solid", state=STATE):
    return {
        "name": f"Part {identity}",
        "partId": identity,
        "elementId": studio,
        "bodyType": kind,
        "microversionId": state,
        "state": "IN_PROGRESS",
    }


PARTS = [body("JHD"), body("JHH"), body("RDB", OTHER, "sheet"), body("JHL", kind="wire")]


class Onshapes:
    """What the server does. Lists of faults are used up one by one."""

    def __init__(self):
        self.parts, self.active = list(PARTS), 2
        self.faults, self.failing, self.expired = [], set(), set()
        self.redirect = None
        self.translations = {}
        self.looks = {}
        self.nonces = set()
        self.state = STATE

    def __call__(self, server, method, path, headers, data):
        self.check(method, path, headers)
        if self.faults:
            return self.faults.pop(0)
        route = urlsplit(path).path.removeprefix("/api/v10")
        for pattern, answer in (
            (r"/documents", self.listing),
            (rf"/documents/({DOC})", lambda *_: SUMMARY),
            (rf"/documents/d/{DOC}/w/{SPACE}/currentmicroversion", self.microversion),
            (rf"/parts/d/{DOC}/(?:w/{SPACE}|v/{VERSION})", lambda *_: self.parts),
            (rf"/partstudios/d/{DOC}/[wv]/\w+/e/(\w+)/translations", self.translate),
            (r"/translations/(\w+)", self.look),
        ):
            match = re.fullmatch(pattern, route)
            if match:
                found = answer(*match.groups(), path, data)
                if found is None:
                    break
                return 200, {"X-Rate-Limit-Remaining": "99"}, json.dumps(found).encode()
        match = re.fullmatch(rf"/documents/d/{DOC}/externaldata/(\w+)", route)
        if match and match[1] not in self.expired:
            if self.redirect:
                return 307, {"Location": self.redirect}, b""
            return 200, {}, f"ISO-10303-21; {match[1]}".encode()
        return 404, {}, b'{"message": "Not found.", "code": 0, "status": 404}'

    def check(self, method, path, headers):
        """Verify a request as the documentation says that Onshape does."""
        nonce, parts = headers["on-nonce"], urlsplit(path)
        assert re.fullmatch(r"[0-9A-Za-z]{16,}", nonce)
        assert nonce not in self.nonces, "every request has a nonce of its own"
        self.nonces.add(nonce)
        parsedate_to_datetime(headers["date"])
        text = "\n".join(
            [method, nonce, headers["date"], headers["content-type"], parts.path, parts.query, ""]
        )
        digest = hmac.new(SECRET.encode(), text.lower().encode(), hashlib.sha256).digest()
        wanted = f"On {ACCESS}:HmacSHA256:{base64.b64encode(digest).decode()}"
        assert headers["authorization"] == wanted
        assert SECRET not in str(headers)

    def listing(self, path, _data):
        query = {name: values[0] for name, values in parse_qs(urlsplit(path).query).items()}
        assert (query["filter"], int(query["limit"]) <= 20) == ("4", True)
        first = int(query["offset"])
        ids = [f"{i:024x}" for i in range(45)][first : first + int(query["limit"])]
        items = [SUMMARY | {"id": identity} for identity in ids]
        return {"items": items, "next": "more" if first + len(items) < 45 else None}

    def microversion(self, *_):
        return {"microversion": self.state}

    def translate(self, element, _path, data):
        wish = json.loads(data)
        assert (wish["formatName"], wish["storeInDocument"]) == ("STEP", False)
        identity = f"t{len(self.translations)}"
        self.translations[identity] = (element, wish["partIds"])
        return self.shape(identity, "ACTIVE")

    def look(self, identity, *_):
        if identity not in self.translations:
            return None
        self.looks[identity] = self.looks.get(identity, 0) + 1
        if self.looks[identity] <= self.active:
            return self.shape(identity, "ACTIVE")
        part = self.translations[identity][1]
        return self.shape(identity, "FAILED" if part in self.failing else "DONE")

    def shape(self, identity, state):
        return {
            "requestState": state,
            "requestElementId": self.translations[identity][0],
            "resultExternalDataIds": [f"data{identity}"] if state == "DONE" else None,
            "resultElementIds": None,
            "failureReason": "Geometry is broken" if state == "FAILED" else None,
            "documentId": DOC,
            "id": identity,
            "href": f"https://cad.onshape.com/api/v10/translations/{identity}",
        }


@pytest.fixture
def played():
    return Onshapes()


@pytest.fixture
def server(played, serve, monkeypatch):
    started = serve(played)
    monkeypatch.setenv("ONSHAPE_URL", started.url)
    monkeypatch.setenv("ONSHAPE_ACCESS_KEY", ACCESS)
    monkeypatch.setenv("ONSHAPE_SECRET_KEY", SECRET)
    return started


@pytest.fixture
def waits():
    return []


@pytest.fixture
def onshape(server, waits):
    with Ledger.open() as ledger:
        web, downloads = Web(backoff=0.001), Downloads(ledger, Limits())
        api = OnshapeApi(web, Keys.from_environment(), base_address())
        yield Onshape(api, ledger, downloads, Limits(), wait=waits.append)
        downloads.close()
        web.close()


@pytest.fixture
def no_waiting(monkeypatch):
    monkeypatch.setattr("breplake.ingest.sources.onshape_parts._FIRST_LOOK", 0.001)


WORKSPACE = Document(DOC, "w", SPACE)


def test_a_document_becomes_one_model_per_part(server, no_waiting):
    found = find(f"onshape:{server.url}/documents/{DOC}/w/{SPACE}")
    assert [(item.collection, item.name) for item in found] == [
        ("onshape", f"{DOC}/{STUDIO}/JHD"),
        ("onshape", f"{DOC}/{STUDIO}/JHH"),
        ("onshape", f"{DOC}/{OTHER}/RDB"),  # the wire has no surface
    ]
    first = found[0]
    assert first.facts.owner == "Ada Lovelace"
    assert first.facts.licence == "LicenseRef-Onshape-ToU-1.g.ii"
    assert first.facts.source_url == f"{server.url}/documents/{DOC}/w/{SPACE}/e/{STUDIO}"
    more = dict(first.facts.metadata)
    assert (more["part"], more["document"]) == ("Part JHD", "Gearbox")
    assert "description" not in more
    assert len({item.sha256 for item in found}) == 3
    for item in found:
        assert item.bytes > 0
    assert server.count("POST", "/translations") == 3


def test_one_model_per_part_studio(server, no_waiting, played):
    found = find(f"onshape:{server.url}/documents/{DOC}?by=studio")
    assert [item.name for item in found] == [f"{DOC}/{STUDIO}", f"{DOC}/{OTHER}"]
    assert {parts for _, parts in played.translations.values()} == {"JHD,JHH", "RDB"}


def test_one_part_studio_of_a_version(server, no_waiting):
    find(f"onshape:{server.url}/documents/{DOC}/v/{VERSION}/e/{OTHER}")
    assert server.count("POST", f"/v/{VERSION}/e/{OTHER}/translations") == 1
    assert server.count("GET", "/currentmicroversion") == 0
    assert server.count("POST", "/translations") == 1


def test_what_was_done_is_not_done_again(server, no_waiting, tmp_path):
    source = f"onshape:{server.url}/documents/{DOC}/w/{SPACE}"
    first = find(source)
    calls = len(server.asked)
    assert find(source) == first
    assert len(server.asked) == calls + 1, "one call tells that nothing changed"
    version = f"onshape:{server.url}/documents/{DOC}/v/{VERSION}"
    find(version)
    calls = len(server.asked)
    find(version)
    assert len(server.asked) == calls, "a version never changes"
    target = tmp_path / "target"
    target.mkdir()
    with Sources.open() as opened, opened.fetcher(first, tmp_path / "ahead") as fetcher:
        for item in first:
            got = fetcher.take(item, target).result(60)
            assert hashlib.sha256(got.path.read_bytes()).hexdigest() == item.sha256
    assert len(server.asked) == calls, "the files are kept"
    for path in (tmp_path / "cache/downloads").rglob("*"):
        if path.is_file():
            path.unlink()
    with Sources.open() as opened, opened.fetcher(first, tmp_path / "ahead") as fetcher:
        assert fetcher.take(first[0], target).result(60).path.parent == target
    assert server.count("POST", "/translations") == 3, "it was downloaded again, not translated"


def test_a_changed_part_is_translated_again(server, no_waiting, played):
    source = f"onshape:{server.url}/documents/{DOC}/w/{SPACE}"
    before = {item.name: item.sha256 for item in find(source)}
    played.state, played.parts[0] = "0" * 24, body("JHD", state="9" * 24)
    after = {item.name: item.sha256 for item in find(source)}
    assert {name for name in after if after[name] != before[name]} == {f"{DOC}/{STUDIO}/JHD"}
    assert server.count("POST", "/translations") == 4


def test_looks_at_a_translation_become_rare(onshape, played, waits):
    played.active = 7
    (part, *_) = onshape.parts(WORKSPACE, by_studio=False)
    onshape.fetch(part)
    assert waits == [2, 4, 8, 16, 32, 60, 60, 60]
    played.active = 1000
    part = onshape.parts(WORKSPACE, by_studio=False)[1]
    with pytest.raises(InputError, match="is not translated after"):
        onshape.fetch(part)


def test_an_interrupted_translation_is_taken_up(onshape, played, server, monkeypatch):
    (part, *_) = onshape.parts(WORKSPACE, by_studio=False)

    def killed(_seconds):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(onshape, "_wait", killed)
        with pytest.raises(KeyboardInterrupt):
            onshape.fetch(part)
    download, _ = onshape.fetch(part)
    assert download.bytes > 0
    assert server.count("POST", "/translations") == 1


def test_a_forgotten_translation_is_begun_anew(onshape, played, server, monkeypatch):
    (part, *_) = onshape.parts(WORKSPACE, by_studio=False)
    with monkeypatch.context() as patch:
        patch.setattr(onshape, "_wait", lambda _seconds: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            onshape.fetch(part)
    played.translations["t0"], played.translations = None, {"t9": (STUDIO, "x")}
    onshape.fetch(part)
    assert server.count("POST", "/translations") == 2


def test_an_expired_file_is_translated_again(onshape, played, server):
    (part, *_) = onshape.parts(WORKSPACE, by_studio=False)
    played.expired.add("datat0")
    download, address = onshape.fetch(part)
    assert server.count("POST", "/translations") == 2
    assert download.bytes > 0
    played.expired.add("datat1")
    with pytest.raises(InputError, match="has the translation no more"):
        onshape.fetch_again(address, onshape._ledger.folder / "x")
    onshape.fetch(part)
    assert server.count("POST", "/translations") == 3
    played.expired |= {f"datat{i}" for i in range(9)}
    other = onshape.parts(WORKSPACE, by_studio=False)[1]
    with pytest.raises(InputError, match="gone before it was downloaded"):
        onshape.fetch(other)


def test_a_part_that_cannot_be_translated_is_one_failure(server, no_waiting, played):
    played.failing.add("JHH")
    bad = [item for item in find(f"onshape:{server.url}/documents/{DOC}") if item.failure]
    assert [(item.name, item.failure.kind) for item in bad] == [
        (f"{DOC}/{STUDIO}/JHH", "translation-failed")
    ]
    assert "Geometry is broken" in bad[0].failure.message


def test_limits_of_the_server_are_obeyed(onshape, played, server):
    played.faults = [
        (429, {"Retry-After": "1", "X-Rate-Limit-Remaining": "0"}, b""),
        (503, {"Retry-After": "1"}, b""),
        (500, {}, b""),
        (499, {}, b""),
    ]
    assert len(onshape.parts(WORKSPACE, by_studio=False)) == 3
    assert len(server.asked) == 4 + 3


def test_redirections_are_signed_anew(onshape, played, server, serve):
    """Onshape answers some calls by a redirection to a regional server."""
    (part, *_) = onshape.parts(WORKSPACE, by_studio=False)
    played.redirect = f"{server.url}/regional?node=Eu1"

    def regional(_server, method, path, headers, data):
        if path == "/regional?node=Eu1":
            played.check(method, path, headers)
            return 200, {}, b"ISO-10303-21; regional"
        return played(_server, method, path, headers, data)

    server.answer = regional
    download, _ = onshape.fetch(part)
    assert download.sha256 == hashlib.sha256(b"ISO-10303-21; regional").hexdigest()


def test_strangers_get_no_signature(onshape, played, serve):
    (part, *_) = onshape.parts(WORKSPACE, by_studio=False)
    stranger = serve(lambda *_: (200, {}, b"ISO-10303-21; bucket"))
    played.redirect = f"{stranger.url.replace('127.0.0.1', 'localhost')}/bucket?signature=x"
    onshape.fetch(part)
    (asked,) = stranger.asked
    assert not {"authorization", "on-nonce"} & set(asked[2])


def test_wrong_keys_end_the_run(server, played):
    played.faults = [(401, {}, b"")]
    with pytest.raises(UsageError, match="does not accept the keys in ONSHAPE_ACCESS_KEY"):
        find(f"onshape:{server.url}/documents/{DOC}")


def test_spent_calls_are_not_tried_again_and_again(server, played, no_waiting):
    good = [SUMMARY, {"microversion": STATE}, PARTS]
    played.faults = [(200, {}, json.dumps(answer).encode()) for answer in good]
    played.faults.append((402, {}, b""))
    found = find(f"onshape:{server.url}/documents/{DOC}")
    assert {item.failure.kind for item in found} == {"download-failed"}
    assert "used up" in found[0].failure.message
    assert len(server.asked) <= 3 + 4, "only what was under way already"


def test_documents_that_cannot_be_read_are_failures(server, no_waiting):
    gone = "0" * 24
    (item,) = find(f"onshape:{server.url}/documents/{gone}/w/{SPACE}")
    assert (item.name, item.failure.kind) == (gone, "download-failed")
    assert "private or gone" in item.failure.message


@pytest.mark.parametrize(
    ("route", "answer", "reason"),
    [
        ("currentmicroversion", {}, "lacks 'microversion'"),
        (f"/parts/d/{DOC}", [{"name": "x", "elementId": "e"}], "lacks 'partId'"),
        (f"/parts/d/{DOC}", {"message": "later"}, "is dict and no array"),
        (f"/documents/{DOC}", [], "is list and no object"),
        ("/translations", {"requestState": "ACTIVE"}, "lacks 'id'"),
        ("/translations/t0", {"id": "t0"}, "lacks 'requestState'"),
    ],
)
def test_answers_that_lack_something_are_failures(
    server, no_waiting, played, monkeypatch, route, answer, reason
):
    def answered(server, method, path, *rest):
        if urlsplit(path).path.endswith(route) or (route in path and "/parts/" in route):
            return 200, {}, json.dumps(answer).encode()
        return played(server, method, path, *rest)

    monkeypatch.setattr(server, "answer", answered)
    found = find(f"onshape:{server.url}/documents/{DOC}/w/{SPACE}")
    failed = [item.failure for item in found if item.failure]
    assert failed
    assert {failure.kind for failure in failed} == {"download-failed"}
    assert reason in failed[0].message


def test_public_documents_are_listed_page_by_page(onshape, server):
    found = list(onshape.public("gear box", 43))
    assert [document.id for document in found] == [f"{i:024x}" for i in range(43)]
    assert found[0] == Document("0" * 24, "w", SPACE)
    assert server.count("GET", "q=gear+box") == 3
    assert len(list(onshape.public("", 1000))) == 45


def test_a_list_may_name_documents(server, no_waiting, tmp_path):
    path = tmp_path / "list.csv"
    path.write_text(
        "uri,licence,collection,batch\n"
        f"{server.url}/documents/{DOC}/w/{SPACE}/e/{OTHER},CC0-1.0,mine,7\n",
        encoding="utf-8",
    )
    (item,) = find(path)
    assert (item.collection, item.name) == ("mine", f"{DOC}/{OTHER}/RDB")
    assert (item.facts.licence, item.facts.owner) == ("CC0-1.0", "Ada Lovelace")
    assert dict(item.facts.metadata)["batch"] == "7"


def test_the_secret_stays_secret(server, no_waiting, tmp_path, caplog):
    caplog.set_level(logging.DEBUG)
    find(f"onshape:{server.url}/documents/{DOC}")
    assert SECRET not in caplog.text
    assert SECRET not in repr(Keys(ACCESS, SECRET))
    assert ACCESS not in str(Keys(ACCESS, SECRET))
    for path in (tmp_path / "cache").rglob("*"):
        assert not path.is_file() or SECRET.encode() not in path.read_bytes()
    assert SECRET not in str(server.asked)


def test_the_signature_of_a_known_request():
    """Computed with openssl: printf '...' | openssl dgst -sha256 -hmac secret -binary | base64."""
    proof = signature(
        Keys("key", "secret"),
        "GET",
        "https://cad.onshape.com/api/v10/documents?q=Gear&offset=0",
        nonce="0123456789abcdefABCDEF",
        date="Mon, 11 Apr 2016 20:08:56 GMT",
        content_type="application/json",
    )
    assert proof == "On key:HmacSHA256:0DwbqBaYSk9qwVdmC+YWKPDNJvnho5/Khnl/DrsNXtg="


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("onshape:", "is no document"),
        ("onshape:https://evil.example/documents/" + DOC, "is no document"),
        (f"onshape:https://cad.onshape.com/documents/{DOC}/m/{STATE}", "microversion"),
        ("onshape:https://cad.onshape.com/documents/zz", "is no document"),
        (f"onshape:https://cad.onshape.com/documents/{DOC}?by=face", "by must be"),
        (f"onshape:https://cad.onshape.com/documents/{DOC}?q=a", "no option 'q'"),
        ("onshape:public?limit=many", "limit must be"),
        ("onshape:public?limit=0", "limit must be"),
        ("onshape:public?owner=me", "no option 'owner', only q, limit, by"),
    ],
)
def test_sources_that_are_none(source, reason):
    with pytest.raises(UsageError, match=reason):
        Query.parse(source)


def test_sources_that_are_some():
    address = f"onshape:https://cad.onshape.com/documents/{DOC}/w/{SPACE}/e/{STUDIO}?by=studio"
    assert Query.parse(address) == Query(Document(DOC, "w", SPACE, STUDIO), by_studio=True)
    assert Query.parse("onshape:public?q=gear%20box&limit=3") == Query(None, "gear box", 3)


def test_keys_come_from_the_environment(monkeypatch):
    monkeypatch.delenv("ONSHAPE_SECRET_KEY", raising=False)
    monkeypatch.setenv("ONSHAPE_ACCESS_KEY", ACCESS)
    with pytest.raises(UsageError, match="set ONSHAPE_ACCESS_KEY and ONSHAPE_SECRET_KEY"):
        find(f"onshape:https://cad.onshape.com/documents/{DOC}")
    monkeypatch.setenv("ONSHAPE_URL", "http://cad.onshape.com")
    with pytest.raises(UsageError, match="https://"):
        base_address()
