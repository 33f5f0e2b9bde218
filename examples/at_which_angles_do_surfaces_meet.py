"""At which angles do surfaces meet? Length of curves by the two types beside them.

Run it as ``python examples/at_which_angles_do_surfaces_meet.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import polars as pl

import breplake

PAIRS = """
SELECT least(a.type, b.type) || ' - ' || greatest(a.type, b.type) AS pair,
       e.length, degrees(e.angle_max) AS angle
FROM adjacency e
JOIN patches a ON (a.model_id, a.patch_id) = (e.model_id, e.patch_a)
JOIN patches b ON (b.model_id, b.patch_id) = (e.model_id, e.patch_b)
WHERE e.angle_max IS NOT NULL
"""


def main(path: Path) -> None:
    curves = breplake.open(path).sql(PAIRS).pl()
    length = pl.col("length")

    def share(condition: pl.Expr) -> pl.Expr:
        return length.filter(condition).sum() / length.sum()

    angle = pl.col("angle")
    table = (
        curves.group_by("pair")
        .agg(
            length.sum(),
            share(angle < 1).alias("smooth"),
            share((angle - 90).abs() < 1).alias("right"),
        )
        .sort("length", descending=True)
    )
    for pair, total, smooth, right in table.head(8).iter_rows():
        print(f"{pair:<22} {total:>10.0f} mm   smooth {smooth:>4.0%}   right angle {right:>4.0%}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
