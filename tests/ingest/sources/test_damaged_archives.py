"""Archives that are damaged: each fault is one failure, and what can be read is kept."""

from __future__ import annotations

import hashlib
import random
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("py7zr")

from .archives import FILES, FORMATS, noise
from .found import find, kinds


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
