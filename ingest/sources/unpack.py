"""Reads one archive, as a process of its own: a hostile archive can harm nothing else.

Run as ``python -m breplake.ingest.sources.unpack``. The first line of its input is a request in
JSON (see :class:`Request`); on its output it tells line by line, also in JSON, what it finds:

====================================  =====================================================
``["member", place, name]``           a CAD file, or what is named like one
``["done", place, bytes, sha256]``    its bytes were read, and written if that was asked for
``["bad", place, kind, detail]``      it cannot be read
``["facts", key, columns]``           metadata of an ABC model
``["missing", extra, need]``          a package is not installed; the last line
``["refused", message]``              the archive is not safe; the last line
``["damaged", kind, detail]``         it cannot be read, or not further; the last line
``["end", expansion]``                all was read; the last line
====================================  =====================================================

Files are written only as far as the further lines of the input allow, each the number of files
in all. When the input ends the asking process is gone, and this one ends too.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import resource
import signal
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final, TextIO

from breplake.errors import MissingExtraError, RefusedSourceError
from breplake.ingest.inputs import cad_format
from breplake.ingest.orphans import die_with_parent
from breplake.ingest.sources.abc_names import abc_facts, metadata_key
from breplake.ingest.sources.entry import Damage, Entry, Taker, archive_format
from breplake.ingest.sources.facts import Facts
from breplake.ingest.sources.limits import Limits, Meter, hostile_name
from breplake.ingest.sources.sevens import read_7z
from breplake.ingest.sources.tars import read_tar
from breplake.ingest.sources.zips import read_zip

__all__ = ["Request", "main", "read_archive"]

_MEMORY: Final = 4 * 2**30
"""Bytes of address space: a 7z dictionary may take 1.5 GiB."""

_METADATA_BYTES: Final = 2**20
"""More than any file of metadata has."""

_READERS: Final = {"zip": read_zip, "tar": read_tar, "7z": read_7z}


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be read.

    Parameters
    ----------
    archive : str
        Path of the archive.
    limits : Limits
        How far it is trusted.
    places : list of int, optional
        Members to read; by default all CAD files, and metadata of ABC.
    folder : str, optional
        Where to write the members, each named by its place; by default nowhere.
    """

    archive: str
    limits: Limits
    places: list[int] | None = None
    folder: str | None = None

    def line(self) -> str:
        """Return it as the line that asks for it."""
        return json.dumps(asdict(self)) + "\n"

    @classmethod
    def parse(cls, line: str) -> Request:
        """Return the request of a line."""
        given = json.loads(line)
        return cls(**given | {"limits": Limits(**given["limits"])})


def main() -> None:
    """Answer the request on the standard input."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the asking process decides
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries print is no answer
    try:
        read_archive(Request.parse(sys.stdin.readline()), sys.stdin, output)
    except BrokenPipeError:
        os._exit(1)  # nobody listens any more


def read_archive(request: Request, permits: TextIO, output: TextIO) -> None:
    """Answer a request.

    Parameters
    ----------
    request : Request
        What is to be read.
    permits : text file
        Gives the numbers of files that may be written.
    output : text file
        Takes the answer.
    """

    def say(*words: Any) -> None:
        output.write(json.dumps(words) + "\n")
        output.flush()

    path = Path(request.archive)
    taker = _Survey(say) if request.places is None else _Fetch(say, request, permits)
    try:
        meter = Meter(path.stat().st_size, request.limits)
        _READERS[archive_format(path) or "zip"](path, taker, meter)
    except MissingExtraError as error:
        say("missing", error.extra, error.need)
    except RefusedSourceError as error:
        say("refused", str(error))
    except Damage as error:
        if taker.refusal is not None:
            say("refused", taker.refusal)
        else:
            say("damaged", error.kind, error.detail)
    except MemoryError:
        say("damaged", "memory", f"reading it takes more than {_MEMORY >> 30} GiB")
    except BrokenPipeError:
        raise
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        say("damaged", "disk-full" if full else "unreadable", error.strerror or str(error))
    except Exception as error:  # no parser is without faults; what was said so far holds
        say("damaged", "bad-archive", f"{type(error).__name__}: {error}")
    else:
        say("end", meter.expansion)


class _Named(Taker):
    """A taker that refuses archives whose members are not safe, once it has listed them all."""

    def __init__(self, say: Any) -> None:
        self.say = say
        self.names: set[str] = set()
        self.refusal: str | None = None

    def wants(self, entry: Entry) -> bool:
        danger = hostile_name(entry.name) or entry.danger
        if danger is not None:
            self.refusal = (
                self.refusal or f"its member {entry.name!r} {danger}; pack it again without"
            )
        if entry.kind == "folder":
            return False
        if entry.name in self.names:
            self.refusal = self.refusal or f"it has two members {entry.name!r}; pack it again"
        self.names.add(entry.name)
        return self.chooses(entry) and self.refusal is None

    def listed(self) -> None:
        if self.refusal is not None:
            raise RefusedSourceError(self.refusal)

    def chooses(self, entry: Entry) -> bool:
        raise NotImplementedError

    def failed(self, entry: Entry, kind: str, detail: str) -> None:
        self.say("bad", entry.place, kind, detail)


class _Survey(_Named):
    """Hashes the CAD files of an archive and reads the metadata among them."""

    def __init__(self, say: Any) -> None:
        super().__init__(say)
        self.digest = hashlib.sha256()
        self.size = 0
        self.metadata = b""

    def chooses(self, entry: Entry) -> bool:
        if entry.kind == "file" and metadata_key(entry.name):
            return True
        if cad_format(entry.name) is None:
            return False
        self.say("member", entry.place, entry.name)
        if entry.kind != "file":
            what = "this is a link" if entry.kind == "link" else "this is no regular file"
            self.say("bad", entry.place, "not-a-file", what)
        return entry.kind == "file"

    def more(self) -> bool:
        return True

    def write(self, entry: Entry, data: bytes) -> None:
        self.digest.update(data)
        self.size += len(data)
        if metadata_key(entry.name) and len(self.metadata) <= _METADATA_BYTES:
            self.metadata += data

    def failed(self, entry: Entry, kind: str, detail: str) -> None:
        if not metadata_key(entry.name):
            super().failed(entry, kind, detail)
        self._next()

    def done(self, entry: Entry) -> None:
        key = metadata_key(entry.name)
        if key is None:
            self.say("done", entry.place, self.size, self.digest.hexdigest())
        elif self.size <= _METADATA_BYTES:
            self._tell_facts(key)
        self._next()

    def _tell_facts(self, key: str) -> None:
        try:
            self.say("facts", key, abc_facts(self.metadata).columns())
        except ValueError as error:
            # The model itself is as good as without: it says where its facts are lost.
            problem = ("metadata_error", str(error))
            self.say("facts", key, Facts(metadata=(problem,)).columns())

    def _next(self) -> None:
        self.digest, self.size, self.metadata = hashlib.sha256(), 0, b""


class _Fetch(_Named):
    """Writes some members of an archive as files."""

    def __init__(self, say: Any, request: Request, permits: TextIO) -> None:
        super().__init__(say)
        self.folder = Path(request.folder or ".")
        self.left = set(request.places or ())
        self.permits = permits
        self.written = self.allowed = 0
        self.file: BinaryIO | None = None
        self.digest = hashlib.sha256()

    def chooses(self, entry: Entry) -> bool:
        return entry.place in self.left and entry.kind == "file"

    def more(self) -> bool:
        return bool(self.left)

    def write(self, entry: Entry, data: bytes) -> None:
        if self.file is None:
            self.file = self._open(entry)
        self.digest.update(data)
        self.file.write(data)

    def failed(self, entry: Entry, kind: str, detail: str) -> None:
        self._close(entry)
        super().failed(entry, kind, detail)

    def done(self, entry: Entry) -> None:
        file = self.file or self._open(entry)
        size = file.tell()
        digest = self.digest.hexdigest()
        self.file = file
        self._close(entry)
        self.say("done", entry.place, size, digest)

    def _open(self, entry: Entry) -> BinaryIO:
        while self.written >= self.allowed:
            line = self.permits.readline()
            if not line:
                raise BrokenPipeError
            self.allowed = int(line)
        self.written += 1
        self.digest = hashlib.sha256()
        return (self.folder / str(entry.place)).open("wb")

    def _close(self, entry: Entry) -> None:
        self.left.discard(entry.place)
        if self.file is not None:
            self.file.close()
        self.file = None


if __name__ == "__main__":
    main()
