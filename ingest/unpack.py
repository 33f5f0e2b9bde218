"""Compressed CAD files, unpacked no further than to a sane size."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from breplake.errors import InputError
from breplake.ingest.failure import advise

__all__ = ["MAX_UNPACKED", "unpacked"]

MAX_UNPACKED: Final = 4 * 2**30
"""Bytes a compressed file may unpack to: far beyond any CAD file, far below a bomb."""

_BLOCK: Final = 2**20


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
        ``bad-archive`` if it cannot be unpacked, ``unreadable`` if it cannot be read.
    OSError
        If the content cannot be written, which is no fault of the file.
    """
    if source.suffix.lower() != ".gz":
        return source
    target = folder / f"unpacked.{format}"
    with target.open("wb") as plain:
        for block in _blocks(source):
            plain.write(block)
    return target


def _blocks(source: Path) -> Iterator[bytes]:
    """Yield the content of a compressed file; its faults alone are caught, not the caller's."""
    left = MAX_UNPACKED
    try:
        with gzip.open(source) as packed:
            while block := packed.read(_BLOCK):
                left -= len(block)
                if left < 0:
                    raise _bad(f"it unpacks to more than {MAX_UNPACKED} bytes")
                yield block
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise _bad(str(error)) from error
    except OSError as error:
        message = advise("unreadable", error.strerror or str(error))
        raise InputError("unreadable", message) from error


def _bad(detail: str) -> InputError:
    return InputError("bad-archive", advise("bad-archive", detail))
