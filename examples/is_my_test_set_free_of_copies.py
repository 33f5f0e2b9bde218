"""Is my test set free of copies of training parts? Compare splits by model, group and form.

Leaks are told by the form of the fingerprint, which no size and no handedness changes: a part, its
copies, its mirror image and both in other sizes have one form. So a split by duplicate group, whose
groups are copies alone, is measured by more than what it was made by; ``breplake subset create NAME
--where ... --split train=0.8,test=0.2 --together form`` makes one that has no such leak either.
This only counts, and writes nothing. Run it as
``python examples/is_my_test_set_free_of_copies.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt

import breplake
from breplake.queries.subsets import form_groups, split_codes

SHARES = {"train": 0.8, "test": 0.2}
SEEDS = 100


def leaks(keys: npt.NDArray[np.int64], codes: npt.NDArray[np.int16]) -> int:
    """Return how many models of the last split share their key with one in another split."""
    last = len(SHARES) - 1
    return int(np.isin(keys[codes == last], keys[codes != last]).sum())


def main(path: Path) -> None:
    lake = breplake.open(path)
    rows = lake.sql("SELECT model_id, duplicate_group, fingerprint FROM models").fetchall()
    ids, groups = np.array([row[:2] for row in rows], np.int64).T  # (models,) each
    forms = form_groups(groups, [row[2] for row in rows])
    print(
        f"{len(ids)} models in {len(np.unique(groups))} groups of {len(np.unique(forms))} forms; "
        f"over {SEEDS} splits, models of a test set whose form is in training:"
    )
    for name, keys in (("model", ids), ("duplicate group", groups), ("form", forms)):
        found = [leaks(forms, split_codes(keys, SHARES, seed)) for seed in range(SEEDS)]
        print(f"split by {name}: {np.mean(found):.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
