"""What lakes hold, for comparing those of different runs."""

from __future__ import annotations

from pathlib import Path

import polars as pl

import breplake
from breplake.schema.tables import TABLES

MEASURED = {"seconds", "peak_memory"}
"""Columns that tell of the run; those of cpu_* do, too."""


def contents(lake: Path | str) -> dict[str, pl.DataFrame]:
    """Every table that has rows, without what a clock says."""
    found = {}
    opened = breplake.open(lake)
    for name, table in TABLES.items():
        frame = opened.scan(name).collect()
        measured = [c for c in frame.columns if c in MEASURED or c.startswith("cpu_")]
        if not frame.is_empty():
            found[name] = frame.drop(measured).sort(table.key)
    return found


def assert_same(a: dict[str, pl.DataFrame], b: dict[str, pl.DataFrame]) -> None:
    assert a.keys() == b.keys()
    for name in a:
        assert a[name].equals(b[name]), name
