"""Archives read member by member: what comes out, what is recorded, what is refused."""

from __future__ import annotations

import errno
import gzip
import hashlib
import io
import json
import os
import random
import re
import stat
import subprocess
import sys
import tarfile
import zipfile
from concurrent.futures import wait
from pathlib import Path

import pytest

pytest.importorskip("py7zr")

from breplake.errors import InputError, UsageError
from breplake.ingest.printable import printable
from breplake.ingest.sources import reader, zips
from breplake.ingest.sources import survey as surveys
from breplake.ingest.sources.facts import Facts
from breplake.ingest.sources.feed import ArchiveFeed
from breplake.ingest.sources.limits import Limits, hostile_link, hostile_name
from breplake.ingest.sources.resolve import Sources
from breplake.ingest.sources.unpack import Request, read_archive

FORMATS = (".zip", ".tar", ".tar.gz", ".tar.bz2", ".tar.xz", ".tar.zst", ".7z")
TRUSTING = Limits(expansion=1e6)


def noise(seed: int, size: int = 3000) -> bytes:
    return random.Random(seed).randbytes(size)


FILES = {
    "parts/b.step": noise(1),
    "parts/a.STP": noise(2, 2_500_000),  # more than one block
    "readme.txt": b"no CAD file",
    "parts/deep/c.igs.gz": gzip.compress(noise(3)),
    "nested.zip": b"PK, which is not opened",
    "parts/b.stp": noise(4),
    "empty.brep": b"",
}
CAD = {name for name in FILES if name not in ("readme.txt", "nested.zip")}


def find(*paths, limits=None, **options):
    with Sources.open(limits) as sources:
        return sources.find(paths, **options)


def by_member(inputs):
    return {item.shown.partition("!/")[2]: item for item in inputs}


def refusal(*paths, **options):
    """Return why an archive is refused, and the names that are recorded with it."""
    found = find(*paths, **options)
    assert {item.failure.kind for item in found} == {"refused"}
    assert all(item.failure.fatal for item in found)
    (archive,) = (item for item in found if item.format == "archive")
    assert archive.sha256 == hashlib.sha256(archive.path.read_bytes()).hexdigest()
    members = [item for item in found if item is not archive]
    assert all(item.sha256 is None for item in members), "nothing of it is read"
    return archive.failure.message, [item.name for item in members]


def kinds(inputs):
    return {item.name: item.failure.kind for item in inputs if item.failure}


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


# -- hostile archives -------------------------------------------------------------------------


HOSTILE = {
    "../up.step": "leads out",
    "a/../../up.step": "leads out",
    "..\\up.step": "leads out",
    "/etc/root.step": "is absolute",
    "\\\\server\\x.step": "is absolute",
    "C:\\x.step": "names a drive",
    "../notes.txt": "leads out",
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("ending", [".zip", ".tar.gz"])
def test_names_that_lead_out_are_refused(tmp_path, ending, name, pack):
    files = {"good.step": b"x", name: b"bad", "more/good.stp": b"y"}
    path = pack(tmp_path / f"evil{ending}", files)
    before = sorted(tmp_path.rglob("*"))
    reason, members = refusal(path)
    assert HOSTILE[name] in reason
    assert f"{path} is refused" in reason
    assert members == ["good", *([name[:-5]] if name.endswith(".step") else []), "more/good"]
    after = [p for p in sorted(tmp_path.rglob("*")) if "cache" not in p.parts]
    assert after == before


def test_names_that_lead_out_of_7z_are_refused(tmp_path, rename_in_7z):
    import py7zr

    path = tmp_path / "evil.7z"
    with py7zr.SevenZipFile(path, "w") as archive:
        archive.set_encoded_header_mode(False)
        archive.writestr(b"bad", "AA/up.step")
    assert kinds(find(path)) == {}
    reason, members = refusal(rename_in_7z(path, "AA/up.step", "../up.step"))
    assert "leads out" in reason
    assert members == ["../up"]


def test_a_zero_byte_in_a_name_is_refused(tmp_path, pack):
    path = tmp_path / "evil.zip"
    pack(path, {"good.step?/../x": b"bad"})
    path.write_bytes(path.read_bytes().replace(b"step?", b"step\0"))
    assert "zero byte" in refusal(path)[0]


@pytest.mark.parametrize(
    ("target", "kind", "reason"),
    [
        ("/etc/passwd", tarfile.SYMTYPE, "absolute"),
        ("../../out.step", tarfile.SYMTYPE, "leads out"),
        ("../out.step", tarfile.LNKTYPE, "leads out"),
        ("C:\\out.step", tarfile.SYMTYPE, "absolute"),
        ("../good.step", tarfile.SYMTYPE, None),
        ("good.step", tarfile.LNKTYPE, None),
        ("", tarfile.CHRTYPE, None),
        ("", tarfile.FIFOTYPE, None),
    ],
)
def test_links_and_devices(tmp_path, target, kind, reason):
    path = tmp_path / "links.tar"
    with tarfile.open(path, "w") as archive:
        good = tarfile.TarInfo("good.step")
        good.size = 4
        archive.addfile(good, io.BytesIO(b"good"))
        link = tarfile.TarInfo("sub/link.step")
        link.type, link.linkname = kind, target
        archive.addfile(link)
    if reason is not None:
        said, members = refusal(path)
        assert reason in said
        assert members == ["good", "sub/link"]
    else:
        assert kinds(find(path)) == {"sub/link": "not-a-file"}


def test_a_link_in_a_zip_file_is_not_followed(tmp_path):
    path = tmp_path / "links.zip"
    with zipfile.ZipFile(path, "w") as archive:
        link = zipfile.ZipInfo("link.step")
        link.create_system, link.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc/passwd")
    assert kinds(find(path)) == {"link": "not-a-file"}


@pytest.mark.parametrize("name", ["bomb.step", "bomb.txt"])
@pytest.mark.parametrize("ending", [".zip", ".tar.gz", ".tar.xz", ".tar.zst", ".7z"])
def test_bombs_are_refused(tmp_path, ending, name, pack):
    path = pack(tmp_path / f"bomb{ending}", {"good.step": b"good", name: bytes(20_000_000)})
    assert path.stat().st_size < 20_000_000 / 900
    reason, members = refusal(path)
    assert re.search(r"decompression bomb.*--max-expansion", reason)
    if ending in (".zip", ".7z"):  # the others have no directory
        assert members == ["good", *(["bomb"] if name == "bomb.step" else [])]
    found = find(path, limits=TRUSTING)
    assert kinds(found) == {}
    assert "--max-expansion" in refusal(path)[0]  # though it was read before


def test_a_small_archive_may_expand_as_it_likes_every_time(tmp_path, pack):
    path = pack(tmp_path / "a.zip", {"a.step": bytes(500_000)})
    assert path.stat().st_size < 500_000 / 500
    for _ in range(2):
        assert kinds(find(path)) == {}


def test_a_bomb_that_lies_about_its_size_is_stopped_while_it_unpacks(tmp_path, pack):
    """The directory says 1000 bytes; the stream in the member is a bomb."""
    path = pack(tmp_path / "bomb.zip", {"bomb.step": bytes(20_000_000)})
    true, lie = (20_000_000).to_bytes(4, "little"), (1000).to_bytes(4, "little")
    assert path.read_bytes().count(true) == 2
    path.write_bytes(path.read_bytes().replace(true, lie))
    (item,) = find(path)
    assert item.failure.kind == "bad-archive"


def test_many_copies_of_one_file_are_no_bomb(tmp_path, pack):
    step = "".join(f"#{i}=CARTESIAN_POINT('',({i}.,{i * 7 % 99}.,0.));\n" for i in range(400))
    path = pack(tmp_path / "a.7z", {f"{i:04d}.step": step.encode() for i in range(60)})
    assert len(find(path)) == 60


def test_a_member_that_is_too_large_is_one_failure(tmp_path, pack):
    for ending in (".zip", ".tar", ".7z"):
        path = pack(tmp_path / f"a{ending}", {"a.step": noise(1, 5000), "b.step": noise(2, 100)})
        assert kinds(find(path)) == {}
        assert kinds(find(path, limits=Limits(member=4000))) == {"a": "too-large"}


@pytest.mark.parametrize("ending", [".zip", ".tar"])
def test_two_members_of_one_name_are_refused(tmp_path, ending, pack):
    path = pack(tmp_path / f"a{ending}", {"a.step": b"1", "b.step": b"2"})
    path.write_bytes(path.read_bytes().replace(b"b.step", b"a.step"))
    if ending == ".tar":  # the checksum of the second header counts its letters
        data = bytearray(path.read_bytes())
        info = tarfile.TarInfo("a.step")
        info.size = 1
        data[1024:1536] = info.tobuf(tarfile.GNU_FORMAT)
        path.write_bytes(data)
    reason, members = refusal(path)
    assert "two members 'a.step'" in reason
    assert members == ["a", "a.step"]


def test_too_many_members_are_refused(tmp_path, pack):
    for ending in (".zip", ".tar", ".7z"):
        path = pack(tmp_path / f"a{ending}", {f"{i}.txt": b"" for i in range(6)})
        assert "more than 5" in refusal(path, limits=Limits(members=5))[0]


@pytest.mark.parametrize("name", ["a.step", "x/y..step", "..x/a.step", "a b/ü.step", "-x.step"])
def test_good_names_pass(name):
    assert hostile_name(name) is None
    assert hostile_link(name, "b.step", hard=False) is None


# -- damaged archives -------------------------------------------------------------------------


def half(path: Path, share: float = 0.5) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


@pytest.mark.parametrize("ending", [".zip", ".7z"])
def test_a_directory_that_was_cut_off_is_one_failure(tmp_path, ending, pack):
    path = half(pack(tmp_path / f"cut{ending}", FILES), 0.9)
    (item,) = find(path)
    assert (item.name, item.format, item.failure.kind) == (path.name, "archive", "bad-archive")
    assert item.failure.fatal
    assert "cut off" in item.failure.message
    assert item.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("ending", [".tar", ".tar.gz", ".tar.xz", ".tar.bz2", ".tar.zst"])
def test_what_comes_before_the_cut_of_a_tar_is_kept(tmp_path, ending, pack):
    files = {f"{i}.step": noise(i, 400_000) for i in range(4)}
    path = half(pack(tmp_path / f"cut{ending}", files), 0.6)
    found = {item.name: item for item in find(path)}
    good = [name for name, item in found.items() if item.failure is None]
    assert good in (["0", "1"], ["0"])
    assert found[path.name].failure.kind == "bad-archive"
    assert f"after {len(good)} CAD files" in found[path.name].failure.message
    assert set(kinds(found.values()).values()) == {"bad-archive"}


def test_a_tar_cut_between_members_is_noticed(tmp_path, pack):
    path = pack(tmp_path / "cut.tar", {"a.step": noise(1, 512), "b.step": noise(2, 512)})
    path.write_bytes(path.read_bytes()[:1024])
    assert kinds(find(path)) == {"cut.tar": "bad-archive"}


def test_a_member_with_a_wrong_checksum_is_one_failure(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name in ("a.step", "b.step", "c.step"):
            archive.writestr(name, f"content of {name}")
    path.write_bytes(path.read_bytes().replace(b"content of b", b"CONTENT of b"))
    assert kinds(find(path)) == {"b": "bad-archive"}


def test_a_broken_block_of_a_7z_leaves_the_others(tmp_path, pack_7z):
    path = tmp_path / "a.7z"
    blocks = [{f"{b}{i}.step": noise(ord(b) + i, 50_000) for i in range(4)} for b in "abc"]
    pack_7z(path, *blocks)
    data = bytearray(path.read_bytes())
    middle = 32 + int(1.55 * (len(data) - 32) / 3)  # in the third member of the second block
    data[middle : middle + 4] = bytes(4)
    path.write_bytes(data)
    found = find(path)
    assert len(found) == 12
    bad = kinds(found)
    assert set(bad) == {"b2", "b3"}
    assert set(bad.values()) == {"bad-archive"}
    (message,) = (item.failure.message for item in found if item.name == "b3")
    assert "'b2.step'" in message


def test_a_password_is_told(tmp_path, pack, pack_7z):
    plain = pack_7z(tmp_path / "a.7z", {"a.step": b"secret"}, password="x")
    hidden = pack_7z(tmp_path / "b.7z", {"a.step": b"secret"}, password="x", header_encryption=True)
    assert set(kinds(find(plain)).values()) == {"encrypted"}
    assert kinds(find(hidden)) == {"b.7z": "encrypted"}
    path = pack(tmp_path / "c.zip", {"a.step": noise(1), "b.step": noise(2)})
    data = bytearray(path.read_bytes())
    directory = data.index(b"PK\x01\x02")
    data[6] |= 1  # the flag in the member's own header ...
    data[directory + 8] |= 1  # ... and in the directory
    path.write_bytes(data)
    assert kinds(find(path)) == {"a": "encrypted"}


@pytest.mark.parametrize("ending", FORMATS)
def test_rubbish_is_one_failure(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    for data in (b"", noise(1), b"7z\xbc\xaf\x27\x1c" + noise(2), b"PK\x05\x06" + noise(3)):
        path.write_bytes(data)
        assert set(kinds(find(path))) == {path.name}


def test_flipped_bits_never_stop_a_run(tmp_path, pack):
    """Every archive ends as inputs, failures or a refusal, whatever became of its bytes."""
    chance = random.Random(7)
    outcomes = set()
    for ending in (".zip", ".7z", ".tar.gz"):
        good = pack(tmp_path / f"a{ending}", {f"{i}.step": noise(i) for i in range(3)}).read_bytes()
        for _ in range(4):
            data = bytearray(good)
            for _ in range(3):
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
            path = tmp_path / f"a{ending}"
            path.write_bytes(data)
            outcomes |= {item.failure.kind if item.failure else "good" for item in find(path)}
    assert "bad-archive" in outcomes
    assert outcomes <= {"good", "bad-archive", "refused", "empty-file", "encrypted", "memory"}


# -- the process, the ledger, the order -------------------------------------------------------


def answers(path):
    """What the process that reads an archive would say."""
    said = io.StringIO()
    read_archive(Request(str(path), Limits()), io.StringIO(), said)
    return [json.loads(line) for line in said.getvalue().splitlines()]


def test_no_flipped_byte_of_a_zip_ends_the_reader(tmp_path, pack):
    """Of names, extra fields, methods and offsets, each with its own error in zipfile."""
    path = pack(tmp_path / "a.zip", {"grün.step": b"abc" * 9, "b.step": b"def" * 9})
    whole = path.read_bytes()
    lasts = set()
    for place in range(len(whole)):
        for mask in (0xFF, 0x80, 0x08, 0x01):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ mask]) + whole[place + 1 :])
            lasts.add(answers(path)[-1][0])
    assert lasts == {"end", "damaged", "refused"}


def test_an_error_that_nobody_expects_leaves_what_was_read(tmp_path, pack, monkeypatch):
    path = pack(tmp_path / "a.zip", {"a.step": b"abc", "b.step": b"def"})

    def read(file, entry, info, taker, meter):
        if entry.place:
            raise ZeroDivisionError("of a parser")
        taker.done(entry)

    monkeypatch.setattr(zips, "_read", read)
    said = answers(path)
    assert [words[:2] for words in said if words[0] == "done"] == [["done", 0]]
    assert said[-1] == ["damaged", "bad-archive", "ZeroDivisionError: of a parser"]


@pytest.mark.parametrize("ending", [".zip", ".tar", ".tar.gz"])
def test_a_failing_disk_is_no_fault_of_the_archive(tmp_path, ending, pack, monkeypatch):
    path = pack(tmp_path / f"a{ending}", {"a.step": b"abc"})

    def read(*_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    for reads in (zipfile.ZipExtFile, tarfile.ExFileObject):
        monkeypatch.setattr(reads, "read", read)
    assert ["bad", 0, "unreadable", "Input/output error"] in answers(path)


def test_what_a_failing_disk_hides_is_looked_up_again(tmp_path, monkeypatch, pack):
    path = pack(tmp_path / "a.zip", {"a.step": b"abc"})

    class Failing(surveys.ArchiveReader):
        def events(self):
            yield "member", [0, "a.step"]
            yield "bad", [0, "unreadable", "Input/output error"]

    with monkeypatch.context() as patch:
        patch.setattr(surveys, "ArchiveReader", Failing)
        (item,) = find(path)
        assert item.failure.kind == "unreadable"
    (item,) = find(path)
    assert item.failure is None


def test_a_crash_of_the_reader_is_one_failure(tmp_path, monkeypatch, pack):
    path = pack(tmp_path / "a.zip", FILES)
    crash = 'import os, sys; sys.stdin.readline(); print(\'["member", 0, "a.step"]\', flush=True);'
    crash += "os.kill(os.getpid(), 11)"
    with monkeypatch.context() as patch:
        patch.setattr(reader, "_COMMAND", (sys.executable, "-c", crash))
        found = find(path)
    assert kinds(found) == {"a": "worker-died", "a.zip": "worker-died"}
    assert "SIGSEGV" in found[0].failure.message
    assert len(find(path)) == len(CAD), "a crash is not remembered"


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


def test_the_reader_ends_with_the_one_who_asked(tmp_path, pack):
    path = pack(tmp_path / "a.zip", {"a.step": b"1", "b.step": b"2"})
    request = Request(str(path), Limits(), [0, 1], str(tmp_path))
    process = subprocess.Popen(
        reader._COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with process:
        process.stdin.write(request.line() + "1\n")
        process.stdin.flush()
        word, place, *_ = json.loads(process.stdout.readline())
        assert (word, place) == ("done", 0)
        assert process.poll() is None, "it waits for leave to write the second file"
        process.stdin.close()
        assert process.wait(20) == 1
    assert not (tmp_path / "1").exists()


MANY = {f"{i:03d}.step": noise(i, 2000) for i in range(60)}


@pytest.mark.parametrize("ending", [".zip", ".tar.gz", ".7z"])
@pytest.mark.parametrize("order", ["forwards", "backwards", "some"])
def test_members_may_be_asked_for_in_any_order(tmp_path, ending, order, pack):
    found = find(pack(tmp_path / f"a{ending}", MANY))
    assert [item.origin.place for item in found] == sorted(item.origin.place for item in found)
    asked = {"forwards": found, "backwards": found[::-1], "some": found[7::13]}[order]
    with Sources.open() as sources, sources.fetcher(asked, tmp_path / "ahead") as fetcher:
        for item in asked:
            (tmp_path / item.name).mkdir()
            got = fetcher.take(item, tmp_path / item.name).result(60)
            assert got.path.read_bytes() == MANY[f"{item.name}.step"]


def test_only_a_few_members_are_unpacked_ahead(tmp_path, pack):
    found = find(pack(tmp_path / "a.7z", MANY))
    with Sources.open() as sources, sources.fetcher(found, tmp_path / "ahead") as fetcher:
        (tmp_path / "t").mkdir()
        futures = [fetcher.take(item, tmp_path / "t") for item in found[:3]]
        assert not wait(futures, 60).not_done
        ahead = list((tmp_path / "ahead").rglob("*.step")) + list((tmp_path / "ahead/0").iterdir())
        assert len(ahead) <= 8


def test_an_archive_is_closed_behind_its_last_member(tmp_path, pack):
    paths = [pack(tmp_path / f"{n}.zip", {"a.step": b"a", "b.step": b"b"}) for n in "xy"]
    (tmp_path / "out").mkdir()
    children = Path(f"/proc/self/task/{os.getpid()}/children")
    with Sources.open() as opened:
        items = opened.find(paths)
        before = children.read_text().split()
        with opened.fetcher(items, tmp_path / "ahead") as fetcher:
            for number, item in enumerate(items, 1):
                got = fetcher.take(item, tmp_path / "out").result(60)
                assert got.path.read_bytes() == item.name.encode()
                open_now = set(children.read_text().split()) - set(before)
                assert len(open_now) == number % 2


def test_nobody_waits_for_a_reader_that_talks_nonsense(tmp_path, pack, monkeypatch):
    path = pack(tmp_path / "a.zip", {"a.step": b"a"})
    (tmp_path / "out").mkdir()

    def events(_self):
        yield "done", []

    monkeypatch.setattr(reader.ArchiveReader, "events", events)
    feed = ArchiveFeed(path, [0], tmp_path / "out", Limits())
    with pytest.raises(InputError, match="ValueError") as caught:
        feed.take(0).result(10)
    feed.close()
    assert caught.value.kind == "error"


def test_an_archive_that_changed_meanwhile_is_noticed(tmp_path, pack):
    path = pack(tmp_path / "a.zip", FILES)
    found = by_member(find(path))
    pack(path, FILES | {"parts/b.step": b"other bytes"})
    item = found["parts/b.step"]
    with Sources.open() as sources, sources.fetcher(found.values(), tmp_path / "x") as fetcher:
        with pytest.raises(InputError, match="changed since it was planned") as caught:
            fetcher.take(item, tmp_path).result(60)
        assert caught.value.kind == "hash-mismatch"


def test_an_archive_that_is_gone_meanwhile_is_noticed(tmp_path, pack):
    path = pack(tmp_path / "a.zip", FILES)
    found = by_member(find(path))
    path.unlink()
    with Sources.open() as sources, sources.fetcher(found.values(), tmp_path / "x") as fetcher:
        future = fetcher.take(found["parts/b.step"], tmp_path)
        with pytest.raises(InputError) as caught:
            future.result(60)
        assert caught.value.kind == "unreadable"


def test_a_full_disk_is_no_fault_of_the_archive(tmp_path, pack):
    path = pack(tmp_path / "a.zip", {"a.step": noise(1, 500_000)})
    folder = tmp_path / "ahead"
    folder.mkdir()
    (folder / "0").symlink_to("/dev/full")
    feed = ArchiveFeed(path, [0], folder, Limits())
    try:
        with pytest.raises(OSError, match="No space left"):
            feed.take(0).result(60)
    finally:
        feed.close()


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
