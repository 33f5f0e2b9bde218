"""What the datasets return: named tuples of tensors, and ragged batches of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from breplake.errors import UsageError

__all__ = ["MeshBatch", "MeshSample", "PointCloudSample", "collate_meshes"]


class MeshSample(NamedTuple):
    """The mesh of one model, with exact differential properties.

    A mesh vertex on a crease has a normal for each of its patches, so there are more normals
    than positions; `triangles` and `triangle_normals` tie them together.

    Parameters
    ----------
    positions : Tensor
        ``(n, 3)`` float32, mm.
    normals : Tensor
        ``(m, 3)`` float32, outward unit normals; NaN where undefined.
    curvatures : Tensor
        ``(m, 2)`` float32, k_min and k_max in 1/mm, positive towards the normal; NaN where
        undefined.
    normal_patch : Tensor
        ``(m,)`` int64, patch of each normal.
    triangles : Tensor
        ``(f, 3)`` int64, rows of `positions`, counter-clockwise seen from outside.
    triangle_normals : Tensor
        ``(f, 3)`` int64, rows of `normals`.
    triangle_patch : Tensor
        ``(f,)`` int64, patch of each triangle.
    features : Tensor
        ``(n,)`` uint8: 0 interior, 1 on a smooth curve, 2 on a sharp curve, 3 corner.
    model_id : int
        Id of the model.
    name : str
        Its name.
    snapshot : int
        Number of the lake's snapshot.
    """

    positions: Tensor
    normals: Tensor
    curvatures: Tensor
    normal_patch: Tensor
    triangles: Tensor
    triangle_normals: Tensor
    triangle_patch: Tensor
    features: Tensor
    model_id: int
    name: str
    snapshot: int


class PointCloudSample(NamedTuple):
    """Points of one model; PyTorch's default collation stacks them.

    Parameters
    ----------
    positions : Tensor
        ``(n, 3)`` float32, mm.
    normals : Tensor
        ``(n, 3)`` float32, outward unit normals on the point's patch.
    curvatures : Tensor
        ``(n, 2)`` float32, k_min and k_max in 1/mm; NaN where undefined.
    patches : Tensor
        ``(n,)`` int64, patch of each point.
    features : Tensor
        ``(n,)`` uint8, as in `MeshSample`.
    model_id, name, snapshot
        As in `MeshSample`.
    """

    positions: Tensor
    normals: Tensor
    curvatures: Tensor
    patches: Tensor
    features: Tensor
    model_id: int
    name: str
    snapshot: int


class MeshBatch(NamedTuple):
    """Several meshes joined to one; sample `i` is rows ``offsets[i]`` to ``offsets[i + 1]``.

    Triangles index the joined arrays. Patch ids stay local to their model.

    Parameters
    ----------
    positions, normals, curvatures, normal_patch, features : Tensor
        As in `MeshSample`, one model after the other.
    triangles, triangle_normals, triangle_patch : Tensor
        As in `MeshSample`, one model after the other.
    vertex_offsets, normal_offsets, face_offsets : Tensor
        ``(b + 1,)`` int64, first rows of each model along the three axes.
    model_ids : Tensor
        ``(b,)`` int64.
    names : tuple of str
        Names of the models.
    snapshot : int
        Number of the lake's snapshot.
    """

    positions: Tensor
    normals: Tensor
    curvatures: Tensor
    normal_patch: Tensor
    triangles: Tensor
    triangle_normals: Tensor
    triangle_patch: Tensor
    features: Tensor
    vertex_offsets: Tensor
    normal_offsets: Tensor
    face_offsets: Tensor
    model_ids: Tensor
    names: tuple[str, ...]
    snapshot: int


def collate_meshes(samples: Sequence[MeshSample]) -> MeshBatch:
    """Join meshes of different sizes: ``DataLoader(dataset, 8, collate_fn=collate_meshes)``.

    Raises
    ------
    UsageError
        If there are no samples, or they are of several snapshots.
    """
    snapshots = {sample.snapshot for sample in samples}
    if len(snapshots) != 1:
        raise UsageError(
            f"a batch is of one snapshot and at least one mesh, got {sorted(snapshots)}"
        )
    vertex = _offsets(len(s.positions) for s in samples)
    normal = _offsets(len(s.normals) for s in samples)
    face = _offsets(len(s.triangles) for s in samples)
    return MeshBatch(
        positions=torch.cat([s.positions for s in samples]),
        normals=torch.cat([s.normals for s in samples]),
        curvatures=torch.cat([s.curvatures for s in samples]),
        normal_patch=torch.cat([s.normal_patch for s in samples]),
        triangles=torch.cat(
            [s.triangles + first for s, first in zip(samples, vertex, strict=False)]
        ),
        triangle_normals=torch.cat(
            [s.triangle_normals + first for s, first in zip(samples, normal, strict=False)]
        ),
        triangle_patch=torch.cat([s.triangle_patch for s in samples]),
        features=torch.cat([s.features for s in samples]),
        vertex_offsets=vertex,
        normal_offsets=normal,
        face_offsets=face,
        model_ids=torch.tensor([s.model_id for s in samples]),
        names=tuple(s.name for s in samples),
        snapshot=snapshots.pop(),
    )


def _offsets(counts: Iterable[int]) -> Tensor:
    """Return running sums from 0."""
    return torch.tensor([0, *counts]).cumsum(0)
