"""Lines and conics, and how a set of curves answers queries."""

import numpy as np
import pyarrow as pa
import pytest

from breplake.errors import UsageError
from breplake.schema.curves import CurveSet
from breplake.schema.tables import CURVES


def vec(*p):
    return dict(zip("xyz", map(float, p), strict=True))


AT = {"location": vec(1, 2, 3), "x_axis": vec(0, 1, 0), "y_axis": vec(0, 0, 1)}
ROWS = (
    {"type": "Line", "location": vec(1, 2, 3), "direction": vec(0, 0.6, 0.8)},
    {"type": "Circle", "radius": 2.0, **AT},
    {"type": "Ellipse", "x_radius": 3.0, "y_radius": 2.0, **AT},
    {"type": "Parabola", "focal": 0.5, **AT},
    {"type": "Hyperbola", "x_radius": 3.0, "y_radius": 2.0, **AT},
    {"type": "Other"},
)


def curves(rows=ROWS):
    return CurveSet.from_curves(pa.Table.from_pylist(list(rows), CURVES.schema))


def test_closed_forms():
    t = np.linspace(-1, 1, 9)
    zero = 0 * t
    ch, sh, c, s = np.cosh(t), np.sinh(t), np.cos(t), np.sin(t)
    planar = {  # coordinates along the two axes, and their derivatives
        1: ([2 * c, 2 * s], [-2 * s, 2 * c], [-2 * c, -2 * s]),
        2: ([3 * c, 2 * s], [-3 * s, 2 * c], [-3 * c, -2 * s]),
        3: ([t * t / 2, t], [t, zero + 1], [zero + 1, zero]),
        4: ([3 * ch, 2 * sh], [3 * sh, 2 * ch], [3 * ch, 2 * sh]),
    }
    for row, expected in planar.items():
        jet = curves().evaluate(row, t)
        for found, (x, y), origin in zip(
            (jet.point, jet.d1, jet.d2), expected, ([1, 2, 3], 0, 0), strict=True
        ):
            truth = np.stack([zero, x, y], axis=1) + origin
            assert np.allclose(found, truth, rtol=0, atol=1e-15)
    line = curves().evaluate(0, t)
    assert np.allclose(line.point, [1, 2, 3] + t[:, None] * [0, 0.6, 0.8], rtol=0, atol=1e-15)
    assert np.array_equal(line.d1, np.tile([0, 0.6, 0.8], (9, 1)))
    assert not line.d2.any()


def test_focal_distances():
    """A conic is where the distances to its foci say so."""
    t = np.linspace(-2, 2, 50)
    local = curves().evaluate(2, t).point - [1, 2, 3]
    foci = [np.array([0, f, 0]) for f in (np.sqrt(5), -np.sqrt(5))]
    near, far = (np.linalg.norm(local - f, axis=1) for f in foci)
    assert np.allclose(near + far, 6, rtol=0, atol=1e-14)
    local = curves().evaluate(4, t).point - [1, 2, 3]
    foci = [np.array([0, f, 0]) for f in (np.sqrt(13), -np.sqrt(13))]
    near, far = (np.linalg.norm(local - f, axis=1) for f in foci)
    assert np.allclose(far - near, 6, rtol=0, atol=1e-14)


def test_rows_that_cannot_be_evaluated():
    rows = (*ROWS, {"type": "Circle", **AT}, {"type": "Line", "location": vec(0, 0, 0)})
    found = curves(rows)
    assert found.known.tolist() == [True] * 5 + [False] * 3
    jet = found.evaluate(np.arange(8), 0.5)
    assert np.isnan(jet.point).all(axis=1).tolist() == [False] * 5 + [True] * 3
    assert not np.isnan(jet.d2[:5]).any()


def test_order_of_rows_does_not_matter():
    rng = np.random.default_rng(0)
    rows, t = rng.integers(0, 6, 50_000), rng.uniform(-1, 1, 50_000)
    jet = curves().evaluate(rows, t)
    for row in range(5):
        alone = curves().evaluate(row, t[rows == row])
        assert np.array_equal(jet.point[rows == row], alone.point)
        assert np.array_equal(jet.d2[rows == row], alone.d2)


def test_empty():
    assert curves().evaluate([], []).point.shape == (0, 3)
    none = CurveSet.from_curves(CURVES.schema.empty_table())
    assert none.evaluate([], []).d2.shape == (0, 3)


def test_a_table_with_the_needed_columns_only_and_in_chunks():
    table = pa.concat_tables([pa.Table.from_pylist([ROWS[1]])] * 3).slice(1)
    assert table.column("radius").num_chunks == 2
    assert np.allclose(CurveSet.from_curves(table).evaluate([0, 1], 0.0).point, [1, 4, 3])


@pytest.mark.parametrize(
    ("row", "t", "words"),
    [
        ([6], [0.0], "rows lie in 0..5"),
        ([-1], [0.0], "rows lie in 0..5"),
        ([0.5], [0.0], "integers"),
        ([0, 1], [0.0, 1.0, 2.0], "one length"),
        ([[0], [1]], 0.0, "one-dimensional"),
    ],
)
def test_wrong_queries(row, t, words):
    with pytest.raises(UsageError, match=words):
        curves().evaluate(row, t)


def test_a_table_without_types():
    with pytest.raises(UsageError, match="needs the column 'type'"):
        CurveSet.from_curves(pa.table({"radius": [1.0]}))
