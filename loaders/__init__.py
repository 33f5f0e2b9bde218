"""PyTorch datasets over a lake: deterministic, typed, safe in forked and spawned workers.

A dataset makes samples (`MeshDataset` and those that are made from one), a `Loader` makes
batches of them in an order that nothing but the seed decides. Importing this package does not
need torch; using what is in it does.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from breplake.errors import MissingExtraError

if TYPE_CHECKING:
    from breplake.loaders.collate import (
        MeshBatch,
        Padded,
        Ragged,
        collate_meshes,
        collate_padded,
        collate_ragged,
    )
    from breplake.loaders.graphs import GraphDataset
    from breplake.loaders.grids import GridDataset
    from breplake.loaders.labels import LabelledMeshDataset
    from breplake.loaders.loader import Loader
    from breplake.loaders.local import LocalPatchDataset
    from breplake.loaders.meshes import MeshDataset
    from breplake.loaders.order import Order
    from breplake.loaders.packs import CloudBatch, PackedClouds, write_pack
    from breplake.loaders.points import PointCloudDataset
    from breplake.loaders.samples import (
        GraphSample,
        GridSample,
        LabelledMesh,
        LocalPatch,
        MeshSample,
        PointCloudSample,
    )
    from breplake.loaders.stream import BatchStream
    from breplake.loaders.transforms import Drop, Jitter, Normalise, Rotate

__all__ = [
    "BatchStream",
    "CloudBatch",
    "Drop",
    "GraphDataset",
    "GraphSample",
    "GridDataset",
    "GridSample",
    "Jitter",
    "LabelledMesh",
    "LabelledMeshDataset",
    "Loader",
    "LocalPatch",
    "LocalPatchDataset",
    "MeshBatch",
    "MeshDataset",
    "MeshSample",
    "Normalise",
    "Order",
    "PackedClouds",
    "Padded",
    "PointCloudDataset",
    "PointCloudSample",
    "Ragged",
    "Rotate",
    "collate_meshes",
    "collate_padded",
    "collate_ragged",
    "write_pack",
]

_NAMES = {
    "collate": (
        *("MeshBatch", "Padded", "Ragged"),
        *("collate_meshes", "collate_padded", "collate_ragged"),
    ),
    "graphs": ("GraphDataset",),
    "grids": ("GridDataset",),
    "labels": ("LabelledMeshDataset",),
    "loader": ("Loader",),
    "local": ("LocalPatchDataset",),
    "meshes": ("MeshDataset",),
    "order": ("Order",),
    "packs": ("CloudBatch", "PackedClouds", "write_pack"),
    "points": ("PointCloudDataset",),
    "samples": (
        *("GraphSample", "GridSample", "LabelledMesh"),
        *("LocalPatch", "MeshSample", "PointCloudSample"),
    ),
    "stream": ("BatchStream",),
    "transforms": ("Drop", "Jitter", "Normalise", "Rotate"),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name, and torch with it, when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module 'breplake.loaders' has no attribute {name!r}")
    try:
        import torch  # noqa: F401  # asked for here to name the extra that brings it
    except ImportError as error:
        raise MissingExtraError("torch", f"breplake.loaders.{name}") from error
    return getattr(import_module(f"breplake.loaders.{_HOMES[name]}"), name)
