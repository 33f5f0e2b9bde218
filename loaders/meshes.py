"""Meshes of a lake, and what else is made of them, as map-style datasets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from breplake.loaders.collate import MeshBatch, collate_meshes
from breplake.loaders.dataset import SampleDataset
from breplake.loaders.index import ModelIndex
from breplake.loaders.samples import MeshSample
from breplake.loaders.transforms import Transform
from breplake.queries.session import Lake
from breplake.schema.subset import Subset

if TYPE_CHECKING:
    from breplake.loaders.local import LocalPatchDataset
    from breplake.loaders.points import PointCloudDataset, Source

__all__ = ["MeshDataset"]


class MeshDataset(SampleDataset[MeshSample]):
    """The models of a lake that have a mesh, in the order of their ids.

    Samples do not depend on the number of workers. The list of models is taken once, from the
    snapshot of `lake` or of the subset; a worker, forked or spawned, opens the arrays when it
    first reads.

    Parameters
    ----------
    lake : Lake, str or pathlib.Path
        A lake at a snapshot, or the folder of one (then its newest snapshot).
    where : str, optional
        SQL condition on columns of ``models``, for instance ``"n_torus > 30"``; it may hold
        subqueries on other tables.
    subset : Subset or str, optional
        Instead of `where`: a subset of the lake, or its name, at the subset's snapshot.
    split : str, optional
        Take one split of the subset.
    transforms : sequence of Transform
        Applied to each sample in turn.
    seed : int
        Seed of the transforms.

    Raises
    ------
    UsageError
        If `where` is no condition on ``models``, or the arguments do not go together.
    NameNotFoundError
        If there is no such subset or split.
    """

    noun = "meshes"

    def __init__(
        self,
        lake: Lake | str | Path,
        where: str | None = None,
        *,
        subset: Subset | str | None = None,
        split: str | None = None,
        transforms: Sequence[Transform] = (),
        seed: int = 0,
    ) -> None:
        super().__init__(ModelIndex(lake, where, subset, split), seed, transforms)

    def draw(self, model: int, number: int, epoch: int) -> MeshSample:
        """Return the mesh of the model number `model`."""
        return MeshSample(
            positions=self.read("position", model),
            normals=self.read("normal", model),
            curvatures=self.read("curvature", model),
            normal_patch=self.read("patch", model),
            triangles=self.read("triangle", model),
            triangle_normals=self.read("triangle_normal", model),
            triangle_patch=self.read("triangle_patch", model),
            features=self.read("feature", model),
            model_id=int(self.model_ids[model]),
            name=self.index.name(model),
            snapshot=self.snapshot,
        )

    def collate(self, samples: Sequence[MeshSample]) -> MeshBatch:
        """Join meshes of different sizes, as `collate_meshes`."""
        return collate_meshes(samples)

    def read(self, array: str, model: int) -> Tensor:
        """Return one array of a model; indices and labels as int64, fit to index with."""
        rows = self.index.read(array, model)
        return torch.from_numpy(rows.astype(np.int64) if rows.dtype.kind == "i" else rows)

    def points(
        self,
        n: int,
        seed: int = 0,
        source: Source = "vertices",
        transforms: Sequence[Transform] = (),
        per_model: int = 1,
    ) -> PointCloudDataset:
        """Return the same models as clouds of exactly `n` points.

        Parameters
        ----------
        n : int
            Points for each model, at least 1.
        seed : int
            Another seed draws other points.
        source : str
            ``vertices``, ``triangles`` or ``exact``: see `PointCloudDataset`.
        transforms : sequence of Transform
            Applied to each cloud in turn.
        per_model : int
            Clouds of each model.
        """
        from breplake.loaders.points import PointCloudDataset

        return PointCloudDataset(self, n, seed, source, transforms, per_model)

    def local_patches(
        self, n: int, per_model: int = 1, seed: int = 0, transforms: Sequence[Transform] = ()
    ) -> LocalPatchDataset:
        """Return pieces of exactly `n` vertices of the models that have as many.

        Parameters
        ----------
        n : int
            Vertices of a piece, at least 3.
        per_model : int
            Pieces of each model.
        seed : int
            Another seed grows other pieces.
        transforms : sequence of Transform
            Applied to each piece in turn.
        """
        from breplake.loaders.local import LocalPatchDataset

        return LocalPatchDataset(self, n, per_model, seed, transforms)
