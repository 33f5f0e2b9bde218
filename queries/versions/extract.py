"""Copy chosen models of a lake into another lake, whichever shards they are in.

Only whole files have a hash, so from a place on a network each shard that holds a chosen model
is fetched as it is, checked, and dropped again when its models have been copied.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from breplake.errors import NameNotFoundError, UsageError
from breplake.queries.session import Lake
from breplake.queries.subset_files import Listed, SubsetFile, check_sources
from breplake.queries.subsets import load_subset, save_subset
from breplake.schema.copies import copy_files
from breplake.schema.files import checked_name, compare
from breplake.schema.identities import read_ids
from breplake.schema.lake import LakeStore
from breplake.schema.rewrite import rewrite_shard
from breplake.schema.shard_writer import fresh_name
from breplake.schema.snapshot import FileEntry, Snapshot
from breplake.schema.storage import Storage
from breplake.schema.subset import Origin, Subset, subset_path

__all__ = ["Extracted", "Selection", "extract"]

_NOTES: Final = "extract"
"""Folder of the target that notes which shards are done, until the commit."""

_NAMING: Final = ("models", "failures")
"""Tables that tell which models there are."""

_Ids = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Selection:
    """Which models to copy: one of these.

    Parameters
    ----------
    where : str, optional
        SQL condition on a row of ``models``.
    subset : str, optional
        Name of a subset of the source, which is copied too.
    models : pathlib.Path, optional
        File that lists models, as `breplake.queries.subset_files` reads it.
    """

    where: str | None = None
    subset: str | None = None
    models: Path | None = None

    def __post_init__(self) -> None:
        """Check that there is one."""
        if sum(value is not None for value in (self.where, self.subset, self.models)) != 1:
            raise UsageError("models are chosen by a condition, a subset or a file: give one")

    def load_subset(self, source: LakeStore) -> Subset | None:
        """Return the subset, if that is what chooses.

        Raises
        ------
        NameNotFoundError
            If the source has none of that name.
        """
        if self.subset is None:
            return None
        path = subset_path(checked_name(self.subset, "subset"))
        try:
            return Subset.from_bytes(source.storage.read(path), path)
        except FileNotFoundError as error:
            raise NameNotFoundError(f"{source.storage.name} has no subset {self.subset}") from error


@dataclass(frozen=True, slots=True)
class Extracted:
    """What was copied.

    Parameters
    ----------
    models : int
        Models that were added to the target.
    present : int
        Chosen models that the target had before; they are left as they are.
    snapshot : Snapshot
        Newest snapshot of the target.
    """

    models: int
    present: int
    snapshot: Snapshot


def extract(
    source: LakeStore,
    place: str | Path,
    snapshot: Snapshot,
    selection: Selection,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Extracted:
    """Copy chosen models, with all their rows and arrays, into a lake in a local folder.

    Interrupted and called again, it goes on after the last shard that was finished. A lake that
    it makes has the same id and content whenever the same models are copied.

    Parameters
    ----------
    source : LakeStore
        The lake.
    place : path or str
        Local folder of the target, which is made if it is not there.
    snapshot : Snapshot
        Of the source.
    selection : Selection
        Which models.
    progress : callable, optional
        Called with the number of shards that are done, and of all.

    Raises
    ------
    UsageError
        If the selection is empty, or lists a model that the snapshot lacks; or if a model has
        another source file in the target, or than the list says. Then nothing is copied.
    """
    subset = selection.load_subset(source)
    with tempfile.TemporaryDirectory(prefix="breplake-") as folder:
        stage = _Stage(source, snapshot, Path(folder))
        ids = _chosen(stage, selection, subset)
        target = _opened(place, source, snapshot, ids)
        with target.lock():
            head = target.head()
            there = read_ids(target.storage, head.files if head else ())
            wanted = np.setdiff1d(ids, there)
            if head is not None and len(wanted) < len(ids):
                here = Lake(target.root, head.number)
                check_sources(here, stage.listed(np.intersect1d(ids, there)), str(place))
            if len(wanted) or head is None:
                head = _copy(stage, target, wanted, progress or (lambda _done, _all: None))
    if subset is not None:
        _adopt(subset, source, target, head)
    return Extracted(len(wanted), len(ids) - len(wanted), head)


class _Stage:
    """The files of the source, here or fetched when needed."""

    def __init__(self, source: LakeStore, snapshot: Snapshot, folder: Path) -> None:
        self.source, self.snapshot = source, snapshot
        if source.storage.is_local:
            self.root = source.root
            self.lake = Lake(source.root, snapshot.number)
            return
        # a lake of nothing but the tables that tell which models there are
        store = LakeStore.create(folder / "lake", source.lake_id)
        self.root = store.root
        files = tuple(entry for entry in snapshot.files if entry.table in _NAMING)
        copy_files(source.storage, store.storage, files)
        store.log.create(replace(snapshot, files=files))
        self.lake = Lake(store.root)

    @contextmanager
    def shard(self, files: list[FileEntry]) -> Iterator[Path]:
        """Give the folder of a lake that holds the files of a shard."""
        storage = self.source.storage
        if storage.is_local:
            yield self.root
            return
        with tempfile.TemporaryDirectory(dir=self.root.parent) as folder:
            copy_files(storage, Storage(folder), files)
            yield Path(folder)

    def ids(self, entry: FileEntry) -> _Ids:
        """Return the ids in a file of ``models`` or ``failures``."""
        with pq.ParquetFile(self.root / entry.path) as file:
            ids: _Ids = file.read(columns=["model_id"]).column("model_id").to_numpy()
        return ids

    def listed(self, ids: _Ids) -> list[Listed]:
        """Return models with the hashes of their source files."""
        columns = "model_id, concat_ws('/', nullif(collection, ''), name) AS label, sha256"
        found: Any = self.lake.sql(f"SELECT {columns} FROM models").to_arrow_table()
        chosen = found.filter(pc.is_in(found.column("model_id"), value_set=pa.array(ids)))
        return [
            Listed(row["model_id"], "", row["label"], row["sha256"] or "")
            for row in chosen.to_pylist()
        ]


def _chosen(stage: _Stage, selection: Selection, subset: Subset | None) -> _Ids:
    """Return the ids of the chosen models, ascending."""
    known = np.sort(read_ids(Storage(stage.root), stage.snapshot.table_files("models")))
    if subset is not None:
        ids = subset.model_ids
    elif selection.models is not None:
        listed = SubsetFile.read(selection.models).models
        check_sources(stage.lake, listed, stage.source.storage.name)
        ids = np.array([model.model_id for model in listed], np.int64)
    else:
        ids = _matching(stage.lake, f"SELECT model_id FROM models WHERE {selection.where}")
    missing = np.setdiff1d(ids, known)
    if len(missing) or not len(ids):
        what = (
            f"{len(missing)} chosen models, {missing[0]} say," if len(missing) else "what matches"
        )
        raise UsageError(
            f"snapshot {stage.snapshot.number} of {stage.source.storage.name} lacks {what}: "
            "choose others or another snapshot (--at)"
        )
    return np.unique(ids)


def _matching(lake: Lake, query: str) -> _Ids:
    import duckdb

    try:
        table: Any = lake.sql(query).to_arrow_table()
    except duckdb.Error as error:
        raise UsageError(str(error)) from error
    ids: _Ids = table.column(0).to_numpy()
    return ids


def _opened(place: str | Path, source: LakeStore, snapshot: Snapshot, ids: _Ids) -> LakeStore:
    """Open the target, or make it with an id that tells which models of which lake it holds."""
    digest = hashlib.sha256(f"{source.lake_id} {snapshot.number}\n".encode())
    digest.update(ids.astype("<i8").tobytes())
    return LakeStore.open_or_create(place, digest.hexdigest()[:32])


def _copy(
    stage: _Stage, target: LakeStore, wanted: _Ids, progress: Callable[[int, int], None]
) -> Snapshot:
    """Copy models shard by shard, then commit them at once."""
    snapshot = stage.snapshot
    shards: dict[str, _Ids] = {}
    for entry in (*snapshot.table_files(_NAMING[0]), *snapshot.table_files(_NAMING[1])):
        found = np.intersect1d(stage.ids(entry), wanted)
        if len(found):
            shards[entry.shard] = np.union1d(shards.get(entry.shard, found), found)
    files: list[FileEntry] = []
    for number, (shard, ids) in enumerate(sorted(shards.items())):
        progress(number, len(shards))
        files += _copy_shard(stage, target, shard, ids)
    is_new = target.head() is None
    made = target.commit(
        files,
        message=f"models of snapshot {snapshot.number} of lake {stage.source.lake_id}",
        tools=snapshot.tools,
        config_hash=snapshot.config_hash,
        time=datetime.fromisoformat(snapshot.time) if is_new else None,
    )
    shutil.rmtree(target.root / _NOTES, ignore_errors=True)
    progress(len(shards), len(shards))
    return made


def _copy_shard(stage: _Stage, target: LakeStore, shard: str, ids: _Ids) -> list[FileEntry]:
    """Copy models of one shard, unless an interrupted call has."""
    entries = [entry for entry in stage.snapshot.files if entry.shard == shard]
    digest = hashlib.sha256("".join(entry.sha256 for entry in entries).encode())
    digest.update(ids.astype("<i8").tobytes())
    name = digest.hexdigest()[:16]
    note = f"{_NOTES}/{name}.json"
    if target.storage.has(note):
        done = [FileEntry(*values) for values in json.loads(target.storage.read(note))]
        if all(compare(target.storage, entry) is None for entry in done):
            return done
    chosen = pa.array(ids)
    with stage.shard(entries) as root:
        files = rewrite_shard(
            root,
            entries,
            target,
            fresh_name(target, name),
            lambda models: pc.is_in(models, value_set=chosen),
        )
    target.storage.overwrite(note, json.dumps(files).encode())
    return files


def _adopt(subset: Subset, source: LakeStore, target: LakeStore, head: Snapshot) -> None:
    """Store the subset that chose the models in the target as well."""
    lake = Lake(target.root, head.number)
    try:
        if load_subset(lake, subset.name).hash == subset.hash:
            return
    except NameNotFoundError:
        pass
    adopted = replace(
        subset,
        lake_id=target.lake_id,
        snapshot=head.number,
        time=datetime.now(UTC).isoformat(timespec="seconds"),
        origin=subset.origin or Origin(source.lake_id, subset.name, subset.snapshot),
    )
    save_subset(lake, adopted)
