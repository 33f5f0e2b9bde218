"""SQL that one does not trust, in a process that can be killed.

Each query runs in a fresh process, behind walls that do not rely on one another:

- the statement must be one SELECT over tables by their names (`require_select`);
- DuckDB has no access to files, network, extensions, settings or Python's variables: the lake's
  files are opened beforehand and are tables to it;
- the process has no environment, may not write a byte to any file, and is limited in memory;
- it is killed when its time is up.

DuckDB's own ``interrupt`` can take long, and COPY may write wherever it may read; hence this.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from breplake.errors import LakeFormatError, LimitError, UsageError
from breplake.schema.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

    from breplake.queries.session import Lake

__all__ = ["Sandbox"]

_GB: Final = 10**9
_HEAD_LIMIT: Final = 100_000
"""Largest message of the process, bytes; the rows come on top."""

_QUERY_LIMIT: Final = 1_000_000
"""Longest query, characters."""

_RUN: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from breplake.queries.sandbox_worker import main; main()"
)


@dataclass(frozen=True, slots=True)
class Sandbox:
    """Runs SQL that one does not trust; made by ``lake.sandbox()``.

    Parameters
    ----------
    lake : Lake
        What is asked, at its snapshot.
    timeout : float
        Seconds for a query, the start of its process included.
    memory : float
        Memory for a query, GB (1e9 bytes); the process itself needs about 0.2 GB more.
    max_rows : int
        Rows that an answer may have.
    max_bytes : int
        Bytes that an answer may have, as Arrow.
    """

    lake: Lake
    timeout: float = 30.0
    memory: float = 1.0
    max_rows: int = 1_000_000
    max_bytes: int = 256_000_000

    def __post_init__(self) -> None:
        for name in ("timeout", "memory", "max_rows", "max_bytes"):
            if not getattr(self, name) > 0:
                raise UsageError(f"{name} of a sandbox must be positive, got {getattr(self, name)}")

    def sql(self, query: str) -> pa.Table:
        """Run one SELECT and return its rows.

        Parameters
        ----------
        query : str
            The statement. Tables and views are those of ``lake.sql``.

        Raises
        ------
        UsageError
            If the statement is wrong or not allowed.
        LimitError
            If it took too long or too much memory, or has too large an answer.
        LakeFormatError
            If a file of the lake cannot be read.
        UsageError
            If the lake is not in a local folder.
        """
        import pyarrow as pa

        if len(query) > _QUERY_LIMIT:
            raise UsageError(f"a query has at most {_QUERY_LIMIT} characters, got {len(query)}")
        with tempfile.TemporaryFile() as request:
            request.write(json.dumps(self._request(query)).encode())
            request.seek(0)
            answer, code = self._run(request)
        end = answer.find(b"\n")
        if end < 0:
            raise LimitError(_stopped(code))
        head = json.loads(answer[:end])
        if head["error"] is not None:
            kind = {"limit": LimitError, "lake-format": LakeFormatError}.get(head["error"])
            raise (kind or UsageError)(head["message"])
        return pa.ipc.open_stream(pa.py_buffer(answer)[end + 1 :]).read_all()

    def _request(self, query: str) -> dict[str, Any]:
        if not self.lake.store.storage.is_local:
            name = self.lake.store.storage.name
            raise UsageError(
                f"{name} is not a local folder, and queries of others run without a network: copy "
                f"it to one with breplake pull {name} --lake FOLDER"
            )
        return {
            "query": query,
            "files": {table: self.lake.sources(table) for table in TABLES},
            "memory": int(self.memory * _GB),
            "seconds": self.timeout,
            "rows": self.max_rows,
            "bytes": self.max_bytes,
        }

    def _run(self, request: Any) -> tuple[bytes, int]:
        """Run the process on a request; return what it said and its exit code."""
        deadline = time.monotonic() + self.timeout
        process = subprocess.Popen(
            [sys.executable, "-I", "-B", "-c", _RUN, json.dumps(_import_path())],
            stdin=request,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            # few arenas: what the allocator reserves counts as memory
            env={"MALLOC_ARENA_MAX": "2", "ARROW_DEFAULT_MEMORY_POOL": "system"},
            cwd="/",
            start_new_session=True,
        )
        try:
            said = self._listen(process, deadline)
            code = process.wait(timeout=max(deadline - time.monotonic(), 1.0))
        except subprocess.TimeoutExpired as error:
            raise self._late() from error
        finally:
            process.kill()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()
        return said, code

    def _listen(self, process: subprocess.Popen[bytes], deadline: float) -> bytes:
        """Return all that the process says, in time and within bounds."""
        assert process.stdout is not None  # it is a pipe
        said = bytearray()
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while True:
                left = deadline - time.monotonic()
                if left <= 0 or not selector.select(left):
                    raise self._late()
                part = os.read(process.stdout.fileno(), 1 << 20)
                if not part:
                    return bytes(said)
                said += part
                if len(said) > self.max_bytes + _HEAD_LIMIT:
                    raise LimitError(f"the answer is larger than {self.max_bytes:,} bytes")

    def _late(self) -> LimitError:
        return LimitError(
            f"the query took longer than {self.timeout:g} s and was stopped: "
            "ask for less, or allow more time"
        )


def _import_path() -> list[str]:
    """Return where this process finds modules, for one that works in another folder."""
    try:
        here = os.getcwd()
    except FileNotFoundError:  # it was deleted
        return [place for place in sys.path if os.path.isabs(place)]
    return [os.path.join(here, place) for place in sys.path]


def _stopped(code: int) -> str:
    how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
    said = f"the query's process ended without an answer ({how})"
    if -code in (signal.SIGKILL, signal.SIGABRT):
        return f"{said}, most likely for want of memory: ask for less"
    return f"{said}: see whether {sys.executable} starts, and imports breplake, in another folder"
