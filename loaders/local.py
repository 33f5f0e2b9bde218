"""Local patches: pieces of a mesh of exactly `n` vertices, as in the paper's normal benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch

from breplake.errors import UsageError
from breplake.loaders.collate import Padded, collate_padded
from breplake.loaders.dataset import SampleDataset
from breplake.loaders.index import ModelIndex
from breplake.loaders.meshes import MeshDataset
from breplake.loaders.points import vertex_of_normal
from breplake.loaders.samples import LocalPatch
from breplake.loaders.transforms import Transform

__all__ = ["LocalPatchDataset", "grow"]

_TRIES: Final = 64
"""Start vertices to try: a model may have small parts beside the large ones."""


class LocalPatchDataset(SampleDataset[LocalPatch]):
    """Pieces of exactly `n` vertices, each grown breadth-first around a random vertex.

    Models with fewer vertices are left out. The pieces are a function of seed, epoch, model and
    number alone.

    Parameters
    ----------
    meshes : MeshDataset
        The models; its own transforms are not applied.
    n : int
        Vertices of a piece, at least 3.
    per_model : int
        Pieces of each model: sample `i` is piece ``i % per_model`` of model ``i // per_model``.
    seed : int
        Another seed grows other pieces.
    transforms : sequence of Transform
        Applied to each piece in turn.

    Raises
    ------
    UsageError
        If a number is too small.
    """

    noun = "local patches"

    def __init__(
        self,
        meshes: MeshDataset,
        n: int,
        per_model: int = 1,
        seed: int = 0,
        transforms: Sequence[Transform] = (),
    ) -> None:
        if n < 3:
            raise UsageError(f"a piece of a mesh has at least 3 vertices, got n={n}")
        kept = np.flatnonzero(meshes.index.counts("vertex") >= n)
        super().__init__(meshes.index.part(kept), seed, transforms, per_model)
        self.meshes = meshes
        self.n = n
        self._rows = kept  # (models,) their numbers in `meshes`

    def draw(self, model: int, number: int, epoch: int) -> LocalPatch:
        """Return piece `number` of the model number `model`.

        Raises
        ------
        UsageError
            If no piece of so many vertices is found: the model's parts may all be smaller.
        """
        row = int(self._rows[model])
        triangles = self.meshes.index.read("triangle", row)  # (f, 3)
        generator = self.generator(model, epoch, number)
        for _ in range(_TRIES):
            start = int(triangles.flat[generator.integers(triangles.size)])
            vertices = grow(triangles, start, self.n)
            if vertices is not None:
                return self._piece(row, triangles, vertices)
        raise UsageError(
            f"no piece of {self.n} vertices in {_TRIES} tries: the parts of the model are smaller, "
            "choose a smaller n or leave it out"
        )

    def _piece(
        self, row: int, triangles: npt.NDArray[np.int32], vertices: npt.NDArray[np.int64]
    ) -> LocalPatch:
        index = self.meshes.index
        positions = index.read("position", row)
        local = np.full(len(positions), -1)
        local[vertices] = np.arange(self.n)
        inside = (local[triangles] >= 0).all(axis=1)  # (f,)
        return LocalPatch(
            positions=torch.from_numpy(positions[vertices]),
            normals=torch.from_numpy(_mean_normals(index, row, local, self.n)),
            features=torch.from_numpy(index.read("feature", row)[vertices]),
            triangles=torch.from_numpy(local[triangles[inside]]),
            vertices=torch.from_numpy(vertices),
            model_id=int(index.model_ids[row]),
            name=index.name(row),
            snapshot=self.snapshot,
        )

    def collate(self, samples: Sequence[LocalPatch]) -> Padded:
        """Stack the vertices and pad the triangles, as `collate_padded`."""
        return collate_padded(samples)


def grow(triangles: npt.NDArray[np.int64], start: int, n: int) -> npt.NDArray[np.int64] | None:
    """Grow a piece of a mesh around a vertex, breadth-first, to exactly `n` vertices.

    Triangles are taken in rings around what is there, each appended while its new vertices still
    fit; one that brings too many is passed over.

    Parameters
    ----------
    triangles : numpy.ndarray
        ``(f, 3)`` integers, vertices.
    start : int
        The vertex to begin with; it must be of a triangle.
    n : int
        How many vertices.

    Returns
    -------
    numpy.ndarray or None
        ``(n,)`` int64, distinct vertices in the order in which they were found, `start` first;
        None where the piece cannot be grown to `n`.
    """
    first, incident = _incidence(triangles)
    taken = np.zeros(len(first) - 1, bool)  # (vertices,)
    seen = np.zeros(len(triangles), bool)
    taken[start] = True
    found = [np.array([start], np.int64)]
    count = 1
    front = found[0]
    while count < n and len(front):
        ring = _unique(_ranges(incident, first[front], first[front + 1]))
        ring = ring[~seen[ring]]
        seen[ring] = True
        front = _unique(triangles[ring].ravel().astype(np.int64))
        front = front[~taken[front]]
        if count + len(front) > n:
            front = _fitting(triangles[ring], taken, n - count)
        taken[front] = True
        found.append(front)
        count += len(front)
    return np.concatenate(found) if count == n else None


def _fitting(
    ring: npt.NDArray[np.integer[Any]], taken: npt.NDArray[np.bool_], room: int
) -> npt.NDArray[np.int64]:
    """Return at most `room` new vertices of the triangles that fit, in their order."""
    new: dict[int, None] = {}
    for corners in ring.tolist():
        fresh = [v for v in corners if not taken[v] and v not in new]
        if len(fresh) <= room - len(new):
            new.update(dict.fromkeys(fresh))
        if len(new) == room:
            break
    return np.fromiter(new, np.int64, len(new))


def _incidence(
    triangles: npt.NDArray[np.integer[Any]],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return ``(n + 1,)`` first places and ``(3 f,)`` triangles: those at each vertex."""
    corner = triangles.ravel()
    count = np.bincount(corner)
    first = np.concatenate([[0], np.cumsum(count)])
    return first, np.argsort(corner, kind="stable") // 3


def _ranges(
    values: npt.NDArray[np.int64], begin: npt.NDArray[np.int64], end: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Return ``values[begin[0]:end[0]], values[begin[1]:end[1]], ...`` joined."""
    length = end - begin
    shift = np.repeat(begin - np.concatenate([[0], np.cumsum(length)[:-1]]), length)
    return values[shift + np.arange(int(length.sum()))]


def _unique(values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the distinct values in the order of their first occurrence."""
    _, place = np.unique(values, return_index=True)
    return values[np.sort(place)]


def _mean_normals(
    index: ModelIndex, row: int, local: npt.NDArray[np.int64], n: int
) -> npt.NDArray[np.float32]:
    """Return ``(n, 3)`` float32: the unit mean of each vertex's normals on its patches.

    `local` has the new number of each vertex of the mesh, -1 for those that are left out.
    """
    normals = index.read("normal", row)  # (m, 3)
    vertex = vertex_of_normal(index, row, len(normals))  # (m,)
    place = np.where(vertex >= 0, local[vertex], -1)
    used = np.flatnonzero((place >= 0) & ~np.isnan(normals[:, 0]))
    total = np.stack(
        [np.bincount(place[used], normals[used, axis], n) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    # a shorter sum is rounding, not a direction
    usable = length > 1e-6
    mean = np.where(usable, total / np.where(usable, length, 1), np.nan)
    return mean.astype(np.float32)
