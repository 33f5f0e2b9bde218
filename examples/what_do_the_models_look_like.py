"""What do the models look like? Draw all of a lake on one contact sheet.

Run it as ``python examples/what_do_the_models_look_like.py demo/lake models.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import breplake
from breplake.queries.picture import draw_sheet

LIMIT = 48  # pictures on the sheet


def main(path: Path, picture: Path = Path("models.png")) -> None:
    lake = breplake.open(path)
    rows = lake.sql(
        """
        SELECT min_by(name, (n_patches, name))  -- the first of each class of complexity
        FROM (
            SELECT name, n_patches, ntile($limit) OVER (ORDER BY n_patches, name) AS class
            FROM models WHERE n_faces > 0
        )
        GROUP BY class ORDER BY class
        """,
        {"limit": LIMIT},
    ).fetchall()
    draw_sheet(lake, [name for (name,) in rows], picture)
    print(f"{len(rows)} models, patches coloured by type: {picture}")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
