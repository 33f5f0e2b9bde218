"""Sessions: views at a snapshot, reading statements only, rows of one model."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
from concurrent.futures import ThreadPoolExecutor

import duckdb
import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest

import breplake
from breplake.errors import LakeFormatError, NameNotFoundError, UsageError
from breplake.queries.views import DERIVED
from breplake.schema.lake import LakeStore
from breplake.schema.shape_tables import SHAPE_TABLES
from breplake.schema.tables import TABLES


@pytest.fixture
def lake(tiny_lake):
    return breplake.open(tiny_lake)


def one(lake, query, params=None):
    ((value,),) = lake.sql(query, params).fetchall()
    return value


def test_tables_are_views_at_the_snapshot(lake):
    assert one(lake, "SELECT count(*) FROM models") == 5
    assert one(lake.at(1), "SELECT count(*) FROM models") == 2
    assert lake.at(1).at().snapshot.number == 2
    assert repr(lake).endswith("at=2)")


@pytest.mark.parametrize("at", [1, 2])
def test_views_have_the_columns_of_the_contract(lake, at):
    """Also `failures`, which has no file in snapshot 1."""
    at_lake = lake.at(at)
    for name, table in TABLES.items():
        relation = at_lake.sql(f"FROM {name}")
        assert relation.columns == table.schema.names
        expected = at_lake.connection.from_arrow(table.empty()).types
        assert [str(t) for t in relation.types] == [str(t) for t in expected]
        assert at_lake.scan(name).collect_schema().names() == table.schema.names


def test_a_session_stays_at_its_snapshot(own_lake, new_shard):
    lake = breplake.open(own_lake)
    new_shard(lake.store, "s2", {"new": (1, 1, 1)})
    lake.store.commit(lake.store.register_shard("s2"), message="m", tools={}, config_hash="c")
    assert one(lake, "SELECT count(*) FROM models") == 5
    assert one(breplake.open(own_lake), "SELECT count(*) FROM models") == 6
    assert len(lake.files("models")) == 2
    assert pickle.loads(pickle.dumps(lake)).snapshot.number == 2


def test_open_at_a_tag(own_lake):
    LakeStore.open(own_lake).tag("paper", 1)
    assert breplake.open(own_lake, at="paper").snapshot.number == 1
    with pytest.raises(NameNotFoundError, match="tags paper"):
        breplake.open(own_lake, at="papers")


def test_polars_and_duckdb_read_the_files_directly(lake, tiny_lake):
    """Without breplake: plain Parquet in a plain folder; a table without rows has no files."""
    for name in TABLES:
        ours = lake.sql(f"FROM {name} ORDER BY ALL").fetchall()
        glob = f"{tiny_lake}/tables/{name}/*.parquet"
        if name in {table.name for table in SHAPE_TABLES}:
            assert not list((tiny_lake / "tables").glob(f"{name}/*"))
            assert ours == lake.scan(name).collect().rows() == []
            continue
        assert duckdb.sql(f"FROM '{glob}' ORDER BY ALL").fetchall() == ours
        assert (
            pl.scan_parquet(glob).collect().height == len(ours) == lake.scan(name).collect().height
        )
    area = "SELECT sum(area) FROM patches"
    polars = lake.scan("patches").select(pl.col("area").sum()).collect().item()
    assert one(lake, area) == polars == pytest.approx(one(lake, "SELECT sum(area) FROM models"))


def test_paths_that_look_like_patterns(own_lake, tmp_path):
    strange = tmp_path / "it's [1] *"
    shutil.move(own_lake, strange)
    lake = breplake.open(strange)
    assert one(lake, "SELECT count(*) FROM models") == 5
    assert lake.scan("models").collect().height == 5


def test_relations_convert(lake):
    relation = lake.sql("SELECT name, n_plane FROM models WHERE n_plane = ? ORDER BY name", [6])
    assert relation.to_arrow_table().num_rows == relation.pl().height == 5
    assert lake.sql("SELECT $a + 1", {"a": 1}).fetchall() == [(2,)]
    assert lake.sql("SELECT 1; SELECT 2").fetchall() == [(2,)]


def test_results_and_threads_go_side_by_side(lake):
    reader = lake.sql("SELECT * FROM range(100000)").to_arrow_reader(1000)
    assert one(lake, "SELECT count(*) FROM faces") == 48
    assert reader.read_all().num_rows == 100_000
    with ThreadPoolExecutor(4) as pool:
        counts = list(pool.map(lambda _: one(lake, "SELECT count(*) FROM faces"), range(20)))
    assert counts == [48] * 20


@pytest.mark.parametrize(
    "query",
    [
        "FROM models",
        "VALUES (1)",
        "WITH x AS (SELECT 1 AS a) SELECT a FROM x UNION ALL SELECT 2",
        "WITH RECURSIVE r AS (SELECT 1 AS a UNION ALL SELECT a + 1 FROM r WHERE a < 3) FROM r",
        "DESCRIBE models",
        "SUMMARIZE corners",
        "SHOW TABLES",
        "EXPLAIN SELECT 1",
        "/* why */ explain -- so\n analyze (FORMAT json) SELECT count(*) FROM models",
        "EXPLAIN (SELECT 1)",
        "SELECT 'COPY models TO x' AS \"copy\" -- INSERT",
        "PIVOT patches ON type IN ('Plane') USING count(*) GROUP BY model_id",
    ],
)
def test_reading_statements_run(lake, query):
    assert lake.sql(query).fetchall()


@pytest.mark.parametrize(
    "query",
    [
        "COPY models TO '{0}'",
        "WITH x AS (COPY (SELECT 1) TO '{0}') SELECT 1",
        "SELECT * FROM (WITH x AS (COPY (SELECT 1) TO '{0}') FROM x)",
        "EXPLAIN ANALYZE COPY models TO '{0}'",
        "EXPLAIN ANALYZE WITH x AS (COPY (SELECT 1) TO '{0}') SELECT 1",
        "EXPLAIN (ANALYZE) COPY models TO '{0}'",
        "explain/**/analyze/* ; */COPY models TO '{0}'",
        "SELECT 1; COPY models TO '{0}'",
        "EXPORT DATABASE '{0}'",
        "ATTACH '{0}'",
        "WITH x AS (INSERT INTO t VALUES (2) RETURNING a) FROM x",
        "SELECT (WITH x AS (DELETE FROM t RETURNING a) SELECT count(*) FROM x)",
        "INSERT INTO t VALUES (2)",
        "UPDATE t SET a = 2",
        "DROP VIEW models",
        "CREATE TABLE u (a INT)",
        "CREATE OR REPLACE VIEW models AS SELECT 1",
        "INSTALL spatial",
        "LOAD spatial",
        "SET threads = 1",
        "PRAGMA threads = 1",
        "CALL checkpoint()",
        "PREPARE p AS SELECT 1",
        "USE memory",
        "BEGIN",
        "PIVOT patches ON type USING count(*)",
        "",
        "-- nothing",
        "SELEC 1",
        "SELECT nme FROM models",
        "FROM lake",  # a variable of this test's frame is no table
    ],
)
def test_other_statements_are_refused(lake, query, tmp_path):
    lake.connection.execute("CREATE TABLE t AS SELECT 1 AS a")
    target = tmp_path / "written"
    with pytest.raises(UsageError) as caught:
        lake.sql(query.format(target)).fetchall()
    assert len(str(caught.value)) > 20
    assert not target.exists()
    assert one(lake, "SELECT sum(a) FROM t") == 1
    assert one(lake, "SELECT count(*) FROM models") == 5


def test_refusals_say_what_is_allowed(lake):
    with pytest.raises(UsageError, match="DROP is no reading statement: a lake is read by SELECT"):
        lake.sql("DROP VIEW models")
    with pytest.raises(UsageError, match="COPY inside a query writes"):
        lake.sql("WITH x AS (COPY (SELECT 1) TO '/tmp/x') SELECT 1")
    with pytest.raises(UsageError, match='"name"'):  # DuckDB's own hint comes through
        lake.sql("SELECT nme FROM models")


def test_vertex_normals_of_a_box_point_to_its_corners(lake):
    query = "SELECT nx, ny, nz, n_patches, x FROM vertex_normals WHERE model_id = ?"
    rows = np.array(lake.sql(query, [lake.model("big")["model_id"]]).fetchall())
    assert len(rows) == 8
    np.testing.assert_allclose(np.abs(rows[:, :3]), 1 / np.sqrt(3), rtol=1e-15)
    np.testing.assert_array_equal(rows[:, 3], 3)
    np.testing.assert_array_equal(np.sign(rows[:, 0]), np.where(rows[:, 4] > 0, 1, -1))


def test_vertex_normals_that_cancel_are_null(own_lake, new_shard):
    import pyarrow as pa

    lake = breplake.open(own_lake)
    rows = pq.read_table(lake.files("vertices")[0])
    two = rows.slice(0, 2)  # the first vertex, on both sides of a sheet
    for name, values in {"vertex_id": [0, 0], "patch_id": [0, 1], "normal_id": [0, 1]}.items():
        at = two.schema.get_field_index(name)
        two = two.set_column(at, two.schema.field(at), pa.array(values, two.schema.field(at).type))
    for name in ("nx", "ny", "nz"):
        at = two.schema.get_field_index(name)
        two = two.set_column(at, two.schema.field(at), pa.array([0.6, -0.6]))
    lake.connection.register("sheet", two)
    from breplake.queries.views import derived_sql

    sql = derived_sql("vertex_normals").replace("FROM vertices", "FROM sheet")
    assert lake.connection.sql(f"SELECT nx, ny, nz, n_patches FROM ({sql})").fetchall() == [
        (None, None, None, 2)
    ]


def test_adjacency_of_a_box(lake):
    query = "SELECT patch_a, patch_b, kind, angle_max FROM adjacency WHERE model_id = ?"
    rows = lake.sql(query, [lake.model("wide")["model_id"]]).fetchall()
    assert len(rows) == 12
    assert {(a, b) for a, b, _, _ in rows} == {
        (a, b) for a in range(6) for b in range(a + 1, 6) if a // 2 != b // 2
    }
    assert {(kind, angle) for _, _, kind, angle in rows} == {("sharp", np.pi / 2)}


@pytest.mark.parametrize("name", DERIVED)
def test_derived_views_document_their_columns(lake, name):
    from breplake.queries.views import derived_sql

    header = "".join(line for line in derived_sql(name).splitlines() if line.startswith("--"))
    for column in lake.sql(f"FROM {name}").columns:
        assert column in header


def test_rows_of_one_model(lake):
    for name in ("small", "long/flat", "big", "wide", "bare"):
        identity = lake.model(name)["model_id"]
        for table in TABLES:
            keys = ", ".join(f'"{key}"' for key in TABLES[table].key)
            query = f"FROM {table} WHERE model_id = ? ORDER BY {keys}"
            assert lake.read(table, identity).to_pylist() == (
                lake.sql(query, [identity]).to_arrow_table().to_pylist()
            )
    assert lake.read("faces", lake.model("bare")["model_id"]).num_rows == 0
    assert lake.read("faces", lake.model("bare")["model_id"]).schema.equals(TABLES["faces"].schema)


def test_columns_of_one_model(lake):
    rows = lake.read("faces", lake.model("big")["model_id"], columns=["v2", "v0"])
    assert rows.column_names == ["v2", "v0"]
    assert rows.num_rows == 12
    with pytest.raises(NameNotFoundError, match="did you mean v0"):
        lake.read("faces", 1, columns=["v00"])


def test_a_model_is_read_from_its_row_groups_alone(lake, monkeypatch):
    read = []
    real = pq.ParquetFile.read_row_groups
    monkeypatch.setattr(
        pq.ParquetFile, "read_row_groups", lambda s, g, **k: read.append(g) or real(s, g, **k)
    )
    lake.read("vertices", lake.model("big")["model_id"])
    assert read == [[0], [0]]  # one file of models, one of vertices


def test_failures_of_an_input(lake):
    with pytest.raises(
        NameNotFoundError, match="broken was not read into the lake: no STEP header"
    ):
        lake.model("broken")
    (row,) = lake.read("failures", lake.model("bare")["model_id"]).to_pylist()
    assert (row["kind"], row["fatal"]) == ("timeout", False)


def test_models_by_name_and_id(lake):
    row = lake.model("long/flat")
    assert row["metadata"] == {}
    assert lake.model(row["model_id"]) == lake.model(str(row["model_id"])) == row
    assert lake.model("boxes/long/flat") == row
    with pytest.raises(NameNotFoundError, match="did you mean big"):
        lake.model("bigg")
    with pytest.raises(NameNotFoundError, match="no model 5"):
        lake.model(5)
    with pytest.raises(NameNotFoundError, match="did you mean patches"):
        lake.files("patch")
    with pytest.raises(NameNotFoundError, match="no arrays"):
        lake.arrays("s9")


def test_arrays_of_a_shard(lake):
    row = lake.model("wide")
    start = row["vertex_offset"]
    points = lake.arrays("s1").read("position", start, start + row["n_vertices"])
    np.testing.assert_array_equal(points.max(axis=0), [7, 8, 2])


def test_damage_is_named(own_lake):
    lake = breplake.open(own_lake)
    identity = lake.model("big")["model_id"]
    path = own_lake / "tables/faces/s1.parquet"
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(LakeFormatError, match="run breplake check"):
        lake.read("faces", identity)
    (own_lake / "tables/models/s0.parquet").unlink()
    with pytest.raises(LakeFormatError, match="run breplake check"):
        breplake.open(own_lake).sql("FROM models")


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")  # that is what is tested
def test_a_forked_process_has_its_own_session(lake):
    assert one(lake, "SELECT count(*) FROM models") == 5
    identity = lake.model("big")["model_id"]
    pid = os.fork()
    if pid == 0:
        signal.alarm(20)  # a hang must become a failure
        rows = lake.read("faces", identity).num_rows
        os._exit(0 if (one(lake, "SELECT count(*) FROM models"), rows) == (5, 12) else 1)
    assert os.waitpid(pid, 0)[1] == 0


def test_info(lake):
    info = lake.info()
    assert (info.models, info.failed, info.meshed) == (5, 1, 4)
    assert info.failures == {"mesh/timeout": 1, "read/not-cad": 1}
    assert info.patches["Plane"] == 30
    assert info.curves["Line"] == 60
    assert (info.vertices, info.normals, info.triangles) == (32, 96, 48)
    assert info.meshes == {"uniform": 4}
    assert sum(info.bytes.values()) == sum(entry.bytes for entry in lake.snapshot.files)
    assert info.tools["breplake"] == "0"
    assert lake.at(1).info().failures == {}
