"""Patches as densities over their parameter planes: area per du dv, and where it is smooth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from breplake.schema.grouping import grouped, selected
from breplake.schema.namespace import Array, Bools, Floats, Ints, cross, length
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.types import SURFACE_TYPES

__all__ = ["Density"]

_BATCH: Final = 4_096  # points whose temporaries stay in the cache
_SPLINE: Final = SURFACE_TYPES.index("BSpline")
_EXTRUSION: Final = SURFACE_TYPES.index("Extrusion")


@dataclass(frozen=True, slots=True)
class Density:
    """The area abs(du x dv) of a unit of parameters, mm^2, on the patches of a table.

    Attributes
    ----------
    surfaces : SurfaceSet
        The patches.
    kind : numpy.ndarray
        ``(n,)`` place of the type in ``SURFACE_TYPES``, that of the basis for an offset.
    """

    surfaces: SurfaceSet
    kind: Ints

    @property
    def single(self) -> Bools:
        """Whether each patch's density depends on one parameter at most, ``(n,)``."""
        return np.asarray(self.kind != _SPLINE)

    def sideways(self, window: Floats) -> Bools:
        """Tell along which parameter it is easier to integrate.

        Parameters
        ----------
        window : numpy.ndarray
            ``(4, n)`` least and greatest u and v that matter.

        Returns
        -------
        numpy.ndarray
            ``(n,)`` bool: along v, where the density is constant along v, or has fewer creases
            there; else along u.
        """
        along: Bools = np.asarray(self.kind == _EXTRUSION)
        for row in np.flatnonzero((self.kind == _SPLINE) & np.isfinite(window[0])).tolist():
            u0, u1, v0, v1 = window[:, row].tolist()
            along[row] = len(self.creases(row, 1, v0, v1)) < len(self.creases(row, 0, u0, u1))
        return along

    def at(self, row: Ints, u: Floats, v: Floats) -> Floats:
        """Return the density at points ``(n,)``."""

        def work(group: int, index: Any) -> list[Array]:
            rows = selected(row, index)
            _, du, dv = self.surfaces.jet(group, rows, u[index], v[index], 1)
            return [length(cross(du, dv))[None]]

        sizes = [_BATCH] * len(self.surfaces.kinds)
        found = grouped(self.surfaces.group[row], len(row), sizes, work, 1, u)
        return np.asarray(found[0])

    def creases(self, row: int, axis: int, low: float, high: float) -> Floats:
        """Return where between two u (axis 0) or v (axis 1) a patch may not be smooth.

        That is at its knots, or at those of the curve that it sweeps; ascending.
        """
        kind = int(self.kind[row])
        if kind == _SPLINE:
            own = self.surfaces.splines
            found = (own.v_knots if axis else own.u_knots).within(row, low, high)
        elif SURFACE_TYPES[kind] == ("Revolution" if axis else "Extrusion"):
            found = self.surfaces.curves.breaks(row, low, high)
        else:
            return np.zeros(0)
        inner: Floats = found[(found > low) & (found < high)]
        return inner
