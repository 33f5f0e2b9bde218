"""A model's record on its way from the worker to the shard.

Files, not pipes: a worker that is killed has handed over all it finished, and the parent's
memory stays flat.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.feather

from breplake.ingest.geometry import Row

__all__ = ["HANG_EXIT", "LEVELS", "Spool"]

LEVELS: Final = ("brep", "mesh")
"""Records a model may leave: the exact rows, then those with mesh and ground truth."""

HANG_EXIT: Final = 75
"""Exit code of a worker that ended itself because Gmsh hung."""

_MODEL: Final = "model.json"
_GRIDS: Final = "grids"

_LARGE: Final = 1 << 20
"""Bytes from which on a table is worth compressing for the time until its shard is written."""


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

    def start(self) -> None:
        """Begin an attempt: what an earlier one noted is not this one's."""
        self.mark("read:")
        (self.folder / "notes").unlink(missing_ok=True)
        (self.folder / "begun").unlink(missing_ok=True)
        (self.folder / "hang").unlink(missing_ok=True)

    def begin(self, name: str) -> None:
        """Note the time at which the worker takes up the model called `name`."""
        (self.folder / "begun").write_text(name)

    @property
    def begun(self) -> str | None:
        """Name of the model, once a worker has taken it up."""
        path = self.folder / "begun"
        return path.read_text() if path.exists() else None

    def age(self) -> float:
        """Return the seconds since the worker took up the model; 0 if it never did."""
        path = self.folder / "begun"
        return time.time() - path.stat().st_mtime if path.exists() else 0.0

    def hang(self, reason: str) -> None:
        """Note why the worker is about to end itself with `HANG_EXIT`."""
        (self.folder / "hang").write_text(reason)

    @property
    def hang_reason(self) -> str:
        """What `hang` noted; empty if nothing."""
        path = self.folder / "hang"
        return path.read_text() if path.exists() else ""

    def note(self, failure: Row) -> None:
        """Keep a failure in case the worker does not live to return it."""
        with (self.folder / "notes").open("a") as file:
            file.write(json.dumps(failure) + "\n")

    def take_notes(self) -> list[Row]:
        """Return the failures that were noted."""
        path = self.folder / "notes"
        lines = path.read_text().splitlines() if path.exists() else []
        return [json.loads(line) for line in lines]

    @property
    def stage(self) -> tuple[str, str]:
        """The last stage begun and its detail; ("read", "") before the first."""
        path = self.folder / "stage"
        stage, _, detail = (path.read_text() if path.exists() else "read:").partition(":")
        return stage, detail

    @property
    def has_record(self) -> bool:
        """Whether at least the exact B-Rep rows are complete."""
        return self._record is not None

    @property
    def _record(self) -> Path | None:
        """Folder of the fullest complete record."""
        found = (self.folder / level for level in reversed(LEVELS))
        return next((folder for folder in found if (folder / _MODEL).exists()), None)

    def write(self, level: str, tables: Mapping[str, pa.Table], row: Callable[[], Row]) -> None:
        """Hand over a record; it counts once its row of ``models`` is written, which is last.

        Parameters
        ----------
        level : str
            A member of `LEVELS`. A kill while one is written leaves the one before it.
        tables : mapping
            All tables of the record.
        row : callable
            Gives the row of ``models`` when the tables are written, whose cost it states.
        """
        folder = self.folder / level
        folder.mkdir(exist_ok=True)
        for name, table in tables.items():
            compression = "lz4" if table.nbytes >= _LARGE else "uncompressed"
            pa.feather.write_feather(table, folder / f"{name}.arrow", compression=compression)
        partial = folder / "model.partial"
        partial.write_text(json.dumps(row()))
        os.replace(partial, folder / _MODEL)

    def is_whole(self) -> bool:
        """Return whether all that was handed over can be read, after a power cut say."""
        try:
            if self._record is not None:
                self.read_model()
                for path in self._record.glob("*.arrow"):
                    pa.feather.read_table(path, memory_map=False)
            self.read_grids()
        except (pa.ArrowException, OSError, ValueError):
            return False
        return True

    def read_model(self) -> dict[str, Any]:
        """Read the row of ``models``.

        Raises
        ------
        FileNotFoundError
            If there is no record.
        """
        row: dict[str, Any] = json.loads((self._complete() / _MODEL).read_text())
        return row

    def read_table(self, name: str) -> pa.Table | None:
        """Read a table, or None if the model has none of it.

        Raises
        ------
        FileNotFoundError
            If there is no record.
        """
        path = self._complete() / f"{name}.arrow"
        return pa.feather.read_table(path, memory_map=False) if path.exists() else None

    def write_grids(self, grids: Mapping[str, npt.NDArray[np.float32]]) -> None:
        """Hand over the UV-grids of the model, all of them or none."""
        partial = self.folder / "grids.partial"
        shutil.rmtree(partial, ignore_errors=True)  # what a killed attempt left
        partial.mkdir()
        for name, grid in grids.items():
            np.save(partial / f"{name}.npy", grid)
        shutil.rmtree(self.folder / _GRIDS, ignore_errors=True)
        os.replace(partial, self.folder / _GRIDS)

    def read_grids(self) -> dict[str, npt.NDArray[np.float32]] | None:
        """Map the UV-grids into memory by name; None if the model has none."""
        folder = self.folder / _GRIDS
        if not folder.exists():
            return None
        return {path.stem: np.load(path, mmap_mode="r") for path in sorted(folder.iterdir())}

    def _complete(self) -> Path:
        if self._record is None:
            raise FileNotFoundError(f"{self.folder} holds no record")
        return self._record
