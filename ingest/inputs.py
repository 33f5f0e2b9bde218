"""Find the CAD files below the given sources and name the models they will be."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from breplake.errors import UsageError
from breplake.ingest.failure import Failure, advise
from breplake.schema.identity import model_id

__all__ = ["FORMATS", "Input", "find_inputs", "printable"]

FORMATS: Final[dict[str, str]] = {
    ".step": "step",
    ".stp": "step",
    ".p21": "step",
    ".iges": "iges",
    ".igs": "iges",
    ".brep": "brep",
    ".brp": "brep",
}
"""Format by file extension, upper or lower case, each also with ``.gz``."""


_ABC: Final = re.compile(r"(\d{8}_[0-9a-f]{24})_step_(\d{3})")
"""Name of an original ABC file: id, document hash, kind, part."""


@dataclass(frozen=True, slots=True)
class Input:
    """One CAD file to ingest.

    Parameters
    ----------
    path : Path
        The file.
    collection, name : str
        Identity of the model.
    format : str
        ``step``, ``iges`` or ``brep``; ``folder`` for one that cannot be listed.
    bytes : int, optional
        Size of the file; None if it cannot be read.
    sha256 : str, optional
        Hash of its bytes; None if they cannot be read.
    failure : Failure, optional
        Why it cannot even be tried.
    """

    path: Path
    collection: str
    name: str
    format: str
    bytes: int | None = None
    sha256: str | None = None
    failure: Failure | None = None
    model_id: int = field(init=False)

    def __post_init__(self) -> None:
        """Derive the id, and name what cannot be in UTF-8 columns."""
        object.__setattr__(self, "model_id", model_id(self.collection, self.name))


def find_inputs(sources: Sequence[Path], collection: str | None = None) -> list[Input]:
    """List the CAD files of `sources` in order of their names.

    A folder is searched with its subfolders; every entry there whose name ends like a CAD
    file is an input, even if it turns out to be a folder or unreadable. Other files are not.
    A folder that cannot be listed is an input that failed. Names leave out the extension; of
    two files that differ in nothing else, the second in order keeps it in its name.

    Parameters
    ----------
    sources : sequence of Path
        Files and folders.
    collection : str, optional
        Collection of all models; by default each folder's own name, for a file that of the
        folder it is in.

    Raises
    ------
    UsageError
        If a source does not exist, a file is of no known format, or two inputs would get the
        same collection and name.
    """
    found: dict[tuple[str, str], Input] = {}
    for source in sources:
        source = Path(source)
        if not source.exists():
            raise UsageError(f"source {source} does not exist; give a CAD file or a folder")
        closed: list[OSError] = []
        is_folder = source.is_dir()
        home = source.resolve() if is_folder else source.resolve().parent
        group = printable(collection or home.name or "root")
        paths = _walk(source, closed.append) if is_folder else [source]
        for path in paths:
            kind = _format(path)
            if kind is None:
                known = ", ".join(FORMATS)
                raise UsageError(
                    f"{path} is no CAD file: its name must end in {known}, or those with .gz"
                )
            relative = path.relative_to(source) if is_folder else Path(path.name)
            item = _input(path, group, _stem(relative), kind)
            twin = found.setdefault((group, item.name), item)
            if twin is not item and not _same_place(twin.path, path):
                # a.step beside a.stp: the extension is what tells them apart
                item = _input(path, group, relative.as_posix(), kind)
                if found.setdefault((group, item.name), item) is not item:
                    raise UsageError(
                        f"{path} and {found[group, item.name].path} would both be model "
                        f"{group}/{item.name}; ingest one with another --collection"
                    )
        for error in closed:
            item = _closed_folder(Path(error.filename), source, group, error)
            found.setdefault((group, item.name), item)
    return sorted(found.values(), key=lambda item: (item.collection, item.name))


def _same_place(a: Path, b: Path) -> bool:
    return a.resolve() == b.resolve()


def _closed_folder(folder: Path, source: Path, collection: str, error: OSError) -> Input:
    """Return a folder that cannot be listed as an input that failed."""
    name = printable(folder.relative_to(source).as_posix()) + "/"
    failure = Failure("plan", "unreadable", advise("unreadable", str(error.strerror)), fatal=True)
    return Input(folder, collection, name, "folder", failure=failure)


def _walk(folder: Path, closed: Callable[[OSError], None]) -> Iterator[Path]:
    """Yield the entries below `folder` that are named like CAD files, in sorted order."""
    for directory, folders, files in os.walk(folder, onerror=closed):
        folders.sort()
        for name in sorted([*files, *folders]):
            if _format(Path(name)) is not None:
                yield Path(directory) / name


def _format(path: Path) -> str | None:
    name = path.name.lower().removesuffix(".gz")
    return FORMATS.get(os.path.splitext(name)[1])


def _stem(relative: Path) -> str:
    """Return a model's name. ABC's files of one model differ but in their kind, left out here."""
    name = relative.name
    if name.lower().endswith(".gz"):
        name = name[:-3]
    stem = os.path.splitext(name)[0]
    if match := _ABC.fullmatch(stem):
        return f"{match[1]}_{match[2]}"
    return (relative.parent / stem).as_posix()


def _input(path: Path, collection: str, name: str, format: str) -> Input:
    """Read the file once for size and hash, and notice what cannot be tried."""
    name = printable(name)
    if not path.is_file():
        what = "this is a folder" if path.is_dir() else "this is no regular file"
        failure = Failure("plan", "not-a-file", advise("not-a-file", what), fatal=True)
        return Input(path, collection, name, format, failure=failure)
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
    except OSError as error:
        detail = error.strerror or type(error).__name__
        failure = Failure("plan", "unreadable", advise("unreadable", detail), fatal=True)
        return Input(path, collection, name, format, failure=failure)
    empty = Failure("plan", "empty-file", advise("empty-file", ""), fatal=True)
    return Input(path, collection, name, format, size, digest, None if size else empty)


def printable(path: Path | str) -> str:
    """Return a path as text that UTF-8 columns can hold."""
    return str(path).encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
