"""Random reads: of a file in object storage, and of the files of a folder wherever it is."""

from __future__ import annotations

import io
import os
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import obstore

if TYPE_CHECKING:
    from breplake.schema.storage import Storage

__all__ = ["LIST", "Folder", "LocalFolder", "RangeReader", "StoredFolder"]

LIST: Final = ".sha256"
"""Ending of the name of the list of a folder's files, which lies beside it."""

_TAIL: Final = 1 << 16
"""Bytes fetched from a file's end at once: a Parquet footer, which every reader asks for first."""


class RangeReader(io.RawIOBase):
    """A file in object storage, of which only what is read is fetched.

    Readers like DuckDB seek and then read, from several threads: each thread has a position of
    its own.

    Parameters
    ----------
    storage : Storage
        Where it is.
    path : str
        The file's path there.

    Raises
    ------
    FileNotFoundError
        If there is none.
    """

    def __init__(self, storage: Storage, path: str) -> None:
        self._storage, self._path = storage, path
        found = obstore.get(storage.connection, path, options={"range": {"suffix": _TAIL}})
        self._size = int(found.meta["size"])
        self._tail = bytes(found.bytes())
        self._local = threading.local()

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return this thread's position."""
        return int(getattr(self._local, "at", 0))

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Move this thread's position and return it."""
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self.tell(), os.SEEK_END: self._size}[whence]
        self._local.at = max(0, base + offset)
        return self.tell()

    def read(self, size: int = -1, /) -> bytes:
        """Return `size` bytes, fewer only at the end; all that are left if it is negative."""
        start = self.tell()
        end = self._size if size < 0 else min(start + size, self._size)
        if end <= start:
            return b""
        self._local.at = end
        before = self._size - len(self._tail)
        if start >= before:
            return self._tail[start - before : end - before]
        return bytes(obstore.get_range(self._storage.connection, self._path, start=start, end=end))

    def readall(self) -> bytes:
        """Return all bytes that are left."""
        return self.read()

    def readinto(self, buffer: Any, /) -> int:
        """Fill `buffer` and return how many bytes that took."""
        view = memoryview(buffer).cast("B")
        data = self.read(len(view))
        view[: len(data)] = data
        return len(data)


class Folder(Protocol):
    """The files of a folder, read in parts.

    Attributes
    ----------
    name : str
        Path or URL, for messages.
    """

    name: str

    def has(self, path: str) -> bool:
        """Return whether there is a file `path`."""
        ...

    def read(self, path: str) -> bytes:
        """Return the file `path`; FileNotFoundError if there is none."""
        ...

    def read_list(self) -> bytes:
        """Return the list of the folder's files; FileNotFoundError if there is none."""
        ...

    def read_range(self, path: str, start: int, size: int) -> bytes:
        """Return exactly `size` bytes from `start` on; ValueError if the file ends before."""
        ...

    def read_end(self, path: str, size: int) -> bytes:
        """Return exactly the last `size` bytes; FileNotFoundError if there is no file."""
        ...


class LocalFolder:
    """A folder of this machine; nothing stays open between reads.

    Parameters
    ----------
    path : pathlib.Path
        The folder, which need not exist.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.name = str(path)

    def has(self, path: str) -> bool:
        """Return whether there is a file `path`."""
        return (self._path / path).is_file()

    def read(self, path: str) -> bytes:
        """Return the file `path`; FileNotFoundError if there is none."""
        return (self._path / path).read_bytes()

    def read_list(self) -> bytes:
        """Return the list of the folder's files; FileNotFoundError if there is none."""
        return self._path.with_name(self._path.name + LIST).read_bytes()

    def read_range(self, path: str, start: int, size: int) -> bytes:
        """Return exactly `size` bytes from `start` on; ValueError if the file ends before."""
        descriptor = os.open(self._path / path, os.O_RDONLY)
        try:
            data = os.pread(descriptor, size, start)
        finally:
            os.close(descriptor)
        return _whole(data, size, f"{self.name}/{path}")

    def read_end(self, path: str, size: int) -> bytes:
        """Return exactly the last `size` bytes; FileNotFoundError if there is no file."""
        end = (self._path / path).stat().st_size
        return self.read_range(path, end - size, size)


class StoredFolder:
    """A folder in object storage.

    Parameters
    ----------
    storage : Storage
        Where it is.
    path : str
        The folder's path there.
    """

    def __init__(self, storage: Storage, path: str) -> None:
        self._storage, self._path = storage, path
        self.name = storage.locate(path)

    def has(self, path: str) -> bool:
        """Return whether there is a file `path`."""
        return self._storage.has(f"{self._path}/{path}")

    def read(self, path: str) -> bytes:
        """Return the file `path`; FileNotFoundError if there is none."""
        return self._storage.read(f"{self._path}/{path}")

    def read_list(self) -> bytes:
        """Return the list of the folder's files; FileNotFoundError if there is none."""
        return self._storage.read(self._path + LIST)

    def read_range(self, path: str, start: int, size: int) -> bytes:
        """Return exactly `size` bytes from `start` on; ValueError if the file ends before."""
        if not size:
            return b""
        place = f"{self._path}/{path}"
        connection = self._storage.connection
        data = bytes(obstore.get_range(connection, place, start=start, length=size))
        return _whole(data, size, f"{self.name}/{path}")

    def read_end(self, path: str, size: int) -> bytes:
        """Return exactly the last `size` bytes; FileNotFoundError if there is no file."""
        place = f"{self._path}/{path}"
        connection = self._storage.connection
        found = obstore.get(connection, place, options={"range": {"suffix": size}})
        return _whole(bytes(found.bytes()), size, f"{self.name}/{path}")


def _whole(data: bytes, size: int, name: str) -> bytes:
    if len(data) != size:
        raise ValueError(f"{name} ends early")
    return data
