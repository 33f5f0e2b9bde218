"""Samples as files: NumPy archives, PLY for viewers, Parquet for many models."""

from __future__ import annotations

from types import TracebackType
from typing import IO, Final, Self

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from breplake.queries.sampling import CurveSample, PointSample
from breplake.schema.contract import Column, Table

__all__ = ["POINTS", "ParquetPoints", "point_table", "write_npz", "write_ply"]

_F64, _I32 = pa.float64(), pa.int32()

POINTS: Final = Table(
    "points",
    "a sampled point, on a patch or along a sharp curve",
    (
        Column("model_id", pa.int64(), "the model"),
        Column("patch_id", _I32, "the patch; null on a curve", nullable=True),
        Column("curve_id", _I32, "the curve; null on a patch", nullable=True),
        *(Column(name, _F64, "position", "mm") for name in ("x", "y", "z")),
        *(Column(name, _F64, "outward unit normal", "", True) for name in ("nx", "ny", "nz")),
        *(Column(name, _F64, "unit tangent of the curve", "", True) for name in ("tx", "ty", "tz")),
        *(Column(name, _F64, "principal curvature", "1/mm", True) for name in ("k_min", "k_max")),
        *(Column(name, _F64, "parameter on the patch", "", True) for name in ("u", "v")),
        Column("t", _F64, "parameter on the curve", nullable=True),
    ),
    key=("model_id",),
)
"""Rows of a Parquet file of samples."""


def point_table(sample: PointSample) -> pa.Table:
    """Return a sample as rows of `POINTS`, those on curves last; undefined numbers are null."""
    parts = [
        _rows(sample.model_id, "patch_id", sample.patch, sample.position)
        | _leaves(("nx", "ny", "nz"), sample.normal)
        | {name: _nullable(getattr(sample, name)) for name in ("k_min", "k_max", "u", "v")}
    ]
    along = sample.curves
    if along is not None:
        parts.append(
            _rows(sample.model_id, "curve_id", along.curve, along.position)
            | _leaves(("tx", "ty", "tz"), along.tangent)
            | {"t": pa.array(along.t)}
        )
    return pa.concat_tables([POINTS.from_columns(part) for part in parts])


def _rows(
    model_id: int, key: str, ids: npt.NDArray[np.int32], position: npt.NDArray[np.float64]
) -> dict[str, pa.Array]:
    columns = {"model_id": pa.array(np.full(len(ids), model_id)), key: pa.array(ids)}
    return columns | _leaves(("x", "y", "z"), position)


def _leaves(names: tuple[str, ...], vectors: npt.NDArray[np.float64]) -> dict[str, pa.Array]:
    return {name: _nullable(vectors[:, i]) for i, name in enumerate(names)}


def _nullable(values: npt.NDArray[np.float64]) -> pa.Array:
    return pa.array(np.ascontiguousarray(values), mask=np.isnan(values))


class ParquetPoints:
    """Write samples of many models, one after the other; use it in a ``with``.

    Parameters
    ----------
    file : file-like
        Where to write, opened for bytes.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._writer = pq.ParquetWriter(file, POINTS.schema, compression="zstd")

    def write(self, sample: PointSample) -> None:
        """Add a sample as a row group of its own."""
        self._writer.write_table(point_table(sample))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.close()


def write_npz(file: IO[bytes], sample: PointSample) -> None:
    """Write a sample as a compressed NumPy archive, an array for each field.

    Those of the points along curves are called ``curve_position`` and so on.
    """
    arrays = {name: getattr(sample, name) for name in _POINT_FIELDS}
    if sample.curves is not None:
        arrays |= {name: getattr(sample.curves, field) for name, field in _CURVE_FIELDS.items()}
    np.savez_compressed(file, model_id=np.int64(sample.model_id), **arrays)


_POINT_FIELDS: Final = ("position", "normal", "k_min", "k_max", "patch", "u", "v")
_CURVE_FIELDS: Final = {
    "curve_position": "position",
    "curve_tangent": "tangent",
    "curve": "curve",
    "curve_t": "t",
}


def write_ply(file: IO[bytes], sample: PointSample) -> None:
    """Write a sample as binary PLY.

    Its element ``vertex`` holds the points on patches; points along curves are an element
    ``curve_sample``, which viewers pass over.
    """
    elements = {"vertex": _vertices(sample)}
    if sample.curves is not None:
        elements["curve_sample"] = _along(sample.curves)
    header = ["ply", "format binary_little_endian 1.0", "comment breplake, millimetres"]
    for name, rows in elements.items():
        header.append(f"element {name} {len(rows)}")
        kinds = {key: rows.dtype[key].str for key in rows.dtype.names or ()}
        header += [f"property {_PLY_TYPES[kind]} {key}" for key, kind in kinds.items()]
    file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
    for rows in elements.values():
        file.write(rows.tobytes())


_PLY_TYPES: Final = {"<f8": "double", "<i4": "int"}


def _vertices(sample: PointSample) -> npt.NDArray[np.void]:
    columns = dict(zip(("x", "y", "z"), sample.position.T, strict=True))
    columns |= dict(zip(("nx", "ny", "nz"), sample.normal.T, strict=True))
    columns |= {name: getattr(sample, name) for name in ("k_min", "k_max", "u", "v")}
    return _records(columns | {"patch_id": sample.patch})


def _along(curves: CurveSample) -> npt.NDArray[np.void]:
    columns = dict(zip(("x", "y", "z"), curves.position.T, strict=True))
    columns |= dict(zip(("tx", "ty", "tz"), curves.tangent.T, strict=True))
    return _records(columns | {"t": curves.t, "curve_id": curves.curve})


def _records(columns: dict[str, npt.NDArray[np.generic]]) -> npt.NDArray[np.void]:
    """Return columns side by side, as PLY stores them."""
    kinds = [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()]
    records = np.empty(len(next(iter(columns.values()))), dtype=kinds)
    for name, values in columns.items():
        records[name] = values
    return records
