"""A lake in object storage as DuckDB sees it: files of which only what is read is fetched.

DuckDB's own extension for that would have to be downloaded when it is first used.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Final

from fsspec import AbstractFileSystem

from breplake.schema.ranges import RangeReader
from breplake.schema.storage import Storage

__all__ = ["PROTOCOL", "LakeFiles", "lake_path", "lake_url"]

PROTOCOL: Final = "breplake"
"""What the paths begin with for which DuckDB asks `LakeFiles`."""


def lake_url(path: str) -> str:
    """Return what DuckDB calls the file `path`, which is relative to the lake."""
    return f"{PROTOCOL}://{path}"


def lake_path(url: str) -> str:
    """Return the file that `lake_url` named, relative to the lake."""
    return url.removeprefix(f"{PROTOCOL}://")


class LakeFiles(AbstractFileSystem):  # type: ignore[misc]  # fsspec ships no types
    """The files of a lake, for ``duckdb.DuckDBPyConnection.register_filesystem``.

    Parameters
    ----------
    storage : Storage
        Of the lake.
    """

    protocol = PROTOCOL
    cachable = False

    def __init__(self, storage: Storage) -> None:
        super().__init__()
        self._storage = storage

    def _open(self, path: str, mode: str = "rb", **_: Any) -> RangeReader:
        if mode != "rb":
            raise PermissionError(f"{self._storage.locate(path)} is written once, by ingest")
        return RangeReader(self._storage, path)

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        """Return name and size of a file.

        Raises
        ------
        FileNotFoundError
            If there is none.
        """
        name = self._strip_protocol(path)
        size = self._storage.size(name)
        if size is None:
            raise FileNotFoundError(self._storage.locate(name))
        return {"name": name, "size": size, "type": "file"}

    def glob(self, path: str, **_: Any) -> list[str]:
        """Return `path`: the names of a snapshot's files have no wildcards."""
        return [path]

    def modified(self, path: str) -> datetime:
        """Return the same for all files: they are written once."""
        return datetime.fromtimestamp(0, UTC)
