"""Run single shapes through the worker, in this process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

pytest.importorskip("OCP")

from breplake.ingest.failure import Failure
from breplake.ingest.inputs import find_inputs
from breplake.ingest.settings import Settings
from breplake.ingest.spool import Spool
from breplake.ingest.worker import Task, work


@dataclass
class Record:
    """What the worker left of one model."""

    model: dict
    tables: dict[str, pa.Table]
    failures: list[Failure]

    def column(self, table: str, name: str) -> np.ndarray:
        return self.tables[table].column(name).to_numpy(zero_copy_only=False)

    def vectors(self, table: str, *names: str) -> np.ndarray:
        return np.column_stack([self.column(table, name) for name in names])

    def structs(self, table: str, name: str) -> np.ndarray:
        column = self.tables[table].column(name).combine_chunks()
        leaves = [column.field(axis).to_numpy(zero_copy_only=False) for axis in "xyz"]
        return np.column_stack(leaves)

    @property
    def points(self) -> np.ndarray:
        return self.vectors("vertices", "x", "y", "z")

    @property
    def normals(self) -> np.ndarray:
        return self.vectors("vertices", "nx", "ny", "nz")


@pytest.fixture
def ingest_file(tmp_path_factory):
    def run(path: Path, rung: int = 0, **settings) -> Record:
        folder = tmp_path_factory.mktemp("spool")
        (item,) = find_inputs([path])
        spool = Spool(folder)
        failures = work(Task(item, Settings(**{"max_edge": 0.05, **settings}), spool, rung))
        names = {p.stem for p in folder.rglob("*.arrow")}
        model = spool.read_model() if spool.has_record else {}
        return Record(model, {name: spool.read_table(name) for name in names}, failures)

    return run


@pytest.fixture
def ingest_shape(ingest_file, tmp_path):
    """Ingest an OCCT or cadquery shape through a BREP file, which keeps it exactly."""

    def run(shape, rung: int = 0, **settings) -> Record:
        from OCP.BRepTools import BRepTools

        path = tmp_path / "shape.brep"
        assert BRepTools.Write_s(getattr(shape, "wrapped", shape), str(path))
        return ingest_file(path, rung, **settings)

    return run
