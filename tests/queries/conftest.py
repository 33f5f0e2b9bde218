"""Lakes of solids made by hand, and of sample parts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import breplake
from breplake.queries.session import Lake
from breplake.schema.arrays import ArrayShardWriter
from breplake.schema.lake import LakeStore
from breplake.schema.tables import TABLES

from .hand_made import MAKERS, fresh
from .solid import Solid

FEATURE_PARTS = ("block_machined", "manifold_block", "enclosure", "dice", "lead_screw")
"""Sample parts with counterbores, blind holes, fillets and a thread."""

Spoil = Callable[[pa.Table], pa.Table]


def write_solids(path: Path, solids: list[Solid], spoil: dict[str, Spoil] | None = None) -> Path:
    """Write a lake of one shard and commit it; `spoil` changes tables before they are written."""
    shard = "s0"
    store = LakeStore.create(path)
    solids = sorted(solids, key=lambda s: s.id)
    with ArrayShardWriter(store.array_path(shard)) as writer:
        for solid in solids:
            if (arrays := solid.arrays()) is not None:
                first = writer.append(arrays)
                solid.rows("models")[0] |= {"vertex_offset": first.vertex,
                    "normal_offset": first.normal, "face_offset": first.face}  # fmt: skip
    for name in TABLES:
        rows = pa.concat_tables([solid.table(name) for solid in solids])
        rows = (spoil or {}).get(name, lambda t: t)(rows)
        pq.write_table(rows, store.table_path(name, shard), row_group_size=64)
    tools = {"breplake": "0"}
    store.commit(store.register_shard(shard), message="by hand", tools=tools, config_hash="c")
    return path


@pytest.fixture
def solid() -> Callable[[str], Solid]:
    """Give a fresh solid by its name."""
    return fresh


@pytest.fixture
def write_hand_lake(tmp_path: Path) -> Callable[..., Path]:
    """Give a function that writes a lake of all solids, spoilt as its arguments say."""
    return lambda **spoil: write_solids(tmp_path / "hand", [fresh(name) for name in MAKERS], spoil)


@pytest.fixture
def hand_lake(tmp_path: Path) -> Path:
    """A faultless lake of all solids, which a test may spoil."""
    return write_solids(tmp_path / "hand", [fresh(name) for name in MAKERS])


@pytest.fixture(scope="module")
def samples(sample_lake: Path) -> Lake:
    return breplake.open(sample_lake)


@pytest.fixture(scope="module")
def features(shared_lake: Callable[..., Path]) -> Lake:
    """A lake of parts with counterbores, blind holes and fillets."""
    return breplake.open(shared_lake("features", FEATURE_PARTS, max_edge=0.05))
