"""The rule on trimmed areas: what the loops of a patch enclose is its area."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from breplake.queries.check.rules import Measure, model_rule
from breplake.queries.check.view import Floats, ModelView
from breplake.schema.trimming.patches import TrimmedPatches

__all__: list[str] = []

_QUADRATURE: Final = 1e-4
"""Share of a patch's area by which Open CASCADE's quadrature may be off. The area of a swept patch
is ours, so that only the rule ``patch-area``, by the mesh, judges it independently."""

_TINY: Final = 1e-7
"""Share of the squared diagonal below which areas say nothing."""


@model_rule(
    "trimmed-areas",
    "the area that a patch's pcurves enclose on its surface is its area",
    limit="1e-4 x area + 1e-7 x diagonal^2 + tolerance x length of its curves",
    unit="mm^2",
    needs=("ids-dense", "references", "words", "coedge-pcurves", "pcurve-loops"),
    share=0.001,
    source=True,
)
def trimmed_areas(view: ModelView) -> Iterator[Measure]:
    """Measure each patch whose surface and loops can be evaluated, in models that keep them."""
    if not view.count("shapes"):
        return
    names = ("patches", "curves", "coedges", "pcurves")
    trimmed = TrimmedPatches.from_tables(**{name: view.table(name) for name in names})
    known = np.flatnonzero(trimmed.known)
    area = view.floats("patches", "area")
    room = _QUADRATURE * np.abs(area) + _TINY * view.diagonal**2 + _doubt(view)
    away = np.abs(trimmed.area() - area)
    yield Measure(away[known], room[known], lambda i: f"patch {known[i]}")


def _doubt(view: ModelView) -> Floats:
    """Return the area beside each patch's curves that is within their tolerance, ``(n,)`` mm^2."""
    curve = view.ints("coedges", "curve_id")
    strip = view.floats("curves", "length") * view.floats("curves", "tolerance")
    patch = view.ints("coedges", "patch_id")
    doubt = np.zeros(view.count("patches"))
    np.add.at(doubt, patch, np.nan_to_num(strip[curve]))
    return doubt
