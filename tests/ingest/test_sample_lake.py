"""A lake of sample parts keeps every rule of ``breplake check`` and has every type."""

from __future__ import annotations

import pytest

pytest.importorskip("OCP")

import breplake
from breplake.queries.check import check_lake
from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES


def test_check_holds(sample_lake):
    report = check_lake(breplake.open(sample_lake))
    assert report.ok, report.broken


def test_every_type_occurs(sample_lake):
    lake = breplake.open(sample_lake)
    for table, types in (("patches", SURFACE_TYPES), ("curves", CURVE_TYPES)):
        found = {name for (name,) in lake.sql(f"SELECT DISTINCT type FROM {table}").fetchall()}
        assert found == set(types)
    rational = lake.sql("SELECT count(*) FROM patches WHERE u_rational").fetchall()
    assert rational[0][0] > 0


def test_many_tori(sample_lake):
    rows = breplake.open(sample_lake).sql("SELECT name FROM models WHERE n_torus > 30").fetchall()
    assert {name for (name,) in rows} == {"bellows", "spindle_grip"}


def test_nothing_failed(sample_lake):
    assert breplake.open(sample_lake).sql("SELECT * FROM failures").fetchall() == []


def test_parts_keep_names_and_colours(sample_lake):
    lake = breplake.open(sample_lake)
    joint = lake.model("flange_joint")
    parts = lake.read("parts", joint["model_id"]).to_pylist()
    assert len(parts) == joint["n_solids"] > 3
    assert all(part["name"] for part in parts)
    assert all(part["colour"].startswith("#") for part in parts)
