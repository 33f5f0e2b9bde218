"""UV-grids: regular samples in the parameters of patches and curves, stored by ingest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch

from breplake.errors import UsageError
from breplake.loaders.collate import Padded, collate_padded
from breplake.loaders.dataset import SampleDataset
from breplake.loaders.graphs import neighbours
from breplake.loaders.meshes import MeshDataset
from breplake.loaders.samples import GridSample
from breplake.schema.arrays import ARRAYS

__all__ = ["GridDataset"]

_ARRAYS: Final = ("patch_grid", "curve_grid")


class GridDataset(SampleDataset[GridSample]):
    """UV-grids of all patches and curves of the models, and which patches meet at which curve.

    Parameters
    ----------
    meshes : MeshDataset
        The models.

    Raises
    ------
    UsageError
        If the lake was ingested without UV-grids.
    """

    noun = "models with UV-grids"

    def __init__(self, meshes: MeshDataset) -> None:
        super().__init__(meshes.index)
        missing = [name for name in _ARRAYS if name not in ARRAYS]
        without = [] if missing else np.flatnonzero(~self.index.stored("patch")).tolist()
        if missing or without:
            whose = f"{len(without)} of {len(self)} models, {self.index.name(without[0])} first," \
                if without else "the lake"  # fmt: skip
            raise UsageError(f"{whose} has no UV-grids: ingest with them, or leave it out")
        self.index.load_types()

    def draw(self, model: int, number: int, epoch: int) -> GridSample:
        """Return the grids of the model number `model`."""
        pairs, curve = neighbours(self.index, model)
        return GridSample(
            patch_grids=torch.from_numpy(self.index.read("patch_grid", model)),
            curve_grids=torch.from_numpy(self.index.read("curve_grid", model)),
            edge_index=torch.from_numpy(np.concatenate([pairs, pairs[:, ::-1]]).T.copy()),
            curves=torch.from_numpy(np.tile(curve, 2)),
            patch_types=torch.from_numpy(self.index.patch_types(model)),
            model_id=int(self.model_ids[model]),
            name=self.index.name(model),
            snapshot=self.snapshot,
        )

    def collate(self, samples: Sequence[GridSample]) -> Padded:
        """Pad to the models with the most patches and curves, as `collate_padded`."""
        return collate_padded(samples)
