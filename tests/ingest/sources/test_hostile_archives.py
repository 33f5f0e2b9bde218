"""Archives that are not safe: refused as a whole, and nothing of them is written anywhere."""

from __future__ import annotations

import hashlib
import io
import re
import stat
import tarfile
import zipfile

import pytest

pytest.importorskip("py7zr")

from breplake.ingest.sources.limits import Limits, hostile_link, hostile_name

from .archives import noise
from .found import find, kinds

TRUSTING = Limits(expansion=1e6)

HOSTILE = {
    "../up.step": "leads out",
    "a/../../up.step": "leads out",
    "..\\up.step": "leads out",
    "/etc/root.step": "is absolute",
    "\\\\server\\x.step": "is absolute",
    "C:\\x.step": "names a drive",
    "../notes.txt": "leads out",
}


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
