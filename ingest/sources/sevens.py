"""Members of 7z files, whose solid blocks are unpacked in order and only once."""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any

from breplake.errors import MissingExtraError
from breplake.ingest.sources.entry import Damage, Entry, Taker, damage_of
from breplake.ingest.sources.limits import Meter

__all__ = ["need_py7zr", "read_7z"]


def need_py7zr() -> Any:
    """Return the module ``py7zr``.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import py7zr
    except ImportError as error:
        raise MissingExtraError("sources", "reading 7z archives") from error
    return py7zr


def read_7z(path: Path, taker: Taker, meter: Meter) -> None:
    """Give the members of the 7z file at `path` to `taker`.

    Raises
    ------
    RefusedSourceError
        If it unpacks to too much, or a member is not safe.
    Damage
        If it has no readable directory or needs a password; a fault inside one solid block is
        told to the taker for the members from there to the block's end.
    """
    py7zr = need_py7zr()
    with path.open("rb") as file:
        try:
            # Given a file and not its name, py7zr unpacks in one thread and in order.
            archive = py7zr.SevenZipFile(file, mode="r", max_extract_size=meter.allowed)
            locked = archive.needs_password()
        except py7zr.exceptions.PasswordRequired as error:
            raise Damage("encrypted", "") from error
        except _errors(py7zr) as error:
            damage = damage_of(error)
            if damage.kind == "bad-archive":
                detail = f"{damage.detail}; a 7z file that was cut off looks so"
                raise Damage(damage.kind, detail) from error
            raise damage from error
        with archive:
            infos = list(archive.files)
            meter.declare(0, len(infos))
            entries = [_entry(place, info) for place, info in enumerate(infos)]
            wanted = [entry for entry in entries if taker.wants(entry)]
            taker.listed()
            meter.declare(sum(info.uncompressed for info in infos), len(infos))
            if locked:
                raise Damage("encrypted", "")
            _Extraction(py7zr, archive, infos, taker, meter).run(wanted)


def _entry(place: int, info: Any) -> Entry:
    if info.is_directory:
        return Entry(place, info.filename, "folder")
    if info.is_symlink or info.is_junction:
        return Entry(place, info.filename, "link")
    return Entry(place, info.filename, "special" if info.is_socket else "file")


def _errors(py7zr: Any) -> tuple[type[Exception], ...]:
    """Return what py7zr raises on broken input: its own errors, and those of its parser."""
    parser = (lzma.LZMAError, zlib.error, OSError, EOFError, ValueError, LookupError, TypeError)
    return (py7zr.exceptions.ArchiveError, *parser, AssertionError, AttributeError)


class _Extraction:
    """Unpacks members of one archive, and goes on with the next block where one is broken."""

    def __init__(
        self, py7zr: Any, archive: Any, infos: list[Any], taker: Taker, meter: Meter
    ) -> None:
        self.py7zr, self.archive, self.infos = py7zr, archive, infos
        self.taker, self.meter = taker, meter
        self.open: Entry | None = None
        self.size = 0
        self.ended: set[int] = set()

    def run(self, wanted: Iterable[Entry]) -> None:
        """Give all of `wanted` to the taker."""
        left = list(wanted)
        while left:
            try:
                self._extract(left)
            except self.py7zr.exceptions.DecompressionBombError as error:
                raise self.meter.bomb(self.meter.allowed) from error
            except _Foreign as error:
                raise error.cause from None
            except _errors(self.py7zr) as error:
                damage = damage_of(error)
                if damage.kind != "bad-archive":
                    raise damage from error
                self._give_up_block(left, damage.detail)
            else:
                self._check_all_ended(left)
            left = [entry for entry in left if entry.place not in self.ended]

    def _extract(self, entries: list[Entry]) -> None:
        self.archive.reset()
        names = {PurePosixPath(entry.name).as_posix(): entry for entry in entries}
        self.archive.extract(
            targets=[entry.name for entry in entries], factory=_Factory(self, names)
        )

    def _give_up_block(self, left: list[Entry], detail: str) -> None:
        """Fail the member at which a block broke, and all that follow in it."""
        first = self.open or left[0]
        block = self.infos[first.place].folder
        self.open = None
        for entry in left:
            if entry.place not in self.ended and self.infos[entry.place].folder is block:
                self._fail(entry, "bad-archive", detail if entry is first else _after(first))

    def _check_all_ended(self, left: list[Entry]) -> None:
        for entry in left:
            if entry.place not in self.ended:
                self._fail(entry, "bad-archive", "its bytes are not in the archive")

    def _fail(self, entry: Entry, kind: str, detail: str) -> None:
        self.ended.add(entry.place)
        self.taker.failed(entry, kind, detail)

    def begin(self, entry: Entry) -> None:
        """Learn that the bytes of a member come next."""
        self.open, self.size = entry, 0

    def write(self, entry: Entry, data: bytes) -> None:
        """Pass bytes of a member on, unless it has failed already."""
        self.meter.add(len(data))
        if entry.place in self.ended:
            return
        self.size += len(data)
        if self.size > self.meter.limits.member:
            self._fail(entry, "too-large", f"more than {self.meter.limits.member} bytes")
            return
        self.taker.write(entry, data)

    def end(self, entry: Entry) -> None:
        """Learn that a member is complete and its checksum right."""
        self.open = None
        if entry.place not in self.ended:
            self.ended.add(entry.place)
            self.taker.done(entry)


def _after(first: Entry) -> str:
    return f"the solid block it is in is broken at {first.name!r}"


class _Foreign(Exception):
    """An error of the taker or the meter on its way through py7zr, whose fault it is not."""

    def __init__(self, cause: Exception) -> None:
        super().__init__(str(cause))
        self.cause = cause


class _Factory:
    """What py7zr calls a writer factory: gives the writer of a member when its turn comes."""

    def __init__(self, extraction: _Extraction, entries: dict[str, Entry]) -> None:
        self._extraction, self._entries = extraction, entries

    def create(self, filename: str) -> _Writer:
        return _Writer(self._extraction, self._entries[filename])


class _Writer:
    """What py7zr writes a member to; it calls `close` only if the checksum is right."""

    def __init__(self, extraction: _Extraction, entry: Entry) -> None:
        self._extraction, self._entry, self._size = extraction, entry, 0
        extraction.begin(entry)

    def write(self, data: bytes) -> int:
        try:
            self._extraction.write(self._entry, data)
        except Exception as error:
            raise _Foreign(error) from error
        self._size += len(data)
        return len(data)

    def close(self) -> None:
        try:
            self._extraction.end(self._entry)
        except Exception as error:
            raise _Foreign(error) from error

    def read(self, _size: int | None = None) -> bytes:
        return b""

    def seek(self, _offset: int, _whence: int = 0) -> int:
        return 0

    def flush(self) -> None:
        """Nothing is buffered here."""

    def size(self) -> int:
        return self._size
