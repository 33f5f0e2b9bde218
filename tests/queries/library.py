"""The query library as its tests ask it."""

from __future__ import annotations

from breplake.queries.named import named_queries
from breplake.queries.session import Lake

QUERIES = {query.name: query for query in named_queries()}
HISTOGRAMS = ("patches_per_model", "curves_per_model")


def ask(lake: Lake, name: str, **given) -> list[dict]:
    return lake.query(name, **given).to_arrow_table().to_pylist()


def by(rows: list[dict], key: str = "name") -> dict:
    found = {row[key]: row for row in rows}
    assert len(found) == len(rows)
    return found
