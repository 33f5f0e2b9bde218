"""Which parts are copies of others? Groups of one shape, whatever the file or unit.

Run it as ``python examples/which_parts_are_copies.py demo/lake``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import breplake
from breplake.queries.duplicates import find_duplicates


def main(path: Path) -> None:
    found = find_duplicates(breplake.open(path))
    print(f"{found.n_copies} of {found.n_models} models are copies of others")
    for group in found.groups:
        names = ", ".join(name for _, name in group.models)
        related = [f"{len(group.mirrors)} mirrored", f"{len(group.scaled)} scaled"]
        print(f"{group.explanation}: {names} (groups: {', '.join(related)})")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
