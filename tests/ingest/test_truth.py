"""Normals and curvatures of whole parts against closed forms, and invariants of motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("OCP")

import cadquery as cq
from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
from OCP.gp import gp_Ax1, gp_Ax2, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec


def transformed(shape, trsf):
    return BRepBuilderAPI_Transform(shape.wrapped, trsf, True).Shape()


def part():
    """A part whose every patch type curves another way: block with hole, fillet and dome."""
    block = cq.Workplane().box(40, 30, 20).edges("|Z").fillet(4).faces(">Z").workplane()
    return block.hole(9).union(cq.Workplane().sphere(8).translate((18, 2, 5))).val()


def by_type(record, name):
    """Rows of vertices that lie on patches of a type."""
    types = np.array(record.tables["patches"].column("type").to_pylist())
    return types[record.column("vertices", "patch_id")] == name


@pytest.mark.parametrize("radius", [0.01, 1.0, 250.0])
def test_sphere(ingest_shape, radius):
    record = ingest_shape(cq.Solid.makeSphere(radius, angleDegrees1=-90, angleDegrees2=90))
    for name in ("k_min", "k_max"):
        np.testing.assert_allclose(record.column("vertices", name) * radius, -1, rtol=1e-12)
    np.testing.assert_allclose(record.normals, record.points / radius, atol=1e-12)
    poles = np.abs(record.points[:, 2]) > radius * (1 - 1e-12)
    assert poles.sum() == 2
    assert record.tables["vertices"].column("d_min").is_null().to_numpy().sum() == 2
    assert record.model["is_watertight"]


def test_cylinder(ingest_shape):
    record = ingest_shape(cq.Solid.makeCylinder(3.0, 10.0))
    side = by_type(record, "Cylinder")
    np.testing.assert_allclose(record.column("vertices", "k_min")[side], -1 / 3, rtol=1e-12)
    np.testing.assert_allclose(record.column("vertices", "k_max")[side], 0, atol=1e-12)
    axis = np.abs(record.structs("vertices", "d_max")[side][:, 2])
    np.testing.assert_allclose(axis, 1, rtol=1e-12)
    assert (record.column("vertices", "k_min")[~side] == 0).all()


def test_hole_curves_towards_the_normal(ingest_shape):
    """Inside a hole the surface bends to the outward normal, which points to the axis."""
    record = ingest_shape(cq.Workplane().box(20, 20, 10).faces(">Z").workplane().hole(6).val())
    side = by_type(record, "Cylinder")
    np.testing.assert_allclose(record.column("vertices", "k_max")[side], 1 / 3, rtol=1e-12)
    radial = record.points[side] * [1, 1, 0]
    assert (np.einsum("ij,ij->i", radial, record.normals[side]) < 0).all()


def test_cone(ingest_shape):
    bottom, height = 4.0, 10.0
    record = ingest_shape(cq.Solid.makeCone(bottom, 0.0, height))
    side = by_type(record, "Cone")
    z = record.points[side][:, 2]
    half_angle = math.atan2(bottom, height)
    radius = bottom * (1 - z / height)
    apex = z > height - 1e-9
    assert apex.sum() == 1
    for name in ("nx", "k_min", "k_max", "d_min"):
        column = record.tables["vertices"].column(name).is_null().to_numpy()
        np.testing.assert_array_equal(column[side], apex)
    expected = -np.cos(half_angle) / radius[~apex]
    np.testing.assert_allclose(record.column("vertices", "k_min")[side][~apex], expected, rtol=1e-9)
    np.testing.assert_allclose(record.normals[side][~apex][:, 2], math.sin(half_angle), atol=1e-12)


def test_torus(ingest_shape):
    major, minor = 10.0, 3.0
    record = ingest_shape(cq.Solid.makeTorus(major, minor))
    ring = np.hypot(record.points[:, 0], record.points[:, 1])
    cosine = (ring - major) / minor
    around = -cosine / (major + minor * cosine)  # 1/mm, positive on the inside
    np.testing.assert_allclose(record.column("vertices", "k_min"), -1 / minor, rtol=1e-11)
    np.testing.assert_allclose(record.column("vertices", "k_max"), around, atol=1e-12)


def mesh_volume(record):
    faces = record.vectors("faces", "n0", "n1", "n2").astype(int)
    a, b, c = (record.points[faces[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def assert_consistent(record):
    """Normals point out of the material and triangles wind with them."""
    assert record.model["is_watertight"]
    assert mesh_volume(record) == pytest.approx(record.model["volume"], rel=0.02)
    faces = record.vectors("faces", "n0", "n1", "n2").astype(int)
    a, b, c = (record.points[faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    for i in range(3):
        assert (np.einsum("ij,ij->i", across, record.normals[faces[:, i]]) > 0).all()
    dome = by_type(record, "Sphere")
    np.testing.assert_allclose(record.column("vertices", "k_min")[dome], -1 / 8, rtol=1e-12)
    hole = by_type(record, "Cylinder") & (record.column("vertices", "k_max") > 0)
    np.testing.assert_allclose(record.column("vertices", "k_max")[hole], 1 / 4.5, rtol=1e-12)
    assert hole.any()


def test_plain_part(ingest_shape):
    assert_consistent(ingest_shape(part()))


def test_reversed_solid(ingest_shape):
    record = ingest_shape(part().wrapped.Reversed())
    assert record.model["volume"] > 0
    assert_consistent(record)


def test_mirrored_solid(ingest_shape):
    mirror = gp_Trsf()
    mirror.SetMirror(gp_Ax2(gp_Pnt(1, 2, 3), gp_Dir(1, 2, -1)))
    assert_consistent(ingest_shape(transformed(part(), mirror)))


def test_mirrored_instance(ingest_shape):
    """A location that mirrors leaves left-handed axes behind."""
    mirror = gp_Trsf()
    mirror.SetMirror(gp_Ax2(gp_Pnt(0, 0, 0), gp_Dir(0, 1, 0)))
    moved = BRepBuilderAPI_Transform(part().wrapped, mirror, False).Shape()
    assert_consistent(ingest_shape(moved))


def test_rigid_motion_moves_everything_along(ingest_shape):
    motion = gp_Trsf()
    motion.SetRotation(gp_Ax1(gp_Pnt(1, 0, 0), gp_Dir(1, 1, 1)), 0.7)
    motion.SetTranslationPart(gp_Vec(5, -3, 2))
    still, moved = ingest_shape(part()), ingest_shape(transformed(part(), motion))
    for name in ("volume", "area"):
        assert moved.model[name] == pytest.approx(still.model[name], rel=1e-12)
    assert moved.model["fingerprint"] == still.model["fingerprint"]
    assert moved.model["duplicate_group"] == still.model["duplicate_group"]
    for name in ("type", "area", "reversed"):
        a, b = (r.tables["patches"].column(name).to_pylist() for r in (still, moved))
        assert a == pytest.approx(b, rel=1e-9) if name == "area" else a == b


def test_scaling_scales_curvature(ingest_shape):
    scale = gp_Trsf()
    scale.SetScale(gp_Pnt(0, 0, 0), 25.4)
    record = ingest_shape(transformed(part(), scale))
    dome = by_type(record, "Sphere")
    np.testing.assert_allclose(record.column("vertices", "k_min")[dome] * 25.4, -1 / 8, rtol=1e-12)
    assert record.model["volume"] == pytest.approx(part().Volume() * 25.4**3, rel=1e-9)


@pytest.mark.parametrize("kind", ["uniform", "adaptive", "tessellation"])
def test_each_mesh_is_exact_and_honours_the_limit(ingest_shape, kind):
    rung = {"uniform": 0, "adaptive": 0, "tessellation": 1}[kind]
    mesh = "adaptive" if kind == "adaptive" else "uniform"
    record = ingest_shape(part(), rung, mesh=mesh, max_edge=0.04)
    assert not record.failures
    assert record.model["mesh_kind"] == kind
    assert record.model["max_edge"] <= 0.04 * record.model["diagonal"] * (1 + 1e-12)
    assert record.column("vertices", "residual").max() < 1e-9
    assert_consistent(record)


def test_adaptive_is_finer_where_it_curves(ingest_shape):
    shape = cq.Workplane().box(100, 100, 10).edges("|Z").fillet(3).val()
    adaptive, uniform = (
        ingest_shape(shape, mesh=mesh, max_edge=0.1) for mesh in ("adaptive", "uniform")
    )
    share = [by_type(record, "Cylinder").mean() for record in (adaptive, uniform)]
    assert share[0] > 1.5 * share[1]
