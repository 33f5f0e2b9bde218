"""Knots with multiplicities and without, there and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from breplake.ingest.lossless.knots import flat_knots, grouped_knots


@st.composite
def splines(draw, periodic: bool):
    """Degree, distinct knots and multiplicities as OCCT accepts them."""
    degree = draw(st.integers(1, 9))
    inner = draw(st.lists(st.integers(1, degree), max_size=8))
    first = draw(st.integers(1, degree if periodic else degree + 1))
    last = first if periodic else draw(st.integers(1, degree + 1))
    steps = st.floats(1e-6, 1e6, allow_nan=False)
    start = draw(st.floats(-1e6, 1e6, allow_nan=False))
    knots = np.cumsum([start, *(draw(steps) for _ in range(len(inner) + 1))])
    times = np.array([first, *inner, last])
    n_poles = times[:-1].sum() if periodic else times.sum() - degree - 1
    return degree, knots, times, int(n_poles)


@given(splines(periodic=False))
def test_grouping_undoes_flattening(spline):
    _, knots, times, n_poles = spline
    found, counts = grouped_knots(flat_knots(knots, times, None), n_poles, None)
    assert found.tolist() == knots.tolist()
    assert counts.tolist() == times.tolist()


@given(splines(periodic=True))
def test_grouping_undoes_the_turns_of_a_periodic_spline(spline):
    degree, knots, times, n_poles = spline
    flat = flat_knots(knots, times, degree)
    found, counts = grouped_knots(flat, n_poles, degree)
    assert found.tolist() == knots.tolist()  # the last one too: no sum of first and period
    assert counts.tolist() == times.tolist()
    assert len(flat) == n_poles + 2 * (degree + 1) - times[0]


@pytest.mark.parametrize("degree", [2, 3])
def test_periodic_turns_repeat(degree):
    flat = np.array(flat_knots([0, 1, 3, 4], [1, 2, 1, 1], degree))
    np.testing.assert_array_equal(flat[degree:-degree], [0, 1, 1, 3, 4])
    # four knots a turn, and a turn is four long
    np.testing.assert_array_equal(flat[4:], flat[:-4] + 4)
