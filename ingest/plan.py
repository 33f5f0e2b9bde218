"""What an ingest will do: compare its inputs with what the lake holds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import pyarrow.parquet as pq

from breplake.errors import UsageError
from breplake.ingest.failure import KINDS
from breplake.ingest.inputs import Input
from breplake.ingest.settings import Settings
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import Snapshot

__all__ = ["Plan", "Redo", "plan"]


@dataclass(frozen=True, slots=True)
class Redo:
    """Which inputs that the lake has already are ingested again.

    Parameters
    ----------
    changed : bool
        Those whose bytes or settings differ.
    failed : bool
        Those that failed, or that have no mesh.
    kinds : tuple of str
        Of the failed, only those with a failure of one of these kinds; empty for all.

    Raises
    ------
    UsageError
        If there is no such kind.
    """

    changed: bool = False
    failed: bool = False
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the kinds."""
        for kind in self.kinds:
            if kind not in KINDS:
                raise UsageError(f"there is no failure {kind!r}: one of {', '.join(KINDS)}")
        if self.kinds and not self.failed:
            raise UsageError("kinds narrow the failures to retry: give --retry-failures too")


@dataclass(frozen=True, slots=True)
class Plan:
    """What an ingest will do.

    Parameters
    ----------
    inputs : list of Input
        All inputs, sorted by collection and name.
    new : list of Input
        Not in the lake.
    unchanged : list of Input
        In the lake already, with the same bytes and settings.
    changed : list of Input
        In the lake with other bytes or settings.
    failed : list of Input
        Those of `unchanged` that failed, or that have no mesh.
    todo : list of Input
        To be ingested: the new ones and those to do again.
    redone : frozenset of int
        Model ids of `todo` that the lake has already.
    """

    inputs: list[Input]
    new: list[Input]
    unchanged: list[Input]
    changed: list[Input]
    failed: list[Input] = field(default_factory=list)
    todo: list[Input] = field(default_factory=list)
    redone: frozenset[int] = frozenset()


class _Known(NamedTuple):
    """What the lake says of one input."""

    sha256: str | None
    config_hash: str
    is_complete: bool
    kinds: tuple[str, ...]


def plan(
    store: LakeStore, inputs: Sequence[Input], settings: Settings, redo: Redo | None = None
) -> Plan:
    """Compare `inputs` with what the lake's newest snapshot holds."""
    redo = redo or Redo()
    known = _known(store.head(), store)
    new: list[Input] = []
    unchanged: list[Input] = []
    changed: list[Input] = []
    failed: list[Input] = []
    again: set[int] = set()
    for item in inputs:
        was = known.get(item.model_id)
        if was is None:
            new.append(item)
        elif (was.sha256, was.config_hash) != (item.sha256, settings.config_hash):
            changed.append(item)
            if redo.changed:
                again.add(item.model_id)
        else:
            unchanged.append(item)
            if not was.is_complete:
                failed.append(item)
                if redo.failed and (not redo.kinds or set(redo.kinds) & set(was.kinds)):
                    again.add(item.model_id)
    fresh = {item.model_id for item in new}
    todo = [item for item in inputs if item.model_id in fresh or item.model_id in again]
    return Plan(list(inputs), new, unchanged, changed, failed, todo, frozenset(again))


def _known(head: Snapshot | None, store: LakeStore) -> dict[int, _Known]:
    """Return what a snapshot holds, by model_id."""
    known: dict[int, _Known] = {}
    if head is None:
        return known
    for row in _rows(store, head, "failures", ["kind"]):
        earlier = known.get(row["model_id"])
        kinds = (*earlier.kinds, row["kind"]) if earlier else (row["kind"],)
        known[row["model_id"]] = _Known(row["sha256"], row["config_hash"], False, kinds)
    for row in _rows(store, head, "models", ["mesh_kind"]):
        earlier = known.get(row["model_id"])
        known[row["model_id"]] = _Known(
            row["sha256"],
            row["config_hash"],
            row["mesh_kind"] is not None,
            earlier.kinds if earlier else (),
        )
    return known


def _rows(
    store: LakeStore, head: Snapshot, table: str, more: list[str]
) -> Iterable[dict[str, Any]]:
    columns = ["model_id", "sha256", "config_hash", *more]
    for entry in head.table_files(table):
        yield from pq.read_table(store.root / entry.path, columns=columns).to_pylist()
