"""Points with derivatives, and what follows from them: normals and principal curvatures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from breplake.schema.forms import principal, unit_normal
from breplake.schema.namespace import VANISHING, Array, namespace, slices

__all__ = [
    "LEAST_ANGLE",
    "CurveJet",
    "PcurveJet",
    "PrincipalCurvature",
    "SurfaceJet",
    "SurfacePoints",
    "times_known",
]

LEAST_ANGLE: Final = VANISHING
"""Sine of the angle of du and dv below which a patch has no normal."""

_BATCH: Final = 16_384  # points whose temporaries stay in the cache


@dataclass(frozen=True, slots=True)
class CurveJet:
    """Points of curves with derivatives by the parameter, each ``(n, 3)``; NaN if unknown.

    Attributes
    ----------
    point : array
        mm.
    d1, d2 : array
        First and second derivative.
    """

    point: Array
    d1: Array
    d2: Array


@dataclass(frozen=True, slots=True)
class PcurveJet:
    """Points (u, v) with derivatives by the curve's parameter, each ``(n, 2)``; NaN if unknown.

    Attributes
    ----------
    point, d1, d2 : array
        Parameters on the patch, first and second derivative.
    """

    point: Array
    d1: Array
    d2: Array


@dataclass(frozen=True, slots=True)
class PrincipalCurvature:
    """Principal curvatures and their directions; NaN where undefined.

    Attributes
    ----------
    k_min, k_max : array
        ``(n,)`` 1/mm, ``k_min <= k_max``, positive where the surface bends to the normal.
    d_min, d_max : array
        ``(n, 3)`` unit, tangent, orthogonal. At an umbilic, where every direction will
        do, d_min is along du.
    """

    k_min: Array
    k_max: Array
    d_min: Array
    d_max: Array


@dataclass(frozen=True, slots=True)
class SurfacePoints:
    """Points of surfaces with normals and principal curvatures; NaN where undefined.

    Attributes
    ----------
    point : array
        ``(n, 3)`` mm.
    normal : array
        ``(n, 3)`` unit, along du x dv.
    k_min, k_max : array
        ``(n,)`` 1/mm, ``k_min <= k_max``, positive where the surface bends to the normal.
    """

    point: Array
    normal: Array
    k_min: Array
    k_max: Array


@dataclass(frozen=True, slots=True)
class SurfaceJet:
    """Points of surfaces with derivatives by u and v, each ``(n, 3)``; NaN if unknown.

    Attributes
    ----------
    point : array
        mm.
    du, dv, duu, duv, dvv : array
        First and second derivatives.
    least : array
        ``(n, 2)`` lengths of du and dv at and below which rounding decides them.
    radial : array or None
        ``(n, 3)`` normal on spheres, which holds at their poles too; NaN elsewhere.
    umbilic : array or None
        ``(n,)`` curvature of spheres towards `radial`, 1/mm; NaN elsewhere.
    """

    point: Array
    du: Array
    dv: Array
    duu: Array
    duv: Array
    dvv: Array
    least: Array
    radial: Array | None = None
    umbilic: Array | None = None

    def normal(self) -> Array:
        """Return the unit normals du x dv / abs(du x dv).

        Returns
        -------
        array
            ``(n, 3)``, NaN where du or dv vanishes or both are parallel: cone apexes,
            collapsed sides of splines. Spheres have their normal at the poles too.
        """
        normal = self._in_batches(lambda part: unit_normal(*self._firsts(part)), 3).T
        if self.radial is None:
            return normal
        xp = namespace(normal)
        return xp.where(xp.isnan(self.radial), normal, self.radial)

    def curvature(self, normal: Array | None = None) -> PrincipalCurvature:
        """Return the principal curvatures towards `normal`.

        Parameters
        ----------
        normal : array, optional
            ``(n, 3)`` unit normals of either side; by default those of `normal()`.
        """
        towards = self.normal() if normal is None else normal
        xp = namespace(towards)

        def work(part: slice) -> Array:
            du, dv, least = self._firsts(part)
            seconds = self.duu[part].T, self.duv[part].T, self.dvv[part].T
            found = principal(du, dv, seconds, towards[part].T, least)
            return xp.concatenate([found.k_min[None], found.k_max[None], found.d_min, found.d_max])

        found = self._in_batches(work, 8)
        k_min, k_max = found[0], found[1]
        if self.radial is not None and self.umbilic is not None:
            sphere = ~xp.isnan(self.umbilic)
            side = xp.sign((towards * xp.where(sphere[:, None], self.radial, 0.0)).sum(-1))
            known = xp.where(sphere, self.umbilic, 0.0) * side
            k_min, k_max = xp.where(sphere, known, k_min), xp.where(sphere, known, k_max)
        return PrincipalCurvature(k_min, k_max, found[2:5].T, found[5:8].T)

    def _firsts(self, part: slice) -> tuple[Array, Array, Array]:
        return self.du[part].T, self.dv[part].T, self.least[part].T

    def _in_batches(self, work: Callable[[slice], Array], height: int) -> Array:
        """Return what `work` makes of all points, ``(height, n)``."""
        if not isinstance(self.point, np.ndarray):
            return work(slice(None))
        out = np.empty((height, len(self.point)))
        for part in slices(len(self.point), _BATCH):
            out[:, part] = work(part)
        return out


def times_known(numbers: Array, vectors: Array) -> Array:
    """Return numbers ``(n,)`` times vectors ``(n, 3)``, NaN where the number is.

    Gradients by the vectors are zero there, and no NaN.
    """
    xp = namespace(vectors)
    known = ~xp.isnan(numbers)
    return xp.where(known[:, None], xp.where(known, numbers, 0.0)[:, None] * vectors, xp.nan)
