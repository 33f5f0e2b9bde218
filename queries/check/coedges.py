"""Rules on coedges: each pcurve, put on its patch, runs along its curve."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from breplake.queries.check.rules import Measure, model_rule
from breplake.queries.check.topology import loop_numbers, next_in_loop
from breplake.queries.check.view import MISSING, Floats, Ints, ModelView
from breplake.schema.curves import CurveSet
from breplake.schema.pcurves import PcurveSet

__all__: list[str] = []

_NEEDS = ("ids-dense", "references", "words")

_PROJECTED: Final = 1e-6
"""Share of the diagonal by which pcurves that Open CASCADE made for a file that states none may
be off: it does not widen the curve's tolerance to what it achieved."""

_SAMPLES: Final = 9
"""Places along each coedge, its ends included."""


@model_rule(
    "coedge-pcurves",
    "a coedge on a curved patch has a pcurve with a range, one on a plane none",
    needs=_NEEDS,
    share=0.001,
    source=True,
)
def coedge_pcurves(view: ModelView) -> Iterator[Measure]:
    """Measure which coedges have a pcurve, in models that keep how they are stored."""
    if not view.count("shapes"):
        return
    patch = view.ints("coedges", "patch_id")
    plane = view.words("patches", "type")[patch] == "Plane"
    given = view.ints("coedges", "pcurve") != MISSING
    ranged = ~np.isnan(view.floats("coedges", "t_min")) & ~np.isnan(view.floats("coedges", "t_max"))
    # Some files state pcurves on planes too.
    ok = np.where(given, ranged, plane & ~ranged)
    yield Measure.of_truth(ok, lambda i: f"coedges row {i}, patch {patch[i]}")


_SAMPLED: Final = 1.1
"""Share of a stated tolerance that is still within it: systems find it from samples."""

_STEPS: Final = 4
"""Newton steps to the nearest place of a curve, from that of equal parameter."""


@model_rule(
    "pcurve-on-curve",
    "a coedge's pcurve, put on its patch, runs on its curve, at whatever speed",
    limit="max(1e-6 x diagonal, 1.1 x tolerance of the curve)",
    unit="mm",
    needs=_NEEDS,
    share=0.005,
    source=True,
)
def pcurve_on_curve(view: ModelView) -> Iterator[Measure]:
    """Measure the greatest distance from samples of each pcurve to its curve.

    Files do state pcurves that run along their curve at another speed.
    """
    rows = _evaluable(view)
    curve = view.ints("coedges", "curve_id")[rows]
    away = np.zeros(len(rows))
    curves = CurveSet.from_curves(view.table("curves"))
    low, high = view.floats("curves", "t_min")[curve], view.floats("curves", "t_max")[curve]
    for share in np.linspace(0.0, 1.0, _SAMPLES):
        point = _on_patch(view, rows, share)
        away = np.maximum(away, _distance(curves, curve, point, low, high, share))
    tolerance = _SAMPLED * view.floats("curves", "tolerance")[curve]
    limit = np.maximum(_PROJECTED * view.diagonal, tolerance)
    patch = view.ints("coedges", "patch_id")[rows]
    yield Measure(away, limit, lambda i: f"curve {curve[i]} on patch {patch[i]}")


@model_rule(
    "pcurve-loops",
    "on its patch, each pcurve of a loop begins where the one before ends",
    limit="2 x the tolerance of the corner between them, at least 1e-6 x diagonal",
    unit="mm",
    needs=(*_NEEDS, "loops", "loops-close"),
    share=0.001,
    source=True,
)
def pcurve_loops(view: ModelView) -> Iterator[Measure]:
    """Measure the gaps between consecutive pcurves, in space: a seam's sides are one place."""
    rows = _evaluable(view)
    count = view.count("coedges")
    ends = np.full((2, count, 3), np.nan)
    for side, share in enumerate((0.0, 1.0)):
        ends[side, rows] = _on_patch(view, rows, share)
    against = view.flags("coedges", "reversed")
    start, stop = np.where(against[:, None], ends[::-1], ends)  # (n, 3) each
    after = next_in_loop(loop_numbers(view))
    gap = np.linalg.norm(start[after] - stop, axis=1) if count else np.empty(0)
    curve = view.ints("coedges", "curve_id")
    last = np.where(
        against,
        view.ints("curves", "start_corner")[curve],
        view.ints("curves", "end_corner")[curve],
    )
    tolerance = np.append(view.floats("corners", "tolerance"), 0.0)
    room = 2 * tolerance[np.where(last == MISSING, -1, last)]
    measured = np.flatnonzero(~np.isnan(gap))
    limit = np.maximum(_PROJECTED * view.diagonal, room[measured])
    patch = view.ints("coedges", "patch_id")
    yield Measure(
        gap[measured],
        limit,
        lambda i: f"after curve {curve[measured[i]]} on patch {patch[measured[i]]}",
    )


def _distance(
    curves: CurveSet, curve: Ints, point: Floats, low: Floats, high: Floats, share: float
) -> Floats:
    """Return how far points ``(n, 3)`` are from their curves, near a share of the range, mm."""
    t = low + share * (high - low)
    best = np.full(len(curve), np.inf)
    for _ in range(_STEPS + 1):
        found = curves.evaluate(curve, t)
        gap = point - found.point
        best = np.fmin(best, np.linalg.norm(gap, axis=1))
        speed = np.sum(found.d1**2, axis=1)
        ahead = np.sum(gap * found.d1, axis=1) / np.where(speed > 0, speed, 1.0)
        t = np.clip(t + ahead, low, high)
    return best


def _evaluable(view: ModelView) -> Ints:
    """Return the coedges whose pcurve, patch and curve can all be evaluated, ``(n,)``."""
    pcurve = view.ints("coedges", "pcurve")
    patch, curve = view.ints("coedges", "patch_id"), view.ints("coedges", "curve_id")
    if not view.count("pcurves"):
        return np.empty(0, dtype=np.int64)
    known = (pcurve != MISSING) & view.surfaces.known[patch]
    known &= PcurveSet.from_pcurves(view.table("pcurves")).known[np.where(known, pcurve, 0)]
    known &= CurveSet.from_curves(view.table("curves")).known[curve]
    return np.flatnonzero(known)


def _on_patch(view: ModelView, rows: Ints, share: float) -> Floats:
    """Return the places on their patches of coedges at a share of their ranges, ``(n, 3)`` mm."""
    low = view.floats("coedges", "t_min")[rows]
    high = view.floats("coedges", "t_max")[rows]
    pcurves = PcurveSet.from_pcurves(view.table("pcurves"))
    uv = pcurves.evaluate(view.ints("coedges", "pcurve")[rows], low + share * (high - low)).point
    patch = view.ints("coedges", "patch_id")[rows]
    point: Floats = view.surfaces.evaluate(patch, uv[:, 0], uv[:, 1]).point
    return point
