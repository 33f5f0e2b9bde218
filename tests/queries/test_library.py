"""The query library as a whole: headers, parameters, narrowing down.

What each query finds is tested in the file of its topic.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import breplake
from breplake.errors import NameNotFoundError, UsageError
from breplake.queries.named import TOPICS, named_query, parse
from breplake.queries.session import Lake

from .library import HISTOGRAMS, QUERIES, ask, by

OF_FAILURES = ("benchmark_rejects", "failures_by_kind")


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
    if name in OF_FAILURES:
        return
    counted = samples.query(name, where="false").to_arrow_table().to_pylist()
    if query_counts_all := name in ("surface_types", "curve_types", *HISTOGRAMS):
        counts = [row.get("models", 0) for row in counted]
        assert set(counts) == {0}
    assert counted == [] or query_counts_all


@pytest.mark.parametrize("name", [name for name in QUERIES if name not in OF_FAILURES])
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


@pytest.mark.parametrize("name", OF_FAILURES)
def test_failures_cannot_be_narrowed_down(name: str, tiny_lake: Path):
    lake = breplake.open(tiny_lake)
    assert lake.query(name).fetchall()
    with pytest.raises(UsageError, match="this query reads failures"):
        lake.query(name, where="n_patches < 100")


def test_every_query_has_a_test_of_its_content():
    files = {t: Path(__file__).with_name(f"test_library_{t}.py").read_text() for t in TOPICS}
    untested = [
        name
        for name, query in QUERIES.items()
        if f"def test_{name}(" not in files[query.topic] and name not in HISTOGRAMS
    ]
    assert untested == []


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
