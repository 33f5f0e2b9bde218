"""A log of an ingest for machines: one line of JSON for each event."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

from breplake.errors import UsageError
from breplake.ingest.pool import Result

__all__ = ["Entry", "Journal", "entry_of"]

Entry = tuple[str, dict[str, Any]]
"""An event and what belongs to it."""


class Journal:
    """Appends events to a file, or to nothing.

    Every line has ``time`` (ISO 8601, UTC) and ``event``: ``plan``, ``model``, ``failed``,
    ``commit`` or ``end``, with what belongs to it. A file that cannot be written any more is
    given up: the run is worth more than its log.

    Parameters
    ----------
    file : binary file, optional
        Where to write, unbuffered; None writes nothing.
    warn : callable
        Takes the news that the file is given up.
    """

    def __init__(
        self, file: BinaryIO | None, warn: Callable[[str], None] = lambda _text: None
    ) -> None:
        self._file, self._warn = file, warn

    @classmethod
    @contextmanager
    def open(
        cls, path: Path | None, warn: Callable[[str], None] = lambda _text: None
    ) -> Iterator[Journal]:
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
            is_cut = _is_cut(path)
            file = path.open("ab", buffering=0)  # a line at a time, so that one can follow it
        except OSError as error:
            raise UsageError(f"cannot write the log {path}: {error.strerror}") from error
        journal = cls(file, warn)
        if is_cut:
            journal._put(b"\n")
        try:
            yield journal
        finally:
            journal._close()

    def write(self, event: str, **facts: Any) -> None:
        """Write one event."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._put(json.dumps({"time": now, "event": event, **facts}).encode() + b"\n")

    def _put(self, data: bytes) -> None:
        try:
            while self._file is not None and data:
                data = data[self._file.write(data) :]
        except OSError as error:
            self._give_up(error)

    def _close(self) -> None:
        try:
            if self._file is not None:
                self._file.close()  # some network disks only say here that they are full
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        """Go on without the file, and say so once."""
        file, self._file = self._file, None
        if file is not None:
            with suppress(OSError):  # it would say the same again
                file.close()
            self._warn(
                f"the log {file.name} cannot be written any more ({error.strerror}): the run goes "
                "on without it, and its last line may be cut short; the lake has all models and "
                "failures"
            )

    def result(self, result: Result) -> None:
        """Write how an input ended, with all failures on the way."""
        if self._file is not None:
            self.add(entry_of(result))

    def add(self, entry: Entry) -> None:
        """Write what `entry_of` made."""
        event, facts = entry
        self.write(event, **facts)


def _is_cut(path: Path) -> bool:
    """Return whether the last line of a file has no end, as a full disk or a kill leaves it."""
    if not path.is_file() or not path.stat().st_size:
        return False
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) != b"\n"


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
