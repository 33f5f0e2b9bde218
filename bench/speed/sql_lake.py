"""A lake of any size with the distributions of a given one, for `breplake.bench.speed.sql`.

Models of the source are drawn with repetition, weighted such that they have the wanted mean number
of patches, and scaled by random factors, so that no two have equal numbers. It is a real lake in
the layout that ingest writes: shards of the same number of models, the same row groups, all columns
of ``models`` and ``patches``. Left out are only lists in ``patches`` that SQL hardly touches
(poles, knots, weights), and the other tables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from breplake.errors import UsageError
from breplake.ingest.shard import SHARD_MODELS
from breplake.queries.session import Lake
from breplake.schema.contract import Table
from breplake.schema.lake import LakeStore
from breplake.schema.shard_writer import write_table
from breplake.schema.tables import MODELS, PATCHES, SCHEMA_VERSION

__all__ = ["Source", "make_lake"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

_LEFT_OUT: Final[dict[str, tuple[str, ...]]] = {
    MODELS.name: (),
    PATCHES.name: ("poles", "u_knots", "v_knots", "weights"),
}
_LENGTHS: Final = {
    MODELS.name: {"bbox_min": 1, "bbox_max": 1, "diagonal": 1, "area": 2, "volume": 3},
    PATCHES.name: {"location": 1, "apex": 1, "radius": 1, "min_radius": 1, "max_radius": 1,
                   "coefficients": 1, "area": 2},
}  # fmt: skip
"""Columns that are scaled, with the power of the factor."""


@dataclass(frozen=True, slots=True)
class Source:
    """Rows to draw from.

    Parameters
    ----------
    models, patches : pyarrow.Table
        Sorted by model, one chunk each.
    first, count : numpy.ndarray
        ``(m,)`` first row in `patches` and number of patches of each model.
    """

    models: pa.Table
    patches: pa.Table
    first: _Ints
    count: _Ints

    @classmethod
    def of(cls, lake: Lake) -> Source:
        """Read the models of a lake that have patches."""
        models = _read(lake, MODELS).filter(pc.field("n_patches") > 0).combine_chunks()
        patches = _read(lake, PATCHES)
        ids = patches.column("model_id").to_numpy()
        _, first, count = np.unique(ids, return_index=True, return_counts=True)
        if len(first) != models.num_rows:
            raise UsageError("some models have no rows in patches: check the source lake")
        return cls(models, patches, first, count)

    def weights(self, mean: float) -> _Floats:
        """Return probabilities ``(m,)`` under which the mean number of patches is `mean`.

        They are ``exp(-t n)``: of all distributions on the models with that mean, the nearest to
        the uniform one (in relative entropy).

        Raises
        ------
        UsageError
            If no model has fewer, or none has more, patches than that.
        """
        n = self.count.astype(np.float64)
        if not n.min() < mean < n.max():
            raise UsageError(f"the source has {n.min():.0f} to {n.max():.0f} patches a model")

        def tilted(t: float) -> _Floats:
            weight = np.exp(-t * (n - n.min() if t > 0 else n - n.max()))
            return np.asarray(weight / weight.sum())

        low, high = -1.0, 1.0
        for _ in range(200):
            middle = (low + high) / 2
            low, high = (middle, high) if tilted(middle) @ n > mean else (low, middle)
        return tilted(low)


def _read(lake: Lake, table: Table) -> pa.Table:
    """Return the rows of a table by its key, with the types of the contract."""
    kept = [column.name for column in table.columns if column.name not in _LEFT_OUT[table.name]]
    rows = pa.concat_tables(pq.read_table(file, columns=kept) for file in lake.files(table.name))
    return rows.sort_by([(key, "ascending") for key in table.key]).combine_chunks()


def make_lake(
    source: Lake,
    path: Path,
    models: int,
    patches: int,
    *,
    seed: int = 0,
    tell: Callable[[int], object] = lambda _: None,
) -> Lake:
    """Write a lake.

    Parameters
    ----------
    source : Lake
        The lake whose distributions it takes.
    path : pathlib.Path
        Where to write it.
    models, patches : int
        How many models it gets, exactly, and patches, nearly.
    seed : int
        Of all draws.
    tell : callable
        Is called with the number of models written so far.
    """
    rng = np.random.default_rng(seed)
    rows = Source.of(source)
    weights = rows.weights(patches / models)
    store = LakeStore.create(path)
    entries = []
    for start in range(0, models, SHARD_MODELS):
        size = min(SHARD_MODELS, models - start)
        drawn = rng.choice(len(weights), size, p=weights)
        shard = f"synthetic{start // SHARD_MODELS:06d}"
        tables = _draw(rows, drawn, start, shard, rng)
        for table in (MODELS, PATCHES):
            write_table(store, shard, table, [tables[table.name]])
        entries += store.register_shard(shard)
        tell(start + size)
    tools = {"breplake": "benchmark", "schema": str(SCHEMA_VERSION)}
    store.commit(entries, message=f"{models} models", tools=tools, config_hash="benchmark")
    return Lake(path)


def _draw(
    rows: Source, drawn: _Ints, start: int, shard: str, rng: np.random.Generator
) -> dict[str, pa.Table]:
    """Return the tables of one shard: the drawn models under new names and sizes."""
    size = len(drawn)
    ids = np.sort(rng.integers(0, 2**63 - 1, size, dtype=np.int64))
    factor = rng.uniform(0.5, 2.0, size)
    count = rows.count[drawn]
    of_patch = np.repeat(np.arange(size), count)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    patches = rows.patches.take(np.repeat(rows.first[drawn], count) + place)
    models = rows.models.take(drawn)
    names = [f"{name}_{start + i}" for i, name in enumerate(models.column("name").to_pylist())]
    replaced: dict[str, Any] = {
        "model_id": ids, "duplicate_group": ids, "name": pa.array(names),
        "shard": pa.array([shard] * size),
    }  # fmt: skip
    return {
        MODELS.name: _finished(models, MODELS, factor, replaced),
        PATCHES.name: _finished(patches, PATCHES, factor[of_patch], {"model_id": ids[of_patch]}),
    }


def _finished(rows: pa.Table, table: Table, factor: _Floats, replaced: dict[str, Any]) -> pa.Table:
    """Return rows of a table's contract with some columns replaced and the lengths scaled."""
    columns: dict[str, Any] = {}
    for column in table.columns:
        if column.name in replaced:
            columns[column.name] = replaced[column.name]
        elif column.name in rows.column_names:
            values = rows.column(column.name).combine_chunks()
            power = _LENGTHS[table.name].get(column.name)
            columns[column.name] = values if power is None else _scaled(values, factor**power)
    return table.from_columns(columns)


def _scaled(values: pa.Array, factor: _Floats) -> pa.Array:
    """Multiply numbers, vectors or lists of numbers by a factor for each row."""
    if pa.types.is_struct(values.type):
        leaves = [_scaled(values.field(i), factor) for i in range(values.type.num_fields)]
        mask = values.is_null()
        return pa.StructArray.from_arrays(leaves, fields=list(values.type), mask=mask)
    if pa.types.is_list(values.type):
        lengths = np.asarray(pc.fill_null(pc.list_value_length(values), 0))
        scaled = _scaled(values.flatten(), np.repeat(factor, lengths))
        offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
        mask = values.is_null()
        return pa.ListArray.from_arrays(pa.array(offsets), scaled, type=values.type, mask=mask)
    return pc.multiply(values, pa.array(factor))
