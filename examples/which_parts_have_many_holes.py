"""Which parts have many holes, and of which size? Drilling jobs, one row for each diameter.

Run it as ``python examples/which_parts_have_many_holes.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import breplake

LEAST = 4  # holes of one diameter in a model

JOBS = """
SELECT name, round(2 * radius, 2) AS diameter, count(*) AS holes,
       count(*) FILTER (kind = 'through') AS through, max(depth) AS deepest
FROM holes JOIN models USING (model_id)
GROUP BY ALL HAVING holes >= $least
ORDER BY holes DESC, name, diameter
"""


def main(path: Path) -> None:
    lake = breplake.open(path)
    for name, diameter, holes, through, deepest in lake.sql(JOBS, {"least": LEAST}).fetchall():
        print(
            f"{name}: {holes} holes of {diameter:g} mm, {through} of them through, "
            f"up to {deepest:.1f} mm deep"
        )
    # the library knows how they are arranged
    for row in lake.query("hole_patterns").to_arrow_table().to_pylist():
        size, pattern = f"radius {row['radius']:g} mm", row["pattern"]
        print(f"{row['name']}: {row['holes']} holes of {size}, pattern: {pattern}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
