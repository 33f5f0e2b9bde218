"""What was found out about sources, kept between runs so that it is not found out again.

Every entry is a fact that cannot change: the hash of a file of given size, inode and times, the
hashes of the members of an archive of given bytes, the hash of what an address gave under a given
entity tag, the translation of a part of a given version. Losing the ledger costs time and calls,
never correctness. Downloaded files lie beside it.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from breplake.errors import UsageError

__all__ = ["CACHE_VARIABLE", "Ledger", "cache_folder"]

CACHE_VARIABLE: Final = "BREPLAKE_CACHE"
"""Environment variable that names the folder of the ledger and of downloads."""

_PATIENCE: Final = 60.0
"""Seconds to wait for another process that writes."""


def cache_folder() -> Path:
    """Return the folder that keeps what was found out and downloaded; it need not exist.

    It is ``$BREPLAKE_CACHE``, else ``breplake`` in ``$XDG_CACHE_HOME`` or ``~/.cache``.
    """
    if given := os.environ.get(CACHE_VARIABLE):
        return Path(given)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "breplake"


class Ledger:
    """A persistent dictionary of JSON values, safe to share between threads and processes.

    Make one with :meth:`open`.
    """

    def __init__(self, connection: sqlite3.Connection, folder: Path) -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self.folder = folder

    @classmethod
    @contextmanager
    def open(cls, folder: Path | None = None) -> Iterator[Ledger]:
        """Open the ledger in `folder`, by default the `cache_folder`; both are made if missing.

        Raises
        ------
        UsageError
            If the folder cannot be written.
        """
        folder = folder or cache_folder()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(
                folder / "sources.sqlite",
                timeout=_PATIENCE,
                isolation_level=None,
                check_same_thread=False,
            )
            try:
                connection.execute(
                    "CREATE TABLE IF NOT EXISTS ledger (kind TEXT, key TEXT, value TEXT, "
                    "PRIMARY KEY (kind, key)) WITHOUT ROWID"
                )
            except sqlite3.Error:
                connection.close()
                raise
        except (OSError, sqlite3.Error) as error:
            raise UsageError(
                f"the cache {folder} cannot be used ({error}); "
                f"name a folder that can be written in {CACHE_VARIABLE}"
            ) from error
        try:
            yield cls(connection, folder)
        finally:
            connection.close()

    def get(self, kind: str, key: str) -> Any:
        """Return the value of `key`, or None if there is none."""
        query = "SELECT value FROM ledger WHERE kind = ? AND key = ?"
        with self._lock:
            row = self._connection.execute(query, (kind, key)).fetchone()
        return None if row is None else json.loads(row[0])

    def put(self, kind: str, key: str, value: Any) -> None:
        """Keep the value of `key`, in place of an earlier one."""
        self.put_all(kind, {key: value})

    def put_all(self, kind: str, values: dict[str, Any]) -> None:
        """Keep many values at once: all of them, or none if the process dies meanwhile."""
        rows = [(kind, key, json.dumps(value)) for key, value in values.items()]
        with self._lock, self._connection:
            self._connection.execute("BEGIN IMMEDIATE")
            self._connection.executemany("INSERT OR REPLACE INTO ledger VALUES (?, ?, ?)", rows)

    def drop(self, kind: str, key: str) -> None:
        """Forget `key`."""
        with self._lock:
            self._connection.execute("DELETE FROM ledger WHERE kind = ? AND key = ?", (kind, key))
