"""A lake: write-once files, and snapshots whose creation is the commit.

::

    LAKE/breplake.json                     format version, lake id
    LAKE/snapshots/00000042.json           created if absent: that is the commit
    LAKE/tags/v1.json                      name -> snapshot
    LAKE/tables/<table>/<shard>.parquet    write-once
    LAKE/arrays/<shard>.zarr/              write-once; its files and hashes beside it

A writer puts its files under new names, registers them and commits.  A process killed at
any moment leaves the last snapshot whole, plus files that no snapshot names.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from pathlib import Path
from typing import TypedDict

from breplake.errors import (
    CommitConflictError,
    LakeFormatError,
    LakeNotFoundError,
    NameNotFoundError,
    UsageError,
)
from breplake.schema.copies import claim, copy_files
from breplake.schema.files import FileProblem, checked_name, compare, describe, list_name
from breplake.schema.identities import IdentityIndex
from breplake.schema.lock import writer_lock
from breplake.schema.older import CONTRACT
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry, Header, Snapshot
from breplake.schema.storage import Storage, local_folder
from breplake.schema.tables import SCHEMA_VERSION, TABLES
from breplake.schema.versions import VersionLog

__all__ = ["FORMAT_VERSION", "MARKER", "FileProblem", "LakeStore"]

FORMAT_VERSION = 1
"""Version of the layout of the folder. Readers refuse a higher one."""

MARKER = "breplake.json"
"""The file that makes a folder a lake."""

_ATTEMPTS = 1000


class LakeStore:
    """A lake as writers see it; readers use ``breplake.open``.

    Make one with `create`, `open` or `open_or_create`. New files of a lake in object storage
    (``s3://…``) are written and described in a local folder, its `desk`, and sent from there; the
    same serves writers on several machines that share a lake's folder.

    Attributes
    ----------
    storage : Storage
        Where it is.
    lake_id : str
        Random id, the same wherever the lake is moved or copied.
    log : VersionLog
        The documents of its history.
    desk : Storage
        Where new files are written before they are sent; the lake itself, if it is local.
    """

    def __init__(self, storage: Storage, lake_id: str, desk: Storage | None = None) -> None:
        self.storage = storage
        self.desk = desk or storage
        self.lake_id = lake_id
        self.log = VersionLog(storage)
        self._identities = IdentityIndex(storage)

    @property
    def root(self) -> Path:
        """Absolute path of the lake's folder; UsageError if it is not local."""
        return self.storage.root

    @classmethod
    def create(cls, path: str | Path, lake_id: str | None = None) -> LakeStore:
        """Create an empty lake in a new or empty folder.

        Parameters
        ----------
        path : path or str
            The folder, or its URL in object storage.
        lake_id : str, optional
            Its id; a random one if not given.

        Raises
        ------
        UsageError
            If there is a lake already, or the folder holds other files.
        """
        root = local_folder(path)
        if root is not None:
            if root.exists() and not root.is_dir():
                raise UsageError(f"{root} is a file, a lake is a folder")
            root.mkdir(parents=True, exist_ok=True)
        storage = Storage(path)
        # a kill while the marker is staged leaves "breplake.json#1", which is no obstacle
        others = [n for n in storage.entries() if not n.startswith(f"{MARKER}#")]
        if others and MARKER not in others:
            raise UsageError(f"{path} holds other files ({others[0]} ...): name a new folder")
        document = {
            "format": "breplake",
            "format_version": FORMAT_VERSION,
            "lake_id": lake_id or uuid.uuid4().hex,
        }
        data = (json.dumps(document, indent=1, sort_keys=True) + "\n").encode()
        if not storage.create(MARKER, data):
            raise UsageError(f"there is a lake in {path} already: open it instead")
        return cls.open(path)

    @classmethod
    def open(cls, place: str | Path) -> LakeStore:
        """Open a lake in a folder, or at a URL as `Storage` takes it.

        Raises
        ------
        LakeNotFoundError
            If there is none.
        LakeFormatError
            If it is of a format that this version cannot read.
        """
        missing = f"there is no lake in {place} (no file {MARKER}): make one with breplake ingest"
        try:
            storage = Storage(place)
            data = storage.read(MARKER)
        except FileNotFoundError as error:
            raise LakeNotFoundError(missing) from error
        try:
            document = json.loads(data)
            version, lake_id = int(document["format_version"]), str(document["lake_id"])
        except (KeyError, TypeError, ValueError) as error:
            raise LakeFormatError(
                f"{storage.name}/{MARKER} is not a lake's marker: {error!r}"
            ) from error
        if version > FORMAT_VERSION:
            raise LakeFormatError(
                f"the lake {storage.name} has format version {version}, this breplake reads up to "
                f"{FORMAT_VERSION}: upgrade with pip install -U breplake"
            )
        return cls(storage, lake_id)

    @classmethod
    def open_or_create(cls, path: str | Path, lake_id: str | None = None) -> LakeStore:
        """Open the lake in `path`, or `create` it; safe when many processes do so at once."""
        try:
            return cls.open(path)
        except LakeNotFoundError:
            pass
        try:
            return cls.create(path, lake_id)
        except UsageError:
            if Storage(path).has(MARKER):
                return cls.open(path)
            raise

    def at_desk(self, folder: Path) -> LakeStore:
        """Return this lake with another `desk`, a folder that is made."""
        folder.mkdir(parents=True, exist_ok=True)
        return LakeStore(self.storage, self.lake_id, Storage(folder))

    def lock(self, waiting: Callable[[], None] | None = None) -> AbstractContextManager[None]:
        """Return a context that holds the writer's lock, as `writer_lock` does.

        In object storage there is none: writers there only hold that of their desk.
        """
        place = self.storage if self.storage.is_local else self.desk
        return writer_lock(place.root, waiting)

    def table_path(self, table: str, shard: str) -> Path:
        """Return where the file of `table` in `shard` is to be written; make its folder.

        Raises
        ------
        UsageError
            If there is no such table, the shard's name is unfit, or the file exists.
        """
        if table not in TABLES:
            raise UsageError(f"there is no table {table!r}: one of {', '.join(TABLES)}")
        return self._new_path(f"tables/{table}/{checked_name(shard, 'shard')}.parquet")

    def array_path(self, shard: str) -> Path:
        """Return where the arrays of `shard` are to be written, as `table_path` does."""
        return self._new_path(f"arrays/{checked_name(shard, 'shard')}.zarr")

    def _new_path(self, relative: str) -> Path:
        path = self.desk.path(relative)
        if path.exists():
            raise UsageError(
                f"{path} exists, and files of a lake are written once: name a new shard"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def register(self, path: str | Path) -> FileEntry:
        """Describe a finished file at the `desk`, ready for `send` and `commit`.

        Beside a folder of arrays, the list of its files and their hashes is written.

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
        return describe(self.desk, self.desk.relative(Path(path)))

    def register_shard(self, shard: str) -> list[FileEntry]:
        """Describe all files of `shard` that are there, as `register` does for one."""
        paths = [f"tables/{table}/{shard}.parquet" for table in TABLES] + [f"arrays/{shard}.zarr"]
        return [self.register(path) for path in paths if self.desk.path(path).exists()]

    def send(self, files: Sequence[FileEntry]) -> bool:
        """Bring the registered files of one shard from the `desk` to the lake.

        Returns
        -------
        bool
            False if another writer has put a shard of that name there: write it under a new one.
        """
        if self.desk is self.storage:
            return True
        if not claim(self.desk, self.storage, files):
            return False
        copy_files(self.desk, self.storage, files, trusting=False)
        return True

    def clear_desk(self) -> None:
        """Remove what was written at the `desk`, unless that is the lake itself."""
        if self.desk is not self.storage:
            for folder in ("tables", "arrays"):
                if self.desk.path(folder).exists():
                    self.desk.remove(folder)

    def numbers(self) -> list[int]:
        """Return the numbers of all snapshots, ascending.

        Raises
        ------
        UsageError
            If the lake is where names cannot be listed.
        """
        return self.log.numbers()

    def headers(self) -> Iterator[Header]:
        """Yield what every snapshot says of itself, ascending, without reading its files."""
        return self.log.headers()

    def head(self) -> Snapshot | None:
        """Return the newest snapshot, or None before the first commit."""
        number = self.log.newest()
        return self.log.read(number) if number else None

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
                    f"the lake {self.storage.name} has no snapshot yet: "
                    "fill it with breplake ingest"
                )
            return head
        number = int(at) if str(at).isdigit() else self.log.tagged(str(at))
        if number is not None:
            try:
                return self.log.read(number)
            except FileNotFoundError:
                pass
        raise NameNotFoundError(f"no snapshot or tag {at!r}{self.log.known()}")

    def commit(
        self,
        files: Sequence[FileEntry],
        *,
        message: str,
        tools: Mapping[str, str],
        config_hash: str,
        replaces: Sequence[str] = (),
        time: datetime | None = None,
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
        time : datetime, optional
            Time of the commit; now if not given.

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
        # Before the snapshot: it must never name files that a power cut would take.
        self.storage.settle(place for entry in files for place in _places(entry))
        for _ in range(_ATTEMPTS):
            head = self.head()
            old = head.files if head else ()
            kept = [entry for entry in old if entry.path not in replaced] if replaced else old
            if replaced:
                _check_replaced(replaced, old)
            _check_new(files, kept)
            self._identities.check(files, kept)
            snapshot = Snapshot(
                number=head.number + 1 if head else 1,
                parent=head.number if head else None,
                message=message,
                time=(time or datetime.now(UTC)).isoformat(timespec="seconds"),
                schema_version=SCHEMA_VERSION,
                tools=dict(sorted(tools.items())),
                config_hash=config_hash,
                files=tuple(sorted([*kept, *files])),
                **_contracts(head, kept, files),
            )
            if self.log.create(snapshot):
                return snapshot
        raise CommitConflictError(
            f"lost {_ATTEMPTS} races for the next snapshot: commit again later"
        )

    def shards_of(self, snapshot: Snapshot, ids: Collection[int]) -> list[str]:
        """Return the sorted shards of a snapshot that have rows of some models, or their failures.

        Parameters
        ----------
        snapshot : Snapshot
            One of this lake. Ask of one after the other: files that the last call or `commit`
            read are not read again.
        ids : collection of int
            The models.
        """
        return self._identities.shards(snapshot.files, ids)

    def tag(self, name: str, snapshot: int | Snapshot) -> None:
        """Name a snapshot for good; `gc` keeps what has a name.

        Raises
        ------
        UsageError
            If the name is unfit (it must not be a number) or names another snapshot.
        NameNotFoundError
            If there is no such snapshot.
        """
        if checked_name(name, "tag").isdigit():
            raise UsageError(f"a tag must not be a number, got {name!r}: numbers name snapshots")
        number = snapshot.number if isinstance(snapshot, Snapshot) else snapshot
        self.snapshot(number)
        self.log.tag(name, number)

    def tags(self) -> dict[str, int]:
        """Return the snapshot number of every tag, sorted by name."""
        return self.log.tags()

    def verify(
        self, snapshot: Snapshot, progress: Callable[[FileEntry], None] | None = None
    ) -> list[FileProblem]:
        """Compare size and hash of every file of `snapshot` with what it says.

        Parameters
        ----------
        snapshot : Snapshot
            One of this lake.
        progress : callable, optional
            Called with each file that was read.
        """
        problems: list[FileProblem] = []
        with ThreadPoolExecutor() as pool:  # hashing leaves the interpreter to others
            checked = pool.map(lambda entry: compare(self.storage, entry), snapshot.files)
            for entry, problem in zip(snapshot.files, checked, strict=True):
                if problem is not None:
                    problems.append(problem)
                if progress is not None:
                    progress(entry)
        return problems


def _places(entry: FileEntry) -> Iterator[str]:
    """Yield the paths of what a commit adds for an entry, if that is what `register` made."""
    yield entry.path
    if entry.table == ARRAYS_TABLE:
        yield list_name(entry.path)


def _check_replaced(replaced: set[str], old: Sequence[FileEntry]) -> None:
    if gone := replaced - {entry.path for entry in old}:
        raise CommitConflictError(
            f"{min(gone)} is not in the newest snapshot (replaced since?): read it again"
        )


class _Contracts(TypedDict):
    """What a `Snapshot` says of contracts."""

    contract: str
    contracts: dict[str, str]


def _contracts(
    head: Snapshot | None, kept: Sequence[FileEntry], new: Sequence[FileEntry]
) -> _Contracts:
    """Return the contract of all files of a commit, else that of each shard where it is known."""
    by_shard: dict[str, set[str]] = {}
    for entry in kept:
        contract = head.contract_of(entry.shard) if head else ""
        by_shard.setdefault(entry.shard, set()).add(contract)
    for entry in new:  # which `register` held against today's contract
        by_shard.setdefault(entry.shard, set()).add(CONTRACT)
    found = set().union(*by_shard.values())
    if len(found) <= 1:
        return _Contracts(contract=next(iter(found), CONTRACT), contracts={})
    known = {shard: min(names) for shard, names in by_shard.items() if len(names) == 1}
    return _Contracts(contract="", contracts={s: name for s, name in known.items() if name})


def _check_new(files: Sequence[FileEntry], kept: Sequence[FileEntry]) -> None:
    there = {entry[:2] for entry in kept}  # table and shard, which make the path
    for entry in files:
        if entry[:2] in there:
            raise CommitConflictError(
                f"{entry.path} is in the lake already: files are written once"
            )
        there.add(entry[:2])
