"""The rules on shapes and coedges catch the fault they are for, on a real part."""

import pyarrow as pa
import pytest

from breplake.queries.check.ids import REFERENCES
from breplake.queries.check.rules import MODEL_RULES, Tally
from breplake.queries.check.run import ORDERED_RULES, check_model
from breplake.queries.check.view import ModelView
from breplake.schema.shape_tables import SHAPE_TABLES
from breplake.schema.tables import TABLES

STORED = {table.name for table in SHAPE_TABLES}
RULES = ("shape-graph", "placements", "shape-rows", "edge-curves")
COEDGE_RULES = ("coedge-pcurves", "pcurve-on-curve", "pcurve-loops", "trimmed-areas")


@pytest.fixture(scope="module")
def model(sample_lake):
    """Rows of an assembly with located parts and curved patches, by table."""
    import breplake

    lake = breplake.open(sample_lake)
    (name, model_id), *_ = lake.sql(
        """
        SELECT m.name, m.model_id FROM models m
        WHERE m.n_cylinder > 0 AND EXISTS (FROM motions o WHERE o.model_id = m.model_id)
        ORDER BY m.n_patches
        """
    ).fetchall()
    tables = {t: lake.read(t, model_id) for t in TABLES if t not in ("failures", "models")}
    return lake.model(name), tables


def broken(model, table=None, spoil=None):
    row, tables = model
    if table is not None:
        rows = tables[table].to_pylist()
        spoil(rows)
        tables = tables | {table: pa.Table.from_pylist(rows, schema=TABLES[table].schema)}
    tallies = {name: Tally(rule) for name, rule in ORDERED_RULES.items()}
    check_model(ModelView(row, tables), tallies)
    return {n for n, tally in tallies.items() if tally.failed and n in (*RULES, *COEDGE_RULES)}


def first(rows, **wanted):
    return next(r for r in rows if all(r[k] == v for k, v in wanted.items()))


def far_child(rows):
    first(rows, type="shell")["children"][0]["shape"] = 10**6


def odd_orientation(rows):
    first(rows, type="wire")["children"][0]["orientation"] = "sideways"


def solid_in_face(rows):
    solid = first(rows, type="solid")["shape_id"]
    first(rows, type="face")["children"][0]["shape"] = solid


def lost_face(rows):
    first(rows, type="shell")["children"].pop()


def far_motion(rows):
    rows[0]["children"][0]["placement"] = [{"motion": 99, "power": 1}]


def wrong_shape(rows):
    rows[0]["shape"] = 0


def no_shape(rows):
    rows[0]["shape"] = None


def curve_without_range(rows):
    first(rows, kind="curve")["t_max"] = None


def pcurve_without_surface(rows):
    first(rows, kind="pcurve")["surface"] = None


def no_pcurve(rows):
    row = next(r for r in rows if r["pcurve"] is not None)
    row.update(pcurve=None, t_min=None, t_max=None)


def no_range(rows):
    next(r for r in rows if r["pcurve"] is not None)["t_min"] = None


def moved_pcurve(rows):
    row = next(r for r in rows if r["location"] is not None)
    row["location"] = {"u": row["location"]["u"], "v": row["location"]["v"] + 0.5}


def wrong_area(rows):
    max(rows, key=lambda row: row["area"])["area"] *= 1.001


@pytest.mark.parametrize(
    ("table", "spoil", "rule"),
    [
        ("shapes", far_child, "shape-graph"),
        ("shapes", odd_orientation, "shape-graph"),
        ("shapes", solid_in_face, "shape-graph"),
        ("shapes", lost_face, "shape-graph"),
        ("shapes", far_motion, "placements"),
        ("patches", wrong_shape, "shape-rows"),
        ("curves", no_shape, "shape-rows"),
        ("edge_curves", curve_without_range, "edge-curves"),
        ("edge_curves", pcurve_without_surface, "edge-curves"),
        ("coedges", no_pcurve, "coedge-pcurves"),
        ("coedges", no_range, "coedge-pcurves"),
        ("pcurves", moved_pcurve, "pcurve-on-curve"),
        ("patches", wrong_area, "trimmed-areas"),
    ],
)
def test_a_fault_breaks_its_rule(model, table, spoil, rule):
    assert rule in broken(model, table, spoil)


def test_a_faultless_model_breaks_none(model):
    assert not broken(model)


def test_a_pcurve_that_ends_elsewhere_opens_its_loop(model):
    def shorten(rows):
        row = next(r for r in rows if r["pcurve"] is not None and r["t_max"] - r["t_min"] > 0.1)
        row["t_max"] -= 0.1

    assert "pcurve-loops" in broken(model, "coedges", shorten)


def test_every_rule_here_is_registered():
    assert set(RULES) | set(COEDGE_RULES) <= set(MODEL_RULES)


@pytest.mark.parametrize("reference", [r for r in REFERENCES if r[0] in STORED])
def test_references_of_stored_shapes(model, reference):
    table, column, *_ = reference
    rows = model[1][table].to_pylist()
    if not rows:
        pytest.skip(f"the part has no {table}")
    rows[0][column] = 10**6
    tables = model[1] | {table: pa.Table.from_pylist(rows, schema=TABLES[table].schema)}
    tally = Tally(MODEL_RULES["references"])
    for measure in MODEL_RULES["references"].measure(ModelView(model[0], tables)):
        tally.add(measure, "model")
    assert tally.failed == 1
