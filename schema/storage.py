"""Storage of a lake's small documents and hashes of its files.

Documents are created through obstore with put-if-absent, which is atomic on a local disk
(a staged file, then a hard link) as on S3, GCS and Azure: either the whole document is
there under its name or nothing is.
"""

from __future__ import annotations

import hashlib
from pathlib import Path, PurePosixPath

import obstore
from obstore.exceptions import AlreadyExistsError
from obstore.store import LocalStore

from breplake.errors import LakeNotFoundError, UsageError

__all__ = ["Storage", "file_hash", "folder_files", "folder_hash"]


class Storage:
    """The folder of a lake.

    Parameters
    ----------
    root : pathlib.Path
        An existing folder.

    Raises
    ------
    LakeNotFoundError
        If there is no such folder.
    """

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            raise LakeNotFoundError(f"there is no folder {root}")
        self.root = root.resolve()
        self._store = LocalStore(self.root)

    def create(self, path: str, data: bytes) -> bool:
        """Create the document `path` whole, unless it exists.

        Returns
        -------
        bool
            False if a document of that name was there before; it is left as it is.
        """
        try:
            obstore.put(self._store, path, data, mode="create")
        except AlreadyExistsError:
            return False
        return True

    def read(self, path: str) -> bytes:
        """Return the document `path`.

        Raises
        ------
        FileNotFoundError
            If there is none.
        """
        return bytes(obstore.get(self._store, path).bytes())

    def names(self, folder: str) -> list[str]:
        """Return the sorted names of the documents right in `folder`, staged ones left out."""
        found = obstore.list_with_delimiter(self._store, folder)["objects"]
        return sorted(PurePosixPath(item["path"]).name for item in found)

    def path(self, relative: str) -> Path:
        """Return the absolute path of `relative`.

        Raises
        ------
        UsageError
            If it leads out of the lake.
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


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def folder_files(path: Path) -> list[str]:
    """Return the files below the folder `path`, as sorted relative POSIX paths."""
    return sorted(p.relative_to(path).as_posix() for p in path.rglob("*") if p.is_file())


def folder_hash(path: Path) -> str:
    """Return the SHA-256 of a folder: over its sorted lines ``<sha256>  <relative name>``.

    The text is what ``sha256sum`` prints for the sorted files, so it can be checked by hand.
    """
    lines = (f"{file_hash(path / name)}  {name}\n" for name in folder_files(path))
    return hashlib.sha256("".join(lines).encode()).hexdigest()
