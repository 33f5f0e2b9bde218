"""Names of ABC's chunks and files, and what its metadata say."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("yaml")

from breplake.ingest.sources.abc_names import (
    ONSHAPE_TERMS,
    abc_facts,
    abc_key,
    chunk_of,
    document_facts,
    is_meta_chunk,
    meta_chunk,
    metadata_key,
)

KEY = "00000050_80d90bfdd2e74e709956122a"
TRUTH = Path(f"/work/shared/abc_groundtruth/{KEY}_metadata_000.yml")


def test_names():
    assert chunk_of(Path("x/abc_0012_step_v00.7z")) == ("0012", "step")
    assert chunk_of(Path("abc_12_step_v00.7z")) is None
    assert is_meta_chunk(Path("ABC_0012_META_V00.7z"))
    assert not is_meta_chunk(Path("abc_0012_obj_v00.7z"))
    assert abc_key(f"00000050/{KEY}_step_000.step") == f"{KEY}_000"
    assert abc_key(f"{KEY}_features_000.yml") is None
    assert metadata_key(f"00000050/{KEY}_metadata_000.yml") == f"{KEY}_000"
    assert metadata_key("metadata_000.yml") is None


def test_the_chunk_beside(tmp_path):
    step, meta = (tmp_path / f"abc_0001_{kind}_v00.7z" for kind in ("step", "meta"))
    assert meta_chunk(step) is None
    meta.touch()
    assert meta_chunk(step) == meta
    assert meta_chunk(meta) is None
    assert meta_chunk(tmp_path / "abc_0002_step_v00.7z") is None


@pytest.mark.skipif(not TRUTH.exists(), reason="needs the ABC ground truth")
def test_a_real_file():
    facts = abc_facts(TRUTH.read_bytes())
    assert (facts.licence, facts.owner) == (ONSHAPE_TERMS, "Mark Gibson")
    assert facts.source_url == "https://cad.onshape.com/documents/80d90bfdd2e74e709956122a"
    assert dict(facts.metadata) == {
        "document": "Mark's First Document",
        "created": "2014-08-19T22:01:17.637+0000",
        "modified": "2014-08-19T23:15:51.643+0000",
    }


@pytest.mark.parametrize(
    ("summary", "licence"),
    [
        ({"public": True, "createdAt": "2018-08-06T23:59:59.000+0000"}, ONSHAPE_TERMS),
        ({"public": True, "createdAt": "2018-08-07T00:00:00.000+0000"}, None),
        ({"public": True, "createdAt": "2016-01-01"}, ONSHAPE_TERMS),
        ({"public": True, "createdAt": "some day"}, None),
        ({"public": True}, None),
        ({"public": False, "createdAt": "2016-01-01"}, None),
        ({"createdAt": "2016-01-01"}, None),
        ({"license": "MIT", "public": True, "createdAt": "2020-01-01"}, "MIT"),
    ],
)
def test_a_licence_is_not_guessed(summary, licence):
    assert document_facts(summary).licence == licence


@pytest.mark.parametrize("text", [b"a: [", b"- 1\n", b"", b"just text", b"\xff\xfe\x00"])
def test_what_is_no_summary(text):
    with pytest.raises(ValueError, match=r"no summary|cannot be parsed"):
        abc_facts(text)


def test_strange_summaries_say_little():
    facts = abc_facts(b"owner: Ada\ntags: [a, b]\nhref: 7\nid: 5\nname: ''\n")
    assert (facts.owner, facts.source_url) == ("Ada", "https://cad.onshape.com/documents/5")
    assert facts.metadata == (("tags", "a, b"),)
    facts = document_facts({"href": "https://cad.onshape.com/api/v10/documents/d/abc"})
    assert facts.source_url == "https://cad.onshape.com/documents/abc"
