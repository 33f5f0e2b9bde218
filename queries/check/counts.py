"""Rules on what ``models`` states of the other tables and of the mesh."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from breplake.queries.check.ids import n_vertices
from breplake.queries.check.rules import Measure, model_rule, place
from breplake.queries.check.view import ModelView
from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES, count_column

__all__: list[str] = []

_MESH = ("ids-dense", "references", "primary")


@model_rule("counts", "counts in models are those of the tables")
def counts(view: ModelView) -> Iterator[Measure]:
    """Measure each ``n_*`` of ``models`` that the tables determine, and both flags of the shape."""
    found = {
        "n_parts": view.count("parts"),
        "n_solids": int(np.count_nonzero(view.words("parts", "kind") == "solid")),
        "n_patches": view.count("patches"),
        "n_curves": view.count("curves"),
        "n_corners": view.count("corners"),
        "n_sharp_curves": int(np.count_nonzero(view.flags("curves", "sharp"))),
    }
    for table, types in (("patches", SURFACE_TYPES), ("curves", CURVE_TYPES)):
        words = view.words(table, "type")
        for name in types:
            column = count_column(name, curve=table == "curves")
            found[column] = int(np.count_nonzero(words == name))
    kinds = view.words("curves", "kind")
    found["is_closed"] = view.count("patches") > 0 and not np.any(kinds == "boundary")
    yield _compare(view, found)


@model_rule("mesh-counts", "mesh counts in models are those of the tables; null without a mesh")
def mesh_counts(view: ModelView) -> Iterator[Measure]:
    """Measure n_vertices, n_normals and n_faces."""
    if view.has_mesh:
        vertex = view.ints("vertices", "vertex_id")
        found: dict[str, object] = {
            "n_vertices": len(np.unique(vertex)),
            "n_normals": view.count("vertices"),
            "n_faces": view.count("faces"),
        }
    else:
        rows = {"n_normals": view.count("vertices"), "n_faces": view.count("faces")}
        found = {"n_vertices": None} | {name: n or None for name, n in rows.items()}
    yield _compare(view, found)


@model_rule("mesh-edges", "watertightness and edge counts are those of the triangles", needs=_MESH)
def mesh_edges(view: ModelView) -> Iterator[Measure]:
    """Measure is_watertight, n_boundary_edges and n_nonmanifold_edges."""
    if not view.has_mesh:
        return
    edges = view.mesh_edges
    found = {
        "n_boundary_edges": len(edges.boundary),
        "n_nonmanifold_edges": len(edges.nonmanifold),
        "is_watertight": bool(len(edges.count) and np.all(edges.count == 2)),
    }
    yield _compare(view, found)


@model_rule(
    "mesh-measures",
    "max_edge, min_angle and regular_angles are those of the triangles",
    limit="1e-9",
    unit="relative",
    needs=_MESH,
)
def mesh_measures(view: ModelView) -> Iterator[Measure]:
    """Measure the three against the triangles."""
    if not view.has_mesh or not view.count("faces"):
        return
    angles = view.triangles.angles
    # an angle of exactly 30 degrees may fall on either side by rounding
    regular = (angles >= math.radians(30)) & (angles <= math.radians(90))
    edge = (abs(angles - math.radians(30)) < 1e-9) | (abs(angles - math.radians(90)) < 1e-9)
    found = {
        "max_edge": (float(view.triangles.lengths.max()), 0.0),
        "min_angle": (float(angles.min()), 1e-9),
        "regular_angles": (float(regular.mean()), float(edge.mean())),
    }
    names = list(found)
    values = [_relative(view.row[name], value, slack) for name, (value, slack) in found.items()]
    yield Measure(
        np.array(values),
        1e-9,
        lambda i: f"{names[i]} {view.row[names[i]]}, is {found[names[i]][0]}",
    )


@model_rule(
    "edge-limit",
    "the longest edge of a uniform mesh keeps the limit asked for, or mesh_note says why not",
    limit="1.05 x mesh_limit",
    unit="mm",
)
def edge_limit(view: ModelView) -> Iterator[Measure]:
    """Measure max_edge of uniform meshes without a note."""
    row = view.row
    if row["mesh_kind"] != "uniform" or row["mesh_note"] or row["max_edge"] is None:
        return
    asked = math.nan if row["mesh_limit"] is None else row["mesh_limit"]
    yield Measure(np.array([row["max_edge"]]), 1.05 * asked, lambda _: f"mesh_limit {asked}")


@model_rule(
    "bounding-box",
    "diagonal is that of the box, and all mesh vertices lie in it",
    limit="1e-9 x diagonal + greatest tolerance",
    unit="mm",
    share=0.001,
    source=True,
)
def bounding_box(view: ModelView) -> Iterator[Measure]:
    """Measure the diagonal, and how far mesh vertices stick out of the box."""
    low, high = (np.array([view.row[k][a] for a in "xyz"]) for k in ("bbox_min", "bbox_max"))
    slack = 1e-9 * view.diagonal
    error = abs(float(np.linalg.norm(high - low)) - view.diagonal)
    yield Measure(np.array([error]), slack, lambda _: "diagonal")
    points = view.points
    outside = np.maximum(np.maximum(low - points, points - high).max(axis=1, initial=0.0), 0.0)
    tolerance = view.floats("patches", "tolerance").max(initial=0.0)
    yield Measure(outside, slack + tolerance, lambda i: f"vertices row {i}")


@model_rule(
    "watertight",
    "every edge of a closed model's mesh has two triangles; four or more even ones where strips "
    "of patches touch, an odd number only at nonmanifold curves",
    needs=(*_MESH, "mesh-edges"),
    share=0.001,
    source=True,
)
def watertight(view: ModelView) -> Iterator[Measure]:
    """Measure each edge of the mesh of a closed model."""
    if not view.row["is_closed"] or not view.has_mesh:
        return
    edges = view.mesh_edges
    crossing = np.zeros(n_vertices(view), dtype=bool)  # vertices on nonmanifold curves
    offsets, vertices = view.lists("curves", "vert_indices")
    for curve in np.flatnonzero(view.words("curves", "kind") == "nonmanifold"):
        crossing[vertices[offsets[curve] : offsets[curve + 1]]] = True
    allowed = (edges.count > 2) & crossing[edges.ends].all(axis=1)
    ok = (edges.count % 2 == 0) | allowed
    start, stop = edges.ends.T
    words = place("edge {0}-{1} has {2} triangles", start, stop, edges.count)
    yield Measure.of_truth(ok, words)


def _compare(view: ModelView, found: Mapping[str, object]) -> Measure:
    """Measure columns of ``models`` against what they should be."""
    names = list(found)
    return Measure.of_truth(
        [view.row[name] == found[name] for name in names],
        lambda i: f"{names[i]} is {view.row[names[i]]}, the tables have {found[names[i]]}",
    )


def _relative(stored: float | None, found: float, slack: float) -> float:
    """Return the relative difference beyond an absolute `slack`."""
    if stored is None:
        return math.inf
    return max(abs(stored - found) - slack, 0.0) / max(abs(found), 1e-300)
