"""What does a training loop get? Stream one batch of labelled point clouds into torch.

Run it as ``python examples/what_does_a_training_loop_get.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

from torch import Tensor
from torch.utils.data import DataLoader

from breplake.loaders import MeshDataset


def main(lake: Path) -> None:
    clouds = MeshDataset(lake, where="is_closed").points(2048)
    loader = DataLoader(clouds, batch_size=8, num_workers=2)
    batch = next(iter(loader))
    print(f"{len(clouds)} closed models are {len(loader)} batches; the first one holds")
    for name, value in batch._asdict().items():
        if isinstance(value, Tensor):
            print(f"    {name:<11} {value.dtype!s:<14} {tuple(value.shape)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
