"""Rules on files and on what spans models: hashes, contract, order, identity."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from breplake.errors import UsageError
from breplake.queries.check.rules import Measure, lake_rule, place
from breplake.queries.check.stream import KeyScan, scan_keys
from breplake.schema.identity import model_id
from breplake.schema.lake import FileProblem, LakeStore
from breplake.schema.older import CONTRACT, conform, is_older
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry, Snapshot
from breplake.schema.tables import TABLES

__all__ = ["LakeView"]


@dataclass
class LakeView:
    """The files that are checked.

    Parameters
    ----------
    root : pathlib.Path
        Folder of the lake.
    snapshot : Snapshot
        The snapshot that is checked.
    entries : tuple of FileEntry
        Its files, or those of the shards that were asked for.
    """

    root: Path
    snapshot: Snapshot
    entries: tuple[FileEntry, ...]

    def path(self, entry: FileEntry) -> Path:
        """Return the absolute path of a file."""
        return self.root / entry.path

    @cached_property
    def tables(self) -> tuple[FileEntry, ...]:
        """The Parquet files."""
        return tuple(e for e in self.entries if e.table != ARRAYS_TABLE)

    @cached_property
    def problems(self) -> dict[str, FileProblem]:
        """What is wrong with sizes and hashes, by path."""
        wanted = replace(self.snapshot, files=self.entries)
        return {problem.path: problem for problem in LakeStore.open(self.root).verify(wanted)}

    @cached_property
    def contract_faults(self) -> dict[str, str]:
        """What keeps a Parquet file from being read by its contract, by path."""
        faults: dict[str, str] = {}
        alike: dict[tuple[str, str], dict[str, int]] = {}
        for entry in self.tables:
            contract = self.snapshot.contract_of(entry.shard)
            fault, columns = _contract_fault(self.path(entry), entry.table, contract == CONTRACT)
            if fault:
                faults[entry.path] = fault
            elif contract:
                alike.setdefault((entry.table, contract), {})[entry.path] = columns
        for (_, contract), found in alike.items():
            usual = Counter(found.values()).most_common(1)[0][0]
            for path in (path for path, columns in found.items() if columns != usual):
                faults[path] = f"its columns are not those of other files of contract {contract}"
        return faults

    @cached_property
    def readable(self) -> tuple[FileEntry, ...]:
        """The Parquet files that can be read by their contract."""
        return tuple(e for e in self.tables if e.path not in self.contract_faults)

    @cached_property
    def scans(self) -> dict[str, KeyScan]:
        """The keys of every readable Parquet file, by path."""
        return {e.path: scan_keys(self.path(e), TABLES[e.table].key) for e in self.readable}

    @cached_property
    def broken_shards(self) -> frozenset[str]:
        """Shards with a file that cannot be read: their models cannot be checked."""
        unreadable = {e.shard for e in self.tables if e.path in self.contract_faults}
        missing = {
            e.shard
            for e in self.entries
            if e.path in self.problems and self.problems[e.path].kind == "missing"
        }
        return frozenset(unreadable | missing)

    def read(self, table: str, columns: list[str]) -> pa.Table:
        """Return columns of all readable files of a small table, with the file's shard."""
        parts = []
        for entry in self.readable:
            if entry.table == table:
                part = pq.read_table(self.path(entry), columns=columns)
                part = conform(part, TABLES[table].empty().select(columns).schema)
                shard = pa.array([entry.shard] * part.num_rows, pa.string())
                parts.append(part.append_column("file_shard", shard))
        if parts:
            return pa.concat_tables(parts)
        empty = TABLES[table].empty().select(columns)
        return empty.append_column("file_shard", pa.array([], pa.string()))


def _contract_fault(path: Path, table: str, whole: bool) -> tuple[str, int]:
    """Return how the schema of a file differs from its contract, and a hash of its columns.

    The text is empty if it does not differ.

    Unless the snapshot says that files are `whole`, one of an older breplake may lack columns,
    and members of structures, that can be null.
    """
    if table not in TABLES:
        return f"the contract has no table {table}", 0
    try:
        found = pq.read_schema(path)
    except FileNotFoundError:
        return "the file is not there", 0
    except (OSError, pa.ArrowException) as error:
        return f"not a Parquet file: {error}", 0
    wanted = TABLES[table].schema
    if not whole:
        wanted = pa.schema([f for f in wanted if f.name in found.names or not f.nullable])
    if found.names != wanted.names:
        missing = [n for n in wanted.names if n not in found.names]
        added = [n for n in found.names if n not in wanted.names]
        return f"columns differ: missing {missing}, not in the contract {added}", 0
    for have, want in zip(found, wanted, strict=True):
        if not have.equals(want) and (whole or not is_older(have, want)):
            return f"column {have.name} is {have} instead of {want}", 0
    return "", hash(tuple((field.name, str(field.type)) for field in found))


@lake_rule("files", "size and SHA-256 of every file are those of the snapshot")
def files(view: LakeView) -> Iterator[Measure]:
    """Measure each file's size and hash."""
    for entry in view.entries:
        problem = view.problems.get(entry.path)
        words = f"{problem.kind}: {problem.message}" if problem else ""
        yield Measure.of_truth([problem is None], place("{w}", w=words), entry.path)


@lake_rule("contract", "columns, types and nullability of every file are the contract's")
def contract(view: LakeView) -> Iterator[Measure]:
    """Measure each Parquet file's schema."""
    for entry in view.tables:
        fault = view.contract_faults.get(entry.path, "")
        yield Measure.of_truth([not fault], place("{w}", w=fault), entry.path)


@lake_rule("file-rows", "rows and range of models of every file are the snapshot's")
def file_rows(view: LakeView) -> Iterator[Measure]:
    """Measure each Parquet file's number of rows, least and greatest model id."""
    for entry in view.readable:
        scan = view.scans[entry.path]
        least = int(scan.ids[0]) if len(scan.ids) else None
        most = int(scan.ids[-1]) if len(scan.ids) else None
        found = (scan.rows, least, most)
        wanted = (entry.rows, entry.min_model_id, entry.max_model_id)
        yield Measure.of_truth(
            [a == b for a, b in zip(found, wanted, strict=True)],
            place("rows and ids {f} instead of {w}", f=found, w=wanted),
            entry.path,
        )


@lake_rule("sorted", "rows of every file ascend by the table's key")
def sorted_rows(view: LakeView) -> Iterator[Measure]:
    """Measure rows whose key is less than that of the row before."""
    for entry in view.readable:
        scan = view.scans[entry.path]
        yield _count(scan.disorder, scan.rows, f"row {scan.first_disorder}", entry.path)


@lake_rule("unique", "no key of a file is there twice")
def unique_keys(view: LakeView) -> Iterator[Measure]:
    """Measure rows whose key another row has."""
    for entry in view.readable:
        scan = view.scans[entry.path]
        key = ", ".join(TABLES[entry.table].key)
        yield _count(scan.repeated, scan.rows, f"({key})", entry.path)


def _count(broken: int, rows: int, words: str, subject: str) -> Measure:
    """Measure `rows` statements of which `broken` are false."""
    values = np.zeros(rows)
    values[:broken] = 1.0
    return Measure(values, 0.0, lambda _: words, subject)


@lake_rule("model-known", "every model_id of a table is in models of the same shard")
def model_known(view: LakeView) -> Iterator[Measure]:
    """Measure each model id of each file."""
    known: dict[str, list[np.ndarray]] = {}
    for entry in view.readable:
        if entry.table == "models":
            known.setdefault(entry.shard, []).append(view.scans[entry.path].ids)
    for entry in view.readable:
        if entry.table in ("models", "failures") or entry.shard in view.broken_shards:
            continue
        ids = view.scans[entry.path].ids
        ok = np.isin(ids, np.concatenate(known.get(entry.shard, [np.empty(0, np.int64)])))
        yield Measure.of_truth(ok, place("model_id {0}", ids), entry.path)


@lake_rule("one-outcome", "every input is once in models or in the fatal failures")
def one_outcome(view: LakeView) -> Iterator[Measure]:
    """Measure the number of outcomes of each input that any row speaks of."""
    models = view.read("models", ["model_id", "collection", "name"])
    failures = view.read("failures", ["model_id", "collection", "name", "fatal"])
    fatal = failures.filter(failures.column("fatal"))
    outcomes = Counter(models.column("model_id").to_pylist())
    outcomes.update(fatal.column("model_id").to_pylist())
    names = _names(models) | _names(failures)
    for model, name in names.items():
        number = outcomes[model]
        yield Measure.of_truth([number == 1], place("{n} outcomes", n=number), name)


@lake_rule("identity", "model_id is the hash of collection and name, each of them once")
def identity(view: LakeView) -> Iterator[Measure]:
    """Measure each model's id against its name, and that no name has two ids."""
    for table in ("models", "failures"):
        rows = view.read(table, ["model_id", "collection", "name"]).to_pylist()
        for row in rows:
            try:
                right = model_id(row["collection"], row["name"]) == row["model_id"]
            except UsageError:
                right = False
            name = f"{row['collection']}/{row['name']}"
            yield Measure.of_truth(
                [right], place("{t}: model_id {r[model_id]}", t=table, r=row), name
            )


@lake_rule("shards", "models.shard names the shard whose files hold the model")
def shards(view: LakeView) -> Iterator[Measure]:
    """Measure each model's shard against its file's."""
    for row in view.read("models", ["collection", "name", "shard"]).to_pylist():
        yield Measure.of_truth(
            [row["shard"] == row["file_shard"]],
            place("{r[shard]} in the file of {r[file_shard]}", r=row),
            f"{row['collection']}/{row['name']}",
        )


@lake_rule("duplicates", "duplicate_group is one for models of one fingerprint, and for no other")
def duplicates(view: LakeView) -> Iterator[Measure]:
    """Measure each model's group; without a fingerprint, only exact copies are one group."""
    columns = ["collection", "name", "sha256", "fingerprint", "duplicate_group"]
    rows = view.read("models", columns).to_pylist()
    group_of: dict[str, int] = {}
    shape_of: dict[int, str] = {}
    for row in rows:
        shape, group = row["fingerprint"] or row["sha256"], row["duplicate_group"]
        right = group_of.setdefault(shape, group) == group
        right &= shape_of.setdefault(group, shape) == shape
        words = place("group {g} of fingerprint {s}", g=group, s=shape)
        yield Measure.of_truth([right], words, f"{row['collection']}/{row['name']}")


def _names(table: pa.Table) -> dict[int, str]:
    """Return the name of each model id of a table."""
    columns: Iterable[list[str]] = (table.column(c).to_pylist() for c in ("collection", "name"))
    pairs = zip(*columns, strict=True)
    ids = table.column("model_id").to_pylist()
    return {i: f"{c}/{n}" for i, (c, n) in zip(ids, pairs, strict=True)}
