"""Rows to Arrow and back without losing a bit."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from breplake.ingest.lossless.columns import column_array, column_values, rows_table, table_rows
from breplake.schema.contract import VEC3
from breplake.schema.shape_tables import PLACEMENT, SPACE_CURVES

NUMBERS = st.floats(allow_nan=False)


def same(a, b):
    """Equal bits: NaN is not made, and -0.0 is not 0.0."""
    if a is None or b is None:
        return a is b
    return np.asarray(a).tobytes() == np.asarray(b).tobytes() and np.shape(a) == np.shape(b)


def grids(*last: int):
    shape = st.tuples(st.integers(1, 4), st.integers(1, 4))
    return shape.flatmap(lambda s: arrays.arrays(np.float64, (*s, *last), elements=NUMBERS))


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (pa.float64(), NUMBERS),
        (VEC3, st.tuples(NUMBERS, NUMBERS, NUMBERS)),
        (
            pa.list_(pa.float64()),
            arrays.arrays(np.float64, st.integers(0, 5), elements=NUMBERS),
        ),
        (
            pa.list_(VEC3),
            arrays.arrays(np.float64, st.tuples(st.integers(0, 5), st.just(3)), elements=NUMBERS),
        ),
        (pa.list_(pa.list_(VEC3)), grids(3)),
        (pa.list_(pa.list_(pa.float64())), grids()),
    ],
    ids=str,
)
def test_columns_come_back(kind, values):
    @given(st.lists(st.none() | values, max_size=6))
    def check(rows):
        array = column_array(kind, rows)
        assert array.type == kind
        assert array.null_count == sum(row is None for row in rows)
        back = column_values(pa.chunked_array([array]))
        assert len(back) == len(rows)
        assert all(same(a, b) for a, b in zip(rows, back, strict=True))
        # a table is read in pieces
        cut = pa.chunked_array([array[:2], array[2:]])
        assert all(same(a, b) for a, b in zip(rows, column_values(cut), strict=True))

    check()


def test_placements_are_whole_numbers():
    array = column_array(PLACEMENT, [((3, -1), (0, 2)), ()])
    assert array.to_pylist() == [[{"motion": 3, "power": -1}, {"motion": 0, "power": 2}], []]
    back = column_values(pa.chunked_array([array]))
    assert back[0].tolist() == [[3, -1], [0, 2]]
    assert len(back[1]) == 0


def test_rows_and_tables():
    row = {"space_curve_id": 0, "type": "Line", "location": (1.0, 2.0, 3.0)}
    table = rows_table(SPACE_CURVES, 7, [row])
    assert table.schema == SPACE_CURVES.schema
    (back,) = table_rows(table)
    assert {k: v for k, v in back.items() if v is not None} == {"model_id": 7, **row}
    assert table_rows(rows_table(SPACE_CURVES, 7, [])) == []
    with pytest.raises(KeyError, match="offfset"):
        rows_table(SPACE_CURVES, 7, [row | {"offfset": 1.0}])
    with pytest.raises(pa.ArrowInvalid, match=r"space_curves\.type"):
        rows_table(SPACE_CURVES, 7, [{"space_curve_id": 0}])
