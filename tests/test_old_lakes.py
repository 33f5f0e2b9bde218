"""Lakes of every released version stay readable.

``tests/data/lake_vN`` was written by the last breplake of schema version N, and ``lake_vN.json``
says what is in it. Neither is ever changed. When the version of the schema is raised, the old
one has been frozen before, by its own code::

    python tests/test_old_lakes.py tests/data/lake_v1
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import breplake
from breplake.schema.arrays import GRID_ARRAYS, MESH_ARRAYS
from breplake.schema.tables import SCHEMA_VERSION, TABLES

FROZEN = sorted((Path(__file__).parent / "data").glob("lake_v*.json"))
PARTS = (("ball_steel", "base_plate_inch"), ("bottle", "hinge"))
"""Sample parts of two commits: quadrics, planes and torus; B-splines, two solids, colours."""

SAMPLED = {
    "models": "sum(n_patches), sum(n_faces), round(sum(area), 3), round(sum(volume), 3)",
    "patches": "count(DISTINCT type), round(sum(area), 3)",
    "curves": "count(DISTINCT type), round(sum(length), 3), count(*) FILTER (sharp)",
    "vertices": "round(sum(x * nx + y * ny + z * nz), 2), round(sum(k_max - k_min), 3)",
    "faces": "sum(v0 + v1 * v2)",
}
"""Sums over columns of all kinds, by table; they were right when the lake was frozen."""


def make(path: Path) -> None:
    """Write a lake: two commits, a failure, a tag and a subset."""
    from breplake.ingest.run import ingest
    from breplake.ingest.samples import write_samples
    from breplake.ingest.settings import Settings
    from breplake.queries.subsets import create_subset

    with tempfile.TemporaryDirectory() as folder:
        for number, parts in enumerate(PARTS):
            source = Path(folder) / f"parts{number}"
            write_samples(source, parts)
            (source / f"broken{number}.step").write_text("this is no STEP file")
            ingest(
                [source], path, settings=Settings(max_edge=0.1), collection="samples", message="old"
            )
    lake = breplake.open(path)
    lake.store.tag("first", 1)
    create_subset(lake, "solid", where="n_solids > 0", split={"train": 0.5, "test": 0.5})
    (path / "writer.lock").unlink()
    path.with_suffix(".json").write_text(json.dumps(contents(path), indent=1) + "\n")


def contents(path: Path) -> dict[str, Any]:
    """Read all of a lake, by every way of reading."""
    lake = breplake.open(path)
    rows = {table: lake.scan(table).collect().height for table in TABLES}
    found: dict[str, Any] = {
        "snapshots": lake.store.numbers(),
        "tags": lake.store.tags(),
        "files": [entry.path for entry in lake.snapshot.files],
        "rows": {table: count for table, count in rows.items() if count},
        "models": {
            row["name"]: row["model_id"] for row in lake.scan("models").collect().to_dicts()
        },
        "subset": lake.subset("solid").hash,
        "sums": {
            table: list(lake.sql(f"SELECT {sums} FROM {table}").fetchall()[0])
            for table, sums in SAMPLED.items()
        },
        "arrays": {},
    }
    for entry in lake.snapshot.table_files("arrays"):
        reader = lake.arrays(entry.shard)
        for name in (*MESH_ARRAYS, *(GRID_ARRAYS if reader.grid else ())):
            values = reader.read(name, 0, reader.rows(name)).astype(np.float64)
            total = found["arrays"].get(name, 0.0) + float(np.nansum(np.abs(values)))
            found["arrays"][name] = round(total, 2)
    return found


def agrees(path: Path, expected: dict[str, Any]) -> None:
    found = contents(path)
    for name, value in expected["sums"].items():
        assert found["sums"].pop(name) == pytest.approx(value)
    assert found.pop("arrays") == pytest.approx(expected["arrays"])
    assert found == {key: expected[key] for key in found} | {"sums": {}}
    lake = breplake.open(path)
    for number in lake.store.numbers():
        assert lake.store.verify(lake.store.snapshot(number)) == []


@pytest.mark.parametrize("facts", FROZEN, ids=lambda path: path.stem)
def test_a_frozen_lake_is_read(facts):
    agrees(facts.with_suffix(""), json.loads(facts.read_text()))


def test_what_is_frozen_can_be_made_and_read(tmp_path):
    pytest.importorskip("OCP")
    path = tmp_path / f"lake_v{SCHEMA_VERSION}"
    make(path)
    facts = path.with_suffix(".json")
    expected = json.loads(facts.read_text())
    agrees(path, expected)
    assert expected["snapshots"] == [1, 2]
    assert set(expected["models"]) == {part for parts in PARTS for part in parts}
    assert expected["rows"]["failures"] == 2
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    assert size < 3_000_000  # fit for a repository


if __name__ == "__main__":
    make(Path(sys.argv[1]))
