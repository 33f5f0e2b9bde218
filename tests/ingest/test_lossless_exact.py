"""Directions, axes and motions keep their bits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("OCP")

from OCP.gp import (
    gp_Ax1,
    gp_Ax2,
    gp_Ax3,
    gp_Ax22d,
    gp_Dir,
    gp_Dir2d,
    gp_Pnt,
    gp_Pnt2d,
    gp_Quaternion,
    gp_Trsf,
    gp_Vec,
)

from breplake.errors import LakeFormatError
from breplake.ingest.lossless import exact
from breplake.ingest.lossless.placements import motion_row

NUMBERS = st.floats(-1, 1, allow_nan=False)
VECTORS = st.tuples(NUMBERS, NUMBERS, NUMBERS).filter(lambda v: math.hypot(*v) > 1e-3)
POINTS = st.tuples(*[st.floats(-1e4, 1e4)] * 3)
TRSF = st.builds(lambda *a: turned(*a), VECTORS, NUMBERS, VECTORS, st.booleans())


def turned(axis, angle, shift, mirrored):
    motion = gp_Trsf()
    motion.SetTransformation(gp_Quaternion(gp_Vec(*axis), 7 * angle), gp_Vec(*shift))
    mirror = gp_Trsf()
    if mirrored:
        mirror.SetMirror(gp_Ax2(gp_Pnt(1, 2, 3), gp_Dir(*axis)))
    return motion.Multiplied(mirror)


def xyz(value):
    return (value.X(), value.Y(), value.Z())


def axes(frame):
    return tuple(map(xyz, (frame.XDirection(), frame.YDirection(), frame.Direction())))


def random_vectors(n, shape=(3,)):
    return np.random.default_rng(0).normal(size=(n, *shape)).tolist()


@given(VECTORS)
def test_directions_are_at_most_a_rounding_off(vector):
    wanted = xyz(gp_Dir(*vector))
    np.testing.assert_allclose(xyz(exact.direction(wanted)), wanted, rtol=0, atol=3e-16)


def test_directions_keep_their_bits():
    """A constructor alone moves a third of all directions when they are made again."""
    wanted = [xyz(gp_Dir(*vector)) for vector in random_vectors(5000)]
    again = [xyz(gp_Dir(*vector)) for vector in wanted]
    assert sum(a != b for a, b in zip(wanted, again, strict=True)) > 1000
    found = [xyz(exact.direction(vector)) for vector in wanted]
    assert sum(a != b for a, b in zip(wanted, found, strict=True)) <= 5


def test_directions_in_a_plane_keep_their_bits():
    made = [gp_Dir2d(x, y) for x, y, _ in random_vectors(5000)]
    wanted = [(d.X(), d.Y()) for d in made]
    found = [exact.direction2d(pair) for pair in wanted]
    assert sum((d.X(), d.Y()) != pair for d, pair in zip(found, wanted, strict=True)) <= 5


@settings(deadline=None)
@given(POINTS, VECTORS, VECTORS, TRSF, st.booleans())
def test_frames(point, z, x, motion, left_handed):
    if math.hypot(*np.cross(z, x)) < 1e-3:
        return
    frame = gp_Ax3(gp_Pnt(*point), gp_Dir(*z), gp_Dir(*x))
    if left_handed:
        frame.YReverse()
    for wanted in (frame, frame.Transformed(motion)):
        found = exact.ax3(xyz(wanted.Location()), *axes(wanted))
        np.testing.assert_allclose(axes(found), axes(wanted), rtol=0, atol=4e-16)
        assert xyz(found.Location()) == xyz(wanted.Location())
        assert found.Direct() == wanted.Direct()


@settings(deadline=None)
@given(POINTS, VECTORS, VECTORS, TRSF)
def test_frames_of_conics(point, z, x, motion):
    if math.hypot(*np.cross(z, x)) < 1e-3:
        return
    frame = gp_Ax2(gp_Pnt(*point), gp_Dir(*z), gp_Dir(*x))
    for wanted in (frame, frame.Transformed(motion)):
        found = exact.ax2(xyz(wanted.Location()), *axes(wanted))
        np.testing.assert_allclose(axes(found), axes(wanted), rtol=0, atol=4e-16)
        assert xyz(found.Location()) == xyz(wanted.Location())


@pytest.mark.parametrize("way", ["stated", "moved", "left-handed"])
def test_frames_keep_their_bits(way):
    """Of surfaces, and of conics: as files state them, and as their mirror images."""
    motion = turned((1, 2, -3), 0.3, (4, 5, 6), way != "stated")
    missed = [0, 0]
    for z, x in random_vectors(300, (2, 3)):
        plain = gp_Ax2(gp_Pnt(1, 2, 3), gp_Dir(*z), gp_Dir(*x))
        frame = gp_Ax3(plain)
        if way == "left-handed":
            frame.YReverse()
        for i, (make, made) in enumerate(((exact.ax3, frame), (exact.ax2, plain))):
            wanted = made if way == "stated" else made.Transformed(motion)
            found = make(xyz(wanted.Location()), *axes(wanted))
            missed[i] += axes(found) != axes(wanted)
    assert missed[0] <= 1
    assert missed[1] <= 6


@pytest.mark.parametrize("sense", [1, -1])
def test_frames_in_a_plane(sense):
    for angle in np.linspace(0, 6, 50):
        x = gp_Dir2d(math.cos(angle), math.sin(angle))
        y = gp_Dir2d(-sense * x.Y(), sense * x.X())
        wanted = gp_Ax22d(gp_Pnt2d(1, 2), x, y)
        pairs = [(d.X(), d.Y()) for d in (wanted.XDirection(), wanted.YDirection())]
        found = exact.ax22d((1, 2), *pairs)
        assert [(d.X(), d.Y()) for d in (found.XDirection(), found.YDirection())] == pairs


def test_axes_of_rotation():
    wanted = gp_Ax1(gp_Pnt(1, 2, 3), gp_Dir(1, 2, -3))
    found = exact.ax1((1, 2, 3), xyz(wanted.Direction()))
    assert xyz(found.Direction()) == xyz(wanted.Direction())
    assert xyz(found.Location()) == (1, 2, 3)


class Datum:
    def __init__(self, motion):
        self.Trsf = lambda: motion


def rebuilt(motion):
    row = motion_row(Datum(motion))
    rows = (row["row_x"], row["row_y"], row["row_z"])
    return row, exact.motion(row["form"], row["scale"], rows, row["translation"])


@settings(deadline=None)
@given(TRSF, st.sampled_from([1.0, -1.0, 2.5]))
def test_motions(motion, scale):
    motion.SetScaleFactor(scale)
    row, found = rebuilt(motion)
    assert motion_row(Datum(found)) == row
    point = gp_Pnt(0.1, 20.3, -400.7)
    assert xyz(point.Transformed(found)) == xyz(point.Transformed(motion))


def test_plain_motions_keep_their_form():
    shift = gp_Trsf()
    shift.SetTranslation(gp_Vec(1, 2, 3))
    assert rebuilt(shift)[1].Form().name == "gp_Translation"
    assert rebuilt(gp_Trsf())[1].Form().name == "gp_Identity"


def test_a_sheared_motion_is_refused():
    with pytest.raises(LakeFormatError, match="orthogonal"):
        exact.motion("CompoundTrsf", 1.0, ((1, 0.1, 0), (0, 1, 0), (0, 0, 1)), (0, 0, 0))
