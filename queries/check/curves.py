"""Rules on curves: their mesh vertices, parameters, ends and lengths."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from breplake.queries.check.ids import n_vertices
from breplake.queries.check.rules import Measure, model_rule, place
from breplake.queries.check.view import MISSING, Floats, Ints, ModelView
from breplake.schema.curves import CurveSet

__all__: list[str] = []

_NEEDS = ("ids-dense", "references", "words", "primary", "curve-lists")

_GAUSS: Final = np.polynomial.legendre.leggauss(8)
"""Places and weights on [-1, 1] that integrate polynomials of degree 15 exactly."""

_COARSE: Final = np.polynomial.legendre.leggauss(5)
"""The same for degree 9: where both differ, pieces are halved."""

_HALVINGS: Final = 12


@model_rule("curve-lists", "vert_indices and vert_parameters of a curve are equally long")
def curve_lists(view: ModelView) -> Iterator[Measure]:
    """Measure the lengths; a curve with a mesh has at least two entries, degenerate ones none."""
    indices, parameters = (
        np.diff(view.lists("curves", name)[0]) for name in ("vert_indices", "vert_parameters")
    )
    kinds = view.words("curves", "kind")
    ok = indices == parameters
    ok &= (indices != 1) | (kinds == "degenerate")
    yield Measure.of_truth(
        ok, lambda i: f"curve {i}: {indices[i]} indices, {parameters[i]} parameters"
    )


@model_rule(
    "curve-position",
    "mesh vertices of a curve lie at its vert_parameters (degenerate curves left out)",
    limit="max(1e-9 x diagonal, tolerance of the curve, of its corners at the ends)",
    unit="mm",
    needs=_NEEDS,
    share=0.001,
    source=True,
)
def curve_position(view: ModelView) -> Iterator[Measure]:
    """Measure the distance of curve(t) to the mesh vertex."""
    truth = view.curve
    rows = np.flatnonzero(truth.known)
    points = view.primary_points[truth.vertex[rows]]
    distance = np.linalg.norm(truth.jet.point[rows] - points, axis=1)
    owner, place = truth.owner[rows], truth.place[rows]
    limit = np.maximum(1e-9 * view.diagonal, view.floats("curves", "tolerance")[owner])
    tolerance = view.floats("corners", "tolerance")
    last = truth.offsets[owner + 1] - truth.offsets[owner] - 1
    for corner, at_end in (("start_corner", place == 0), ("end_corner", place == last)):
        corners = view.ints("curves", corner)[owner]
        ends = np.flatnonzero(at_end & (corners >= 0))
        limit[ends] = np.maximum(limit[ends], tolerance[corners[ends]])
    types = view.words("curves", "type")
    yield Measure(
        distance, limit, lambda i: f"curve {owner[i]} ({types[owner[i]]}), entry {place[i]}"
    )


@model_rule("curve-parameters", "vert_parameters ascend strictly from t_min to t_max", needs=_NEEDS)
def curve_parameters(view: ModelView) -> Iterator[Measure]:
    """Measure each step, and both ends up to 1e-9 of the range."""
    truth = view.curve
    inner = np.flatnonzero(truth.place[1:] > 0)
    step = truth.parameter[inner + 1] - truth.parameter[inner]
    owner = truth.owner[inner]
    yield Measure.of_truth(
        step > 0, lambda i: f"curve {owner[i]}, entry {truth.place[inner[i] + 1]}"
    )
    curves = np.flatnonzero(np.diff(truth.offsets) > 1)
    low, high = view.floats("curves", "t_min")[curves], view.floats("curves", "t_max")[curves]
    slack = 1e-9 * np.abs(high - low)
    for column, bound, entry in (
        ("t_min", low, truth.offsets[curves]),
        ("t_max", high, truth.offsets[curves + 1] - 1),
    ):
        ok = np.abs(truth.parameter[entry] - bound) <= slack
        yield Measure.of_truth(ok, place("curve {0}: {c}", curves, c=column))


@model_rule(
    "curve-ends",
    "a curve's mesh vertices run from its start corner to its end corner",
    needs=_NEEDS,
)
def curve_ends(view: ModelView) -> Iterator[Measure]:
    """Measure the first and last mesh vertex of each curve against its corners."""
    truth = view.curve
    curves = np.flatnonzero(np.diff(truth.offsets) > 1)
    of_corner = np.append(view.ints("corners", "vertex_id"), MISSING)
    for column, entry in (
        ("start_corner", truth.offsets[curves]),
        ("end_corner", truth.offsets[curves + 1] - 1),
    ):
        corner = view.ints("curves", column)[curves]
        vertex = of_corner[np.where(corner == MISSING, -1, corner)]
        ok = (truth.vertex[entry] == vertex) | (corner == MISSING)
        yield Measure.of_truth(ok, place("curve {0}: {c}", curves, c=column))


@model_rule(
    "curve-edges",
    "a curve's mesh vertices are joined by edges of the mesh",
    needs=_NEEDS,
    share=0.001,
    source=True,
)
def curve_edges(view: ModelView) -> Iterator[Measure]:
    """Measure each pair of mesh vertices that follow each other on a curve of a patch."""
    truth = view.curve
    used = view.ints("curves", "n_patches") > 0
    inner = np.flatnonzero((truth.place[1:] > 0) & used[truth.owner[1:]])
    ok = view.mesh_edges.find(truth.vertex[inner], truth.vertex[inner + 1], n_vertices(view))
    yield Measure.of_truth(
        ok, lambda i: f"curve {truth.owner[inner[i]]}, entry {truth.place[inner[i]]}"
    )


@model_rule(
    "on-curve",
    "curve_id and corner_id of a vertex row are of a curve and corner there",
    needs=_NEEDS,
)
def on_curve(view: ModelView) -> Iterator[Measure]:
    """Measure each label, and that no vertex of a curve or corner is without one."""
    vertex = view.ints("vertices", "vertex_id")
    curve, corner = view.ints("vertices", "curve_id"), view.ints("vertices", "corner_id")
    truth, count = view.curve, n_vertices(view)
    pairs = np.unique(truth.owner * max(count, 1) + truth.vertex)
    ok = (curve == MISSING) | np.isin(curve * max(count, 1) + vertex, pairs)
    yield Measure.of_truth(ok, lambda i: f"row {i}: vertex {vertex[i]} is not on curve {curve[i]}")
    corners = np.append(view.ints("corners", "vertex_id"), MISSING)
    at = corners[np.where(corner == MISSING, -1, corner)]
    ok = (corner == MISSING) | (at == vertex)
    yield Measure.of_truth(ok, lambda i: f"row {i}: vertex {vertex[i]} is not corner {corner[i]}")
    lies = np.zeros(count + 1, dtype=bool)
    lies[truth.vertex] = True
    lies[corners[corners != MISSING]] = True
    ok = ~lies[vertex] | (curve != MISSING) | (corner != MISSING)
    yield Measure.of_truth(ok, lambda i: f"row {i}: vertex {vertex[i]} lies on a curve or corner")


@model_rule(
    "corner-position",
    "the mesh vertex of a corner is at its point",
    limit="max(1e-9 x diagonal, tolerance of the corner)",
    unit="mm",
    share=0.001,
    needs=("ids-dense", "references", "primary"),
)
def corner_position(view: ModelView) -> Iterator[Measure]:
    """Measure the distance of each corner to its mesh vertex."""
    vertex = view.ints("corners", "vertex_id")
    rows = np.flatnonzero(vertex != MISSING)
    away = view.vectors("corners", "point")[rows] - view.primary_points[vertex[rows]]
    limit = np.maximum(1e-9 * view.diagonal, view.floats("corners", "tolerance")[rows])
    yield Measure(np.linalg.norm(away, axis=1), limit, lambda i: f"corner {rows[i]}")


@model_rule(
    "curve-length",
    "length is the integral of the curve's speed from t_min to t_max",
    limit="1e-6 x length + 1e-9 x diagonal + tolerance",
    unit="mm",
    needs=_NEEDS,
)
def curve_length(view: ModelView) -> Iterator[Measure]:
    """Measure length against Gauss quadrature between knots and mesh vertices."""
    exact = view.floats("curves", "length")
    curves = CurveSet.from_curves(view.table("curves"))
    owner, start, stop = _smooth_pieces(view)
    found = np.bincount(owner, _arc_lengths(curves, owner, start, stop), minlength=len(exact))
    rows = np.unique(owner)
    rows = rows[~np.isnan(exact[rows])]
    limit = 1e-6 * exact[rows] + 1e-9 * view.diagonal + view.floats("curves", "tolerance")[rows]
    types = view.words("curves", "type")
    yield Measure(
        np.abs(found - exact)[rows], limit, lambda i: f"curve {rows[i]} ({types[rows[i]]})"
    )


def _arc_lengths(curves: CurveSet, owner: Ints, start: Floats, stop: Floats) -> Floats:
    """Return the lengths of pieces of curves, mm; halved until two quadratures agree."""
    length = np.asarray(_quadrature(curves, owner, start, stop, _GAUSS))
    rough = np.abs(length - _quadrature(curves, owner, start, stop, _COARSE))
    again = np.flatnonzero(rough > 1e-8 * length)
    halves = 0
    one, two, piece = start[again], stop[again], again
    length[again] = 0.0
    while len(piece):
        middle = (one + two) / 2
        one, two = np.concatenate([one, middle]), np.concatenate([middle, two])
        piece, halves = np.concatenate([piece, piece]), halves + 1
        fine = _quadrature(curves, owner[piece], one, two, _GAUSS)
        rough = np.abs(fine - _quadrature(curves, owner[piece], one, two, _COARSE))
        done = (rough <= 1e-8 * fine) | (halves == _HALVINGS)
        np.add.at(length, piece[done], fine[done])
        one, two, piece = one[~done], two[~done], piece[~done]
    return length


def _quadrature(
    curves: CurveSet, owner: Ints, start: Floats, stop: Floats, rule: tuple[Floats, Floats]
) -> Floats:
    """Integrate the speed of curves from start to stop, ``(n,)`` mm."""
    total: Floats = np.zeros(len(owner))
    for at, weight in zip(*rule, strict=True):
        t = (start + stop) / 2 + at * (stop - start) / 2
        total += weight * np.linalg.norm(curves.evaluate(owner, t).d1, axis=1)
    return total * (stop - start) / 2


def _smooth_pieces(view: ModelView) -> tuple[Ints, Floats, Floats]:
    """Cut curves at their knots and mesh vertices; return curve, start and stop of the pieces."""
    truth = view.curve
    offsets, knots = view.lists("curves", "knots")
    of_knot = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    low, high = view.floats("curves", "t_min"), view.floats("curves", "t_max")
    inside = (knots > low[of_knot]) & (knots < high[of_knot])
    owner = np.concatenate([truth.owner[truth.known], of_knot[inside]])
    cuts = np.concatenate([truth.parameter[truth.known], knots[inside]])
    order = np.lexsort((cuts, owner))
    owner, cuts = owner[order], cuts[order]
    meshed = np.isin(owner, truth.owner[truth.known])
    piece = np.flatnonzero((np.diff(owner) == 0) & meshed[1:])
    return owner[piece], cuts[piece], cuts[piece + 1]
