"""Rules on ids: dense, pointing to rows that exist, and agreeing with each other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from breplake.queries.check.rules import Measure, model_rule, place
from breplake.queries.check.view import MISSING, ModelView
from breplake.schema.shape_tables import (
    CONTINUITIES,
    CURVE_CLASSES,
    EDGE_CURVE_KINDS,
    SHAPE_TYPES,
    SURFACE_CLASSES,
)
from breplake.schema.types import CURVE_KINDS, CURVE_TYPES, MESH_KINDS, SURFACE_TYPES

__all__ = ["REFERENCES"]

_IDS: Final = (
    ("parts", "part_id"),
    ("patches", "patch_id"),
    ("curves", "curve_id"),
    ("corners", "corner_id"),
    ("vertices", "normal_id"),
    ("faces", "face_id"),
    ("shapes", "shape_id"),
    ("motions", "motion_id"),
    ("surfaces", "surface_id"),
    ("space_curves", "space_curve_id"),
    ("pcurves", "pcurve_id"),
)

REFERENCES: Final = (
    ("patches", "part_id", "parts", False),
    ("coedges", "patch_id", "patches", False),
    ("coedges", "curve_id", "curves", False),
    ("curves", "start_corner", "corners", True),
    ("curves", "end_corner", "corners", True),
    ("curves", "left_patch", "patches", True),
    ("curves", "right_patch", "patches", True),
    ("corners", "vertex_id", "mesh vertices", True),
    ("vertices", "patch_id", "patches", False),
    ("vertices", "curve_id", "curves", True),
    ("vertices", "corner_id", "corners", True),
    ("faces", "v0", "mesh vertices", False),
    ("faces", "v1", "mesh vertices", False),
    ("faces", "v2", "mesh vertices", False),
    ("faces", "n0", "vertices", False),
    ("faces", "n1", "vertices", False),
    ("faces", "n2", "vertices", False),
    ("faces", "patch_id", "patches", False),
    *((table, "shape", "shapes", True) for table in ("parts", "patches", "curves", "corners")),
    ("coedges", "pcurve", "pcurves", True),
    ("shapes", "surface", "surfaces", True),
    ("edge_curves", "shape_id", "shapes", False),
    ("edge_curves", "space_curve", "space_curves", True),
    ("edge_curves", "surface", "surfaces", True),
    ("edge_curves", "surface2", "surfaces", True),
    ("edge_curves", "pcurve", "pcurves", True),
    ("edge_curves", "pcurve2", "pcurves", True),
    ("surfaces", "space_curve", "space_curves", True),
    ("surfaces", "basis", "surfaces", True),
    ("space_curves", "basis", "space_curves", True),
    ("pcurves", "basis", "pcurves", True),
)
"""Table, column, what it points to, and whether it may be null."""

_WORDS: Final = (
    ("parts", "kind", ("solid", "shell", "face"), False),
    ("patches", "type", SURFACE_TYPES, False),
    ("curves", "type", CURVE_TYPES, False),
    ("curves", "kind", CURVE_KINDS, False),
    ("curves", "convexity", ("convex", "concave", "mixed"), True),
    ("shapes", "type", SHAPE_TYPES, False),
    ("edge_curves", "kind", EDGE_CURVE_KINDS, False),
    ("edge_curves", "continuity", CONTINUITIES, True),
    ("surfaces", "type", SURFACE_CLASSES, False),
    ("space_curves", "type", CURVE_CLASSES, False),
    ("pcurves", "type", CURVE_CLASSES, False),
)


@model_rule("ids-dense", "ids of a model are 0 .. n-1 in the order of the rows")
def ids_dense(view: ModelView) -> Iterator[Measure]:
    """Measure each id against its place; of mesh vertices, that each number occurs."""
    for table, column in _IDS:
        ids = view.ints(table, column)
        yield Measure.of_truth(
            ids == np.arange(len(ids)), place("{t} row {i}: {c}", t=table, c=column)
        )
    vertex = view.ints("vertices", "vertex_id")
    count = n_vertices(view)
    inside = vertex[(vertex >= 0) & (vertex < count)]
    used = np.bincount(inside, minlength=count) > 0
    yield Measure.of_truth(used, lambda i: f"no row of vertices has vertex_id {i}")
    ok = (vertex >= 0) & (vertex < count)
    yield Measure.of_truth(ok, lambda i: f"vertices row {i}: vertex_id {vertex[i]} of {count}")


@model_rule("references", "every id points to a row that exists")
def references(view: ModelView) -> Iterator[Measure]:
    """Measure each foreign id."""
    for table, column, target, nullable in REFERENCES:
        count = n_vertices(view) if target == "mesh vertices" else view.count(target)
        ids = view.ints(table, column)
        ok = (ids >= 0) & (ids < count)
        if nullable:
            ok |= ids == MISSING
        yield Measure.of_truth(
            ok,
            place(
                "{t} row {i}: {c} {0}, there are {n} {to}",
                ids,
                t=table,
                c=column,
                n=count,
                to=target,
            ),
        )
    offsets, vertices = view.lists("curves", "vert_indices")
    ok = (vertices >= 0) & (vertices < n_vertices(view))
    yield Measure.of_truth(
        ok, lambda i: f"curve {_owner(offsets, i)}: vert_indices holds {vertices[i]}"
    )


@model_rule("words", "types and kinds are words of the contract")
def words(view: ModelView) -> Iterator[Measure]:
    """Measure each type and kind."""
    for table, column, known, nullable in _WORDS:
        found = view.words(table, column)
        allowed = set(known) | ({None} if nullable else set())
        ok = [word in allowed for word in found]
        yield Measure.of_truth(ok, place("{t} row {i}: {c} {0!r}", found, t=table, c=column))
    kind = view.row["mesh_kind"]
    yield Measure.of_truth([kind is None or kind in MESH_KINDS], lambda _: f"mesh_kind {kind!r}")


@model_rule(
    "face-rows",
    "a triangle's normal_id names its vertex on its patch",
    needs=("ids-dense", "references"),
)
def face_rows(view: ModelView) -> Iterator[Measure]:
    """Measure vertices[n_i].vertex_id = v_i and vertices[n_i].patch_id = patch_id."""
    rows = view.triples("faces", "n0 n1 n2")  # (f, 3)
    same_vertex = view.ints("vertices", "vertex_id")[rows] == view.triples("faces", "v0 v1 v2")
    patch = view.ints("faces", "patch_id")[:, None]
    same_patch = view.ints("vertices", "patch_id")[rows] == patch
    yield Measure.of_truth(same_vertex.ravel(), lambda i: f"face {i // 3}: n{i % 3}, vertex")
    yield Measure.of_truth(same_patch.ravel(), lambda i: f"face {i // 3}: n{i % 3}, patch")


@model_rule("primary", "is_primary is true once for each mesh vertex", needs=("ids-dense",))
def primary(view: ModelView) -> Iterator[Measure]:
    """Measure the number of primary rows of each mesh vertex."""
    chosen = view.ints("vertices", "vertex_id")[view.flags("vertices", "is_primary")]
    times = np.bincount(chosen, minlength=n_vertices(view))
    yield Measure.of_truth(times == 1, lambda i: f"vertex {i}: {times[i]} times")


@model_rule("vertex-patch", "a mesh vertex has one row on each patch", needs=("ids-dense",))
def vertex_patch(view: ModelView) -> Iterator[Measure]:
    """Measure whether a pair of vertex and patch occurs again."""
    vertex, patch = view.ints("vertices", "vertex_id"), view.ints("vertices", "patch_id")
    order = np.lexsort((patch, vertex))
    again = (np.diff(vertex[order]) == 0) & (np.diff(patch[order]) == 0)
    ok = np.ones(len(vertex), dtype=bool)
    ok[order[1:]] = ~again
    yield Measure.of_truth(ok, lambda i: f"vertex {vertex[i]} on patch {patch[i]}, row {i}")


@model_rule(
    "one-position",
    "all rows of a mesh vertex have the same position",
    needs=("ids-dense", "primary"),
)
def one_position(view: ModelView) -> Iterator[Measure]:
    """Measure each row's position against the vertex's primary row, bit for bit."""
    vertex = view.ints("vertices", "vertex_id")
    same = np.all(view.points == view.primary_points[vertex], axis=1)
    yield Measure.of_truth(same, lambda i: f"row {i}, vertex {vertex[i]}")


def n_vertices(view: ModelView) -> int:
    """Return the number of mesh vertices that ``models`` states, 0 without a mesh."""
    return int(view.row["n_vertices"] or 0)


def _owner(offsets: np.ndarray, index: int) -> int:
    """Return the list that holds the value at `index`."""
    return int(np.searchsorted(offsets, index, side="right")) - 1
