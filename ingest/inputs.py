"""Find the CAD files below the given sources and name the models they will be."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Final

from breplake.errors import InputError, UsageError
from breplake.ingest.failure import Failure, advise
from breplake.ingest.hashing import Hasher
from breplake.ingest.printable import printable
from breplake.ingest.sources.facts import NO_FACTS, Facts
from breplake.ingest.sources.origin import Origin
from breplake.schema.abc import ABC_FORMAT, AbcName, parse_name
from breplake.schema.identity import model_id

__all__ = [
    "FORMATS",
    "Input",
    "cad_format",
    "find_inputs",
    "model_name",
    "read_input",
]

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


_CAD: Final = "cad"
"""Kind of the file that holds exact shapes, beside the kinds of ABC's files."""

_ORDER: Final = (_CAD, "features", "trimesh", "stats", "metadata")
"""Kinds of files of one model, in the order in which they are hashed."""


@dataclass(frozen=True, slots=True)
class Input:
    """One model to ingest: a CAD file, files of the ABC dataset, or both.

    Parameters
    ----------
    path : Path
        The CAD file; without one, the features, or what there is of them.
    collection, name : str
        Identity of the model.
    format : str
        ``step``, ``iges`` or ``brep``; ``abc`` for ABC's files without a CAD file; ``folder``
        for one that cannot be listed.
    bytes : int, optional
        Size of all files; None if they cannot be read.
    sha256 : str, optional
        Hash of their bytes, one file after the other; None if they cannot be read.
    failure : Failure, optional
        Why it cannot even be tried.
    beside : tuple of (str, Path)
        Kind and path of ABC's files beside `path`.
    shown : str
        What the lake says of where it is; `path` by default.
    origin : Origin, optional
        Where its bytes are, if they are in no file yet; `path` then is of no use.
    facts : Facts
        What its source says of it.
    """

    path: Path
    collection: str
    name: str
    format: str
    bytes: int | None = None
    sha256: str | None = None
    failure: Failure | None = None
    beside: tuple[tuple[str, Path], ...] = ()
    shown: str = ""
    origin: Origin | None = None
    facts: Facts = NO_FACTS
    model_id: int = field(init=False)

    def __post_init__(self) -> None:
        """Derive the id, and name what cannot be in UTF-8 columns."""
        object.__setattr__(self, "model_id", model_id(self.collection, self.name))
        object.__setattr__(self, "shown", self.shown or printable(self.path))

    @property
    def files(self) -> list[Path]:
        """All files, in the order in which they are hashed."""
        return [self.path, *(path for _, path in self.beside)]

    @property
    def companions(self) -> dict[str, Path]:
        """ABC's files beside a CAD file by kind, or all of them where there is none."""
        own = {"features": self.path} if self.format == ABC_FORMAT else {}
        return own | dict(self.beside)


def find_inputs(
    sources: Sequence[Path], collection: str | None = None, hasher: Hasher | None = None
) -> list[Input]:
    """List the models of `sources` in order of their names.

    A folder is searched with its subfolders, also those behind links, each of them once; every
    entry there whose name ends like a CAD file, or is that of a file of the ABC dataset, is an
    input or part of one, even if it turns out to be a folder or unreadable. Other files are not.
    A folder that cannot be listed is an input that failed. Names leave out the extension; of two
    files that differ in nothing else, the second in order keeps it in its name. ABC's files of one
    model are one input, together with the CAD file of that name; stats and metadata alone are
    none.

    Parameters
    ----------
    sources : sequence of Path
        Files and folders.
    collection : str, optional
        Collection of all models; by default each folder's own name, for a file that of the
        folder it is in.
    hasher : Hasher, optional
        Reads the files; by default one that remembers nothing.

    Raises
    ------
    UsageError
        If a source does not exist, a file is of no known format, or two inputs would get the
        same collection and name.
    KeyboardInterrupt
        If the hasher is to stop.
    """
    hasher = hasher or Hasher()

    def look() -> None:
        hasher.look(f"{len(models)} models found")

    models: dict[tuple[str, str], dict[str, Path]] = {}
    found: list[Input] = []
    for source in sources:
        source = Path(source)
        if not source.exists():
            raise UsageError(f"source {source} does not exist; give a CAD file or a folder")
        closed: list[OSError] = []
        is_folder = source.is_dir()
        home = source.resolve() if is_folder else source.resolve().parent
        group = printable(collection or home.name or "root")
        for path in _walk(source, closed.append, look) if is_folder else [source]:
            relative = path.relative_to(source) if is_folder else Path(path.name)
            _sort_in(models, group, path, relative)
        found += [_closed_folder(Path(error.filename), source, group, error) for error in closed]
    unique = {(item.collection, item.name): item for item in found}
    named = list(models.items())
    for item in hasher.over(named, lambda each: _input(each[1], *each[0], hasher), "reading files"):
        if item is not None:
            unique[item.collection, item.name] = item
    return sorted(unique.values(), key=lambda item: (item.collection, item.name))


def _sort_in(
    models: dict[tuple[str, str], dict[str, Path]], group: str, path: Path, relative: Path
) -> None:
    """Put a file to the others of its model.

    Raises
    ------
    UsageError
        If it is none of a model, or another file is in its place.
    """
    abc = _abc_file(path)
    if cad_format(path.name) is not None:
        # a.step beside a.stp: the extension is what tells them apart
        kind, names = _CAD, (model_name(relative), relative.as_posix())
    elif abc is not None:
        kind, names = abc.kind, (abc.model, (relative.parent / abc.model).as_posix())
    else:
        known = ", ".join(FORMATS)
        raise UsageError(
            f"{path} is no CAD file: its name must end in {known}, or those with .gz, or be "
            "that of a file of the ABC dataset: NAME_trimesh_000.obj, NAME_features_000.yml"
        )
    for name in names:
        files = models.setdefault((group, printable(name)), {})
        if _same_place(files.setdefault(kind, path), path):
            return
    raise UsageError(
        f"{path} and {files[kind]} would both be model {group}/{printable(names[-1])}; "
        "ingest one with another --collection"
    )


def _same_place(a: Path, b: Path) -> bool:
    return a is b or a.resolve() == b.resolve()


def _closed_folder(folder: Path, source: Path, collection: str, error: OSError) -> Input:
    """Return a folder that cannot be listed as an input that failed."""
    name = printable(folder.relative_to(source).as_posix()) + "/"
    failure = Failure("plan", "unreadable", advise("unreadable", str(error.strerror)), fatal=True)
    return Input(folder, collection, name, "folder", failure=failure)


def _walk(
    folder: Path, closed: Callable[[OSError], None], look: Callable[[], None]
) -> Iterator[Path]:
    """Yield the entries below `folder` that are named like files of models, in sorted order."""
    for directory, folders, files in _folders(folder, closed):
        for name in sorted([*files, *folders]):
            look()
            path = Path(directory) / name
            if cad_format(path.name) is not None or _abc_file(path) is not None:
                yield path


def _folders(
    top: Path, closed: Callable[[OSError], None]
) -> Iterator[tuple[str, list[str], list[str]]]:
    """Yield folders as `os.walk` does, those behind links too, but each once.

    Links come last, so that what is here by itself is named by its own path.
    """
    seen: set[tuple[int, int]] = set()
    waiting = deque([str(top)])
    while waiting:
        for directory, folders, files in os.walk(waiting.popleft(), onerror=closed):
            try:
                status = os.stat(directory)
            except OSError as error:  # it was removed meanwhile
                closed(error)
                folders.clear()
                continue
            place = status.st_dev, status.st_ino
            if place in seen:
                folders.clear()
                continue
            seen.add(place)
            folders.sort()
            paths = (os.path.join(directory, name) for name in folders)
            waiting.extend(path for path in paths if os.path.islink(path))
            yield directory, folders, files


def cad_format(name: str) -> str | None:
    """Return the format of a CAD file by its name; None for other files."""
    return FORMATS.get(os.path.splitext(name.lower().removesuffix(".gz"))[1])


def _abc_file(path: Path) -> AbcName | None:
    """Read the name of a file of the ABC dataset that is no CAD file."""
    name = parse_name(path.name)
    return None if name is None or name.kind == "step" else name


def model_name(relative: PurePath) -> str:
    """Return the name of the model in a CAD file, given its path below the source.

    ABC's files of one model differ but in their kind, which is left out here.
    """
    name = relative.name
    if name.lower().endswith(".gz"):
        name = name[:-3]
    abc = parse_name(name)
    if abc is not None and abc.kind == "step":
        return abc.model
    return (relative.parent / os.path.splitext(name)[0]).as_posix()


def read_input(path: Path, collection: str, name: str, hasher: Hasher) -> Input:
    """Return the model of one CAD file, read for its size and hash unless that is remembered."""
    item = _input({_CAD: path}, collection, name, hasher)
    if item is None:
        raise AssertionError("a CAD file is enough for a model")
    return item


def _input(files: Mapping[str, Path], collection: str, name: str, hasher: Hasher) -> Input | None:
    """Return the input that the files of one model make; None if there is nothing to read.

    They are looked at for size and hash, and to notice what cannot be tried.
    """
    ordered = {kind: files[kind] for kind in _ORDER if kind in files}
    kind, path = next(iter(ordered.items()))
    if kind not in (_CAD, "features", "trimesh"):
        return None
    format = cad_format(path.name) or ABC_FORMAT
    beside = tuple(ordered.items())[1:]
    try:
        digest = hasher.digest(list(ordered.values()))
    except InputError as error:
        failure = Failure("plan", error.kind, str(error), fatal=True)
        return Input(path, collection, name, format, failure=failure, beside=beside)
    wrong = "empty-file" if digest.has_empty else _lacks(ordered)
    problem = None if wrong is None else Failure("plan", wrong, advise(wrong, ""), fatal=True)
    return Input(path, collection, name, format, digest.bytes, digest.sha256, problem, beside)


def _lacks(files: Mapping[str, Path]) -> str | None:
    """Return the kind of failure of files of which one alone tells too little."""
    if _CAD in files or {"features", "trimesh"} <= files.keys():
        return None
    return "no-trimesh" if "features" in files else "no-features"
