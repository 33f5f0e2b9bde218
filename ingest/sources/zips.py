"""Members of zip files."""

from __future__ import annotations

import lzma
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from breplake.ingest.sources.entry import Damage, Entry, Taker, damage_of
from breplake.ingest.sources.limits import Meter

__all__ = ["read_zip"]

_BLOCK: Final = 2**20
_SMALL: Final = 2**14
"""Bytes read at once: bzip2 and LZMA unpack all they are given in one piece, however large."""

_ENCRYPTED: Final = 0x1
_MS_DOS: Final = 0  # members made there have no Unix mode

_ERRORS: Final = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    LookupError,
    ArithmeticError,
    RuntimeError,
    ValueError,
    OSError,
)
"""What zipfile raises on bytes that are wrong, beside its own error: of names that are no text,
extra fields that are too short, methods and offsets that do not exist."""


def read_zip(path: Path, taker: Taker, meter: Meter) -> None:
    """Give the members of the zip file at `path` to `taker`.

    Raises
    ------
    RefusedSourceError
        If it unpacks to too much, or a member is not safe.
    Damage
        If it has no readable directory; the fault of one member is told to the taker.
    """
    try:
        archive = zipfile.ZipFile(path)
    except _ERRORS as error:
        damage = damage_of(error)
        if damage.kind == "bad-archive":
            raise Damage(
                damage.kind, f"{damage.detail}; a zip file that was cut off looks so"
            ) from error
        raise damage from error
    with archive:
        infos = archive.infolist()
        meter.declare(0, len(infos))
        entries = [(_entry(place, info), info) for place, info in enumerate(infos)]
        wanted = [(entry, info) for entry, info in entries if taker.wants(entry)]
        taker.listed()
        meter.declare(sum(info.file_size for info in infos), len(infos))
        for entry, info in wanted:
            _read(archive, entry, info, taker, meter)


def _entry(place: int, info: zipfile.ZipInfo) -> Entry:
    # `orig_filename` is the name before zipfile cuts it off at a zero byte.
    name = info.orig_filename
    if info.is_dir():
        return Entry(place, name, "folder")
    mode = info.external_attr >> 16 if info.create_system != _MS_DOS else 0
    kind = stat.S_IFMT(mode)
    if kind == stat.S_IFLNK:
        return Entry(place, name, "link")
    return Entry(place, name, "file" if kind in (0, stat.S_IFREG) else "special")


def _read(
    archive: zipfile.ZipFile, entry: Entry, info: zipfile.ZipInfo, taker: Taker, meter: Meter
) -> None:
    if info.flag_bits & _ENCRYPTED:
        taker.failed(entry, "encrypted", "")
        return
    blocks = _blocks(archive, info)
    size = 0
    while True:
        try:
            block = next(blocks, b"")
        except _ERRORS as error:  # of reading alone: those of the taker are not the archive's
            damage = damage_of(error)
            taker.failed(entry, damage.kind, damage.detail)
            return
        if not block:
            taker.done(entry)
            return
        meter.add(len(block))
        size += len(block)
        if size > meter.limits.member:
            taker.failed(entry, "too-large", f"more than {meter.limits.member} bytes")
            return
        taker.write(entry, block)


def _blocks(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[bytes]:
    plain = info.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
    with archive.open(info) as file:
        while block := file.read(_BLOCK if plain else _SMALL):
            yield block
