"""B-Reps as graphs: a node for each patch, an edge for each curve between two of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
import torch

from breplake.errors import MissingExtraError, UsageError
from breplake.loaders.collate import collate_padded
from breplake.loaders.dataset import SampleDataset
from breplake.loaders.index import ModelIndex
from breplake.loaders.meshes import MeshDataset
from breplake.loaders.samples import GraphSample
from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES

__all__ = ["EDGE_FEATURES", "NODE_FEATURES", "GraphDataset", "as_data", "neighbours"]

NODE_FEATURES: Final = (
    *(f"is_{name.lower()}" for name in SURFACE_TYPES),
    "area",  # share of the model's area
    "radius",  # least radius in diagonals of the model, 0 where there is none
    "reversed",
    "n_loops",
    "is_rational",
)
"""Columns of `GraphSample.x`."""

_CONVEXITY: Final = ("convex", "concave", "mixed")

EDGE_FEATURES: Final = (
    *(f"is_{name.lower()}" for name in CURVE_TYPES),
    "length",  # in diagonals of the model
    "angle_min",  # between the outward normals, rad
    "angle_max",
    *(f"is_{name}" for name in _CONVEXITY),  # `curves.convexity`; none where it is null
    "sharp",
)
"""Columns of `GraphSample.edge_attr`."""

_PATCH_COLUMNS = ["type", "area", "radius", "min_radius", "reversed", "n_loops"]
_PATCH_COLUMNS += ["u_rational", "v_rational"]
_CURVE_COLUMNS = ["curve_id", "type", "length", "angle_min", "angle_max", "convexity", "sharp"]


class GraphDataset(SampleDataset[Any]):
    """Graphs of the models' patches and the curves between them.

    A nonmanifold curve is an edge between each two of its patches; seams and boundaries are none.

    Parameters
    ----------
    meshes : MeshDataset
        The models.
    form : str
        ``data`` for `torch_geometric.data.Data`, ``sample`` for a plain `GraphSample`, ``auto``
        for the first where torch_geometric is installed.

    Raises
    ------
    UsageError
        If there is no such form.
    MissingExtraError
        If `form` is ``data`` and torch_geometric is not installed.
    """

    noun = "graphs"

    def __init__(
        self, meshes: MeshDataset, form: Literal["auto", "data", "sample"] = "auto"
    ) -> None:
        super().__init__(meshes.index)
        if form not in ("auto", "data", "sample"):
            raise UsageError(f"form is auto, data or sample, got {form!r}")
        there = find_spec("torch_geometric") is not None
        if form == "data" and not there:
            raise MissingExtraError("graphs", "GraphDataset(form='data')")
        self.form = form if form != "auto" else "data" if there else "sample"

    def draw(self, model: int, number: int, epoch: int) -> Any:
        """Return the graph of the model number `model`, as `form` says."""
        made = self.graph(model)
        return as_data(made) if self.form == "data" else made

    def graph(self, model: int) -> GraphSample:
        """Return the graph of the model number `model` as a plain sample."""
        patches = self.index.table("patches", model, _PATCH_COLUMNS)
        curves = self.index.table("curves", model, _CURVE_COLUMNS)
        diagonal, area = self._sizes[model].tolist()
        codes = _codes(patches, "type", SURFACE_TYPES)
        pairs, curve = neighbours(self.index, model)
        at = np.searchsorted(_column(curves, "curve_id"), curve)
        features = _curve_features(curves, diagonal)[at]  # (e, 14)
        return GraphSample(
            x=torch.from_numpy(_patch_features(patches, codes, diagonal, area)),
            edge_index=torch.from_numpy(np.concatenate([pairs, pairs[:, ::-1]]).T.copy()),
            edge_attr=torch.from_numpy(np.tile(features, (2, 1))),
            patch_types=torch.from_numpy(codes.astype(np.uint8)),
            curves=torch.from_numpy(np.tile(curve, 2)),
            model_id=int(self.model_ids[model]),
            name=self.index.name(model),
            snapshot=self.snapshot,
        )

    @cached_property
    def _sizes(self) -> npt.NDArray[np.float64]:
        """``(models, 2)``: diagonal (mm) and area (mm^2) of each model."""
        query = "SELECT model_id, diagonal, area FROM models ORDER BY model_id"
        table = self.index.lake.sql(query).to_arrow_table()
        at = np.searchsorted(table.column("model_id").to_numpy(), self.model_ids)
        return np.stack([table.column(c).to_numpy()[at] for c in ("diagonal", "area")], axis=1)

    def collate(self, samples: Sequence[Any]) -> Any:
        """Join graphs: `torch_geometric.data.Batch`, or `Padded` plain samples."""
        if self.form == "sample":
            return collate_padded(samples)
        return _geometric().Batch.from_data_list(list(samples))


def as_data(sample: GraphSample) -> Any:
    """Return a graph as `torch_geometric.data.Data`; fields of the same names.

    Raises
    ------
    MissingExtraError
        If torch_geometric is not installed.
    """
    return _geometric().Data(**sample._asdict())


def _geometric() -> Any:
    """Return the module `torch_geometric.data`, which is not there for type checkers."""
    try:
        return import_module("torch_geometric.data")
    except ImportError as error:
        raise MissingExtraError("graphs", "a graph as torch_geometric's Data") from error


def neighbours(
    index: ModelIndex, model: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the pairs of patches that meet at a curve, as the view ``adjacency`` has them.

    Returns
    -------
    pairs : numpy.ndarray
        ``(k, 2)`` int64, the smaller patch first.
    curve : numpy.ndarray
        ``(k,)`` int64, ascending.
    """
    uses = index.table("coedges", model, ["curve_id", "patch_id"])
    rows = np.stack([_column(uses, "curve_id"), _column(uses, "patch_id")], axis=1)
    rows = np.unique(rows.astype(np.int64), axis=0)  # (k, 2) sorted by curve, then patch
    found = []
    # patches of one curve follow each other: pair each with its next, its next but one ...
    for step in range(1, len(rows)):
        same = rows[step:, 0] == rows[:-step, 0]
        if not same.any():
            break
        found.append(np.column_stack([rows[:-step][same], rows[step:, 1][same]]))
    if not found:
        return np.empty((0, 2), np.int64), np.empty(0, np.int64)
    joined = np.concatenate(found)  # (k, 3) curve, patch, patch
    joined = joined[np.lexsort(joined.T[::-1])]
    return joined[:, 1:], joined[:, 0]


def _patch_features(
    patches: Any, codes: npt.NDArray[np.int64], diagonal: float, area: float
) -> npt.NDArray[np.float32]:
    radius = _column(patches, "min_radius")
    radius = np.where(np.isnan(radius), _column(patches, "radius"), radius)
    columns = [
        _column(patches, "area") / area if area else np.zeros(len(codes)),
        np.nan_to_num(radius / diagonal),
        _column(patches, "reversed"),
        _column(patches, "n_loops"),
        np.fmax(_column(patches, "u_rational"), _column(patches, "v_rational")) > 0,
    ]
    one_hot = np.eye(len(SURFACE_TYPES))[codes]
    return np.column_stack([one_hot, *columns]).astype(np.float32)


def _curve_features(curves: Any, diagonal: float) -> npt.NDArray[np.float32]:
    kinds = np.eye(len(CURVE_TYPES))[_codes(curves, "type", CURVE_TYPES)]
    convexity = curves.column("convexity").to_numpy()
    columns = [
        np.nan_to_num(_column(curves, "length") / diagonal),
        np.nan_to_num(_column(curves, "angle_min")),
        np.nan_to_num(_column(curves, "angle_max")),
        *(convexity == name for name in _CONVEXITY),
        _column(curves, "sharp"),
    ]
    return np.column_stack([kinds, *columns]).astype(np.float32)


def _codes(table: Any, name: str, order: Sequence[str]) -> npt.NDArray[np.int64]:
    """Return ``(n,)`` places in `order` of a column of names."""
    place = {kind: code for code, kind in enumerate(order)}
    return np.array([place[kind] for kind in table.column(name).to_pylist()], np.int64)


def _column(table: Any, name: str) -> npt.NDArray[Any]:
    """Return a column of numbers or truth; nulls are NaN."""
    values: npt.NDArray[Any] = table.column(name).to_numpy()
    return values.astype(np.float64) if values.dtype == object else values
