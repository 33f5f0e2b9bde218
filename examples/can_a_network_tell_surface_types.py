"""Can a network tell the type of the surface under a point? Train a tiny one for a minute.

It sees a point with its normal and the principal curvatures there, and names the type of the
patch: Plane, Cylinder, Torus ... Run it as
``python examples/can_a_network_tell_surface_types.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from torch import Tensor, nn

import breplake
from breplake.loaders import Loader, MeshDataset, Normalise
from breplake.loaders.samples import PointCloudSample
from breplake.schema.types import SURFACE_TYPES

POINTS, EPOCHS = 256, 4


def features(batch: PointCloudSample) -> Tensor:
    """Return (b, n, 8): position, normal, curvatures on a scale that suits all sizes."""
    curvatures = torch.nan_to_num(batch.curvatures)
    return torch.cat([batch.positions, batch.normals, torch.asinh(curvatures)], dim=2)


def run(model: nn.Module, loader: Loader, optimiser: torch.optim.Optimizer | None) -> float:
    """Return the share of points whose type is right."""
    right, total = 0, 0
    with torch.set_grad_enabled(optimiser is not None):
        for batch in loader:
            scores = model(features(batch)).flatten(0, 1)  # (b n, types)
            types = batch.types.long().flatten()  # (b n,)
            if optimiser is not None:
                optimiser.zero_grad()
                nn.functional.cross_entropy(scores, types).backward()  # type: ignore[no-untyped-call]
                optimiser.step()
            right += int((scores.argmax(dim=1) == types).sum())
            total += len(types)
    return right / total


def main(path: Path) -> None:
    lake = breplake.open(path)
    torch.manual_seed(0)
    # without a subset: every fifth duplicate group is for testing, so no copy is in both
    held_out = "duplicate_group % 5 = 0"
    clouds = {
        name: MeshDataset(lake, where=where).points(POINTS, transforms=[Normalise()], per_model=8)
        for name, where in (("train", f"NOT {held_out}"), ("test", held_out))
    }
    model = nn.Sequential(nn.Linear(8, 64), nn.ReLU(), nn.Linear(64, len(SURFACE_TYPES)))
    optimiser = torch.optim.Adam(model.parameters(), 1e-2)
    train = Loader(clouds["train"], batch_size=8)
    for epoch in range(EPOCHS):
        print(f"epoch {epoch}: {run(model, train, optimiser):.0%} of the training points right")
    if len(clouds["test"]):
        print(f"{run(model, Loader(clouds['test'], batch_size=8), None):.0%} of unseen models")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
