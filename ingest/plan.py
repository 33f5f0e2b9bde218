"""What an ingest will do: compare its inputs with what the lake holds."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from breplake.errors import UsageError
from breplake.ingest.failure import CHANGED, KINDS
from breplake.ingest.inputs import Input
from breplake.ingest.settings import Settings
from breplake.schema.lake import LakeStore

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Plan", "Redo", "plan"]


@dataclass(frozen=True, slots=True)
class Redo:
    """Which inputs that the lake has already are ingested again.

    Parameters
    ----------
    changed : bool
        Those whose bytes or settings differ.
    failed : bool
        Those that failed, whether their bytes are the same or not, and those that have no mesh.
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
        All inputs, sorted by collection and name; members of an archive in its order.
    new : list of Input
        Not in the lake.
    unchanged : list of Input
        In the lake already, with the same bytes and settings.
    changed : list of Input
        In the lake with other bytes or settings.
    unread : list of Input
        Models of the lake whose input cannot be read now. They are not ingested again, whatever
        is asked for: a failure would take the place of a model.
    failed : list of Input
        Those of `unchanged` that failed, or that have no mesh.
    todo : list of Input
        To be ingested: the new ones and those to do again.
    redone : frozenset of int
        Model ids of `todo` that the lake has already.
    models : frozenset of int
        Those of `redone` that are models, which stay if their input turns out to be unreadable.
    retried : bool
        Whether failures are tried again, also those that a run did not live to commit.
    settled : frozenset of int
        Ids of failures in the lake that hold no more: of archives that can be read now, and of
        rows of lists that can be used.
    """

    inputs: list[Input]
    new: list[Input]
    unchanged: list[Input]
    changed: list[Input]
    unread: list[Input] = field(default_factory=list)
    failed: list[Input] = field(default_factory=list)
    todo: list[Input] = field(default_factory=list)
    redone: frozenset[int] = frozenset()
    models: frozenset[int] = frozenset()
    retried: bool = False
    settled: frozenset[int] = frozenset()

    @property
    def retry(self) -> frozenset[int]:
        """Model ids of `todo` of which no earlier failure counts."""
        return frozenset(item.model_id for item in self.todo) if self.retried else frozenset()

    @property
    def done(self) -> list[Input]:
        """Those of `unchanged` that are left as they are."""
        return [item for item in self.unchanged if item.model_id not in self.redone]


def plan(
    store: LakeStore,
    inputs: Sequence[Input],
    settings: Settings,
    redo: Redo | None = None,
    whole: Collection[int] = (),
) -> Plan:
    """Compare `inputs` with what the lake's newest snapshot holds.

    Parameters
    ----------
    store : LakeStore
        The lake.
    inputs : sequence of Input
        What was found in the sources.
    settings : Settings
        What is done to each model.
    redo : Redo, optional
        What of the lake's content is ingested again; by default nothing.
    whole : collection of int
        Ids that would stand for archives and rows of lists that are in order, if they were not.
    """
    redo = redo or Redo()
    state = _states(store, inputs, settings.config_hash, redo.kinds)
    retried = redo.failed & (state["has_kind"] | (not redo.kinds))
    is_model = state["is_known"] & ~state["only_failed"]
    readable = (item.failure is None and item.sha256 is not None for item in inputs)
    unread = is_model & ~np.fromiter(readable, bool, len(inputs))
    changed = state["is_known"] & ~unread & ~state["is_same"]
    unchanged = state["is_known"] & ~unread & state["is_same"]
    failed = unchanged & ~state["is_complete"]
    # Of what only failed before there is nothing to lose: a file that was repaired since, or a
    # download that comes now. One that changed in mid-run was promised another try.
    harmless = state["only_failed"] & (retried | state["is_promised"])
    again = (changed & (redo.changed | harmless)) | (failed & retried)

    def chosen(which: npt.NDArray[np.bool_]) -> list[Input]:
        return [inputs[i] for i in np.flatnonzero(which).tolist()]

    return Plan(
        list(inputs),
        new=chosen(~state["is_known"]),
        unchanged=chosen(unchanged),
        changed=chosen(changed),
        unread=chosen(unread),
        failed=chosen(failed),
        todo=chosen(~state["is_known"] | again),
        redone=frozenset(item.model_id for item in chosen(again)),
        models=frozenset(item.model_id for item in chosen(again & is_model)),
        retried=redo.failed,
        settled=_failed_before(store, whole),
    )


def _failed_before(store: LakeStore, ids: Collection[int]) -> frozenset[int]:
    """Return those of `ids` that the newest snapshot has as failures."""
    if not ids:
        return frozenset()
    found = _scan(store, "failures", "kind").select("model_id").unique().collect()
    return frozenset(found["model_id"].to_list()) & frozenset(ids)


def _states(
    store: LakeStore, inputs: Sequence[Input], config_hash: str, kinds: Sequence[str]
) -> dict[str, npt.NDArray[np.bool_]]:
    """Return what the newest snapshot knows of each input, ``(n,)`` each, in their order.

    Whether it has the input, of the same bytes and settings, with a mesh; whether as a failure
    only, with one of `kinds`, or one that was promised another try. By columns: a lake may hold a
    million models.
    """
    import polars as pl

    asked = pl.LazyFrame(
        {
            "model_id": [item.model_id for item in inputs],
            "asked": [item.sha256 for item in inputs],
        },
        schema={"model_id": pl.Int64, "asked": pl.String},
    )
    models = _scan(store, "models", "mesh_kind")
    failures = _scan(store, "failures", "kind").group_by("model_id", maintain_order=True)
    known = models.join(
        failures.agg(
            pl.col("sha256", "config_hash").last(),
            has_kind=pl.col("kind").is_in(list(kinds)).any(),
            is_promised=(pl.col("kind") == CHANGED[1]).any(),
        ),
        on="model_id",
        how="full",
        coalesce=True,
        suffix="_failed",
    )
    only_failed = pl.col("config_hash").is_null()
    sha256 = pl.when(only_failed).then("sha256_failed").otherwise("sha256")
    settings = pl.coalesce("config_hash", "config_hash_failed")
    state = asked.join(known, on="model_id", how="left", maintain_order="left").select(
        is_known=settings.is_not_null(),
        is_same=settings.eq(config_hash).fill_null(False) & sha256.eq_missing(pl.col("asked")),
        is_complete=pl.col("mesh_kind").is_not_null(),
        only_failed=only_failed,
        has_kind=pl.col("has_kind").fill_null(False),
        is_promised=pl.col("is_promised").fill_null(False),
    )
    return {column.name: column.to_numpy() for column in state.collect()}


def _scan(store: LakeStore, table: str, more: str) -> pl.LazyFrame:
    """Return model_id, sha256, config_hash and one more column of a table, to be read."""
    import polars as pl

    columns = ("model_id", "sha256", "config_hash", more)
    head = store.head()
    paths = [store.storage.locate(entry.path) for entry in head.table_files(table)] if head else []
    if not paths:
        schema = {name: pl.Int64 if name == "model_id" else pl.String for name in columns}
        return pl.LazyFrame(schema=schema)
    frame = pl.scan_parquet(
        paths, glob=False, hive_partitioning=False,
        missing_columns="insert", extra_columns="ignore",
    )  # fmt: skip
    return frame.select(columns)
