"""Write the records of some hundred models as one shard: Parquet files and a Zarr group."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa

from breplake.ingest.failure import KILLED
from breplake.ingest.geometry import Row
from breplake.ingest.pool import Result
from breplake.ingest.printable import printable
from breplake.schema.arrays import GRID_ARRAYS, ArrayShardWriter
from breplake.schema.lake import LakeStore
from breplake.schema.shard_writer import fresh_name, write_table
from breplake.schema.snapshot import FileEntry
from breplake.schema.tables import FACES, FAILURES, MODELS, TABLES, VERTICES

__all__ = ["SHARD_MODELS", "shard_name", "write_shard"]

SHARD_MODELS: Final = 256
"""Inputs in a shard."""

_STREAMED: Final = (VERTICES, FACES)
"""Tables too large to gather in memory before they are written."""


def shard_name(results: Sequence[Result], config_hash: str) -> str:
    """Name a shard by its content: the same inputs and settings give the same name."""
    digest = hashlib.sha256(config_hash.encode())
    for result in results:
        digest.update(f"{result.input.model_id} {result.input.sha256}\n".encode())
    return digest.hexdigest()[:16]


def write_shard(store: LakeStore, results: Sequence[Result], config_hash: str) -> list[FileEntry]:
    """Write all tables and arrays of `results`, register and send them, ready for a commit.

    Rows are sorted by model_id, then id. Files that an interrupted run left under the same
    name belong to no snapshot and are replaced, if they are in a local folder.

    Parameters
    ----------
    store : LakeStore
        The lake.
    results : sequence of Result
        Finished models and failures.
    config_hash : str
        Of the settings.
    """
    taken: set[str] = set()
    while True:
        name = fresh_name(store, shard_name(results, config_hash), taken)
        files = _write_shard(store, results, config_hash, name)
        if store.send(files):
            return files
        taken.add(name)
        store.clear_desk()


def _write_shard(
    store: LakeStore, results: Sequence[Result], config_hash: str, name: str
) -> list[FileEntry]:
    ordered = sorted(results, key=lambda result: result.input.model_id)
    recorded = [result for result in ordered if result.recorded]
    rows = [_finished(result, name) for result in recorded]
    meshed = [bool(row.get("mesh_kind")) for row in rows]
    grids = [result.spool.read_grids() for result in recorded]
    if any(meshed) or any(grids):
        size = next((grid[GRID_ARRAYS[0]].shape[1] for grid in grids if grid), 0)
        with ArrayShardWriter(store.array_path(name), size) as arrays:
            for result, row, has_mesh, grid in zip(recorded, rows, meshed, grids, strict=True):
                blocks = (_mesh_arrays(result) if has_mesh else {}) | (grid or {})
                if blocks:
                    row |= arrays.append(blocks).columns()
    failures = [row for result in ordered for row in _failure_rows(result, config_hash)]
    if rows:
        write_table(store, name, MODELS, [MODELS.from_rows(rows)])
    if failures:
        write_table(store, name, FAILURES, [FAILURES.from_rows(failures)])
    for table in TABLES.values():
        if table not in (MODELS, FAILURES):
            parts = (result.spool.read_table(table.name) for result in recorded)
            write_table(store, name, table, (part for part in parts if part is not None))
    return store.register_shard(name)


def _finished(result: Result, shard: str) -> Row:
    """Return the model's row, completed by what only the parent knows."""
    row = result.spool.read_model()
    row["metadata"] = [tuple(fact) for fact in row["metadata"]]  # JSON made lists of pairs
    # A killed worker's CPU time is lost with it; it was busy, so its wall time stands in.
    lost = sum(f.seconds for f in result.failures if f.kind in KILLED)
    return row | {"shard": shard, "cpu_total": row["cpu_total"] + lost}


def _failure_rows(result: Result, config_hash: str) -> list[Row]:
    item = result.input
    # the bytes of files that changed meanwhile are not known
    size, sha256 = (None, None) if result.is_changed else (item.bytes, item.sha256)
    return [
        {
            "model_id": item.model_id,
            "collection": item.collection,
            "name": item.name,
            "path": item.shown,
            "bytes": size,
            "sha256": sha256,
            "stage": failure.stage,
            "kind": failure.kind,
            "message": printable(failure.message),
            "signal": failure.signal,
            "seconds": failure.seconds,
            "peak_memory": failure.peak_memory,
            "config_hash": config_hash,
            "fatal": failure.fatal,
            "attempt": attempt,
        }
        for attempt, failure in enumerate(result.failures)
    ]


def _mesh_arrays(result: Result) -> dict[str, Any]:
    """Return a model's mesh as arrays."""
    vertices, faces = (result.spool.read_table(table.name) for table in _STREAMED)
    curves = result.spool.read_table("curves")
    if vertices is None or faces is None or curves is None:
        raise FileNotFoundError(f"the record of {result.input.name} lost its mesh tables")

    def column(table: pa.Table, name: str) -> Any:
        # A null becomes NaN in float columns; the others have none.
        return table.column(name).to_numpy()

    def columns(table: pa.Table, *names: str) -> Any:
        return np.column_stack([column(table, name) for name in names])

    primary = column(vertices, "is_primary").astype(bool)
    by_vertex = np.argsort(column(vertices, "vertex_id")[primary])
    position = columns(vertices, "x", "y", "z")[primary][by_vertex]  # (n, 3) mm
    feature = _feature(vertices, curves)[primary][by_vertex]
    return {
        "position": position.astype(np.float32),
        "feature": feature,
        "normal": columns(vertices, "nx", "ny", "nz").astype(np.float32),
        "curvature": columns(vertices, "k_min", "k_max").astype(np.float32),
        "patch": column(vertices, "patch_id"),
        "triangle": columns(faces, "v0", "v1", "v2"),
        "triangle_normal": columns(faces, "n0", "n1", "n2"),
        "triangle_patch": column(faces, "patch_id"),
    }


def _feature(vertices: pa.Table, curves: pa.Table) -> Any:
    """Return ``(m,)`` uint8, the index in ``schema.types.FEATURES`` of each row."""
    sharp = curves.column("sharp").to_numpy(zero_copy_only=False)
    curve = vertices.column("curve_id").fill_null(-1).to_numpy()
    corner = vertices.column("corner_id").is_valid().to_numpy()
    feature = np.zeros(len(curve), dtype=np.uint8)
    on_curve = curve >= 0
    feature[on_curve] = np.where(sharp[curve[on_curve]], 2, 1)
    feature[corner] = 3
    return feature
