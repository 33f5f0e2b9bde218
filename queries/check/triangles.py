"""Rules on triangles: their winding, and the areas and volumes they add up to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from breplake.queries.check.mesh import Triangles
from breplake.queries.check.rules import Measure, model_rule, place
from breplake.queries.check.view import Floats, Ints, ModelView
from breplake.schema.curves import CurveSet

__all__ = ["SLIVER"]

_NEEDS = ("ids-dense", "references", "primary", "face-rows")

SLIVER: Final = 1e-7
"""Triangles whose height is below this share of the model's diagonal have no sure normal."""


@model_rule(
    "winding",
    "triangles run counter-clockwise seen from outside: their normal and the mean of their "
    "vertex normals agree (slivers lower than 1e-7 x diagonal left out)",
    limit="90 degrees",
    unit="degrees",
    needs=_NEEDS,
    share=0.001,
    source=True,
)
def winding(view: ModelView) -> Iterator[Measure]:
    """Measure the angle of each triangle's normal to the mean of its exact normals."""
    cross = view.triangles.cross  # (f, 3)
    normals = np.nan_to_num(view.normals)[view.triples("faces", "n0 n1 n2")].sum(axis=1)
    height = np.linalg.norm(cross, axis=1) / np.maximum(view.triangles.lengths.max(axis=1), 1e-300)
    rows = np.flatnonzero(
        (height > SLIVER * view.diagonal) & (np.linalg.norm(normals, axis=1) > 1e-3)
    )
    sine = np.linalg.norm(np.cross(cross[rows], normals[rows]), axis=1)
    angle = np.degrees(np.arctan2(sine, np.einsum("fi,fi->f", cross[rows], normals[rows])))
    patch = view.ints("faces", "patch_id")
    yield Measure(angle, 90.0, lambda i: f"face {rows[i]} on patch {patch[rows[i]]}")


@model_rule(
    "neighbours",
    "at an edge of a closed model's mesh as many triangles run along it as against it "
    "(edges with an odd number left out)",
    needs=_NEEDS,
    share=0.001,
    source=True,
)
def neighbours(view: ModelView) -> Iterator[Measure]:
    """Measure each edge with an even number of triangles."""
    if not view.row["is_closed"] or not view.has_mesh:
        return
    edges = view.mesh_edges
    rows = np.flatnonzero(edges.count % 2 == 0)
    start, stop = edges.ends[rows].T
    ok = 2 * edges.forward[rows] == edges.count[rows]
    yield Measure.of_truth(ok, place("edge {0}-{1}", start, stop))


@model_rule(
    "patch-area",
    "the triangles of a patch have its exact area, as far as chords can",
    limit="chord error of surface and rim, see patch_area",
    unit="mm^2",
    needs=(*_NEEDS, "words", "curve-lists"),
    share=0.001,
    source=True,
)
def patch_area(view: ModelView) -> Iterator[Measure]:
    """Measure the difference of mesh area and exact area of each patch.

    A chord of length h on a curve of curvature k stands off by the sagitta h^2 k / 8.
    A triangle with longest side h on a surface of curvature k is smaller than its part of
    the surface by a relative error of order (h k)^2; the rim of the patch loses or gains
    2/3 x sagitta x chord = h^3 k / 12 per edge.  The limit is twice the sum of both, with
    at least 1e-6 of the area and the tolerance times the rim's length for the file's own
    inaccuracy.
    """
    if not view.has_mesh or not view.count("patches"):
        return
    patch, count = view.ints("faces", "patch_id"), view.count("patches")
    mesh = np.bincount(patch, view.triangles.areas, minlength=count)
    exact = view.floats("patches", "area")
    inner = np.bincount(patch, _surface_loss(view), minlength=count)
    rim, length = _rim(view)
    slack = 1e-6 * exact + view.floats("patches", "tolerance") * length
    limit = 2 * (inner + rim) + slack + 1e-12 * view.diagonal**2
    types = view.words("patches", "type")
    yield Measure(np.abs(mesh - exact), limit, lambda i: f"patch {i} ({types[i]})")


def _surface_loss(view: ModelView) -> Floats:
    """Return the area that each triangle may lack against its surface, ``(f,)`` mm^2."""
    k = np.maximum(
        np.abs(view.floats("vertices", "k_min")), np.abs(view.floats("vertices", "k_max"))
    )
    k = np.nan_to_num(k)[view.triples("faces", "n0 n1 n2")].max(axis=1)  # (f,)
    bend = np.minimum(view.triangles.lengths.max(axis=1) * k, 2.0)
    return np.asarray(view.triangles.areas * bend**2 / 4)


def _rim(view: ModelView) -> tuple[Floats, Floats]:
    """Return area between chords and curves, and length, of the rim of each patch."""
    count = view.count("patches")
    loss, length = _chord_loss(view)
    curve, patch = view.ints("coedges", "curve_id"), view.ints("coedges", "patch_id")
    return (
        _sum(patch, loss[curve], count),
        _sum(patch, length[curve], count),
    )


def _chord_loss(view: ModelView) -> tuple[Floats, Floats]:
    """Return area between chords and curve ``(n,)`` mm^2, and length mm, of each curve."""
    truth, count = view.curve, view.count("curves")
    inner = np.flatnonzero(truth.place[1:] > 0)  # chords, by their first entry
    owner, points = truth.owner[inner], view.primary_points[truth.vertex]
    chord = np.linalg.norm(points[inner + 1] - points[inner], axis=1)
    # the greatest curvature of five places on the chord stands for all of it
    curves = CurveSet.from_curves(view.table("curves"))
    k = np.zeros(len(inner))
    for share in np.linspace(0, 1, 5):
        t = (1 - share) * truth.parameter[inner] + share * truth.parameter[inner + 1]
        k = np.maximum(k, _curvature(curves, owner, t))
    loss = chord**3 * np.minimum(k, 2 / np.maximum(chord, 1e-300)) / 12
    return (
        _sum(owner, loss, count),
        _sum(owner, chord, count),
    )


def _sum(group: Ints, values: Floats, count: int) -> Floats:
    """Return the sum of the values of each of `count` groups."""
    return np.asarray(np.bincount(group, values, minlength=count), dtype=np.float64)


def _curvature(curves: CurveSet, row: np.ndarray, t: Floats) -> Floats:
    """Return the curvature of curves, 1/mm, 0 where it is not defined."""
    jet = curves.evaluate(row, t)
    speed = np.linalg.norm(jet.d1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        k = np.linalg.norm(np.cross(jet.d1, jet.d2), axis=1) / speed**3
    return np.asarray(np.nan_to_num(k, nan=0.0, posinf=0.0))


@model_rule(
    "mesh-volume",
    "the mesh of a closed model encloses the model's volume, as far as chords can",
    limit="2 x sum of area x sagitta + 1e-6 x volume + tolerance x area",
    unit="mm^3",
    needs=(*_NEEDS, "watertight", "winding", "neighbours"),
    share=0.001,
    source=True,
)
def mesh_volume(view: ModelView) -> Iterator[Measure]:
    """Measure the volume inside the mesh against the exact one."""
    row = view.row
    if not (row["is_closed"] and view.has_mesh and row["volume"] is not None):
        return
    if np.any(view.words("parts", "kind") != "solid"):
        return
    triangles: Triangles = view.triangles
    found = triangles.volume(view.primary_points.mean(axis=0))
    k = np.maximum(
        np.abs(view.floats("vertices", "k_min")), np.abs(view.floats("vertices", "k_max"))
    )
    k = np.nan_to_num(k)[view.triples("faces", "n0 n1 n2")].max(axis=1)
    h = triangles.lengths.max(axis=1)
    sagitta = np.minimum(h**2 * k / 8, h / 2)
    tolerance = view.floats("patches", "tolerance").max(initial=0.0)
    slack = 1e-6 * abs(row["volume"]) + tolerance * row["area"]
    limit = 2 * float(triangles.areas @ sagitta) + slack
    yield Measure(np.array([abs(found - row["volume"])]), limit, lambda _: f"mesh has {found}")
