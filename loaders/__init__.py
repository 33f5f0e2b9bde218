"""PyTorch datasets over a lake: deterministic, typed, safe in forked and spawned workers.

Importing this package does not need torch; using what is in it does.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from breplake.errors import MissingExtraError

if TYPE_CHECKING:
    from breplake.loaders.meshes import MeshDataset
    from breplake.loaders.points import PointCloudDataset
    from breplake.loaders.samples import (
        MeshBatch,
        MeshSample,
        PointCloudSample,
        collate_meshes,
    )

__all__ = [
    "MeshBatch",
    "MeshDataset",
    "MeshSample",
    "PointCloudDataset",
    "PointCloudSample",
    "collate_meshes",
]

_HOMES = {
    "MeshDataset": "meshes",
    "PointCloudDataset": "points",
    "MeshBatch": "samples",
    "MeshSample": "samples",
    "PointCloudSample": "samples",
    "collate_meshes": "samples",
}


def __getattr__(name: str) -> Any:
    """Load a public name, and torch with it, when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module 'breplake.loaders' has no attribute {name!r}")
    try:
        import torch  # noqa: F401  # asked for here to name the extra that brings it
    except ImportError as error:
        raise MissingExtraError("torch", f"breplake.loaders.{name}") from error
    return getattr(import_module(f"breplake.loaders.{_HOMES[name]}"), name)
