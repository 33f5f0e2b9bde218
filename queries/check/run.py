"""Check a lake: every rule, model by model, in flat memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow.parquet as pq

from breplake.queries.check import (
    areas,
    coedges,
    counts,
    curves,
    ids,
    parameters,
    parts,
    points,
    shapes,
    topology,
    triangles,
)
from breplake.queries.check import arrays as _arrays
from breplake.queries.check.files import LakeView
from breplake.queries.check.report import Report
from breplake.queries.check.rules import LAKE_RULES, MODEL_RULES, Tally
from breplake.queries.check.stream import ModelStream
from breplake.queries.check.view import ModelView
from breplake.schema.array_reader import ArrayShardReader
from breplake.schema.older import conform
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry
from breplake.schema.tables import MODELS, TABLES

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["ORDERED_RULES", "Progress", "check_lake", "check_model"]

Progress = Callable[[int, int, str], None]
"""Called with models done, models in all, and the name of the last one."""

RULE_MODULES = (
    *(ids, counts, parts, topology, shapes, parameters, curves, coedges),
    *(areas, points, triangles, _arrays),
)
"""The modules whose rules are registered by importing them."""

_ORDER = {module.__name__: place for place, module in enumerate(RULE_MODULES)}
ORDERED_RULES = dict(
    sorted(MODEL_RULES.items(), key=lambda item: _ORDER[item[1].measure.__module__])
)
"""The model rules, each after those it needs."""

_PER_MODEL = tuple(name for name in TABLES if name not in ("models", "failures"))


def check_lake(
    lake: Lake, *, models: Sequence[int] | None = None, progress: Progress | None = None
) -> Report:
    """Prove a lake from its own tables, without a CAD kernel.

    Parameters
    ----------
    lake : Lake
        An open lake; its snapshot is what is checked.
    models : sequence of int, optional
        Ids of the models to check, with the files of their shards. Default: all.
    progress : callable, optional
        See `Progress`.

    Returns
    -------
    Report
        One result for each rule. It is returned, not raised: see `Report.ok`.
    """
    begin = time.perf_counter()
    root, only = Path(lake.root), None if models is None else frozenset(models)
    view = LakeView(root, lake.snapshot, _entries(lake.snapshot.files, only))
    tallies = {name: Tally(rule) for name, rule in {**LAKE_RULES, **ORDERED_RULES}.items()}
    for name, lake_rule in LAKE_RULES.items():
        for measure in lake_rule.measure(view):
            tallies[name].add(measure, "lake")
    rows = sum(scan.rows for scan in view.scans.values())
    total = sum(
        len(view.scans[e.path].ids) if only is None else len(only & set(view.scans[e.path].ids))
        for e in view.readable
        if e.table == "models"
    )
    done = 0
    for model in _models(view, only):
        if model is None:  # of a shard that cannot be read
            for name in ORDERED_RULES:
                tallies[name].skipped += 1
        else:
            check_model(model, tallies)
        done += 1
        if progress is not None:
            progress(done, total, "" if model is None else model.name)
    return Report(
        lake=str(root),
        snapshot=lake.snapshot.number,
        models=done,
        rows=rows,
        seconds=time.perf_counter() - begin,
        rules=tuple(tally.result() for tally in tallies.values()),
    )


def check_model(view: ModelView, tallies: dict[str, Tally]) -> None:
    """Measure every model rule on one model, leaving out what a broken rule makes senseless."""
    broken: set[str] = set()
    faulty = not view.row["is_valid"] or bool(view.row["n_added_pcurves"])
    for name, rule in ORDERED_RULES.items():
        tally = tallies[name]
        if broken.intersection(rule.needs):
            tally.skipped += 1
            broken.add(name)
            continue
        for measure in rule.measure(view):
            if not tally.add(measure, view.name, faulty=faulty):
                broken.add(name)


def _entries(files: Sequence[FileEntry], only: Collection[int] | None) -> tuple[FileEntry, ...]:
    """Return the files to check: all, or those of the shards that may hold the models."""
    if only is None:
        return tuple(files)
    shards = {
        e.shard
        for e in files
        if e.table == "models"
        and e.min_model_id is not None
        and e.max_model_id is not None
        and any(e.min_model_id <= i <= e.max_model_id for i in only)
    }
    return tuple(e for e in files if e.shard in shards)


def _models(view: LakeView, only: Collection[int] | None) -> Iterator[ModelView | None]:
    """Yield the models shard by shard; None for each that cannot be read."""
    for entry in view.readable:
        if entry.table != "models":
            continue
        models = conform(pq.read_table(view.path(entry)), MODELS.schema)
        rows = models.sort_by("model_id").to_pylist()
        chosen = [r for r in rows if only is None or r["model_id"] in only]
        if entry.shard in view.broken_shards:
            yield from [None] * len(chosen)
        else:
            yield from _shard(view, entry.shard, chosen, only)


def _shard(
    view: LakeView, shard: str, rows: list[dict[str, Any]], only: Collection[int] | None
) -> Iterator[ModelView]:
    """Yield the models of one shard, reading each file once from front to back."""
    streams: dict[str, ModelStream] = {}
    reader: ArrayShardReader | None = None
    for entry in view.entries:
        if entry.shard == shard and entry.table in _PER_MODEL:
            by_model = view.scans[entry.path].by_model
            streams[entry.table] = ModelStream(view.path(entry), by_model=by_model, only=only)
        elif entry.shard == shard and entry.table == ARRAYS_TABLE:
            reader = ArrayShardReader(view.path(entry))
    for row in rows:
        found = {name: stream.take(row["model_id"]) for name, stream in streams.items()}
        tables = {
            name: conform(table, TABLES[name].schema)
            for name, table in found.items()
            if table is not None
        }
        slices = None if reader is None else _arrays.model_arrays(reader, row)
        yield ModelView(row, tables, slices)
