"""What if training is killed? Go on with the very next batch, in the same order.

Run it as ``python examples/what_if_training_is_killed.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

from breplake.loaders import Loader, MeshDataset, Normalise, Rotate


def loader_of(lake: Path, threads: int) -> Loader:
    clouds = MeshDataset(lake).points(256, seed=1, transforms=[Normalise(), Rotate()])
    return Loader(clouds, batch_size=4, threads=threads)


def main(lake: Path) -> None:
    loader = loader_of(lake, threads=2)
    steps = len(loader)
    seen = []
    for batch in loader:
        seen.append(batch.name)
        if len(seen) == steps // 2:
            state = loader.state_dict()  # what a checkpoint would keep
            break
    print(f"killed after {len(seen)} of {steps} batches, at place {state['cursor']}")

    resumed = loader_of(lake, threads=0)  # as in another process, on another machine
    resumed.load_state_dict(state)
    seen += [batch.name for batch in resumed]

    uninterrupted = [batch.name for batch in loader_of(lake, threads=1)]
    print(f"resumed: {len(seen)} batches, the same as uninterrupted: {seen == uninterrupted}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
