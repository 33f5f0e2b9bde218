"""Archives read member by member: what comes out, and when they are read at all."""

from __future__ import annotations

import hashlib
import io
import os
import tarfile
from pathlib import Path

import pytest

pytest.importorskip("py7zr")

from breplake.errors import UsageError
from breplake.ingest.printable import printable
from breplake.ingest.sources import survey as surveys
from breplake.ingest.sources.facts import Facts
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.resolve import Sources

from .archives import CAD, FILES, FORMATS, MANY, by_member
from .found import find, kinds


@pytest.mark.parametrize("ending", FORMATS)
def test_members_become_inputs(tmp_path, ending, pack):
    path = pack(tmp_path / f"my.parts{ending}", FILES)
    found = by_member(find(path))
    assert set(found) == CAD
    for name, item in found.items():
        assert item.collection == "my.parts"
        assert (item.bytes, item.sha256) == (
            len(FILES[name]),
            hashlib.sha256(FILES[name]).hexdigest(),
        )
    names = {member: (item.name, item.format) for member, item in found.items()}
    assert names == {
        "parts/b.step": ("parts/b", "step"),
        "parts/a.STP": ("parts/a", "step"),
        "parts/deep/c.igs.gz": ("parts/deep/c", "iges"),
        "parts/b.stp": ("parts/b.stp", "step"),  # as in a folder: the extension tells them apart
        "empty.brep": ("empty", "brep"),
    }
    assert kinds(found.values()) == {"empty": "empty-file"}
    assert {item.collection for item in find(path, collection="mine")} == {"mine"}


@pytest.mark.parametrize("ending", FORMATS)
def test_members_come_as_files(tmp_path, ending, pack):
    path = pack(tmp_path / f"a{ending}", FILES)
    target, found = tmp_path / "target", find(path)
    target.mkdir()
    with Sources.open() as sources, sources.fetcher(found, tmp_path / "ahead") as fetcher:
        for item in found:
            if item.failure is None:
                got = fetcher.take(item, target).result(60)
                assert got.path.parent == target
                assert got.path.read_bytes() == FILES[item.shown.partition("!/")[2]]
                packed = item.shown.endswith(".gz")
                assert got.path.suffix == (".gz" if packed else f".{item.format}")
                got.path.unlink()
    assert not (tmp_path / "ahead").exists()


def test_names_that_are_no_text(tmp_path):
    path = tmp_path / "a.tar"
    with tarfile.open(path, "w", format=tarfile.GNU_FORMAT) as archive:
        for name in ("caf\udce9.step", "good.step"):
            info = tarfile.TarInfo(name)
            info.size = 1
            archive.addfile(info, io.BytesIO(b"x"))
    found = find(path)
    assert [item.name for item in found] == [r"caf\xe9", "good"]
    assert kinds(found) == {}
    target = tmp_path / "target"
    target.mkdir()
    with Sources.open() as sources, sources.fetcher(found, tmp_path / "ahead") as fetcher:
        assert fetcher.take(found[0], target).result(60).path.read_bytes() == b"x"


@pytest.mark.parametrize(
    ("text", "shown"),
    [("plain ü", "plain ü"), ("\udcff", r"\xff"), ("half \ud83d of one", r"half \ud83d of one")],
)
def test_text_that_columns_cannot_hold_is_spelled_out(text, shown):
    assert printable(text) == shown
    facts = Facts(owner=text, metadata=((text, text),)).columns()
    assert (facts["owner"], facts["metadata"]) == (shown, [(shown, shown)])


def test_archives_in_folders_stay_closed(tmp_path, pack):
    (tmp_path / "box").mkdir()
    pack(tmp_path / "box/a.zip", FILES)
    assert find(tmp_path / "box") == []


def test_the_same_archive_twice_counts_once(tmp_path, pack):
    path = pack(tmp_path / "a.zip", FILES)
    assert len(find(path, tmp_path / "." / "a.zip", Path(os.path.relpath(path)))) == len(CAD)


def test_names_that_two_archives_share_are_told(tmp_path, pack):
    (tmp_path / "x").mkdir()
    first, second = pack(tmp_path / "a.zip", FILES), pack(tmp_path / "x/a.tar", FILES)
    with pytest.raises(UsageError, match="would both be model a/"):
        find(first, second)


def test_an_archive_is_read_once_for_all_runs(tmp_path, monkeypatch, pack):
    path = pack(tmp_path / "a.tar.gz", FILES)
    first = find(path)

    def never(*_):
        raise AssertionError("it was read again")

    with monkeypatch.context() as patch:
        patch.setattr(surveys, "ArchiveReader", never)
        assert find(path) == first
        path.rename(tmp_path / "b.tar.gz")
        moved = find(tmp_path / "b.tar.gz")
        assert [item.sha256 for item in moved] == [item.sha256 for item in first]
    changed = pack(tmp_path / "b.tar.gz", FILES | {"parts/b.step": b"other"})
    assert by_member(find(changed))["parts/b.step"].bytes == 5


def test_what_software_cannot_read_is_read_again_by_other_software(tmp_path, monkeypatch, pack):
    path = pack(tmp_path / "a.zip", FILES)
    read = []

    class Reader(surveys.ArchiveReader):
        def events(self):
            read.append(self)
            for word, values in super().events():
                if word == "done" and len(read) == 1:
                    yield "bad", (values[0], "bad-archive", "compression method 99")
                else:
                    yield word, values

    monkeypatch.setattr(surveys, "ArchiveReader", Reader)
    first = find(path)
    assert set(kinds(first).values()) == {"bad-archive"}
    assert find(path) == first
    assert len(read) == 1, "the same software was asked twice"
    monkeypatch.setattr(surveys, "version", lambda _package: "99")
    assert kinds(find(path)) == {"empty": "empty-file"}
    assert find(path) != first
    assert len(read) == 2, "what is in order depends on no version"


def test_problems_that_were_kept_without_versions_are_forgotten(tmp_path, pack):
    path = pack(tmp_path / "a.zip", FILES)
    limits = Limits()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    old = surveys.Survey(digest, damage=("bad-archive", "no such method"))
    with Ledger.open() as ledger:
        ledger.put("archive-1", f"{digest}/{limits.member}", old.document())
    assert set(by_member(find(path))) == CAD


def test_reading_ends_when_it_is_asked_to(tmp_path, pack):
    path = pack(tmp_path / "a.zip", MANY)
    with (
        pytest.raises(KeyboardInterrupt),
        Sources.open(stop=lambda: True) as sources,
    ):
        sources.find([path])
    assert len(find(path)) == len(MANY)


def test_an_archive_that_cannot_be_opened_is_one_failure(tmp_path, pack, monkeypatch):
    path = pack(tmp_path / "a.zip", FILES)

    def denied(*_):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(surveys, "_state", denied)
        (item,) = find(path)
    assert (item.name, item.failure.kind, item.sha256) == ("a.zip", "unreadable", None)
