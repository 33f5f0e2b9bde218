"""UV-grids: regular samples in the parameters of patches and curves, stored by ingest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from breplake.errors import UsageError
from breplake.loaders.collate import Padded, collate_padded
from breplake.loaders.dataset import SampleDataset
from breplake.loaders.graphs import neighbours
from breplake.loaders.meshes import MeshDataset
from breplake.loaders.samples import GridSample

__all__ = ["GridDataset"]


class GridDataset(SampleDataset[GridSample]):
    """UV-grids of all patches and curves of the models, and which patches meet at which curve.

    Parameters
    ----------
    meshes : MeshDataset
        The models.

    Raises
    ------
    UsageError
        If a model was ingested without UV-grids.
    """

    noun = "models with UV-grids"

    def __init__(self, meshes: MeshDataset) -> None:
        super().__init__(meshes.index)
        without = np.flatnonzero(~self.index.stored("patch")).tolist()
        if without:
            raise UsageError(
                f"{len(without)} of {len(self)} models have no UV-grids, "
                f"{self.index.name(without[0])} first: breplake ingest --uv-grid N makes them"
            )
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
