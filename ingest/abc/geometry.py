"""The exact geometry behind an original mesh: of a features file, or of the STEP beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.ingest.refine import Periods
from breplake.schema.curves import CurveSet
from breplake.schema.jets import SurfaceJet
from breplake.schema.periods import surface_periods
from breplake.schema.surfaces import SurfaceSet

__all__ = ["ExactGeometry"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]
_Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ExactGeometry:
    """Curves and surfaces by our ids, evaluated by closed forms.

    Parameters
    ----------
    curves : CurveSet
        By curve_id.
    surfaces : SurfaceSet
        By patch_id.
    periods : Periods
        Of the surfaces' parameters.
    is_plane : numpy.ndarray
        ``(p,)`` bool.
    """

    curves: CurveSet
    surfaces: SurfaceSet
    periods: Periods
    is_plane: _Bools

    @classmethod
    def of(cls, curves: pa.Table, patches: pa.Table) -> ExactGeometry:
        """Build it from the columns of ``curves`` and ``patches`` that describe geometry."""
        surfaces = SurfaceSet.from_patches(patches)
        period = np.ascontiguousarray(surface_periods(patches, surfaces).T)  # (n, 2)
        is_plane = np.array([kind == "Plane" for kind in patches.column("type").to_pylist()], bool)
        return cls(CurveSet.from_curves(curves), surfaces, _bounded(patches, period), is_plane)

    def jet(self, patch_ids: _Ints, u: _Floats, v: _Floats) -> SurfaceJet:
        """Evaluate surfaces, as ``ingest.kernel.GmshModel.jet`` does."""
        return self.surfaces.evaluate(patch_ids, u, v)

    def curve_points(self, curve_id: int, t: _Floats) -> _Floats:
        """Return points ``(n, 3)`` mm of a curve at parameters ``(n,)``."""
        return np.ascontiguousarray(self.curves.evaluate(curve_id, t).point)


def _bounded(patches: pa.Table, period: _Floats) -> Periods:
    """Return the periods with bounds: of open splines their knots', of spheres the poles'.

    A spline that is closed without being periodic goes round, too.
    """
    bounds = np.tile([-np.inf, np.inf] * 2, (len(period), 1))
    for i, row in enumerate(patches.select(_used(patches)).to_pylist()):
        if row["type"] == "Sphere":
            bounds[i, 2:] = -np.pi / 2, np.pi / 2
        for axis, name in enumerate("uv"):
            holder, prefix = row, f"{name}_"
            if row["type"] == ("Extrusion", "Revolution")[axis]:
                holder, prefix = row["curve"], ""
            knots, degree = holder.get(f"{prefix}knots"), holder.get(f"{prefix}degree")
            if knots and np.isinf(period[i, axis]):
                low, high = knots[degree], knots[-degree - 1]
                bounds[i, 2 * axis : 2 * axis + 2] = low, high
                if row[f"{name}_closed"]:
                    period[i, axis] = high - low
    return Periods(period, bounds)


def _used(patches: pa.Table) -> list[str]:
    wanted = ("type", "curve", "u_degree", "v_degree", "u_knots", "v_knots", "u_closed", "v_closed")
    return [name for name in wanted if name in patches.column_names]
