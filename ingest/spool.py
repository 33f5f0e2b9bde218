"""A model's record on its way from the worker to the shard.

Files, not pipes: a worker that is killed has handed over all it finished, and the parent's
memory stays flat.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.feather

from breplake.ingest.geometry import Row

__all__ = ["Spool"]


@dataclass(frozen=True, slots=True)
class Spool:
    """A folder for one model.

    Parameters
    ----------
    folder : Path
        Existing folder that no other model uses.
    """

    folder: Path

    def mark(self, stage: str) -> None:
        """Note the stage that begins, so that a kill is attributed to it."""
        (self.folder / "stage").write_text(stage)

    @property
    def stage(self) -> tuple[str, str]:
        """The last stage begun and its detail; ("read", "") before the first."""
        path = self.folder / "stage"
        stage, _, detail = (path.read_text() if path.exists() else "read:").partition(":")
        return stage, detail

    @property
    def has_record(self) -> bool:
        """Whether at least the exact B-Rep rows are complete."""
        return (self.folder / "model.json").exists()

    def write_tables(self, tables: Mapping[str, pa.Table]) -> None:
        """Write tables under their names, each appearing whole or not at all."""
        for name, table in tables.items():
            target = self.folder / f"{name}.arrow"
            partial = target.with_suffix(".partial")
            pa.feather.write_feather(table, partial, compression="lz4")
            os.replace(partial, target)

    def write_model(self, row: Row) -> None:
        """Write the row of ``models``, which makes the record complete."""
        partial = self.folder / "model.partial"
        partial.write_text(json.dumps(row))
        os.replace(partial, self.folder / "model.json")

    def read_model(self) -> dict[str, Any]:
        """Read the row of ``models``."""
        row: dict[str, Any] = json.loads((self.folder / "model.json").read_text())
        return row

    def read_table(self, name: str) -> pa.Table | None:
        """Read a table, or None if the model has none of it."""
        path = self.folder / f"{name}.arrow"
        return pa.feather.read_table(path, memory_map=False) if path.exists() else None
