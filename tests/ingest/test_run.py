"""Ingest as a whole: every input accounted for, equal results twice, kills survived."""

from __future__ import annotations

import gzip
import os
import shutil
from pathlib import Path

import polars as pl
import pytest

pytest.importorskip("OCP")
pytest.importorskip("pebble")

import breplake
from breplake.errors import UsageError
from breplake.ingest.inputs import find_inputs
from breplake.ingest.run import ingest
from breplake.ingest.samples import write_samples
from breplake.ingest.settings import Settings
from breplake.schema.tables import TABLES

COARSE = Settings(max_edge=0.06, timeout=120)
PARTS = ["base_plate_mm", "base_plate_inch", "ring_o", "hinge", "duct_surface", "panel_offset"]
VARYING = {"seconds", "peak_memory", "breplake_version"}
"""Columns that measure the run, not the model; all of cpu_* too."""


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_samples(folder, PARTS)
    return folder


@pytest.fixture(scope="module")
def lake(parts, tmp_path_factory):
    path = tmp_path_factory.mktemp("lakes") / "lake"
    summary = ingest([parts], path, settings=COARSE, jobs=2, message="first")
    assert summary.n_meshed == len(PARTS)
    return path


def contents(lake, table):
    columns = TABLES[table].columns
    names = [c.name for c in columns if c.name not in VARYING and not c.name.startswith("cpu_")]
    return breplake.open(lake).scan(table).select(names).collect()


def test_twice_is_equal(parts, lake, tmp_path):
    ingest([parts], tmp_path / "again", settings=COARSE, jobs=1)
    for table in TABLES:
        first, second = contents(lake, table), contents(tmp_path / "again", table)
        assert first.equals(second), table
        if table == "failures":
            assert first.is_empty()
    a, b = (
        breplake.open(path).snapshot.table_files("vertices") for path in (lake, tmp_path / "again")
    )
    assert [entry.sha256 for entry in a] == [entry.sha256 for entry in b]


def test_a_second_run_finds_nothing_new(parts, lake):
    before = breplake.open(lake).snapshot.number
    summary = ingest([parts], lake, settings=COARSE, jobs=1)
    assert (len(summary.plan.new), len(summary.plan.unchanged)) == (0, len(PARTS))
    assert summary.snapshot is None
    assert breplake.open(lake).snapshot.number == before


def test_other_content_under_the_same_name_is_told(parts, lake, tmp_path):
    copy = tmp_path / parts.name
    shutil.copytree(parts, copy)
    with (copy / "ring_o.step").open("a") as file:
        file.write("/* changed */\n")
    summary = ingest([copy], lake, settings=COARSE, jobs=1)
    assert [item.name for item in summary.plan.changed] == ["ring_o"]
    assert not summary.plan.new


def test_inch_and_millimetre_twins(lake):
    opened = breplake.open(lake)
    inch, mm = (opened.model(f"base_plate_{unit}") for unit in ("inch", "mm"))
    assert (inch["length_unit"], mm["length_unit"]) == ("INCH", "MILLIMETRE")
    assert (inch["scale_to_mm"], mm["scale_to_mm"]) == (25.4, 1.0)
    for table in ("patches", "curves", "corners", "coedges", "vertices", "faces"):
        a, b = (
            pl.from_arrow(opened.read(table, model["model_id"])).drop("model_id")
            for model in (inch, mm)
        )
        assert a.shape == b.shape, table
        for name, kind in a.schema.items():
            x, y = a[name], b[name]
            if kind == pl.Struct:
                x, y = (s.struct.unnest() for s in (x, y))
                for leaf in x.columns:
                    assert same(x[leaf], y[leaf]), (table, name)
            elif not kind.is_nested():
                assert same(x, y), (table, name)


def same(x, y):
    """Equal, floats within rounding of the conversion between units."""
    if not x.dtype.is_float():
        return x.equals(y)
    near = ((x - y).abs() <= 1e-9 * (1 + x.abs())).fill_null(value=True).all()
    return x.is_null().equals(y.is_null()) and near


def test_polars_and_duckdb_read_the_files_themselves(lake):
    import duckdb

    pattern = str(lake / "tables" / "patches" / "*.parquet")
    by_polars = pl.scan_parquet(pattern).group_by("type").agg(pl.col("area").sum()).collect()
    query = f"SELECT type, sum(area) AS area FROM '{pattern}' GROUP BY type"
    by_duckdb = duckdb.connect().sql(query).pl()
    ours = breplake.open(lake).sql("SELECT type, sum(area) AS area FROM patches GROUP BY type").pl()
    for other in (by_duckdb, ours):
        joined = by_polars.join(other, on="type", validate="1:1")
        assert len(joined) == len(by_polars) == len(other)
        assert ((joined["area"] - joined["area_right"]).abs() < 1e-9 * joined["area"]).all()


def test_open_surfaces_and_offsets(lake):
    opened = breplake.open(lake)
    duct = opened.model("duct_surface")
    assert not duct["is_closed"]
    assert duct["volume"] is None
    assert duct["n_boundary_edges"] > 0
    assert opened.model("panel_offset")["n_other"] == 1


def bad_folder(folder):
    """One of each kind of input that cannot become a model, and one that can."""
    write_samples(folder, ["ring_o"])
    good = (folder / "ring_o.step").read_text()
    (folder / "empty.step").touch()
    (folder / "text.step").write_text("Dear customer,\nplease find attached\n")
    (folder / "truncated.stp").write_text(good[: len(good) // 2])
    (folder / "folder.step").mkdir()
    start, _ = good.split("DATA;", 1)
    (folder / "nothing.p21").write_text(start + "DATA;\nENDSEC;\nEND-ISO-10303-21;\n")
    (folder / "broken.step.gz").write_bytes(gzip.compress(good.encode())[:-100])
    (folder / "packed.step.gz").write_bytes(gzip.compress(good.encode()))
    (folder / "text.iges").write_text("not IGES\n")
    (folder / "text.brep").write_text("not BREP\n")
    (folder / "readme.txt").write_text("no CAD file, so no input\n")
    (folder / "secret.step").write_text(good)
    (folder / "secret.step").chmod(0)


EXPECTED = {
    "empty": ("plan", {"empty-file"}),
    "text": ("load", {"read-failed"}),  # the .brep, which comes first
    "truncated": ("load", {"read-failed", "translate-failed", "no-shape"}),
    "folder": ("plan", {"not-a-file"}),
    "nothing": ("load", {"no-shape", "read-failed", "translate-failed"}),
    "broken": ("read", {"bad-archive"}),
    "text.iges": ("load", {"read-failed", "translate-failed", "no-shape"}),
    "text.step": ("load", {"read-failed"}),
    "secret": ("plan", {"unreadable"}),
}


def refuse_secret(monkeypatch):
    """Root reads everything, so the file that is closed to others is closed by hand."""
    plain = Path.open

    def guarded(self, *args, **kwargs):
        if self.name == "secret.step":
            raise PermissionError(13, "Permission denied", str(self))
        return plain(self, *args, **kwargs)

    if os.geteuid() == 0:
        monkeypatch.setattr(Path, "open", guarded)


def test_bad_inputs_are_all_recorded(tmp_path, monkeypatch):
    folder, lake = tmp_path / "inputs", tmp_path / "lake"
    folder.mkdir()
    bad_folder(folder)
    refuse_secret(monkeypatch)
    ingest([folder], lake, settings=COARSE, jobs=1)
    opened = breplake.open(lake)
    rows = opened.sql("SELECT name, stage, kind, message, fatal FROM failures").fetchall()
    models = {name for (name,) in opened.sql("SELECT name FROM models").fetchall()}
    assert models == {"ring_o", "packed"}
    fatal = {name: (stage, kind) for name, stage, kind, _, is_fatal in rows if is_fatal}
    assert fatal.keys() == EXPECTED.keys()
    for name, (stage, kinds) in EXPECTED.items():
        assert fatal[name][0] == stage, name
        assert fatal[name][1] in kinds, name
    assert all(len(message) > 15 for *_, message, _ in rows)
    again = ingest([folder], lake, settings=COARSE, jobs=1)
    assert not again.plan.new
    assert len(again.plan.unchanged) == len(EXPECTED) + 2


def test_timeout_is_attributed_and_the_next_rung_gets_its_turn(tmp_path):
    write_samples(tmp_path / "in", ["gear_bevel"])
    slow = Settings(max_edge=0.002, timeout=6, max_triangles=50_000_000)
    summary = ingest([tmp_path / "in"], tmp_path / "lake", settings=slow, jobs=1)
    opened = breplake.open(tmp_path / "lake")
    rows = opened.sql(
        "SELECT kind, stage, attempt, seconds, message FROM failures ORDER BY attempt"
    ).fetchall()
    assert rows[0][:3] == ("timeout", "mesh", 0)
    assert 5 < rows[0][3] < 60
    assert "mesh uniform" in rows[0][4]
    # The second attempt went on with the next rung: it made that mesh, or failed at it.
    kind = opened.model("gear_bevel")["mesh_kind"]
    assert kind == "tessellation" or "tessellation" in rows[1][4]
    assert summary.n_models == 1  # the exact rows were handed over before the kill
    assert opened.model("gear_bevel")["n_patches"] == 83


@pytest.mark.slow
def test_memory_limit_is_a_failure_and_no_crash(tmp_path):
    write_samples(tmp_path / "in", ["ball_steel"])
    tight = Settings(max_edge=0.0004, timeout=200, memory=1, max_triangles=500_000_000)
    summary = ingest([tmp_path / "in"], tmp_path / "lake", settings=tight, jobs=1)
    assert summary.n_models == 1
    kinds = {kind for _, kind in summary.kinds}
    # OCCT and Gmsh may answer a refused allocation by aborting instead of raising.
    assert kinds & {"memory", "killed-signal", "mesh-failed"}, summary.kinds
    assert "timeout" not in kinds


@pytest.mark.parametrize("stage", ["import", "mesh:uniform", "mesh:tessellation", "truth:uniform"])
def test_a_crash_is_attributed_and_the_next_rung_follows(tmp_path, stage):
    from breplake.ingest.pool import Result, _killed
    from breplake.ingest.processes import Ended
    from breplake.ingest.spool import Spool

    (item,) = find_inputs([write_samples(tmp_path / "in", ["ring_o"])[0]])
    result = Result(item, Spool(tmp_path))
    result.spool.start()
    result.spool.begin("a")
    result.spool.mark(stage if ":" in stage else f"{stage}:")
    again = _killed(Ended(result, killed="death", exitcode=-11), Settings())
    assert again == {"import": 2, "mesh:uniform": 1, "truth:uniform": 1}.get(stage)
    (failure,) = result.failures
    assert (failure.kind, failure.signal) == ("killed-signal", 11)
    assert failure.stage == stage.partition(":")[0]
    assert failure.fatal == (again is None)
    assert "SIGSEGV" in failure.message


def test_beyond_the_ladder_is_a_mesh_without_gmsh(ingest_file, tmp_path):
    (path,) = write_samples(tmp_path, ["knob_door"])
    record = ingest_file(path, rung=2)
    assert not record.failures
    assert record.model["mesh_kind"] == "tessellation"
    assert record.column("vertices", "residual").max() < 1e-9


def test_two_ingests_of_the_same_files_leave_one_whole_lake(parts, tmp_path):
    """Both make the same shard; one commits it and the other is told."""
    from concurrent.futures import ThreadPoolExecutor

    from breplake.errors import CommitConflictError

    only = tmp_path / "in"
    only.mkdir()
    shutil.copy(parts / "ring_o.step", only)

    def run(_):
        try:
            return ingest([only], tmp_path / "lake", settings=COARSE, jobs=1).n_models
        except CommitConflictError as error:
            return type(error)

    with ThreadPoolExecutor(2) as threads:
        outcomes = list(threads.map(run, range(2)))
    assert 1 in outcomes
    opened = breplake.open(tmp_path / "lake")
    assert opened.store.verify(opened.snapshot) == []
    assert opened.sql("SELECT count(*) FROM models").fetchall() == [(1,)]


def test_names_and_sources(tmp_path):
    (tmp_path / "a" / "sub").mkdir(parents=True)
    for name in ("x.step", "x.stp", "sub/y.STEP", "sub/z.iges", "notes.txt"):
        (tmp_path / "a" / name).write_text(name)
    found = find_inputs([tmp_path / "a"])
    assert [(i.collection, i.name, i.format) for i in found] == [
        ("a", "sub/y", "step"),
        ("a", "sub/z", "iges"),
        ("a", "x", "step"),
        ("a", "x.stp", "step"),
    ]
    assert [i.collection for i in find_inputs([tmp_path / "a" / "x.step"], "mine")] == ["mine"]
    assert len(find_inputs([tmp_path / "a", tmp_path / "a" / "x.step"])) == 4
    (tmp_path / "a" / "00000050_80d90bfdd2e74e709956122a_step_000.step").touch()
    assert "00000050_80d90bfdd2e74e709956122a_000" in {
        i.name for i in find_inputs([tmp_path / "a"])
    }
    with pytest.raises(UsageError, match="does not exist"):
        find_inputs([tmp_path / "b"])
    with pytest.raises(UsageError, match="no CAD file"):
        find_inputs([tmp_path / "a" / "notes.txt"])


def test_command(tmp_path):
    from typer.testing import CliRunner

    from breplake.cli import app

    write_samples(tmp_path / "in", ["ring_o"])
    (tmp_path / "in" / "empty.step").touch()
    command = ["ingest", str(tmp_path / "in"), "--lake", str(tmp_path / "lake"), "-j", "1"]
    first = CliRunner().invoke(app, [*command, "--max-edge", "0.06"])
    assert first.exit_code == 0, first.output
    assert "1 models, 1 of them with mesh and ground truth; 1 failed" in first.output
    assert "empty-file" in first.output
    again = CliRunner().invoke(app, [*command, "--max-edge", "0.06"])
    assert (again.exit_code, "nothing is new" in again.output) == (0, True)
    other = CliRunner().invoke(app, [*command, "--max-edge", "0.05"])
    assert "2 files not ingested" in other.output
    wrong = CliRunner().invoke(app, [*command, "--max-edge", "5"])
    assert wrong.exit_code == 2
    assert "max_edge must be in (0, 1]" in wrong.output
