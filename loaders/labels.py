"""Labels for patch segmentation and for finding sharp features."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch

from breplake.loaders.collate import Padded, collate_padded
from breplake.loaders.dataset import SampleDataset
from breplake.loaders.meshes import MeshDataset
from breplake.loaders.samples import LabelledMesh
from breplake.loaders.transforms import Transform

__all__ = ["LabelledMeshDataset"]


class LabelledMeshDataset(SampleDataset[LabelledMesh]):
    """Meshes with the type of every patch, normal and triangle, and their sharp edges.

    Parameters
    ----------
    meshes : MeshDataset
        The models; its own transforms are not applied.
    seed : int
        Seed of the transforms.
    transforms : sequence of Transform
        Applied to each sample in turn.
    """

    noun = "labelled meshes"

    def __init__(
        self, meshes: MeshDataset, seed: int = 0, transforms: Sequence[Transform] = ()
    ) -> None:
        super().__init__(meshes.index, seed, transforms)
        self.meshes = meshes
        self.index.load_types()

    def draw(self, model: int, number: int, epoch: int) -> LabelledMesh:
        """Return the mesh of the model number `model` with its labels."""
        read = self.meshes.read
        positions = read("position", model)
        normal_patch, triangle_patch = read("patch", model), read("triangle_patch", model)
        types = torch.from_numpy(self.index.patch_types(model))  # (p,)
        edges = torch.from_numpy(self._sharp_edges(model))  # (e, 2)
        on_sharp = torch.zeros(len(positions), dtype=torch.bool)
        on_sharp[edges.flatten()] = True
        return LabelledMesh(
            positions=positions,
            normals=read("normal", model),
            triangles=read("triangle", model),
            triangle_normals=read("triangle_normal", model),
            triangle_patch=triangle_patch,
            normal_patch=normal_patch,
            patch_types=types,
            normal_types=types[normal_patch],
            triangle_types=types[triangle_patch],
            sharp_edges=edges,
            sharp_vertices=on_sharp,
            model_id=int(self.model_ids[model]),
            name=self.index.name(model),
            snapshot=self.snapshot,
        )

    def _sharp_edges(self, model: int) -> npt.NDArray[np.int64]:
        """Return ``(e, 2)`` int64: vertices next to each other on sharp curves."""
        curves = self.index.table("curves", model, ["sharp", "vert_indices"])
        lists = curves.filter(curves.column("sharp")).column("vert_indices").combine_chunks()
        lists = lists.drop_null()
        chain = lists.flatten().to_numpy().astype(np.int64)
        length = lists.value_lengths().to_numpy()
        curve = np.repeat(np.arange(len(length)), length)
        same = curve[1:] == curve[:-1]
        return np.stack([chain[:-1][same], chain[1:][same]], axis=1)

    def collate(self, samples: Sequence[LabelledMesh]) -> Padded:
        """Pad everything to the largest, as `collate_padded`."""
        return collate_padded(samples)
