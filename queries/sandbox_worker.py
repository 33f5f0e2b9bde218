"""The process of a sandbox: it answers one query and ends.

It reads a request from stdin, opens the lake's files, gives up its rights, runs the query and
writes one line of JSON and then, as an Arrow IPC stream, the rows.
"""

from __future__ import annotations

import json
import os
import resource
import sys
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO, Final

import duckdb
import pyarrow as pa
import pyarrow.dataset

from breplake.errors import BreplakeError, LakeFormatError, LimitError, UsageError
from breplake.queries.statements import require_select
from breplake.queries.views import DERIVED, derived_sql
from breplake.schema.tables import TABLES

__all__ = ["main"]

_THREADS: Final = 4
"""Most threads of a query."""

_OWN_MEMORY: Final = 500_000_000
"""Address space beyond what the query may use: thread stacks, read buffers."""

_BATCH: Final = 8192


def main() -> None:
    """Answer the request on stdin."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    rows = b""
    try:
        rows = _answer(json.load(sys.stdin))
        head: dict[str, Any] = {"error": None}
    except BreplakeError as error:
        head = {"error": error.kind, "message": str(error)}
    except (MemoryError, duckdb.OutOfMemoryException, pa.ArrowMemoryError):
        head = {"error": LimitError.kind, "message": _TOO_MUCH}
    except (duckdb.Error, pa.ArrowException) as error:
        head = {"error": UsageError.kind, "message": str(error)}
    except OSError as error:
        head = {"error": LakeFormatError.kind, "message": f"a file cannot be read: {error}"}
    except Exception as error:  # whatever it is, the parent must not take it for a lack of memory
        head = {"error": UsageError.kind, "message": f"{type(error).__name__}: {error}"}
    _say(answer, head, rows)


_TOO_MUCH: Final = "the query needs more memory than it may use: ask for less, or allow more"


def _say(stream: BinaryIO, head: Mapping[str, Any], rows: bytes) -> None:
    stream.write(json.dumps({**head, "message": head.get("message", "")[:20_000]}).encode() + b"\n")
    stream.write(rows)
    stream.close()
    os._exit(0)  # threads that still read ahead are not waited for


def _answer(request: Mapping[str, Any]) -> bytes:
    threads = min(_THREADS, os.cpu_count() or 1)
    pa.set_cpu_count(threads)
    pa.set_io_thread_count(threads)
    connection = _connect(_tables(request["files"]), request["memory"], threads)
    _drop_rights(request["memory"], request["seconds"] * threads)
    require_select(connection, request["query"])
    return _collect(connection.sql(request["query"]), request["rows"], request["bytes"])


def _tables(files: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Open the files of every table; one without files is an empty table."""
    return {
        name: pyarrow.dataset.dataset(list(files[name]), schema=table.schema, format="parquet")
        if files[name]
        else table.empty()
        for name, table in TABLES.items()
    }


def _connect(tables: Mapping[str, Any], memory: int, threads: int) -> duckdb.DuckDBPyConnection:
    """Return a session on the tables that can reach nothing else."""
    connection = duckdb.connect(
        ":memory:",
        config={
            "memory_limit": f"{memory}B",
            "threads": str(threads),
            "temp_directory": "",  # no spilling
            "allow_community_extensions": "false",
            "autoinstall_known_extensions": "false",
            "autoload_known_extensions": "false",
            "python_enable_replacements": "false",
            "python_scan_all_frames": "false",
        },
    )
    # with it off, no other setting of paths can be changed, not even in `config`
    connection.execute("SET enable_external_access = false")
    for name, table in tables.items():
        connection.register(name, table)
    for name in DERIVED:
        connection.execute(f"CREATE TEMP VIEW {name} AS {derived_sql(name)}")
    connection.execute("SET lock_configuration = true")
    return connection


def _drop_rights(memory: int, cpu_seconds: float) -> None:
    """Give up, for good, what a query has no need of."""
    os.environ.clear()
    with open("/proc/self/statm") as statm:
        used = int(statm.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    limits = {
        resource.RLIMIT_AS: used + memory + _OWN_MEMORY,
        resource.RLIMIT_CPU: int(cpu_seconds) + 5,  # should the parent be gone
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
    }
    for limit, value in limits.items():
        resource.setrlimit(limit, (value, value))


def _collect(relation: duckdb.DuckDBPyRelation, max_rows: int, max_bytes: int) -> bytes:
    """Return the rows as an Arrow IPC stream.

    Raises
    ------
    LimitError
        If they are too many or too large.
    """
    reader = relation.to_arrow_reader(_BATCH)
    sink = pa.BufferOutputStream()
    rows = 0
    with pa.ipc.new_stream(sink, reader.schema) as writer:
        for batch in reader:
            rows += batch.num_rows
            if rows > max_rows:
                raise LimitError(f"the answer has more than {max_rows:,} rows: add LIMIT")
            if sink.tell() + batch.nbytes > max_bytes:
                raise LimitError(f"the answer is larger than {max_bytes:,} bytes: ask for less")
            writer.write_batch(batch)
    return bytes(sink.getvalue())
