"""How long opening, planning and committing take in a lake of a million models.

::

    python -m breplake.bench.speed.metadata [--shards 2000] [--models 500]

The lake is synthetic: every shard has a real file of ``models``, and entries of the other tables
in the snapshot alone, for neither a plan nor a commit reads those.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

import breplake
from breplake.bench.speed.machine import machine
from breplake.schema.identity import model_id
from breplake.schema.lake import LakeStore
from breplake.schema.shard_writer import write_table
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry
from breplake.schema.tables import MODELS, TABLES

__all__ = ["main", "make_lake", "write_models"]

_COLLECTION: Final = "synthetic"


def make_lake(path: Path, shards: int, models: int) -> LakeStore:
    """Make the lake: `shards` shards of `models` models each, in one commit."""
    store = LakeStore.create(path)
    entries: list[FileEntry] = []
    for shard in range(shards):
        entry = write_models(store, shard * models, models)
        others = [table for table in (*TABLES, ARRAYS_TABLE) if table not in ("models", "failures")]
        entries += [entry, *(entry._replace(table=table) for table in others)]
    store.commit(entries, message="synthetic", tools={}, config_hash="c")
    return store


def write_models(store: LakeStore, first: int, count: int) -> FileEntry:
    """Write a shard of models that are numbered from `first` on."""
    shard = hashlib.sha256(f"{first} {count}".encode()).hexdigest()[:16]
    named = sorted((model_id(_COLLECTION, f"m{i}"), f"m{i}") for i in range(first, first + count))
    filled: dict[str, Any] = {
        "model_id": pa.array([identity for identity, _ in named]),
        "collection": pa.array([_COLLECTION] * count),
        "name": pa.array([name for _, name in named]),
        "sha256": pa.array([hashlib.sha256(name.encode()).hexdigest() for _, name in named]),
        "shard": pa.array([shard] * count),
        "mesh_kind": pa.array(["uniform"] * count),
    }
    for column in MODELS.columns:
        if not column.nullable and column.name not in filled:
            filled[column.name] = pa.array([_zero(column.type)] * count, column.type)
    write_table(store, shard, MODELS, [MODELS.from_columns(filled)])
    return store.register(f"tables/models/{shard}.parquet")


def _zero(kind: pa.DataType) -> Any:
    """Return a value of a type: what it is does not matter."""
    if pa.types.is_struct(kind):
        return {field.name: _zero(field.type) for field in kind}
    if pa.types.is_map(kind) or pa.types.is_list(kind):
        return []
    return "x" if pa.types.is_string(kind) else kind.to_pandas_dtype()(1)


def _measured(what: str, step: Callable[[], object]) -> None:
    started = time.perf_counter()
    step()
    print(f"{what:<34}{time.perf_counter() - started:8.2f} s", flush=True)


def _open(path: Path) -> None:
    _measured("open", lambda: breplake.open(path))
    lake = breplake.open(path)
    first, last = (int(lake.snapshot.table_files("models")[i].min_model_id or 0) for i in (0, -1))
    _measured("first model by id", lambda: lake.read("models", first, ["name"]))
    _measured("next model by id", lambda: lake.read("models", last, ["name"]))
    _measured("list snapshots", lambda: list(lake.store.headers()))


def _plan(path: Path) -> None:
    from breplake.ingest.inputs import Input
    from breplake.ingest.plan import plan
    from breplake.ingest.settings import Settings

    count = LakeStore.open(path).snapshot().header.models
    inputs = [Input(Path("x"), _COLLECTION, f"m{i}", "step", 1, "0" * 64) for i in range(count)]
    for some in (inputs[:1000], inputs):
        what = f"plan {len(some):,} inputs"
        _measured(what, lambda some=some: plan(LakeStore.open(path), some, Settings()))  # type: ignore[misc]  # bound at once


def _commit(path: Path) -> None:
    store, start = LakeStore.open(path), time.time_ns()
    for number, what in enumerate(("first commit of a process", "second commit", "third commit")):
        entries = [write_models(store, start + 500 * number, 500)]
        _measured(
            what,
            lambda entries=entries: store.commit(entries, message="m", tools={}, config_hash="c"),  # type: ignore[misc]  # bound at once
        )


STEPS: Final = {"open": _open, "plan": _plan, "commit": _commit}


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the lake and print the time of each step."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--shards", type=int, default=2000)
    parser.add_argument("--models", type=int, default=500, help="in each shard")
    parser.add_argument("--lake", type=Path, help="keep the lake in this folder, or use it again")
    parser.add_argument("--step", choices=STEPS, help="measure only this, in this process")
    chosen = parser.parse_args(arguments)
    if chosen.step:
        STEPS[chosen.step](chosen.lake)
        return
    print(machine("polars", "pyarrow"))
    with tempfile.TemporaryDirectory() as folder:
        path = chosen.lake or Path(folder) / "lake"
        if not path.exists():
            make_lake(path, chosen.shards, chosen.models)
        head = LakeStore.open(path).snapshot()
        document = path / "snapshots" / f"{head.number:08d}.json"
        print(f"{head.header.models:,} models, {len(head.files):,} files, ", end="")
        print(f"snapshot of {document.stat().st_size / 1e6:.1f} MB")
        for step in STEPS:  # each in a process of its own
            module = "breplake.bench.speed.metadata"
            subprocess.run(
                [sys.executable, "-m", module, "--step", step, "--lake", str(path)], check=True
            )


if __name__ == "__main__":
    main()
