"""The data dictionary says everything that the contract says."""

from __future__ import annotations

import pyarrow as pa
import pytest

from breplake.schema.arrays import ARRAYS
from breplake.schema.contract import VEC3, Column, Table
from breplake.schema.dictionary import dictionary, table_section, type_name
from breplake.schema.tables import TABLES

PAGE = dictionary()


def section(name: str) -> str:
    return PAGE.partition(f"\n## {name}\n")[2].partition("\n## ")[0]


@pytest.mark.parametrize("table", TABLES.values(), ids=lambda t: t.name)
def test_every_column_is_there_once_and_in_order(table: Table):
    rows = [line for line in section(table.name).splitlines() if line.startswith("| `")]
    assert [row.split("`")[1] for row in rows] == [column.name for column in table.columns]
    for row, column in zip(rows, table.columns, strict=True):
        assert row.count(" | ") == 4
        assert ("| null |" in row) == column.nullable
        assert column.description.replace("|", "\\|") in row


def test_every_array_is_there():
    rows = [line for line in section("Arrays").splitlines() if line.startswith("| `")]
    assert [row.split("`")[1] for row in rows] == list(ARRAYS)
    assert "| `position` | float32 | (n, 3) | vertex |" in PAGE
    assert "| `patch` | int32 | (n,) | normal |" in PAGE


def test_a_bar_in_a_description_does_not_end_the_cell():
    table = Table("t", "a thing", (Column("a", pa.int32(), "|x|", "mm"),), key=("a",))
    assert "| `a` | int32 | mm |  | \\|x\\| |" in table_section(table)


def test_type_names():
    assert type_name(pa.list_(pa.list_(VEC3))) == "list of list of vec3"
    assert type_name(pa.map_(pa.string(), pa.string())) == "map of string to string"
    with pytest.raises(KeyError, match="decimal"):
        type_name(pa.decimal128(5))
