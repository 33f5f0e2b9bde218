"""A log of an ingest for machines: one line of JSON for each event."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

from breplake.errors import UsageError
from breplake.ingest.pool import Result

__all__ = ["Entry", "Journal", "entry_of"]

Entry = tuple[str, dict[str, Any]]
"""An event and what belongs to it."""


class Journal:
    """Appends events to a file, or to nothing.

    Every line has ``time`` (ISO 8601, UTC) and ``event``: ``plan``, ``model``, ``failed``,
    ``commit`` or ``end``, with what belongs to it.

    Parameters
    ----------
    file : text file, optional
        Where to write; None writes nothing.
    """

    def __init__(self, file: TextIO | None) -> None:
        self._file = file

    @classmethod
    @contextmanager
    def open(cls, path: Path | None) -> Iterator[Journal]:
        """Open the log in `path` for appending; None for none.

        Raises
        ------
        UsageError
            If the file cannot be opened.
        """
        if path is None:
            yield cls(None)
            return
        try:
            file = path.open("a", buffering=1)  # a line at a time, so that one can follow it
        except OSError as error:
            raise UsageError(f"cannot write the log {path}: {error.strerror}") from error
        with file:
            yield cls(file)

    def write(self, event: str, **facts: Any) -> None:
        """Write one event."""
        if self._file is not None:
            now = datetime.now(UTC).isoformat(timespec="milliseconds")
            self._file.write(json.dumps({"time": now, "event": event, **facts}) + "\n")

    def result(self, result: Result) -> None:
        """Write how an input ended, with all failures on the way."""
        if self._file is not None:
            self.add(entry_of(result))

    def add(self, entry: Entry) -> None:
        """Write what `entry_of` made."""
        event, facts = entry
        self.write(event, **facts)


def entry_of(result: Result) -> Entry:
    """Return how an input ended, with all failures on the way."""
    item = result.input
    facts: dict[str, Any] = {
        "collection": item.collection,
        "name": item.name,
        "failures": [
            {"stage": f.stage, "kind": f.kind, "message": f.message, "seconds": f.seconds}
            for f in result.failures
        ],
    }
    if result.recorded:
        row = result.spool.read_model()
        facts |= {key: row.get(key) for key in ("mesh_kind", "seconds", "cpu_total")}
    return "model" if result.recorded else "failed", facts
