"""A search of Onshape that fails is one failure of the lake, and no other source suffers."""

from __future__ import annotations

import json
from urllib.parse import parse_qs, urlsplit

import pytest

pytest.importorskip("OCP")
pytest.importorskip("urllib3")

from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.ingest.run import ingest
from breplake.ingest.sources.onshape import SEARCH, Query
from breplake.ingest.sources.resolve import Sources

SOURCE = "onshape:public?q=gear&limit=45"


class Onshape:
    """Lists as many documents as are told, then fails; no document can be read."""

    def __init__(self):
        self.pages, self.listed = 0, 40

    def __call__(self, _server, _method, path, _headers, _data):
        parts = urlsplit(path)
        if parts.path != "/api/v10/documents":
            return 404, {}, b"{}"
        first = int(parse_qs(parts.query)["offset"][0])
        if first >= 20 * self.pages:
            return 403, {}, b"{}"
        items = [{"id": f"{i:024x}"} for i in range(first, min(first + 20, self.listed))]
        return 200, {}, json.dumps({"items": items, "next": "more" if items else None}).encode()


@pytest.fixture
def onshape():
    return Onshape()


@pytest.fixture(autouse=True)
def server(onshape, serve, monkeypatch):
    started = serve(onshape)
    monkeypatch.setenv("ONSHAPE_URL", started.url)
    monkeypatch.setenv("ONSHAPE_ACCESS_KEY", "key")
    monkeypatch.setenv("ONSHAPE_SECRET_KEY", "secret")
    return started


@pytest.fixture
def folder(tmp_path):
    """Another source, whose only file needs no kernel."""
    path = tmp_path / "in"
    path.mkdir()
    (path / "empty.step").touch()
    return path


def failures(lake):
    query = "SELECT collection, name, stage, kind FROM failures ORDER BY ALL"
    return breplake.open(lake).sql(query).fetchall()


SEARCHED = ("onshape", "public?q=gear&limit=45", "fetch", "search-failed")
EMPTY = ("in", "empty", "plan", "empty-file")


def test_the_other_sources_are_ingested(folder, tmp_path):
    lake = tmp_path / "lake"
    result = CliRunner().invoke(app, ["ingest", SOURCE, str(folder), "--lake", str(lake)])
    assert result.exit_code == 2
    assert failures(lake) == [EMPTY, SEARCHED]
    said = " ".join(result.stderr.split())
    assert f"breplake: {SOURCE}: Onshape /documents: the server answers 403" in said
    assert "what it would have found is missing; run the same command again later" in said
    assert "--retry-failures" not in said
    assert "2 failed" in result.stdout


def test_the_only_source(tmp_path):
    """Whether the lake has the failure already or not."""
    lake = tmp_path / "lake"
    for _ in range(2):
        result = CliRunner().invoke(app, ["ingest", SOURCE, "--lake", str(lake)])
        assert result.exit_code == 2
        assert f"breplake: {SOURCE}: Onshape /documents" in " ".join(result.stderr.split())
        assert failures(lake) == [SEARCHED]


def test_a_search_that_works_again_takes_its_failure_back(onshape, folder, tmp_path):
    lake = tmp_path / "lake"
    summary = ingest([SOURCE, folder], lake)
    assert [item.shown for item in summary.unanswered] == [SOURCE]
    onshape.pages, onshape.listed = 1, 0
    summary = ingest([SOURCE, folder], lake)
    assert summary.unanswered == []
    assert failures(lake) == [EMPTY]


def test_what_was_found_before_is_read(onshape):
    onshape.pages = 1
    with Sources.open() as opened:
        found = opened.find([SOURCE])
    kinds = [item.failure.kind for item in found]
    assert sorted(set(kinds)) == ["download-failed", "search-failed"]
    assert kinds.count("download-failed") == 20, "documents of the first page, none can be read"
    assert [item.format for item in found].count(SEARCH) == 1


def test_a_document_that_can_be_read_again_takes_its_failure_back(onshape, tmp_path, server):
    document, space = "a" * 24, "b" * 24
    address = f"onshape:{server.url}/documents/{document}/v/{space}"
    ingest([address], tmp_path / "lake")
    assert [row[1] for row in failures(tmp_path / "lake")] == [document]
    summary = {
        "createdAt": "2016-05-04T10:00:00.000+0000",
        "modifiedAt": "2017-05-04T10:00:00.000+0000",
        "name": "Gearbox",
        "public": True,
        "owner": {"name": "Ada"},
    }
    server.answer = lambda _server, _method, path, *_: (
        200,
        {},
        json.dumps([] if "/parts/" in path else summary).encode(),
    )
    ingest([address], tmp_path / "lake")
    assert failures(tmp_path / "lake") == []


def test_a_row_of_a_list_may_be_a_search(tmp_path):
    path = tmp_path / "list.csv"
    path.write_text(f"uri,collection\n{SOURCE},mine\n")
    with Sources.open() as opened:
        (item,) = opened.find([path])
    assert (item.collection, item.name, item.format) == ("mine", SEARCHED[1], SEARCH)


@pytest.mark.parametrize(
    ("source", "name"),
    [
        ("onshape:public", "public?q=&limit=20"),
        ("onshape:public?limit=3&q=gear%20box&by=studio", "public?q=gear+box&limit=3&by=studio"),
    ],
)
def test_a_search_has_one_name_however_it_is_written(source, name):
    assert Query.parse(source).name == name
    assert Query.parse(f"onshape:{name}") == Query.parse(source)
