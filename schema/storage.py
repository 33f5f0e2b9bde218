"""Where a lake is: a local folder, object storage, or a folder served over HTTP.

Documents are created through obstore with put-if-absent, which is atomic on a local disk
(a staged file, then a hard link) as on S3, GCS and Azure: either the whole document is
there under its name or nothing is.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import uuid
from collections.abc import Iterable, Iterator
from datetime import datetime
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError
from obstore.store import HTTPStore, LocalStore, from_url

from breplake.errors import LakeNotFoundError, StorageError, UsageError
from breplake.schema.ranges import Folder, LocalFolder, RangeReader, StoredFolder

if TYPE_CHECKING:
    from obstore.store import ClientConfig

__all__ = [
    "PART",
    "Storage",
    "StoredFile",
    "file_hash",
    "folder_files",
    "folder_hash",
    "folder_list",
    "is_staged",
    "local_folder",
]

PART: Final = ".part"
"""Ending of the name of a file that is being copied."""

_STAGED: Final = re.compile(rf"(#\d+|{re.escape(PART)})$")  # obstore's local files end in #1

_NO_LINKS: Final = (errno.EPERM, errno.ENOTSUP, errno.ENOSYS)
"""What linking ends with on file systems that have no hard links, exFAT say."""

_BLOCK: Final = 1 << 20
"""Bytes that are read at once."""


class StoredFile(NamedTuple):
    """A file of a storage.

    Parameters
    ----------
    path : str
        Relative POSIX path.
    bytes : int
        Size.
    modified : float
        Time of the last change, in seconds since 1970.
    """

    path: str
    bytes: int
    modified: float


class Storage:
    """The folder of a lake.

    Parameters
    ----------
    place : path or str
        An existing local folder, or a URL: ``file://``, ``s3://``, ``gs://``, ``az://``,
        ``http://`` or ``https://``. Credentials are those of the environment
        (``AWS_ACCESS_KEY_ID`` and so on).

    Raises
    ------
    LakeNotFoundError
        If there is no such local folder.
    UsageError
        If the URL is of no known kind.

    Attributes
    ----------
    can_list : bool
        Whether names can be listed. A plain HTTP server tells only what one asks for by name.
    """

    def __init__(self, place: str | Path) -> None:
        self._place = str(place).rstrip("/") or "/"
        self._local = local_folder(place)
        if self._local is None:
            try:
                self._store: Any = from_url(self._place, client_options=_client(self._place))
            except (BaseError, ValueError) as error:
                raise UsageError(f"cannot open {self._place}: {error}") from error
        elif not self._local.is_dir():
            raise LakeNotFoundError(f"there is no folder {self._local}")
        else:
            self._local = self._local.resolve()
            self._store = LocalStore(self._local)
        self.can_list = not isinstance(self._store, HTTPStore)
        _forks.note_use()

    def __reduce__(self) -> tuple[type[Storage], tuple[str]]:
        """Pickle the place alone: another process makes connections of its own."""
        return type(self), (self.name,)

    @property
    def connection(self) -> Any:
        """The store of obstore behind it.

        Raises
        ------
        UsageError
            If it is reached over a network and this process was forked from one that has opened
            a storage: the threads that speak to the network are not there.
        """
        if self._local is None and _forks.is_broken:
            raise UsageError(
                f"{self.name} cannot be read in a forked process: start processes with "
                "'forkserver' or 'spawn' (DataLoader(multiprocessing_context='forkserver')), or "
                f"copy the lake to this machine with breplake pull {self.name}"
            )
        return self._store

    @property
    def is_local(self) -> bool:
        """Whether it is a local folder."""
        return self._local is not None

    @property
    def name(self) -> str:
        """The folder's path or URL, for messages."""
        return self._place if self._local is None else str(self._local)

    @property
    def root(self) -> Path:
        """Absolute path of the local folder.

        Raises
        ------
        UsageError
            If it is not local.
        """
        if self._local is None:
            raise UsageError(
                f"{self._place} is not a local folder: copy it to one with "
                f"breplake pull {self._place} --lake FOLDER"
            )
        return self._local

    def create(self, path: str, data: bytes) -> bool:
        """Create the document `path` whole, unless it exists.

        Returns
        -------
        bool
            False if a document of that name was there before; it is left as it is.
        """
        if self._local is not None:
            return self._create_here(self.path(path), data)
        try:
            obstore.put(self.connection, path, data, mode="create")
        except AlreadyExistsError:
            return False
        return True

    def _create_here(self, target: Path, data: bytes) -> bool:
        """Create a local document as obstore does, but on the disk before it gets its name."""
        target.parent.mkdir(parents=True, exist_ok=True)
        staged = target.with_name(f"{target.name}#{uuid.uuid4().int}")
        try:
            with staged.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.link(staged, target)
        except FileExistsError:
            return False
        except OSError as error:
            if error.errno in _NO_LINKS and staged.exists():
                raise StorageError(
                    f"the file system of {target.parent} has no hard links, without which two "
                    "writers could overwrite each other: put the lake on another one"
                ) from error
            raise
        finally:
            staged.unlink(missing_ok=True)
        _sync(target.parent)
        return True

    def settle(self, paths: Iterable[str]) -> None:
        """See that files, and folders with all in them, outlast a power cut, if they are local.

        In object storage they do as soon as they are there.
        """
        if self._local is None:
            return
        folders: dict[Path, None] = {}
        for path in paths:
            target = self.path(path)
            for top, _, names in os.walk(target):
                folders[Path(top)] = None
                for name in names:
                    _sync(Path(top, name))
            if target.is_file():
                _sync(target)
            elif not target.is_dir():
                continue  # nothing to keep: whoever reads or verifies the lake is told
            above = target.parents
            folders |= dict.fromkeys(p for p in above if p.is_relative_to(self._local))
        for folder in folders:
            _sync(folder)

    def overwrite(self, path: str, data: bytes) -> None:
        """Write the document `path`, in place of one that is there."""
        obstore.put(self.connection, path, data, mode="overwrite")

    def read(self, path: str) -> bytes:
        """Return the document `path`.

        Raises
        ------
        FileNotFoundError
            If there is none.
        """
        return bytes(obstore.get(self.connection, path).bytes())

    def read_line(self, path: str) -> bytes:
        """Return the first line of the document `path`, without reading all of it."""
        line = b""
        for block in obstore.get(self.connection, path).stream(min_chunk_size=_BLOCK >> 6):
            head, end, _ = bytes(block).partition(b"\n")
            line += head
            if end:
                break
        return line

    def has(self, path: str) -> bool:
        """Return whether there is a file `path`."""
        return self.size(path) is not None

    def size(self, path: str) -> int | None:
        """Return the size of the file `path` in bytes, or None if there is none."""
        try:
            return int(obstore.head(self.connection, path)["size"])
        except FileNotFoundError:
            return None

    def names(self, folder: str) -> list[str]:
        """Return the sorted names of the documents right in `folder`, staged ones left out."""
        found = obstore.list_with_delimiter(self.connection, folder)["objects"]
        return sorted(PurePosixPath(item["path"]).name for item in found)

    def entries(self) -> list[str]:
        """Return the sorted names of the files and folders right in it."""
        if self._local is not None:
            return sorted(os.listdir(self._local))
        found = obstore.list_with_delimiter(self.connection)
        paths = [*found["common_prefixes"], *(item["path"] for item in found["objects"])]
        return sorted(PurePosixPath(path).name for path in paths)

    def files(self, folder: str) -> Iterator[StoredFile]:
        """Yield all files below `folder`, also those that a killed writer left half-written."""
        if self._local is not None:
            for name in folder_files(self._local / folder):
                state = (self._local / folder / name).stat()
                yield StoredFile(f"{folder}/{name}", state.st_size, state.st_mtime)
            return
        for batch in obstore.list(self.connection, folder):
            for item in batch:
                modified: datetime = item["last_modified"]
                yield StoredFile(item["path"], item["size"], modified.timestamp())

    def folders(self, folder: str) -> Iterator[StoredFile]:
        """Yield the folders right in `folder`, of no size; object storage has none."""
        if self._local is None or not (self._local / folder).is_dir():
            return
        for item in os.scandir(self._local / folder):
            if item.is_dir(follow_symlinks=False):
                yield StoredFile(f"{folder}/{item.name}", 0, item.stat().st_mtime)

    def remove(self, path: str) -> None:
        """Remove a file, or a folder with all that is in it; it may be gone already."""
        if self._local is None:
            obstore.delete(self.connection, [path, *(file.path for file in self.files(path))])
            return
        target = self.path(path)
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        else:
            target.unlink(missing_ok=True)

    def stream(self, path: str) -> Iterator[bytes]:
        """Yield the bytes of the file `path` in blocks.

        Raises
        ------
        FileNotFoundError
            If there is none.
        """
        for block in obstore.get(self.connection, path).stream(min_chunk_size=_BLOCK):
            yield bytes(block)

    def hash(self, path: str) -> str:
        """Return the SHA-256 of the file `path`, hexadecimal.

        Raises
        ------
        FileNotFoundError
            If there is none.
        """
        if self._local is not None:
            return file_hash(self.path(path))
        digest = hashlib.sha256()
        for block in self.stream(path):
            digest.update(block)
        return digest.hexdigest()

    def open(self, path: str) -> Path | BytesIO:
        """Return the file `path` for random reads: its path where it is local, else its bytes."""
        return self.path(path) if self._local is not None else BytesIO(self.read(path))

    def reader(self, path: str) -> Path | RangeReader:
        """Return the file `path` to read parts of it: its path where it is local.

        Raises
        ------
        FileNotFoundError
            If there is none in an object storage.
        """
        return self.path(path) if self._local is not None else RangeReader(self, path)

    def folder(self, path: str) -> Folder:
        """Return the folder `path`, to read parts of its files."""
        if self._local is not None:
            return LocalFolder(self.path(path))
        return StoredFolder(self, path)

    def locate(self, path: str) -> str:
        """Return the absolute path or the URL of the file `path`."""
        return str(self.path(path)) if self._local is not None else f"{self._place}/{path}"

    def upload(self, source: Path, path: str) -> None:
        """Copy a local file to `path`; it appears there whole."""
        obstore.put(self.connection, path, source, mode="overwrite")

    def path(self, relative: str) -> Path:
        """Return the absolute path of `relative` in a local folder.

        Raises
        ------
        UsageError
            If it leads out of the lake, or the lake is not local.
        """
        parts = PurePosixPath(relative).parts
        if not parts or parts[0] == "/" or ".." in parts:
            raise UsageError(f"a path in a lake is relative and stays inside it, got {relative!r}")
        return self.root.joinpath(*parts)

    def relative(self, path: Path) -> str:
        """Return `path` (absolute, or relative to the lake) as a relative POSIX path.

        Raises
        ------
        UsageError
            If it lies outside the lake.
        """
        absolute = path if path.is_absolute() else self.root / path
        absolute = absolute.parent.resolve() / absolute.name
        if not absolute.is_relative_to(self.root):
            raise UsageError(f"{path} is not inside the lake {self.root}")
        return absolute.relative_to(self.root).as_posix()


def _sync(path: Path) -> None:
    """Have the disk keep what was written to a file or folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class _Forks:
    """Whether this process was forked from one that had opened a storage."""

    def __init__(self) -> None:
        self.is_broken = False
        self._used = False
        os.register_at_fork(after_in_child=self._forked)

    def note_use(self) -> None:
        self._used = True

    def _forked(self) -> None:
        self.is_broken = self.is_broken or self._used


_forks: Final = _Forks()


def local_folder(place: str | Path) -> Path | None:
    """Return the path of a local place, or None for one that is reached over a network."""
    text = str(place)
    if isinstance(place, Path) or "://" not in text:
        return Path(place)
    if text.startswith("file://"):
        from urllib.parse import unquote, urlsplit

        return Path(unquote(urlsplit(text).path))
    return None


def _client(url: str) -> ClientConfig | None:
    """Return options of the client, else those of the environment, as ``AWS_ALLOW_HTTP``."""
    return {"allow_http": True} if url.startswith("http://") else None


def is_staged(path: str) -> bool:
    """Return whether a file is one in the making, which gets its true name when it is whole."""
    return bool(_STAGED.search(path))


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def folder_files(path: Path) -> list[str]:
    """Return the files below the folder `path`, as sorted relative POSIX paths."""
    found = (Path(top, name) for top, _, names in os.walk(path) for name in names)
    return sorted(file.relative_to(path).as_posix() for file in found)


def folder_list(path: Path) -> str:
    """Return the lines ``<sha256>  <relative name>`` of a folder's sorted files.

    The text is what ``sha256sum`` prints and ``sha256sum --check`` reads.
    """
    return "".join(f"{file_hash(path / name)}  {name}\n" for name in folder_files(path))


def folder_hash(path: Path) -> str:
    """Return the SHA-256 of a folder: that of its `folder_list`."""
    return hashlib.sha256(folder_list(path).encode()).hexdigest()
