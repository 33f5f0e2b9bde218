"""Compressed CAD files, unpacked no further than to a sane size."""

from __future__ import annotations

import gzip
import shutil
import zlib
from pathlib import Path
from typing import Any, Final

from breplake.errors import InputError
from breplake.ingest.failure import advise

__all__ = ["MAX_UNPACKED", "unpacked"]

MAX_UNPACKED: Final = 4 * 2**30
"""Bytes a compressed file may unpack to: far beyond any CAD file, far below a bomb."""


def unpacked(source: Path, format: str, folder: Path) -> Path:
    """Return `source` if it is not compressed, else its content in a file in `folder`.

    Parameters
    ----------
    source : Path
        The file; compressed if its name ends with ``.gz``.
    format : {"step", "iges", "brep"}
        Suffix of the file that is written.
    folder : Path
        Existing folder.

    Raises
    ------
    InputError
        ``bad-archive`` if it cannot be unpacked.
    """
    if source.suffix.lower() != ".gz":
        return source
    target = folder / f"unpacked.{format}"
    try:
        with gzip.open(source) as packed, target.open("wb") as plain:
            shutil.copyfileobj(_Limited(packed, MAX_UNPACKED), plain, 2**20)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError("bad-archive", advise("bad-archive", str(error))) from error
    return target


class _Limited:
    """A readable file that refuses to give more than so many bytes."""

    def __init__(self, file: Any, most: int) -> None:
        self.file, self.left = file, most

    def read(self, size: int = -1, /) -> bytes:
        data: bytes = self.file.read(size)
        self.left -= len(data)
        if self.left < 0:
            raise OSError(f"it unpacks to more than {MAX_UNPACKED} bytes")
        return data
