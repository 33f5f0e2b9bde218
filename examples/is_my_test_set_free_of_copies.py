"""Is my test set free of copies of training parts? Compare a naive split with one by group.

``breplake subset create NAME --where ... --split train=0.8,test=0.2`` splits by group and freezes
the result; this only counts, and writes nothing. Run it as
``python examples/is_my_test_set_free_of_copies.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt

import breplake
from breplake.queries.subsets import split_codes

SHARES = {"train": 0.8, "test": 0.2}
SEEDS = 100


def leaks(groups: npt.NDArray[np.int64], codes: npt.NDArray[np.int16]) -> int:
    """Return how many models of the last split have a copy in another."""
    last = len(SHARES) - 1
    return int(np.isin(groups[codes == last], groups[codes != last]).sum())


def main(path: Path) -> None:
    lake = breplake.open(path)
    rows = lake.sql("SELECT model_id, duplicate_group FROM models ORDER BY model_id").fetchall()
    ids, groups = np.array(rows, np.int64).T  # (models,) each
    by_model = [leaks(groups, split_codes(ids, SHARES, seed)) for seed in range(SEEDS)]
    by_group = [leaks(groups, split_codes(groups, SHARES, seed)) for seed in range(SEEDS)]
    print(f"{len(ids)} models in {len(np.unique(groups))} groups, {SEEDS} splits of each kind")
    print(f"split by model: {np.mean(by_model):.2f} models of a test set have a copy in training")
    print(f"split by group: {np.mean(by_group):.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
