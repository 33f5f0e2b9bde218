"""Batches: stacked, padded to the longest, or joined one after the other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from breplake.errors import UsageError
from breplake.loaders.samples import MeshSample

__all__ = [
    "MeshBatch",
    "Padded",
    "Ragged",
    "collate_meshes",
    "collate_padded",
    "collate_ragged",
]

_ORIGIN = ("model_id", "name", "snapshot")

_SECOND = ("edge_index",)
"""Tensors ``(2, e)``, whose size differs along the second axis; of all others it is the first."""


class Padded(NamedTuple):
    """Samples of different sizes, stacked.

    Parameters
    ----------
    samples : named tuple
        Of the samples' kind; each tensor is ``(b, longest, ...)``, `edge_index` is
        ``(b, 2, longest)``. What is padded is 0 in floats, -1 in int64 and 0 in uint8 and bool.
        `model_id` and `snapshot` are ``(b,)``, `name` is a tuple.
    lengths : dict
        Name of each tensor -> ``(b,)`` int64, rows (of `edge_index` columns) of each sample
        before padding.
    """

    samples: Any
    lengths: dict[str, Tensor]

    def mask(self, name: str = "positions") -> Tensor:
        """Return ``(b, longest)`` bool: True for rows that are no padding."""
        longest = getattr(self.samples, name).shape[1 + _axis(name)]
        return torch.arange(longest) < self.lengths[name][:, None]


class Ragged(NamedTuple):
    """Samples of different sizes, one after the other.

    Parameters
    ----------
    samples : named tuple
        Of the samples' kind; each tensor is joined along its first axis, `edge_index` along its
        second. `model_id` and `snapshot` are ``(b,)``, `name` is a tuple.
    offsets : dict
        Name of each tensor -> ``(b + 1,)`` int64: sample `i` is rows ``offsets[i]`` to
        ``offsets[i + 1]``, of `edge_index` the columns.
    """

    samples: Any
    offsets: dict[str, Tensor]


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


def collate_padded(samples: Sequence[Any]) -> Padded:
    """Stack samples of different sizes, padded to the longest.

    Raises
    ------
    UsageError
        If there are no samples.
    """
    fields = _fields(samples)
    lengths = {k: torch.tensor(_lengths(values, _axis(k))) for k, values in fields.items()}
    stacked = {name: _padded(values, _axis(name)) for name, values in fields.items()}
    return Padded(samples[0]._replace(**stacked, **_origins(samples)), lengths)


def collate_ragged(samples: Sequence[Any]) -> Ragged:
    """Join samples of different sizes.

    Numbers of rows stay local to their sample; `collate_meshes` shifts those of meshes.

    Raises
    ------
    UsageError
        If there are no samples.
    """
    fields = _fields(samples)
    offsets = {k: _offsets(_lengths(values, _axis(k))) for k, values in fields.items()}
    joined = {name: torch.cat(values, dim=_axis(name)) for name, values in fields.items()}
    return Ragged(samples[0]._replace(**joined, **_origins(samples)), offsets)


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


def _fields(samples: Sequence[Any]) -> dict[str, list[Tensor]]:
    """Return the tensors of all samples by name."""
    if not samples:
        raise UsageError("a batch has at least one sample")
    names = [name for name, value in samples[0]._asdict().items() if isinstance(value, Tensor)]
    return {name: [getattr(sample, name) for sample in samples] for name in names}


def _origins(samples: Sequence[Any]) -> dict[str, Any]:
    ids, names, snapshots = ([getattr(s, name) for s in samples] for name in _ORIGIN)
    return {
        "model_id": torch.tensor(ids),
        "name": tuple(names),
        "snapshot": torch.tensor(snapshots),
    }


def _axis(name: str) -> int:
    """Return the axis along which samples differ in size."""
    return int(name in _SECOND)


def _lengths(values: list[Tensor], axis: int) -> list[int]:
    return [value.shape[axis] for value in values]


def _padded(values: list[Tensor], axis: int) -> Tensor:
    first = values[0]
    shape = list(first.shape)
    shape[axis] = max(_lengths(values, axis))
    # no number of a row, so that padding which is used by mistake shows
    fill = -1 if first.dtype == torch.int64 else 0
    stacked = torch.full((len(values), *shape), fill, dtype=first.dtype)
    for row, value in zip(stacked, values, strict=True):
        row.narrow(axis, 0, value.shape[axis]).copy_(value)
    return stacked
