"""Members of tar files, plain or compressed."""

from __future__ import annotations

import bz2
import gzip
import lzma
import struct
import tarfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final, cast

from breplake.errors import RefusedSourceError
from breplake.ingest.sources.entry import Damage, Entry, Taker, damage_of
from breplake.ingest.sources.limits import Meter, hostile_link

__all__ = ["read_tar"]

_BLOCK: Final = 2**20


def _open_zstd(file: Any) -> Any:
    import pyarrow  # here, since the others need not wait for it

    return pyarrow.input_stream(file, compression="zstd")


_OPENERS: Final[dict[str, Callable[[Any], Any]]] = {
    ".gz": gzip.open,
    ".tgz": gzip.open,
    ".bz2": bz2.open,
    ".tbz2": bz2.open,
    ".xz": lzma.open,
    ".txz": lzma.open,
    ".zst": _open_zstd,
    ".tzst": _open_zstd,
}
"""What unpacks a tar file, by the last ending of its name."""

_ERRORS: Final = (
    tarfile.TarError,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    LookupError,
    ArithmeticError,
    ValueError,
    OSError,
)


def read_tar(path: Path, taker: Taker, meter: Meter) -> None:
    """Give the members of the tar file at `path` to `taker`.

    A tar file has no directory: it is read as a stream, and where that breaks off the members
    that follow are unknown.

    Raises
    ------
    RefusedSourceError
        If it unpacks to too much, or a member is not safe: those behind it are listed still.
    Damage
        If it cannot be read, or not to its end.
    """
    with _unpacked(path) as file:
        stream = _Metered(file, meter)
        with _attributed():
            # "r|" reads a stream whose only method is `read`
            archive: Any = tarfile.open(fileobj=cast("Any", stream), mode="r|")  # noqa: SIM115
        with archive:
            for place, info in enumerate(_members(archive, meter)):
                _read(archive, _entry(place, info), info, taker, meter)
                if not taker.more():
                    return
        taker.listed()
        if stream.ended:
            raise Damage("bad-archive", "it ends without the mark of its end: it was cut off")


@contextmanager
def _unpacked(path: Path) -> Iterator[Any]:
    with path.open("rb") as packed, ExitStack() as stack:
        opener = _OPENERS.get(path.suffix.lower())
        yield packed if opener is None else stack.enter_context(opener(packed))


class _Metered:
    """A readable stream that counts what it gives.

    Attributes
    ----------
    ended : bool
        Something was read beyond the end.
    """

    def __init__(self, file: Any, meter: Meter) -> None:
        self._file, self._meter = file, meter
        self.ended = False

    def read(self, size: int) -> bytes:
        block: bytes = self._file.read(size)
        self._meter.add(len(block))
        self.ended = self.ended or not block
        return block


def _members(archive: Any, meter: Meter) -> Iterator[tarfile.TarInfo]:
    count = 0
    while True:
        with _attributed():
            info = archive.next()
        if info is None:
            return
        archive.members.clear()  # else it remembers all of them
        count += 1
        meter.declare(0, count)
        yield info


def _entry(place: int, info: tarfile.TarInfo) -> Entry:
    if info.isdir():
        return Entry(place, info.name, "folder")
    if info.issym() or info.islnk():
        danger = hostile_link(info.name, info.linkname, hard=info.islnk())
        return Entry(place, info.name, "link", danger)
    return Entry(place, info.name, "file" if info.isreg() else "special")


def _read(archive: Any, entry: Entry, info: tarfile.TarInfo, taker: Taker, meter: Meter) -> None:
    if not taker.wants(entry):
        return
    if info.size > meter.limits.member:
        taker.failed(entry, "too-large", f"{info.size} bytes")
        return
    file = archive.extractfile(info)
    if file is None:
        raise AssertionError(f"{info.name} is a regular file by its kind")
    while True:
        try:
            with _attributed():
                block = file.read(_BLOCK)
        except Damage as damage:
            taker.failed(entry, damage.kind, damage.detail)
            raise
        if not block:
            taker.done(entry)
            return
        if info.issparse():  # its holes are not in the archive, so were not counted yet
            meter.add(len(block))
        taker.write(entry, block)


@contextmanager
def _attributed() -> Iterator[None]:
    """Say of errors in a block that they are the archive's."""
    try:
        yield
    except RefusedSourceError:  # by the meter, while tarfile reads
        raise
    except _ERRORS as error:
        raise damage_of(error) from error
