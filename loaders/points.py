"""Point clouds of a fixed size, drawn from the stored meshes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import Dataset

from breplake.errors import UsageError
from breplake.loaders.meshes import MeshDataset
from breplake.loaders.samples import PointCloudSample

__all__ = ["PointCloudDataset", "draw"]


class PointCloudDataset(Dataset[PointCloudSample]):
    """Exactly `n` points of each model, with exact normals, curvatures and patches.

    The points are stored mesh vertices, one for each patch that a vertex lies on, drawn
    evenly: their density follows the mesh and not the area, and a crease has points of both
    its sides.  Points without a normal (the apex of a cone) are left out.  A model with fewer
    than `n` points gives each once and then some again.

    The draw is a function of the seed, the model's id and the epoch alone.

    Parameters
    ----------
    meshes : MeshDataset
        The models.
    n : int
        Points for each model, at least 1.
    seed : int
        At least 0; another seed draws other points.

    Raises
    ------
    UsageError
        If `n` or `seed` is too small.
    """

    def __init__(self, meshes: MeshDataset, n: int, seed: int = 0) -> None:
        if n < 1 or seed < 0:
            raise UsageError(f"n must be at least 1 and seed at least 0, got n={n}, seed={seed}")
        self.meshes = meshes
        self.n = n
        self.seed = seed
        # shared memory, so that workers that live for several epochs see it change
        self._epoch = torch.zeros((), dtype=torch.int64)
        self._epoch.share_memory_()  # type: ignore[no-untyped-call]  # torch does not annotate it

    def set_epoch(self, epoch: int) -> None:
        """Draw other points in another epoch; call it before iterating.

        Raises
        ------
        UsageError
            If `epoch` is negative.
        """
        if epoch < 0:
            raise UsageError(f"an epoch is at least 0, got {epoch}")
        self._epoch.fill_(epoch)

    def __len__(self) -> int:
        return len(self.meshes)

    def __getitem__(self, index: int) -> PointCloudSample:
        """Return the points of a model.

        Raises
        ------
        IndexError
            If there is no sample of that number.
        UsageError
            If no vertex of the model has a normal.
        """
        meshes = self.meshes
        index = meshes.checked(index)
        model_id = int(meshes.model_ids[index])
        normals = meshes.read("normal", index)  # (m, 3)
        vertex = _vertex_of_normal(meshes, index, len(normals))  # (m,)
        usable = torch.nonzero((vertex >= 0) & ~normals.isnan().any(dim=1)).flatten()
        if len(usable) == 0:
            raise UsageError(f"model {meshes.name(index)} has no vertex with a normal")
        drawn = draw(len(usable), self.n, (self.seed, model_id, int(self._epoch)))
        row = usable[torch.from_numpy(drawn)]  # (n,)
        return PointCloudSample(
            positions=meshes.read("position", index)[vertex[row]],
            normals=normals[row],
            curvatures=meshes.read("curvature", index)[row],
            patches=meshes.read("patch", index)[row],
            features=meshes.read("feature", index)[vertex[row]],
            model_id=model_id,
            name=meshes.name(index),
            snapshot=meshes.snapshot,
        )


def draw(count: int, n: int, key: tuple[int, int, int]) -> npt.NDArray[np.int64]:
    """Draw `n` of `count` numbers, without repeats as long as there are enough.

    Parameters
    ----------
    count : int
        Draw from 0 to ``count - 1``; at least 1.
    n : int
        How many.
    key : tuple of int
        Seed, model and epoch: the draw depends on nothing else.

    Returns
    -------
    numpy.ndarray
        ``(n,)`` int64, in random order; every number occurs at least ``n // count`` times.
    """
    generator = np.random.default_rng(key)
    whole, rest = divmod(n, count)
    numbers = np.concatenate(
        [np.tile(np.arange(count), whole), generator.choice(count, rest, replace=False)]
    )
    return generator.permutation(numbers)


def _vertex_of_normal(meshes: MeshDataset, index: int, count: int) -> Tensor:
    """Return ``(m,)`` int64: the mesh vertex of each normal, -1 for one that no triangle uses."""
    vertex = torch.full((count,), -1)
    corner = meshes.read("triangle_normal", index).flatten()  # (3 f,)
    vertex[corner] = meshes.read("triangle", index).flatten()
    return vertex
