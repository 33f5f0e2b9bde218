"""Point clouds of a fixed size, drawn from the stored meshes or from the exact surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import torch

from breplake.errors import UsageError
from breplake.loaders.dataset import SampleDataset
from breplake.loaders.index import ModelIndex
from breplake.loaders.meshes import MeshDataset
from breplake.loaders.samples import PointCloudSample
from breplake.loaders.transforms import Transform

__all__ = ["PointCloudDataset", "Source", "draw", "vertex_of_normal"]

Source = Literal["vertices", "triangles", "exact"]
"""What points are drawn from."""


class PointCloudDataset(SampleDataset[PointCloudSample]):
    """Exactly `n` points of each model, with normals, curvatures, patches and their types.

    From ``vertices``, points are stored mesh vertices with exact normals, one for each patch that
    a vertex lies on, drawn evenly: their density follows the mesh and not the area, and a crease
    has points of both its sides.  Points without a normal (the apex of a cone) are left out.  A
    model with fewer than `n` points gives each once and then some again.

    From ``triangles``, points are evenly spread over the area of the mesh. Normal and curvatures
    are the exact ones of the corners on the triangle's patch, interpolated linearly and made
    unit; where a corner has none, the triangle's own normal stands in and curvatures are NaN.

    With ``exact``, points are evenly spread over the area of the trimmed surfaces themselves, with
    all quantities evaluated there (`Lake.sample`); patches that cannot be evaluated have none.

    The draw is a function of the seed, the model's id and the epoch alone.

    Parameters
    ----------
    meshes : MeshDataset
        The models; its own transforms are not applied.
    n : int
        Points for each model, at least 1.
    seed : int
        At least 0; another seed draws other points.
    source : str
        ``vertices``, ``triangles`` or ``exact``.
    transforms : sequence of Transform
        Applied to each cloud in turn.
    per_model : int
        Clouds of each model: sample `i` is cloud ``i % per_model`` of model ``i // per_model``.

    Raises
    ------
    UsageError
        If `n` or `seed` is too small, or there is no such source.
    """

    noun = "point clouds"

    def __init__(
        self,
        meshes: MeshDataset,
        n: int,
        seed: int = 0,
        source: Source = "vertices",
        transforms: Sequence[Transform] = (),
        per_model: int = 1,
    ) -> None:
        if n < 1 or seed < 0:
            raise UsageError(f"n must be at least 1 and seed at least 0, got n={n}, seed={seed}")
        if source not in get_args(Source):
            raise UsageError(f"source is {' or '.join(get_args(Source))}, got {source!r}")
        super().__init__(meshes.index, seed, transforms, per_model)
        self.meshes = meshes
        self.n = n
        self.source: Source = source
        self.index.load_types()

    def draw(self, model: int, number: int, epoch: int) -> PointCloudSample:
        """Return the points of the model number `model`.

        Raises
        ------
        UsageError
            If no vertex of the model has a normal, its mesh has no area, or no patch of it can be
            evaluated.
        """
        match self.source:
            case "vertices":
                return self._from_vertices(model, self._key(model, number, epoch))
            case "triangles":
                return self._from_triangles(model, self._key(model, number, epoch))
            case "exact":
                return self._from_surfaces(model, self._key(model, number, epoch))

    def _key(self, model: int, number: int, epoch: int) -> tuple[int, ...]:
        """Return what a draw depends on."""
        key = (self.seed, int(self.model_ids[model]), epoch)
        return (*key, number) if number else key

    def _from_vertices(self, model: int, key: tuple[int, ...]) -> PointCloudSample:
        read = self.index.read
        normals = read("normal", model)  # (m, 3)
        vertex = vertex_of_normal(self.index, model, len(normals))  # (m,)
        usable = np.flatnonzero((vertex >= 0) & ~np.isnan(normals[:, 0]))
        if len(usable) == 0:
            raise UsageError(f"model {self.index.name(model)} has no vertex with a normal")
        row = usable[draw(len(usable), self.n, key)]  # (n,)
        return self._sample(
            model,
            positions=read("position", model)[vertex[row]],
            normals=normals[row],
            curvatures=read("curvature", model)[row],
            patches=read("patch", model)[row],
            features=read("feature", model)[vertex[row]],
        )

    def _from_triangles(self, model: int, key: tuple[int, ...]) -> PointCloudSample:
        read = self.index.read
        triangles = read("triangle", model)  # (f, 3)
        corners = read("position", model)[triangles]  # (f, 3, 3) mm
        twice = _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        ends = np.linalg.norm(twice, axis=1).cumsum(dtype=np.float64)  # (f,) twice the area, mm^2
        if not ends[-1] > 0:
            raise UsageError(f"the mesh of model {self.index.name(model)} has no area")
        generator = np.random.default_rng(key)
        at = generator.random(self.n) * ends[-1]
        face = np.searchsorted(ends, at, side="right").clip(max=len(ends) - 1)  # (n,)
        weight = _barycentric(generator, self.n)[:, :, None]  # (n, 3, 1)
        pair = read("triangle_normal", model)[face]  # (n, 3) rows of normals
        mean = (read("normal", model)[pair] * weight).sum(axis=1)  # (n, 3)
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        exact = length > 1e-6  # False also where a corner's normal is NaN
        flat = twice[face] / np.linalg.norm(twice[face], axis=1, keepdims=True)
        return self._sample(
            model,
            positions=(corners[face] * weight).sum(axis=1),
            normals=np.where(exact, mean / np.where(exact, length, 1), flat),
            curvatures=(read("curvature", model)[pair] * weight).sum(axis=1),
            patches=read("triangle_patch", model)[face],
            features=np.zeros(self.n, np.uint8),  # inside a triangle lies no curve
        )

    def _from_surfaces(self, model: int, key: tuple[int, ...]) -> PointCloudSample:
        seed = int(np.random.default_rng(key).integers(2**63))
        found = self.index.lake.sample(int(self.model_ids[model]), self.n, seed=seed)
        return self._sample(
            model,
            positions=found.position.astype(np.float32),
            normals=found.normal.astype(np.float32),
            curvatures=np.stack([found.k_min, found.k_max], axis=1).astype(np.float32),
            patches=found.patch,
            features=np.zeros(self.n, np.uint8),  # inside a patch lies no curve
        )

    def _sample(
        self, model: int, patches: npt.NDArray[np.int32], **values: npt.NDArray[Any]
    ) -> PointCloudSample:
        return PointCloudSample(
            **{name: torch.from_numpy(value) for name, value in values.items()},
            patches=torch.from_numpy(patches.astype(np.int64)),
            types=torch.from_numpy(self.index.patch_types(model)[patches]),
            model_id=int(self.model_ids[model]),
            name=self.index.name(model),
            snapshot=self.snapshot,
        )


def vertex_of_normal(index: ModelIndex, model: int, count: int) -> npt.NDArray[np.int32]:
    """Return the mesh vertex of each of a model's normals.

    Parameters
    ----------
    index : ModelIndex
        The models.
    model : int
        Number of the model.
    count : int
        How many normals it has.

    Returns
    -------
    numpy.ndarray
        ``(count,)`` int32, -1 for a normal that no triangle uses.
    """
    vertex = np.full(count, -1, np.int32)
    vertex[index.read("triangle_normal", model).ravel()] = index.read("triangle", model).ravel()
    return vertex


def draw(count: int, n: int, key: tuple[int, ...]) -> npt.NDArray[np.int64]:
    """Draw `n` of `count` numbers, without repeats as long as there are enough.

    Parameters
    ----------
    count : int
        Draw from 0 to ``count - 1``; at least 1.
    n : int
        How many.
    key : tuple of int
        Seed, model, epoch and number of the cloud: the draw depends on nothing else.

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


def _cross(a: npt.NDArray[np.float32], b: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return ``(n, 3)`` cross products, several times faster than numpy's."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _barycentric(generator: np.random.Generator, n: int) -> npt.NDArray[np.float32]:
    """Return ``(n, 3)`` float32 weights of points evenly spread over a triangle.

    By the square root of the first number, as in Osada et al., "Shape Distributions", 2002.
    """
    root, second = np.sqrt(generator.random(n)), generator.random(n)
    weights = np.stack([1 - root, root * (1 - second), root * second], axis=1)
    return weights.astype(np.float32)
