"""``check_lake`` on whole lakes: files, what spans models, and the report."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from breplake.queries.check import Report, check_lake
from breplake.queries.check.rules import LAKE_RULES
from breplake.queries.check.stream import ModelStream, scan_keys
from breplake.queries.session import Lake
from breplake.schema.identity import model_id
from breplake.schema.lake import LakeStore
from breplake.schema.tables import FAILURES

WriteLake = Callable[..., Path]
BOX = model_id("hand", "box")
NEED_A_KERNEL = {
    "shape-graph", "placements", "shape-rows", "edge-curves", "coedge-pcurves",
    "pcurve-on-curve", "pcurve-loops", "trimmed-areas", "uv-grids",
}  # fmt: skip
"""Rules on what a lake written by hand lacks; test_check_shapes.py has them on real parts."""


def check(path: Path, **options: Any) -> Report:
    return check_lake(Lake(path), **options)


def broken(path: Path) -> set[str]:
    return {rule.name for rule in check(path).broken}


def set_column(table: pa.Table, name: str, values: Any) -> pa.Table:
    place = table.column_names.index(name)
    field = table.schema.field(name)
    return table.set_column(place, field, pa.array(values, field.type))


def swap_rows(table: pa.Table, i: int, j: int) -> pa.Table:
    order = np.arange(table.num_rows)
    order[[i, j]] = order[[j, i]]
    return table.take(pa.array(order))


def failure(name: str, *, fatal: bool, collection: str = "hand") -> Callable[[pa.Table], pa.Table]:
    """Add a row of failures."""
    row = {
        "model_id": model_id("hand", name), "collection": collection, "name": name, "path": name,
        "stage": "mesh", "kind": "timeout", "message": "took 60 s", "seconds": 60.0,
        "config_hash": "c", "fatal": fatal, "attempt": 0,
    }  # fmt: skip
    return lambda table: pa.concat_tables([table, FAILURES.from_rows([row])])


def change_snapshot(path: Path, file: str, **values: Any) -> None:
    """Change what the snapshot says of a file."""
    snapshot = LakeStore.open(path).snapshot(1)
    files = tuple(e._replace(**values) if e.path == file else e for e in snapshot.files)
    (path / "snapshots/00000001.json").write_bytes(replace(snapshot, files=files).to_json())


def honest_entry(path: Path, file: str) -> None:
    """Let the snapshot agree with a file that was changed after the commit."""
    from breplake.schema.storage import file_hash

    size = (path / file).stat().st_size
    change_snapshot(path, file, bytes=size, sha256=file_hash(path / file))


def test_faultless_lake(hand_lake: Path) -> None:
    report = check(hand_lake)
    assert report.ok, report.broken
    assert report.models == 6
    assert report.rows == sum(e.rows for e in Lake(hand_lake).snapshot.files if e.table != "arrays")
    idle = {rule.name for rule in report.rules if not rule.checked}
    assert idle == NEED_A_KERNEL  # no other rule passes for want of work


def test_a_flipped_byte(hand_lake: Path) -> None:
    file = next(p for p in (hand_lake / "arrays/s0.zarr/normal/c").rglob("0") if p.is_file())
    data = bytearray(file.read_bytes())
    data[-1] ^= 1  # in the checksum of the index: the values are the same
    file.write_bytes(data)
    assert "files" in broken(hand_lake)


def test_a_missing_table(hand_lake: Path) -> None:
    (hand_lake / "tables/faces/s0.parquet").unlink()
    report = check(hand_lake)
    assert {"files", "contract"} <= {r.name for r in report.broken}
    assert report.rule("files").offenders[0].subject == "tables/faces/s0.parquet"
    assert report.rule("winding").skipped == 6


def test_a_file_that_is_no_parquet(hand_lake: Path) -> None:
    (hand_lake / "tables/curves/s0.parquet").write_bytes(b"nonsense")
    report = check(hand_lake)
    assert {r.name for r in report.broken} == {"files", "contract"}
    assert "not a Parquet file" in report.rule("contract").offenders[0].where


def test_missing_arrays(hand_lake: Path) -> None:
    import shutil

    shutil.rmtree(hand_lake / "arrays/s0.zarr")
    assert {"files", "offsets"} <= broken(hand_lake)


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.drop_columns(["area"]),
        lambda t: t.append_column("extra", pa.array([1] * t.num_rows)),
        lambda t: t.cast(pa.schema([f.with_nullable(True) for f in t.schema])),
    ],
    ids=["missing column", "additional column", "nullable"],
)
def test_contract(hand_lake: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    file = "tables/patches/s0.parquet"
    pq.write_table(change(pq.read_table(hand_lake / file)), hand_lake / file)
    honest_entry(hand_lake, file)
    assert broken(hand_lake) == {"contract"}


@pytest.mark.parametrize("values", [{"rows": 3}, {"min_model_id": 5}, {"max_model_id": 2**62}])
def test_file_rows(hand_lake: Path, values: dict[str, int]) -> None:
    change_snapshot(hand_lake, "tables/patches/s0.parquet", **values)
    assert broken(hand_lake) == {"file-rows"}


def test_rows_out_of_order(write_hand_lake: WriteLake) -> None:
    path = write_hand_lake(coedges=lambda t: swap_rows(t, 0, 1))
    assert "sorted" in broken(path)


def test_models_out_of_order(write_hand_lake: WriteLake) -> None:
    """The rows of each model are still found."""

    def turn(table: pa.Table) -> pa.Table:
        order = pc.sort_indices(table, [("model_id", "descending"), ("curve_id", "ascending")])
        return table.take(order)

    assert broken(write_hand_lake(curves=turn)) == {"sorted"}


def test_repeated_key(write_hand_lake: WriteLake) -> None:
    path = write_hand_lake(parts=lambda t: pa.concat_tables([t.slice(0, 1), t]))
    assert "unique" in broken(path)


def test_unknown_model(write_hand_lake: WriteLake) -> None:
    def add(table: pa.Table) -> pa.Table:
        row = set_column(table.slice(0, 1), "model_id", [2**62])
        return pa.concat_tables([table, row]).sort_by("model_id")

    assert broken(write_hand_lake(parts=add)) == {"model-known"}


@pytest.mark.parametrize(
    ("name", "fatal", "rules"),
    [
        ("box", False, set()),  # a stage of a model that is there
        ("lost", True, set()),  # an input that is not
        ("lost", False, {"one-outcome"}),
    ],
)
def test_one_outcome(write_hand_lake: WriteLake, name: str, fatal: bool, rules: set[str]) -> None:
    assert broken(write_hand_lake(failures=failure(name, fatal=fatal))) == rules


def test_two_outcomes(write_hand_lake: WriteLake) -> None:
    path = write_hand_lake(failures=failure("box", fatal=False))
    file = "tables/failures/s0.parquet"
    pq.write_table(set_column(pq.read_table(path / file), "fatal", [True]), path / file)
    honest_entry(path, file)
    assert broken(path) == {"one-outcome"}


def test_identity(write_hand_lake: WriteLake) -> None:
    path = write_hand_lake(failures=failure("lost", fatal=True, collection="other"))
    assert broken(path) == {"identity"}


def test_shards(write_hand_lake: WriteLake) -> None:
    path = write_hand_lake(models=lambda t: set_column(t, "shard", ["s1"] + ["s0"] * 5))
    assert broken(path) == {"shards"}


@pytest.mark.parametrize(
    ("column", "values"), [("fingerprint", ["same"] * 6), ("duplicate_group", [7] * 6)]
)
def test_duplicates(write_hand_lake: WriteLake, column: str, values: list[Any]) -> None:
    path = write_hand_lake(models=lambda t: set_column(t, column, values))
    assert broken(path) == {"duplicates"}


def test_offsets(write_hand_lake: WriteLake) -> None:
    def shift(table: pa.Table) -> pa.Table:
        offsets = [x if x is None else x + (x > 0) for x in table["face_offset"].to_pylist()]
        return set_column(table, "face_offset", offsets)

    assert broken(write_hand_lake(models=shift)) == {"offsets", "arrays"}


def test_every_lake_rule_is_tested_above() -> None:
    text = Path(__file__).read_text()
    assert all(f'"{name}"' in text for name in LAKE_RULES)


def test_a_choice_of_models(write_hand_lake: WriteLake) -> None:
    """Only the models asked for are measured, and a fault elsewhere is not seen."""

    def spoil(table: pa.Table) -> pa.Table:
        faulty = pc.and_(pc.not_equal(table["model_id"], BOX), table["reversed"])
        return set_column(table, "reversed", faulty.to_pylist())

    path = write_hand_lake(patches=spoil)
    assert {r.name for r in check(path, models=[BOX]).broken} == {"normal"}
    other = check(path, models=[model_id("hand", "cone"), model_id("hand", "saddle")])
    assert other.ok
    assert other.models == 2


def test_progress(hand_lake: Path) -> None:
    seen: list[tuple[int, int, str]] = []
    check(hand_lake, progress=lambda done, total, name: seen.append((done, total, name)))
    assert [done for done, _, _ in seen] == [1, 2, 3, 4, 5, 6]
    assert {total for _, total, _ in seen} == {6}
    assert {name for _, _, name in seen} >= {"hand/box", "hand/torus"}


def test_report_as_json_and_text(write_hand_lake: WriteLake) -> None:
    def bend(table: pa.Table) -> pa.Table:
        return set_column(table, "residual", [1.0, *table["residual"].to_pylist()[1:]])

    report = check(write_hand_lake(vertices=bend))
    document = json.loads(report.to_json())
    assert not document["ok"]
    (rule,) = (r for r in document["rules"] if not r["passed"])
    assert rule["name"] == "residual"
    assert rule["exceptions"] == [rule["exceptions"][0]]
    assert rule["exceptions"][0]["value"] == pytest.approx(1.0)
    out = io.StringIO()
    Console(file=out, width=200).print(report.render())
    text = out.getvalue()
    assert "residual" in text
    assert "✗" in text
    assert rule["offenders"][0]["subject"] in text
    assert "1 of" in text


def test_scan_finds_order_across_batches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from breplake.queries.check import stream

    monkeypatch.setattr(stream, "_BATCH", 4)
    file = tmp_path / "t.parquet"
    ids = [1] * 6 + [2] * 6
    pq.write_table(pa.table({"model_id": ids, "k": [0, 1, 2, 3, 4, 5, 0, 1, 2, 2, 4, 3]}), file)
    scan = scan_keys(file, ("model_id", "k"))
    assert (scan.rows, scan.disorder, scan.first_disorder, scan.repeated) == (12, 1, 11, 1)
    assert scan.ids.tolist() == [1, 2]
    assert scan.counts.tolist() == [6, 6]
    rows = ModelStream(file)
    assert rows.take(1).num_rows == 6
    assert rows.take(2)["k"].to_pylist() == [0, 1, 2, 2, 4, 3]
    assert rows.take(3) is None
