"""Archives, good and bad, and a web server, for the tests of sources."""

from __future__ import annotations

import io
import struct
import tarfile
import threading
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pyarrow as pa
import pytest


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """The ledger and downloads of this test alone."""
    monkeypatch.setenv("BREPLAKE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def _pack(path: Path, files: Mapping[str, bytes]) -> Path:
    """Write an archive of the kind that its name says."""
    if path.suffix == ".zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in files.items():
                info = zipfile.ZipInfo(name)
                info.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(info, data)
    elif path.suffix == ".7z":
        _pack_7z(path, files)
    else:
        mode = {".tar": "w", ".gz": "w:gz", ".bz2": "w:bz2", ".xz": "w:xz", ".zst": "w"}
        data = io.BytesIO()
        with tarfile.open(fileobj=data, mode=mode[path.suffix]) as archive:
            for name, content in files.items():
                info = tarfile.TarInfo(name)
                info.size = len(content)
                archive.addfile(info, io.BytesIO(content))
        path.write_bytes(data.getvalue())
        if path.suffix == ".zst":
            path.write_bytes(pa.compress(data.getvalue(), codec="zstd", asbytes=True))
    return path


def _pack_7z(path: Path, *blocks: Mapping[str, bytes], **options: object) -> Path:
    """Write a 7z archive with one solid block for each mapping."""
    import py7zr

    for number, files in enumerate(blocks):
        with py7zr.SevenZipFile(path, "a" if number else "w", **options) as archive:
            for name, data in files.items():
                archive.writestr(data, name)
    return path


def _rename_in_7z(path: Path, old: str, new: str) -> Path:
    """Give a member of a 7z archive with a plain header a name that no packer would write."""
    data = bytearray(path.read_bytes())
    offset, size = struct.unpack_from("<QQ", data, 12)
    start = 32 + offset
    header = bytes(data[start : start + size])
    assert len(old) == len(new)
    assert old.encode("utf-16-le") in header
    header = header.replace(old.encode("utf-16-le"), new.encode("utf-16-le"))
    data[start : start + size] = header
    struct.pack_into("<I", data, 28, zlib.crc32(header))
    struct.pack_into("<I", data, 8, zlib.crc32(bytes(data[12:32])))
    path.write_bytes(data)
    return path


Reply = tuple[int, Mapping[str, str], bytes]
Answer = Callable[["Server", str, str, Mapping[str, str], bytes], Reply]
"""Gives status, headers and body for a server and a request's method, path, headers and body."""


class Server:
    """A web server on this machine that answers by a function and remembers what it was asked."""

    def __init__(self, answer: Answer) -> None:
        self.asked: list[tuple[str, str, dict[str, str], bytes]] = []
        self.answer = answer
        server = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                size = int(self.headers.get("Content-Length") or 0)
                body = self.rfile.read(size)
                headers = {name.lower(): value for name, value in self.headers.items()}
                server.asked.append((self.command, self.path, headers, body))
                status, more, data = server.answer(server, self.command, self.path, headers, body)
                self.send_response(status)
                for name, value in {"Content-Length": str(len(data)), **more}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(data)
                self.close_connection = "Content-Length" in more  # a body that breaks off

            do_POST = do_GET

            def log_message(self, *_: object) -> None:
                pass

        self._httpd = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._httpd.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._httpd.server_port}"

    @contextmanager
    def running(self) -> Iterator[Server]:
        thread = threading.Thread(target=self._httpd.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self._httpd.shutdown()
            self._httpd.server_close()
            thread.join()

    def count(self, method: str, part: str) -> int:
        return sum(m == method and part in path for m, path, _, _ in self.asked)


@pytest.fixture(scope="session")
def pack():
    return _pack


@pytest.fixture(scope="session")
def pack_7z():
    return _pack_7z


@pytest.fixture(scope="session")
def rename_in_7z():
    return _rename_in_7z


@pytest.fixture
def serve():
    """Start servers that answer by a function: ``serve(answer).url``."""
    with ExitStack() as stack:
        yield lambda answer: stack.enter_context(Server(answer).running())
