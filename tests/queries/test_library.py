"""The query library: headers, parameters, and what each query finds in parts whose shape is known.

That every number is right is shown on the sample parts, which were modelled with these features.
"""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.errors import NameNotFoundError, UsageError
from breplake.queries.named import TOPICS, named_queries, named_query, parse
from breplake.queries.session import Lake
from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES

QUERIES = {query.name: query for query in named_queries()}
FEATURE_PARTS = ("block_machined", "manifold_block", "enclosure", "dice", "lead_screw")


@pytest.fixture(scope="session")
def feature_lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lake of parts with counterbores, blind holes and fillets; made once for all workers."""
    pytest.importorskip("OCP")
    from filelock import FileLock

    base = tmp_path_factory.getbasetemp()
    shared = base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base
    lake = shared / "feature_lake"
    with FileLock(shared / "feature_lake.lock"):
        if not (shared / "feature_lake.done").exists():
            from breplake.ingest.run import ingest
            from breplake.ingest.samples import write_samples
            from breplake.ingest.settings import Settings

            write_samples(shared / "features", FEATURE_PARTS)
            ingest([shared / "features"], lake, settings=Settings(max_edge=0.05), message="parts")
            (shared / "feature_lake.done").touch()
    return lake


@pytest.fixture(scope="module")
def samples(sample_lake: Path) -> Lake:
    return breplake.open(sample_lake)


@pytest.fixture(scope="module")
def features(feature_lake: Path) -> Lake:
    return breplake.open(feature_lake)


def ask(lake: Lake, name: str, **given) -> list[dict]:
    return lake.query(name, **given).to_arrow_table().to_pylist()


def by(rows: list[dict], key: str = "name") -> dict:
    found = {row[key]: row for row in rows}
    assert len(found) == len(rows)
    return found


# Headers


def test_the_library_is_large():
    assert len(QUERIES) >= 30
    assert {query.topic for query in QUERIES.values()} == set(TOPICS)


@pytest.mark.parametrize("name", QUERIES)
def test_header_and_statement_agree(name: str, tiny_lake: Path):
    query = QUERIES[name]
    code = "\n".join(line.split("--")[0] for line in query.sql.splitlines())
    assert set(re.findall(r"\$(\w+)", code)) == {p.name for p in query.parameters}
    assert len(query.description) > 60
    assert not {"where", "name", "lake", "at"} & {p.name for p in query.parameters}
    relation = breplake.open(tiny_lake).query(name)
    assert relation.columns == [column.name for column in query.columns]
    assert "ORDER BY" in code, "an answer has an order"


@pytest.mark.parametrize("name", QUERIES)
def test_every_query_runs(name: str, samples: Lake, tiny_lake: Path):
    """On samples; on a lake without failures, patches' axes or meshes; narrowed down to nothing."""
    samples.query(name).fetchall()
    for at in (1, 2):
        breplake.open(tiny_lake, at).query(name).fetchall()
    counted = samples.query(name, where="false").to_arrow_table().to_pylist()
    if query_counts_all := name in ("surface_types", "curve_types", *HISTOGRAMS):
        counts = [row.get("models", 0) for row in counted]
        assert set(counts) == {0}
    assert counted == [] or query_counts_all


HISTOGRAMS = ("patches_per_model", "curves_per_model")


@pytest.mark.parametrize("name", QUERIES)
def test_narrowing_down_to_all_changes_nothing(name: str, samples: Lake):
    whole, narrowed = (
        sorted(map(repr, rounded(samples.query(name, where=where).fetchall())))
        for where in (None, "true -- all")
    )
    assert whole == narrowed


def rounded(value):
    """Sums depend on the order of the rows, in the last bit."""
    if isinstance(value, float):
        return float(f"{value:.9g}")
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    return value


def test_narrowing_down(samples: Lake):
    tori = by(ask(samples, "surface_types", where="name = 'bellows'"), "type")["Torus"]
    assert tori["patches"] == samples.model("bellows")["n_torus"]
    assert tori["model_share"] == 1
    rows = ask(samples, "holes", where="name LIKE 'base%'")
    assert {row["models"] for row in rows} <= {1, 2}
    assert set(by(ask(samples, "fillets", where="name LIKE 'base%'"))) == {
        "base_plate_inch", "base_plate_mm",
    }  # fmt: skip
    with pytest.raises(UsageError, match="nme"):
        samples.query("holes", where="nme = 'x'")


# Parameters


def test_unknown_names_name_the_nearest(samples: Lake):
    with pytest.raises(NameNotFoundError, match="did you mean fillets"):
        samples.query("filets")
    with pytest.raises(NameNotFoundError, match=r"did you mean min_radius.*max_radius"):
        samples.query("fillets", min_radus=1)
    with pytest.raises(NameNotFoundError, match="parameters are none"):
        samples.query("surface_types", limit=1)


@pytest.mark.parametrize(
    ("given", "bound"),
    [(2, 2.0), (2.5, 2.5), ("2.25", 2.25), ("null", None), (None, None), ("1e-3", 1e-3)],
)
def test_numbers_are_read(given: object, bound: float | None):
    (parameter,) = (p for p in QUERIES["fillets"].parameters if p.name == "max_radius")
    assert parameter.value(given) == bound


@pytest.mark.parametrize(
    ("query", "given"),
    [
        ("fillets", {"min_radius": "wide"}),
        ("fillets", {"min_radius": True}),
        ("torus_rich", {"more_than": 2.5}),
        ("torus_rich", {"more_than": "2.25"}),
        ("torus_rich", {"more_than": "30; DROP VIEW models"}),
        ("benchmark_candidates", {"unique": "maybe"}),
        ("benchmark_candidates", {"unique": 1}),
        ("largest_models", {"by": 3}),
    ],
)
def test_values_of_another_type_are_refused(query: str, given: dict):
    (name,) = given
    with pytest.raises(UsageError, match=f"parameter {name} is a"):
        named_query(query).bind(given)


def test_values_are_values_not_sql(samples: Lake):
    assert ask(samples, "repeated_parts", model="' OR true --") == []


def test_a_required_parameter():
    query = parse(
        "q", "-- T\n-- Topic: records\n-- Parameters:\n--   n BIGINT: how many\nSELECT $n"
    )
    with pytest.raises(UsageError, match="query q needs n: how many"):
        query.bind({})
    assert str(query.bind({"n": "3"})["n"]) == "3"


@pytest.mark.parametrize(
    "text",
    [
        "SELECT 1",
        "-- Title\nSELECT 1",
        "-- Title\n-- Topic: cooking\nSELECT 1",
        "-- Title\n-- Topic: records\n-- Parameters:\n--   n INT = 3: how many\nSELECT 1",
        "-- Title\n-- Topic: records\n-- Parameters:\n-- n BIGINT = 3: how many\nSELECT 1",
        "-- Title\n-- Topic: records\n-- Parameters:\n--   n BIGINT = x: how many\nSELECT 1",
        "-- Title\n-- Topic: records\n-- Columns:\n--   a, b: both\nSELECT 1",
    ],
)
def test_broken_headers_are_told(text: str):
    with pytest.raises(UsageError):
        parse("q", text)


def test_headers_may_wrap():
    text = "-- T\n-- Topic: records\n--\n-- One\n-- two.\n--\n-- Three.\n-- Columns:\n"
    query = parse("q", text + "--   a (mm): first\n--     second\nSELECT 1")
    assert query.description == "One two.\n\nThree."
    assert query.columns[0].meaning == "first second"
    assert query.columns[0].unit == "mm"


# What they find


def test_surface_types(samples: Lake):
    rows = ask(samples, "surface_types")
    assert tuple(row["type"] for row in rows) == SURFACE_TYPES
    assert [row["patches"] for row in rows] == list(samples.info().patches.values())
    assert sum(row["share"] for row in rows) == pytest.approx(1)
    assert sum(row["area_share"] for row in rows) == pytest.approx(1)
    assert all(row["models"] >= 1 for row in rows)


def test_curve_types(samples: Lake):
    rows = by(ask(samples, "curve_types"), "type")
    assert set(rows) == set(CURVE_TYPES)
    assert {t: row["curves"] for t, row in rows.items()} == samples.info().curves
    assert [t for t, row in rows.items() if row["paper_type"] == "Other"] == [
        "Parabola", "Hyperbola", "Other",
    ]  # fmt: skip


@pytest.mark.parametrize("name", HISTOGRAMS)
def test_histograms(samples: Lake, name: str):
    column = f"n_{name.removesuffix('_per_model')}"
    rows = ask(samples, name, bin=7, last=100)
    counts = [n for (n,) in samples.sql(f"SELECT {column} FROM models").fetchall()]
    assert [row["low"] for row in rows] == [*range(0, 100, 7), 100]
    assert rows[-2]["high"] == 99
    assert rows[-1]["high"] is None
    for row in rows:
        high = float("inf") if row["high"] is None else row["high"]
        assert row["models"] == sum(row["low"] <= n <= high for n in counts)
    assert rows[-1]["cumulative"] == pytest.approx(1)
    with pytest.raises(Exception, match="bin must be at least 1"):
        ask(samples, name, bin=0)


def test_complexity(samples: Lake):
    rows = by(ask(samples, "complexity"), "measure")
    patches = sorted(n for (n,) in samples.sql("SELECT n_patches FROM models").fetchall())
    row = rows["n_patches"]
    assert (row["least"], row["most"], row["total"]) == (patches[0], patches[-1], sum(patches))
    assert row["median"] == (patches[10] + patches[11]) / 2
    assert rows["volume"]["models"] == 21  # duct_surface is a sheet


def test_surface_mixes(samples: Lake):
    rows = by(ask(samples, "surface_mixes"), "types")
    assert sum(row["models"] for row in rows.values()) == 22
    assert rows["Sphere"]["example"] == "ball_steel"
    assert "bellows" not in rows["BSpline"]["example"]


def test_neighbours(samples: Lake):
    rows = ask(samples, "neighbours", where="name = 'base_plate_mm'")
    found = {(row["type_a"], row["type_b"]): row for row in rows}
    rounds = found["Cylinder", "Plane"]
    assert rounds["smooth"] == 8  # four rounded corners with two sides each
    assert rounds["mixed"] == 0
    assert rounds["concave"] == 1  # the foot of the boss
    assert found["Plane", "Plane"]["mean_angle"] == pytest.approx(1.5708, abs=1e-3)
    every = ask(samples, "neighbours")
    assert all(r["smooth"] + r["convex"] + r["concave"] + r["mixed"] == r["pairs"] for r in every)
    assert sum(row["share"] for row in every) == pytest.approx(1)
    assert all(row["type_a"] <= row["type_b"] for row in every)


def test_spline_degrees(samples: Lake):
    rows = ask(samples, "spline_degrees")
    assert sum(row["patches"] for row in rows) == samples.info().patches["BSpline"]
    assert any(row["rational"] for row in rows)
    assert all(1 <= row["low_degree"] <= row["high_degree"] for row in rows)


def test_torus_rich(samples: Lake):
    assert set(by(ask(samples, "torus_rich"))) == {"bellows", "spindle_grip"}
    assert "bellows" not in by(ask(samples, "torus_rich", more_than=10_000))


def test_freeform_share(samples: Lake):
    rows = by(ask(samples, "freeform_share"))
    for name in ("panel_offset", "duct_surface", "nozzle_nurbs", "gasket_wave"):
        assert rows[name]["share"] == pytest.approx(1)
    assert "gear_spur" not in rows
    assert by(ask(samples, "freeform_share", min_share=0))["hinge"]["freeform_patches"] == 0


def test_fillets(features: Lake, samples: Lake):
    rows = by(ask(features, "fillets"))
    assert (rows["dice"]["fillets"], rows["dice"]["rounds"]) == (0, 20)  # 12 edges, 8 corners
    assert rows["dice"]["most_radius"] == pytest.approx(2.5)
    assert "manifold_block" not in rows
    assert rows["enclosure"]["fillets"] > 0
    assert set(by(ask(features, "fillets", min_radius=3.5))) == {"block_machined", "enclosure"}
    assert "dice" in by(ask(features, "fillets", max_radius=2.6))
    plate = by(ask(samples, "fillets"))["base_plate_inch"]
    assert plate["rounds"] == 4
    assert plate["least_radius"] == pytest.approx(25.4 / 4)


def test_fillet_radii(features: Lake):
    rows = by(ask(features, "fillet_radii"), "radius")
    assert rows[2.5] == {"radius": 2.5, "fillets": 0, "rounds": 20, "models": 1}
    assert ask(features, "fillet_radii", min_models=5) == []


def test_holes(features: Lake, samples: Lake):
    rows = by(ask(features, "holes"), "radius")
    assert (rows[16]["stepped"], rows[11]["through"]) == (1, 1)  # counterbore of block_machined
    assert (rows[9]["stepped"], rows[3.2]["through"]) == (3, 4)  # ports of manifold_block
    assert (rows[1.6]["blind"], rows[1.6]["least_depth"]) == (4, pytest.approx(26.5))
    plates = by(ask(samples, "holes", where="name LIKE 'base_plate%'"), "radius")
    assert plates[12.7]["through"] == 2
    assert plates[4.763]["through"] + plates.get(4.762, {"through": 0})["through"] == 8
    assert all(row["radius"] >= 5 for row in ask(features, "holes", min_radius=5))
    assert all(row["radius"] <= 5 for row in ask(features, "holes", max_radius=5))


def test_holes_are_one_however_their_wall_is_cut(features: Lake):
    rows = features.sql("SELECT len(patches), depth, high - low FROM holes").fetchall()
    assert all(n >= 1 and depth == pytest.approx(extent) for n, depth, extent in rows)
    axis = "SELECT axis.x * foot.x + axis.y * foot.y + axis.z * foot.z FROM holes"
    assert all(abs(dot) < 1e-9 for (dot,) in features.sql(axis).fetchall())


def test_hole_patterns(samples: Lake, features: Lake):
    flange = [r for r in ask(samples, "hole_patterns") if r["name"] == "flange_joint"]
    assert [(r["holes"], r["pattern"]) for r in flange] == [(8, "circle")] * 2
    assert flange[0]["circle_radius"] == pytest.approx(80)
    plate = next(r for r in ask(samples, "hole_patterns") if r["name"] == "base_plate_mm")
    assert (plate["holes"], plate["pattern"]) == (4, "rectangle")
    assert plate["radius"] == pytest.approx(4.7625)
    ports = [r for r in ask(features, "hole_patterns") if r["name"] == "manifold_block"]
    assert {(r["radius"], r["pattern"]) for r in ports} == {
        (5.0, "row"), (9.0, "row"), (3.2, "rectangle"),
    }  # fmt: skip
    assert all(r["holes"] >= 8 for r in ask(samples, "hole_patterns", min_holes=8))


def test_counterbores(features: Lake):
    rows = ask(features, "counterbores")
    block = next(row for row in rows if row["name"] == "block_machined")
    assert (block["radius"], block["head_radius"], block["head_depth"]) == pytest.approx(
        (11, 16, 6)
    )
    assert [row["name"] for row in rows].count("manifold_block") == 3


def test_turned_parts(samples: Lake):
    rows = {row["name"] for row in ask(samples, "turned_parts")}
    assert {"plumb_bob", "spindle_grip", "bellows"} & rows
    assert not {"gear_spur", "base_plate_mm", "gasket_wave"} & rows
    everything = ask(samples, "turned_parts", min_share=0)
    assert all(0 < row["share"] <= 1 + 1e-6 for row in everything)


HELICES = """
CREATE OR REPLACE VIEW patches AS SELECT
    $id AS model_id, 0 AS patch_id, 'Cylinder' AS type, 2.0 AS radius,
    {'x': 1.0, 'y': 0.0, 'z': 0.0} AS x_axis, {'x': 0.0, 'y': 1.0, 'z': 0.0} AS y_axis,
    {'x': 0.0, 'y': 0.0, 'z': 1.0} AS z_axis;
CREATE OR REPLACE VIEW coedges AS SELECT
    $id AS model_id, 0 AS patch_id, unnest([5, 6, 9]) AS curve_id, unnest([7, 8, 9]) AS pcurve,
    0.0 AS t_min, unnest([$length, 1.0, 1.0]) AS t_max;
CREATE OR REPLACE VIEW pcurves AS
    SELECT
        $id AS model_id, 7 AS pcurve_id, 'Line' AS type, NULL::INT AS basis,
        NULL AS knots, NULL AS poles,
        {'u': 3 * pi() / $length, 'v': 4.5 / $length} AS direction
    UNION ALL BY NAME
    SELECT
        $id AS model_id, 8 AS pcurve_id, 'BSpline' AS type, [0.0, 0, 1, 1] AS knots,
        [{'u': 0.0, 'v': 1.0}, {'u': -3 * pi(), 'v': 5.5}] AS poles
    UNION ALL BY NAME
    SELECT
        $id AS model_id, 9 AS pcurve_id, 'BSpline' AS type, [0.0, 0, 0, 1, 1, 1] AS knots,
        [{'u': 0.0, 'v': 1.0}, {'u': 3.0, 'v': 1.0}, {'u': 6.0, 'v': 5.5}] AS poles;
"""
"""Curves on a cylinder of radius 2: a line and a spline of one and a half turns and pitch 3, one
rising to the right and one to the left, and a spline that bends and so is no helix."""


def test_helices(tiny_lake: Path):
    lake = breplake.open(tiny_lake)
    length = ((3 * math.pi) ** 2 + 4.5**2) ** 0.5  # of the line in the parameter plane
    values = {"$id": f"{lake.model('big')['model_id']}::BIGINT", "$length": str(length)}
    text = HELICES
    for name, value in values.items():
        text = text.replace(name, value)
    lake.connection.execute(text)
    rows = ask(lake, "helices")
    assert {(row["pitch"], row["handed"], row["helices"]) for row in rows} == {
        (3, "left", 1), (3, "right", 1),
    }  # fmt: skip
    assert all(row["turns"] == row["all_turns"] == pytest.approx(1.5) for row in rows)
    assert ask(lake, "helices", min_turns=2) == []


def test_a_thread_is_found(features: Lake):
    (row,) = ask(features, "helices")
    assert (row["name"], row["handed"], row["pitch"]) == ("lead_screw", "right", 5)
    assert row["all_turns"] > 10
    assert row["least_radius"] == row["most_radius"] == pytest.approx(8)


def test_thin_walled(samples: Lake):
    rows = {row["name"]: row for row in ask(samples, "thin_walled")}
    assert {"bellows", "gasket_wave", "trough_parabolic"} <= set(rows)
    assert not {"ball_steel", "base_plate_mm"} & set(rows)
    assert rows["bellows"]["thickness"] == pytest.approx(0.6, abs=0.01)


def test_sharp_share(samples: Lake):
    rows = by(ask(samples, "sharp_share"))
    assert rows["hinge"]["share"] <= 1
    assert rows["plumb_bob"]["sharp_curves"] == samples.model("plumb_bob")["n_sharp_curves"]
    assert "ball_steel" not in rows  # its one curve is a seam
    assert all(row["share"] >= 0.9 for row in ask(samples, "sharp_share", min_share=0.9))


def test_genus(samples: Lake):
    rows = by(ask(samples, "genus"))
    assert rows["ball_steel"]["genus"] == rows["weight_lemon"]["genus"] == 0
    assert rows["mug"]["genus"] == rows["gear_spur"]["genus"] == 1
    assert rows["base_plate_mm"]["genus"] == 5  # its holes
    assert "duct_surface" not in rows  # open
    assert min(row["genus"] for row in ask(samples, "genus", min_genus=2)) == 2


def test_mirror_symmetry(samples: Lake):
    rows = by(ask(samples, "mirror_symmetry"))
    assert rows["trough_parabolic"]["x"] == rows["trough_parabolic"]["y"] == 1
    assert rows["trough_parabolic"]["z"] is None
    assert "ball_steel" not in rows  # too few corners
    assert "gear_spur" in rows


def test_repeated_parts(samples: Lake):
    rows = {row["part"]: row for row in ask(samples, "repeated_parts", model="flange_joint")}
    assert (rows["bolt"]["copies"], rows["nut"]["copies"], rows["flange"]["copies"]) == (8, 8, 2)
    mirrored = ask(samples, "repeated_parts", model="shelf_brackets")
    assert {row["copies"] for row in mirrored} == {2}
    assert len(ask(samples, "repeated_parts", model="ball_steel", min_copies=1)) == 1


def test_largest_models(samples: Lake):
    rows = ask(samples, "largest_models", limit=3)
    values = [n for (n,) in samples.sql("SELECT n_patches FROM models").fetchall()]
    assert [row["value"] for row in rows] == sorted(values, reverse=True)[:3]
    assert len(ask(samples, "largest_models", by="volume")) <= 20
    with pytest.raises(Exception, match="by is patches, curves"):
        ask(samples, "largest_models", by="weight")


def test_duplicates(samples: Lake):
    (cluster,) = ask(samples, "duplicates")
    assert cluster["names"] == ["base_plate_inch", "base_plate_mm"]
    assert cluster["models"] == 2
    assert ask(samples, "duplicates", min_models=3) == []


def test_invalid_models(samples: Lake):
    rows = by(ask(samples, "invalid_models"))
    assert rows["duct_surface"]["faults"] == ["open"]
    assert rows["duct_surface"]["boundary_curves"] == 2
    assert "base_plate_mm" not in rows
    assert "tolerance" in by(ask(samples, "invalid_models", max_tolerance=0))["mug"]["faults"]


def test_mesh_quality(samples: Lake, tiny_lake: Path):
    rows = by(ask(samples, "mesh_quality", min_angle=2.0))
    assert len(rows) == 22
    assert all("angle" in row["faults"] for row in rows.values())
    assert "holes" not in {f for row in rows.values() for f in row["faults"]}
    assert by(ask(breplake.open(tiny_lake), "mesh_quality"))["bare"]["faults"] == ["no mesh"]


def test_tiny_features(samples: Lake):
    every = ask(samples, "tiny_features", max_ratio=10)
    assert {row["feature"] for row in every} == {"curve", "patch"}
    box = [r for r in every if r["name"] == "base_plate_mm" and r["feature"] == "patch"]
    assert len(box) == samples.model("base_plate_mm")["n_patches"]
    assert all(row["ratio"] <= 1e-2 for row in ask(samples, "tiny_features", max_ratio=1e-2))


def test_benchmark_candidates(samples: Lake):
    rows = by(ask(samples, "benchmark_candidates", min_bytes=0))
    assert "ball_steel" not in rows  # a single primitive
    assert {"mug", "bellows", "base_plate_inch", "base_plate_mm"} <= set(rows)
    unique = by(ask(samples, "benchmark_candidates", min_bytes=0, unique=True))
    assert set(rows) - set(unique) == {"base_plate_mm"}
    assert ask(samples, "benchmark_candidates", max_faces=10) == []
    assert ask(samples, "benchmark_candidates", min_vertices=10**8) == []


@pytest.mark.parametrize(
    "given", [{}, {"min_bytes": 0, "unique": True}, {"max_faces": 900, "min_vertices": 0}]
)
def test_every_input_is_a_candidate_or_rejected(samples: Lake, tiny_lake: Path, given: dict):
    for lake in (samples, breplake.open(tiny_lake)):
        taken, rejected = (
            by(ask(lake, name, **given), "model_id")
            for name in ("benchmark_candidates", "benchmark_rejects")
        )
        query = "SELECT model_id FROM models UNION SELECT model_id FROM failures WHERE fatal"
        assert sorted([*taken, *rejected]) == sorted(row for (row,) in lake.sql(query).fetchall())
        assert all(row["reasons"] for row in rejected.values())


def test_benchmark_rejects(samples: Lake, tiny_lake: Path):
    none = {"min_bytes": 0, "min_vertices": 0}
    reasons = {row["name"]: row["reasons"] for row in ask(samples, "benchmark_rejects", **none)}
    assert reasons["ball_steel"] == ["single-primitive"]
    assert "mug" not in reasons
    ball = by(ask(samples, "benchmark_rejects", max_faces=10))["ball_steel"]
    assert ball["reasons"][:2] == ["nearly-empty", "single-primitive"]
    assert "mesh-too-large" in ball["reasons"]
    unique = by(ask(samples, "benchmark_rejects", min_bytes=0, unique=True))
    assert unique["base_plate_mm"]["reasons"] == ["duplicate"]
    assert "base_plate_inch" not in unique
    failed = by(ask(breplake.open(tiny_lake), "benchmark_rejects", **none))
    assert "not-cad" in failed["broken"]["reasons"]


def test_licences(tiny_lake: Path):
    lake = breplake.open(tiny_lake)
    lake.connection.execute(
        "CREATE TABLE given AS SELECT * REPLACE (if(name = 'big', 'MIT', NULL) AS licence, "
        "if(name = 'big', 'Ada', NULL) AS owner) FROM models"
    )
    lake.connection.execute("CREATE OR REPLACE VIEW models AS FROM given")
    rows = ask(lake, "licences")
    assert [(r["licence"], r["owner"], r["models"]) for r in rows] == [
        (None, None, 4),
        ("MIT", "Ada", 1),
    ]
    assert rows[1]["example"] == "big"


def test_failures_by_kind(tiny_lake: Path):
    rows = by(ask(breplake.open(tiny_lake), "failures_by_kind"), "kind")
    assert (rows["not-cad"]["fatal"], rows["not-cad"]["example"]) == (True, "broken")
    assert rows["timeout"]["message"] == "took longer than 1 s"
    assert ask(breplake.open(tiny_lake, 1), "failures_by_kind") == []


def test_ingest_cost(samples: Lake):
    rows = by(ask(samples, "ingest_cost"), "stage")
    assert rows["total"]["share"] == 1
    stages = sum(rows[stage]["total"] for stage in ("load", "brep", "mesh", "truth", "write"))
    assert 0 < stages <= rows["total"]["total"]
    assert rows["mesh"]["models"] == 22


def test_length_units(samples: Lake):
    rows = {row["length_unit"]: row for row in ask(samples, "length_units")}
    assert sum(row["models"] for row in rows.values()) == 22
    assert {row["scale_to_mm"] for row in rows.values()} == {1.0, 25.4}


def test_collections(samples: Lake):
    (row,) = ask(samples, "collections")
    assert (row["models"], row["duplicates"], row["meshed_share"]) == (22, 1, 1)
    assert row["closed_share"] == pytest.approx(21 / 22)
    assert row["patches"] == sum(samples.info().patches.values())


def test_every_query_has_a_test_of_its_content():
    tests = {name for name in globals() if name.startswith("test_")} | {"test_histograms"}
    missing = [n for n in QUERIES if f"test_{n}" not in tests and n not in HISTOGRAMS]
    assert missing == []


# The command


@pytest.fixture
def call(tiny_lake: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("BREPLAKE", str(tiny_lake))
    return lambda *arguments: CliRunner().invoke(app, ["query", *map(str, arguments)])


def test_command_lists_all(call):
    for arguments in ((), ("--list",)):
        text = call(*arguments).stdout
        assert all(f"  {name} " in text for name in QUERIES)
        assert all(title in text for title in TOPICS.values())


def test_command_describes(call):
    text = call("fillets", "--describe").stdout
    assert "least_radius" in text
    assert re.search(r"min_radius +DOUBLE = 0 \(mm\) +least radius", text)
    assert re.search(r"max_radius +DOUBLE = NULL \(mm\)", text)
    assert call("fillets", "--sql").stdout == QUERIES["fillets"].sql


def test_command_runs(call):
    result = call("largest_models", "-p", "by=volume", "--param", "limit=1", "-f", "csv")
    assert [line.split(",")[1:4] for line in result.stdout.splitlines()] == [
        ["collection", "name", "value"], ["boxes", "big", "120.0"],
    ]  # fmt: skip
    result = call("largest_models", "--where", "name <> 'big'", "-p", "limit=1", "-f", "csv")
    assert ",big," not in result.stdout
    assert call("collections", "--at", 1, "-f", "csv").stdout.splitlines()[1].startswith("boxes,2,")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("filets",), "did you mean fillets"),
        (("fillets", "-p", "radius=1"), "no parameter 'radius': did you mean"),
        (("fillets", "-p", "min_radius"), "--param takes NAME=VALUE"),
        (("fillets", "-p", "min_radius=x"), "min_radius is a number, got 'x'"),
        (("largest_models", "-p", "by=weight"), "by is patches, curves"),
        (("patches_per_model", "-p", "bin=0"), "bin must be at least 1"),
        (("holes", "--where", "nme = 1"), "nme"),
        (("holes", "--lake", "/nowhere"), "there is no lake"),
    ],
)
def test_command_errors(call, arguments: tuple[str, ...], message: str):
    result = call(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert message in line
