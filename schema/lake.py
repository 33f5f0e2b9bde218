"""A lake on disk: write-once files, and snapshots whose creation is the commit.

::

    LAKE/breplake.json                     format version, lake id
    LAKE/snapshots/00000042.json           created if absent: that is the commit
    LAKE/tags/v1.json                      name -> snapshot
    LAKE/tables/<table>/<shard>.parquet    write-once
    LAKE/arrays/<shard>.zarr/              write-once

A writer puts its files under new names, registers them and commits.  A process killed at
any moment leaves the last snapshot whole, plus files that no snapshot names.
"""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from breplake.errors import (
    CommitConflictError,
    LakeFormatError,
    LakeNotFoundError,
    NameNotFoundError,
    UsageError,
)
from breplake.schema.files import (
    FileProblem,
    check_models,
    compare,
    describe_arrays,
    describe_table,
    measure,
)
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry, Snapshot
from breplake.schema.storage import Storage
from breplake.schema.tables import SCHEMA_VERSION, TABLES

__all__ = ["FORMAT_VERSION", "FileProblem", "LakeStore"]

FORMAT_VERSION = 1
"""Version of the layout of the folder. Readers refuse a higher one."""

_MARKER = "breplake.json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_ATTEMPTS = 1000


class LakeStore:
    """A lake as writers see it; readers use ``breplake.open``.

    Make one with `create`, `open` or `open_or_create`.

    Attributes
    ----------
    root : pathlib.Path
        Absolute path of the lake's folder.
    lake_id : str
        Random id, the same wherever the lake is moved or copied.
    """

    def __init__(self, storage: Storage, lake_id: str) -> None:
        self._storage = storage
        self.lake_id = lake_id

    @property
    def root(self) -> Path:
        """Absolute path of the lake's folder."""
        return self._storage.root

    @classmethod
    def create(cls, path: str | Path) -> LakeStore:
        """Create an empty lake in a new or empty folder.

        Raises
        ------
        UsageError
            If there is a lake already, or the folder holds other files.
        """
        root = Path(path)
        if root.exists() and not root.is_dir():
            raise UsageError(f"{root} is a file, a lake is a folder")
        root.mkdir(parents=True, exist_ok=True)
        # a kill while the marker is staged leaves "breplake.json#1", which is no obstacle
        others = [p.name for p in root.iterdir() if not p.name.startswith(f"{_MARKER}#")]
        if others and _MARKER not in others:
            raise UsageError(f"{root} holds other files ({others[0]} ...): name a new folder")
        document = {
            "format": "breplake",
            "format_version": FORMAT_VERSION,
            "lake_id": uuid.uuid4().hex,
        }
        data = (json.dumps(document, indent=1, sort_keys=True) + "\n").encode()
        if not Storage(root).create(_MARKER, data):
            raise UsageError(f"there is a lake in {root} already: open it instead")
        return cls.open(root)

    @classmethod
    def open(cls, path: str | Path) -> LakeStore:
        """Open a lake.

        Raises
        ------
        LakeNotFoundError
            If there is none in that folder.
        LakeFormatError
            If it is of a format that this version cannot read.
        """
        root = Path(path)
        if not (root / _MARKER).is_file():
            raise LakeNotFoundError(
                f"there is no lake in {root} (no file {_MARKER}): make one with breplake ingest"
            )
        storage = Storage(root)
        try:
            document = json.loads(storage.read(_MARKER))
            version, lake_id = int(document["format_version"]), str(document["lake_id"])
        except (KeyError, TypeError, ValueError) as error:
            raise LakeFormatError(f"{root / _MARKER} is not a lake's marker: {error!r}") from error
        if version > FORMAT_VERSION:
            raise LakeFormatError(
                f"the lake {root} has format version {version}, this breplake reads up to "
                f"{FORMAT_VERSION}: upgrade with pip install -U breplake"
            )
        return cls(storage, lake_id)

    @classmethod
    def open_or_create(cls, path: str | Path) -> LakeStore:
        """Open the lake in `path`, or create it; safe when many processes do so at once."""
        try:
            return cls.open(path)
        except LakeNotFoundError:
            pass
        try:
            return cls.create(path)
        except UsageError:
            if (Path(path) / _MARKER).is_file():
                return cls.open(path)
            raise

    def table_path(self, table: str, shard: str) -> Path:
        """Return where the file of `table` in `shard` is to be written; make its folder.

        Raises
        ------
        UsageError
            If there is no such table, the shard's name is unfit, or the file exists.
        """
        if table not in TABLES:
            raise UsageError(f"there is no table {table!r}: one of {', '.join(TABLES)}")
        return self._new_path(f"tables/{table}/{_checked_name(shard, 'shard')}.parquet")

    def array_path(self, shard: str) -> Path:
        """Return where the arrays of `shard` are to be written, as `table_path` does."""
        return self._new_path(f"arrays/{_checked_name(shard, 'shard')}.zarr")

    def _new_path(self, relative: str) -> Path:
        path = self._storage.path(relative)
        if path.exists():
            raise UsageError(
                f"{path} exists, and files of a lake are written once: name a new shard"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def register(self, path: str | Path) -> FileEntry:
        """Describe a finished file under the lake's root, ready for `commit`.

        Parameters
        ----------
        path : str or pathlib.Path
            ``tables/<table>/<shard>.parquet`` or ``arrays/<shard>.zarr``, absolute or relative
            to the lake. The arrays of a shard take their range of models from its file of
            ``models``, which must be written.

        Raises
        ------
        UsageError
            If the path is none of these, or the file breaks its table's contract.
        FileNotFoundError
            If there is no such file.
        """
        relative = self._storage.relative(Path(path))
        absolute = self._storage.path(relative)
        match relative.split("/"):
            case ["tables", table, file] if table in TABLES and file.endswith(".parquet"):
                shard = _checked_name(file.removesuffix(".parquet"), "shard")
                rows, ids = describe_table(absolute, TABLES[table])
            case ["arrays", folder] if folder.endswith(".zarr"):
                table, shard = ARRAYS_TABLE, _checked_name(folder.removesuffix(".zarr"), "shard")
                _, ids = describe_table(
                    self.root / f"tables/models/{shard}.parquet", TABLES["models"]
                )
                rows = describe_arrays(absolute)
            case _:
                raise UsageError(
                    f"{relative} is neither tables/<table>/<shard>.parquet nor arrays/<shard>.zarr"
                )
        return FileEntry(relative, table, shard, rows, *measure(absolute), *ids)

    def register_shard(self, shard: str) -> list[FileEntry]:
        """Describe all files of `shard` that are there, as `register` does for one."""
        paths = [f"tables/{table}/{shard}.parquet" for table in TABLES] + [f"arrays/{shard}.zarr"]
        return [self.register(path) for path in paths if self._storage.path(path).exists()]

    def numbers(self) -> list[int]:
        """Return the numbers of all snapshots, ascending."""
        names = self._storage.names("snapshots")
        return [int(n[:-5]) for n in names if n.endswith(".json") and n[:-5].isdigit()]

    def head(self) -> Snapshot | None:
        """Return the newest snapshot, or None before the first commit."""
        numbers = self.numbers()
        return self._read_snapshot(max(numbers)) if numbers else None

    def snapshot(self, at: int | str | None = None) -> Snapshot:
        """Return a snapshot by number (also as text) or tag; None is the newest.

        Raises
        ------
        NameNotFoundError
            If there is none.
        LakeFormatError
            If it has a higher schema version than this breplake can read.
        """
        if at is None:
            head = self.head()
            if head is None:
                raise NameNotFoundError(
                    f"the lake {self.root} has no snapshot yet: fill it with breplake ingest"
                )
            return head
        number = int(at) if str(at).isdigit() else self.tags().get(str(at))
        numbers = self.numbers()
        if number is None or number not in numbers:
            known = f"1 to {max(numbers)}" if numbers else "none"
            tags = ", ".join(self.tags()) or "none"
            raise NameNotFoundError(
                f"no snapshot or tag {at!r}: snapshots are {known}, tags {tags}"
            )
        return self._read_snapshot(number)

    def _read_snapshot(self, number: int) -> Snapshot:
        path = f"snapshots/{number:08d}.json"
        return Snapshot.from_json(self._storage.read(path), path)

    def commit(
        self,
        files: Sequence[FileEntry],
        *,
        message: str,
        tools: Mapping[str, str],
        config_hash: str,
        replaces: Sequence[str] = (),
    ) -> Snapshot:
        """Add registered files to the lake in one step.

        Other writers may commit at the same time: who loses the race reads the new head,
        checks again and retries, so no acknowledged commit is lost.

        Parameters
        ----------
        files : sequence of FileEntry
            What `register` returned.
        message : str
            What the commit does.
        tools : mapping
            Versions of the tools that wrote the files.
        config_hash : str
            Hash of the settings that decide the content.
        replaces : sequence of str
            Paths of files of the head that the new ones supersede.

        Returns
        -------
        Snapshot
            The snapshot that was made.

        Raises
        ------
        CommitConflictError
            If a model or a file is in the head already, or a file to be replaced is not.
        """
        replaced = set(replaces)
        checked: frozenset[str] = frozenset()
        for _ in range(_ATTEMPTS):
            head = self.head()
            old = head.files if head else ()
            kept = [entry for entry in old if entry.path not in replaced]
            _check_files(files, kept, replaced - {entry.path for entry in old})
            # files that an earlier attempt has compared need no second look
            check_models(self.root, files, [e for e in kept if e.path not in checked])
            checked = frozenset(entry.path for entry in kept)
            snapshot = Snapshot(
                number=head.number + 1 if head else 1,
                parent=head.number if head else None,
                message=message,
                time=datetime.now(UTC).isoformat(timespec="seconds"),
                schema_version=SCHEMA_VERSION,
                tools=dict(sorted(tools.items())),
                config_hash=config_hash,
                files=tuple(sorted([*kept, *files])),
            )
            if self._storage.create(f"snapshots/{snapshot.number:08d}.json", snapshot.to_json()):
                return snapshot
        raise CommitConflictError(
            f"lost {_ATTEMPTS} races for the next snapshot: commit again later"
        )

    def tag(self, name: str, snapshot: int | Snapshot) -> None:
        """Name a snapshot for good.

        Raises
        ------
        UsageError
            If the name is unfit (it must not be a number) or names another snapshot.
        NameNotFoundError
            If there is no such snapshot.
        """
        if _checked_name(name, "tag").isdigit():
            raise UsageError(f"a tag must not be a number, got {name!r}: numbers name snapshots")
        number = snapshot.number if isinstance(snapshot, Snapshot) else snapshot
        self.snapshot(number)
        data = (json.dumps({"name": name, "snapshot": number}, sort_keys=True) + "\n").encode()
        if not self._storage.create(f"tags/{name}.json", data) and self.tags()[name] != number:
            raise UsageError(
                f"tag {name} names snapshot {self.tags()[name]} for good: use a new name"
            )

    def tags(self) -> dict[str, int]:
        """Return the snapshot number of every tag, sorted by name."""
        names = [n for n in self._storage.names("tags") if n.endswith(".json")]
        return {
            n.removesuffix(".json"): int(json.loads(self._storage.read(f"tags/{n}"))["snapshot"])
            for n in names
        }

    def verify(self, snapshot: Snapshot) -> list[FileProblem]:
        """Compare size and hash of every file of `snapshot` with what it says."""
        found = (compare(self.root, entry) for entry in snapshot.files)
        return [problem for problem in found if problem is not None]


def _checked_name(name: str, what: str) -> str:
    if not _NAME.fullmatch(name) or len(name) > 200:
        raise UsageError(
            f"a {what} is named by letters, digits, '.', '_' and '-', at most 200, got {name!r}"
        )
    return name


def _check_files(files: Sequence[FileEntry], kept: Sequence[FileEntry], gone: set[str]) -> None:
    if gone:
        raise CommitConflictError(
            f"{min(gone)} is not in the newest snapshot (replaced since?): read it again"
        )
    paths = [entry.path for entry in (*kept, *files)]
    if len(set(paths)) < len(paths):
        twice = next(path for path in paths if paths.count(path) > 1)
        raise CommitConflictError(f"{twice} is in the lake already: files are written once")
