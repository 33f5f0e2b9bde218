"""Parameter periods of the surfaces of the table ``patches``."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from breplake.schema import ragged
from breplake.schema.curves import CurveSet
from breplake.schema.namespace import Floats, Ints
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.types import SURFACE_TYPES

__all__ = ["curve_periods", "surface_kinds", "surface_periods"]

_TURN = 2 * np.pi


def surface_kinds(patches: pa.Table) -> Ints:
    """Return the place of each patch's type in ``SURFACE_TYPES``, ``(n,)``; -1 if unknown.

    An offset surface is of the kind of the surface that is offset.
    """
    kind = ragged.codes(patches, "type", SURFACE_TYPES)
    if "basis_type" not in patches.column_names:
        return kind
    moved = kind == SURFACE_TYPES.index("Other")
    return np.where(moved, ragged.codes(patches, "basis_type", SURFACE_TYPES), kind)


def surface_periods(patches: pa.Table, surfaces: SurfaceSet) -> Floats:
    """Return the periods in u and v, ``(2, n)``; infinite where a surface is open.

    Parameters
    ----------
    patches : pyarrow.Table
        Rows of ``patches``.
    surfaces : SurfaceSet
        The same rows.
    """
    kind = surface_kinds(patches)
    swept = curve_periods(surfaces.curves)
    own = surfaces.splines
    period = np.full((2, len(kind)), np.inf)
    for axis, (side, knots, name) in enumerate(
        (("u", own.u_knots, "Extrusion"), ("v", own.v_knots, "Revolution"))
    ):
        choices = [kind == SURFACE_TYPES.index("BSpline"), kind == SURFACE_TYPES.index(name)]
        found = np.select(choices, [knots.high - knots.low, swept], _TURN)
        closed = ragged.flags(patches, f"{side}_periodic")
        period[axis] = np.where(closed, found, np.inf)
    return period


def curve_periods(curves: CurveSet) -> Floats:
    """Return the period that each curve has if it is periodic."""
    spline = np.array([kind.name == "BSpline" for kind in curves.kinds] + [False])[curves.group]
    knots = curves.splines.knots
    return np.where(spline, knots.high - knots.low, _TURN)
