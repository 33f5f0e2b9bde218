"""Rules on vertex rows: position, normal and curvature against the closed form."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from breplake.queries.check.mesh import angle_between
from breplake.queries.check.rules import Measure, Where, model_rule, place
from breplake.queries.check.truth import Side, sides
from breplake.queries.check.view import Flags, Floats, Ints, ModelView
from breplake.schema.jets import PrincipalCurvature

__all__: list[str] = []

_NEEDS = ("ids-dense", "references", "words")


def _row(view: ModelView, rows: np.ndarray | None = None) -> Where:
    """Name a vertex row by its id, its patch and the patch's type."""
    patch, types = view.ints("vertices", "patch_id"), view.words("patches", "type")

    def words(index: int) -> str:
        row = index if rows is None else int(rows[index])
        return f"row {row} on patch {patch[row]} ({types[patch[row]]})"

    return words


@model_rule(
    "position",
    "(x, y, z) is the closed form of the patch at (u, v)",
    limit="max(1e-9 x diagonal, tolerance of the patch)",
    unit="mm",
    share=0.001,
    needs=_NEEDS,
)
def position(view: ModelView) -> Iterator[Measure]:
    """Measure the distance of p(u, v) to the vertex."""
    rows = np.flatnonzero(view.surface.known)
    tolerance = view.floats("patches", "tolerance")[view.ints("vertices", "patch_id")[rows]]
    limit = np.maximum(1e-9 * view.diagonal, tolerance)
    yield Measure(_distance(view)[rows], limit, _row(view, rows))


@model_rule(
    "residual",
    "the column residual is the distance of (x, y, z) to p(u, v)",
    limit="1e-9 x diagonal + 1e-6 x residual",
    unit="mm",
    needs=_NEEDS,
)
def residual(view: ModelView) -> Iterator[Measure]:
    """Measure the stored residual against the recomputed one."""
    rows = np.flatnonzero(view.surface.known)
    distance = _distance(view)[rows]
    error = np.abs(view.floats("vertices", "residual")[rows] - distance)
    yield Measure(error, 1e-9 * view.diagonal + 1e-6 * distance, _row(view, rows))


def _distance(view: ModelView) -> Floats:
    return np.asarray(np.linalg.norm(view.surface.point - view.points, axis=1))


@model_rule(
    "range",
    "(u, v) lies in the range of its patch; where the surface is periodic, any period will do",
    limit="1e-4 x range",
    needs=_NEEDS,
    share=0.001,
    source=True,
)
def parameter_range(view: ModelView) -> Iterator[Measure]:
    """Measure how far u and v are outside, as a share of the range."""
    patch = view.ints("vertices", "patch_id")
    for name in "uv":
        low, high = (view.floats("patches", f"{name}_{end}")[patch] for end in ("min", "max"))
        rows = np.flatnonzero(~view.flags("patches", f"{name}_periodic")[patch])
        value = view.floats("vertices", name)
        beyond = np.maximum(np.maximum(low - value, value - high), 0.0)
        share = beyond[rows] / np.maximum(high - low, 1e-300)[rows]
        yield Measure(share, 1e-4, _row(view, rows))


@model_rule("unit-normal", "normals are unit vectors", limit="1e-12")
def unit_normal(view: ModelView) -> Iterator[Measure]:
    """Measure how far the lengths of normals are from 1."""
    rows = np.flatnonzero(_has_normal(view))
    length = np.linalg.norm(view.normals[rows], axis=1)
    yield Measure(np.abs(length - 1), 1e-12, lambda i: f"row {rows[i]}")


@model_rule(
    "normal",
    "normals of Plane, Cylinder, Cone, Sphere, Torus are the closed form's, orientation applied",
    limit="1e-9, near an apex what rounding allows",
    unit="rad",
    needs=_NEEDS,
)
def normal(view: ModelView) -> Iterator[Measure]:
    """Measure the angle between stored and exact normal."""
    yield _normal_angle(view, view.surface.elementary, 1e-9)


@model_rule(
    "normal-freeform",
    "normals of Revolution, Extrusion, BSpline are the closed form's, orientation applied",
    limit="1e-6, near a singular point what rounding allows",
    unit="rad",
    needs=_NEEDS,
)
def normal_freeform(view: ModelView) -> Iterator[Measure]:
    """Measure the angle between stored and exact normal."""
    yield _normal_angle(view, ~view.surface.elementary, 1e-6)


def _normal_angle(view: ModelView, chosen: Flags, limit: float) -> Measure:
    truth = view.surface
    defined = truth.known & _has_normal(view) & ~np.isnan(truth.normal[:, 0])

    def compare(rows: Ints, side: Side) -> tuple[Floats, Floats]:
        angle = angle_between(view.normals[rows], side.normal)
        return angle, np.maximum(limit, truth.noise[rows])

    return _against_closed_form(view, np.flatnonzero(chosen & defined), compare)


def _against_closed_form(
    view: ModelView, rows: Ints, compare: Callable[[Ints, Side], tuple[Floats, Floats]]
) -> Measure:
    """Measure rows against the closed form; what is beyond the limit, also just beside (u, v).

    `compare` takes rows and their normals and curvatures, and gives values and limits.
    """
    values, limits = compare(rows, view.surface.at(rows))
    broken = np.flatnonzero(~(values <= limits))
    if len(broken):
        for side in sides(view, rows[broken]):
            other, bound = compare(rows[broken], side)
            right = other <= bound
            values[broken[right]], limits[broken[right]] = other[right], bound[right]
    return Measure(values, limits, _row(view, rows))


@model_rule(
    "normal-defined",
    "a normal is null where, and only where, the closed form has none",
    needs=_NEEDS,
)
def normal_defined(view: ModelView) -> Iterator[Measure]:
    """Measure nulls; where a derivative is almost zero, both are right."""
    truth, there = view.surface, _has_normal(view)
    exists = ~np.isnan(truth.normal[:, 0])
    ok = np.where(there, exists, ~(exists & truth.regular))
    rows = np.flatnonzero(truth.known)
    yield Measure.of_truth(ok[rows], _row(view, rows))
    whole = np.isnan(view.normals).all(axis=1) | _has_normal(view)
    yield Measure.of_truth(whole, _row(view))


def _has_normal(view: ModelView) -> Flags:
    return np.asarray(~np.isnan(view.normals).any(axis=1))


@model_rule("curvature-order", "k_min <= k_max, both or neither null, null without a normal")
def curvature_order(view: ModelView) -> Iterator[Measure]:
    """Measure the order and the nulls of both curvatures."""
    low, high = view.floats("vertices", "k_min"), view.floats("vertices", "k_max")
    neither = np.isnan(low) & np.isnan(high)
    ok = np.where(_has_normal(view), (low <= high) | neither, neither)
    yield Measure.of_truth(ok, lambda i: f"row {i}: k_min {low[i]}, k_max {high[i]}")


@model_rule(
    "curvature",
    "k_min and k_max are the closed form's towards the outward normal",
    limit="1e-6 x greater of both + 1e-9 / diagonal, singular points left out",
    unit="1/mm",
    needs=_NEEDS,
    share=0.001,
    source=True,
)
def curvature(view: ModelView) -> Iterator[Measure]:
    """Measure the greater error of both curvatures against the closed form."""
    stored = view.triples("vertices", "k_min k_max")

    def compare(rows: Ints, side: Side) -> tuple[Floats, Floats]:
        exact = np.stack([side.curvature.k_min, side.curvature.k_max], axis=1)
        error = np.abs(stored[rows] - exact).max(axis=1, initial=0)
        return error, 1e-6 * np.abs(exact).max(axis=1, initial=0) + 1e-9 / view.diagonal

    truth = view.surface
    defined = ~np.isnan(truth.curvature.k_min) & ~np.isnan(stored).any(axis=1)
    yield _against_closed_form(view, np.flatnonzero(defined & truth.regular), compare)


@model_rule(
    "curvature-defined",
    "curvatures are null where, and only where, the closed form has none",
    needs=_NEEDS,
)
def curvature_defined(view: ModelView) -> Iterator[Measure]:
    """Measure nulls; where a derivative is almost zero, both are right."""
    truth = view.surface
    there = ~np.isnan(view.floats("vertices", "k_min"))
    exists = ~np.isnan(truth.curvature.k_min)
    ok = np.where(there, exists, ~(exists & truth.regular))
    rows = np.flatnonzero(truth.known)
    yield Measure.of_truth(ok[rows], _row(view, rows))


@model_rule(
    "directions",
    "d_min and d_max are unit, tangent and orthogonal; both or neither null",
    limit="1e-9",
)
def directions(view: ModelView) -> Iterator[Measure]:
    """Measure lengths and right angles of the curvature directions."""
    low, high = view.vectors("vertices", "d_min"), view.vectors("vertices", "d_max")
    alone = np.isnan(low[:, 0]) != np.isnan(high[:, 0])
    yield Measure.of_truth(~alone, lambda i: f"row {i}: one of both is null")
    rows = np.flatnonzero(~np.isnan(low[:, 0]) & ~np.isnan(high[:, 0]))
    low, high, normal = low[rows], high[rows], view.normals[rows]
    for what, error in (
        ("length of d_min", np.linalg.norm(low, axis=1) - 1),
        ("length of d_max", np.linalg.norm(high, axis=1) - 1),
        ("d_min . normal", np.einsum("ni,ni->n", low, normal)),
        ("d_max . normal", np.einsum("ni,ni->n", high, normal)),
        ("d_min . d_max", np.einsum("ni,ni->n", low, high)),
    ):
        yield Measure(np.abs(error), 1e-9, place("row {0}: {w}", rows, w=what))


@model_rule(
    "direction-truth",
    "d_min is the closed form's direction, as sharply as k_max - k_min defines it",
    limit="1e-6 x greater of both / (k_max - k_min)",
    unit="rad",
    needs=(*_NEEDS, "directions"),
    share=0.001,
    source=True,
)
def direction_truth(view: ModelView) -> Iterator[Measure]:
    """Measure the angle between stored and exact d_min, up to its sign."""
    truth, stored = view.surface, view.vectors("vertices", "d_min")

    def compare(rows: Ints, side: Side) -> tuple[Floats, Floats]:
        angle = angle_between(stored[rows], side.curvature.d_min)
        size, gap = _size_and_gap(side.curvature)
        return np.minimum(angle, np.pi - angle), 1e-6 * size / np.maximum(gap, 1e-6 * size)

    known = truth.regular & ~np.isnan(truth.curvature.d_min[:, 0]) & ~np.isnan(stored[:, 0])
    # below a thousandth of the curvature itself, the direction is that of the rounding
    size, gap = _size_and_gap(truth.curvature)
    rows = np.flatnonzero(known & (gap > 1e-3 * size) & (size > 1e-9 / view.diagonal))
    yield _against_closed_form(view, rows, compare)


def _size_and_gap(k: PrincipalCurvature) -> tuple[Floats, Floats]:
    """Return the greater absolute value of both curvatures, and their difference."""
    return np.maximum(np.abs(k.k_min), np.abs(k.k_max)), k.k_max - k.k_min
