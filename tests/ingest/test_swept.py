"""Areas of swept patches against closed forms that Open CASCADE's quadrature misses."""

import math

import numpy as np
import pytest

cq = pytest.importorskip("cadquery")


def test_an_extruded_spline_is_as_large_as_it_is_long(ingest_shape):
    x = np.linspace(0, 40, 25)
    points = list(zip(x.tolist(), (3 * np.sin(x / 3)).tolist(), strict=True))
    block = cq.Workplane().spline(points).lineTo(40, -20).lineTo(0, -20).close().extrude(7.0)
    record = ingest_shape(block.val(), max_edge=0.2)
    types = record.tables["patches"]["type"].to_pylist()
    area = record.column("patches", "area")
    long = record.column("curves", "length").max()
    assert long > 40
    assert area[types.index("Extrusion")] == pytest.approx(7 * long, rel=1e-8)
    assert record.model["area"] == pytest.approx(area.sum(), rel=1e-12)
    np.testing.assert_allclose(record.column("parts", "area"), area.sum(), rtol=1e-12)


def test_a_cylinder_of_an_ellipse(ingest_shape):
    """The perimeter of an ellipse is a complete elliptic integral."""
    special = pytest.importorskip("scipy.special")
    record = ingest_shape(cq.Workplane().ellipse(9, 2).extrude(5.0).val(), max_edge=0.2)
    types = record.tables["patches"]["type"].to_pylist()
    area = record.column("patches", "area")
    around = 4 * 9 * special.ellipe(1 - (2 / 9) ** 2)
    assert area[types.index("Extrusion")] == pytest.approx(5 * around, rel=1e-9)
    assert record.model["area"] == pytest.approx(5 * around + 2 * math.pi * 18, rel=1e-9)
    np.testing.assert_allclose(record.column("parts", "area"), area.sum(), rtol=1e-12)


def test_a_revolved_ellipse(ingest_shape):
    """A torus with an ellipse for its tube: its perimeter times the way of its centre."""
    special = pytest.importorskip("scipy.special")
    ring = cq.Workplane("XZ").center(20, 0).ellipse(4, 1.5).revolve(360, (-20, 0), (-20, 1))
    # Gmsh all but hangs on it, and a hang of Gmsh ends the process: that of the tests.
    record = ingest_shape(ring.val(), rung=2, max_edge=0.2)
    assert record.tables["patches"]["type"].to_pylist() == ["Revolution"]
    around = 4 * 4 * special.ellipe(1 - (1.5 / 4) ** 2)
    (area,) = record.column("patches", "area")
    assert area == pytest.approx(2 * math.pi * 20 * around, rel=1e-9)
