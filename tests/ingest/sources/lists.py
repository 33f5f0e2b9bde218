"""Lists of addresses, and what is to be had at each."""

from __future__ import annotations

import csv
import hashlib

from breplake.ingest.sources.resolve import Sources

STEP = b"ISO-10303-21; not much more"
HASH = hashlib.sha256(STEP).hexdigest()


def write_csv(path, rows):
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
    return path


def fetch(tmp_path, item):
    """What a run gets of an input, by the time its turn comes."""
    target = tmp_path / "target"
    target.mkdir(exist_ok=True)
    with Sources.open() as opened, opened.fetcher([item], tmp_path / "ahead") as fetcher:
        return fetcher.take(item, target).result(60)
