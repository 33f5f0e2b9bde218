"""Which inner fillets are too small for my cutter? Concave ones below its radius, by part.

Run it as ``python examples/which_fillets_are_too_small_for_my_cutter.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import polars as pl

import breplake

CUTTER = 7.0  # mm, radius of a ball-nose cutter


def main(path: Path) -> None:
    lake = breplake.open(path)
    fillets = lake.sql("SELECT name, f.* FROM fillets f JOIN models USING (model_id)").pl()
    inner = fillets.filter(pl.col("is_concave"))
    tight = (
        inner.filter(pl.col("radius") < CUTTER)
        .group_by("name")
        .agg(pl.len().alias("fillets"), pl.col("radius").min().alias("least_radius"))
        .sort("least_radius", "name")
    )
    print(f"{inner.height} of {fillets.height} fillets and rounds are inner ones")
    for name, count, radius in tight.iter_rows():
        print(f"{name}: {count} below {CUTTER:g} mm, the least {radius:g} mm")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
