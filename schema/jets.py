"""Points with derivatives, and what follows from them: normals and principal curvatures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from breplake.schema.namespace import Array, Floats, cross, dot, length, namespace, slices

__all__ = ["LEAST_ANGLE", "CurveJet", "PrincipalCurvature", "SurfaceJet"]

LEAST_ANGLE = 1e-9
"""Sine of the angle of du and dv below which a patch has no normal."""

_BATCH = 16_384  # points whose temporaries stay in the cache


@dataclass(frozen=True, slots=True)
class CurveJet:
    """Points of curves with derivatives by the parameter, each ``(n, 3)``; NaN if unknown.

    Attributes
    ----------
    point : numpy.ndarray
        mm.
    d1, d2 : numpy.ndarray
        First and second derivative.
    """

    point: Floats
    d1: Floats
    d2: Floats


@dataclass(frozen=True, slots=True)
class PrincipalCurvature:
    """Principal curvatures and their directions; NaN where undefined.

    Attributes
    ----------
    k_min, k_max : numpy.ndarray
        ``(n,)`` 1/mm, ``k_min <= k_max``, positive where the surface bends to the normal.
    d_min, d_max : numpy.ndarray
        ``(n, 3)`` unit, tangent, orthogonal. At an umbilic, where every direction will
        do, d_min is along du.
    """

    k_min: Floats
    k_max: Floats
    d_min: Floats
    d_max: Floats


@dataclass(frozen=True, slots=True)
class SurfaceJet:
    """Points of surfaces with derivatives by u and v, each ``(n, 3)``; NaN if unknown.

    Attributes
    ----------
    point : numpy.ndarray
        mm.
    du, dv, duu, duv, dvv : numpy.ndarray
        First and second derivatives.
    least : numpy.ndarray
        ``(n, 2)`` lengths of du and dv at and below which rounding decides them.
    radial : numpy.ndarray or None
        ``(n, 3)`` normal on spheres, which holds at their poles too; NaN elsewhere.
    umbilic : numpy.ndarray or None
        ``(n,)`` curvature of spheres towards `radial`, 1/mm; NaN elsewhere.
    """

    point: Floats
    du: Floats
    dv: Floats
    duu: Floats
    duv: Floats
    dvv: Floats
    least: Floats
    radial: Floats | None = None
    umbilic: Floats | None = None

    def normal(self) -> Floats:
        """Return the unit normals du x dv / abs(du x dv).

        Returns
        -------
        numpy.ndarray
            ``(n, 3)``, NaN where du or dv vanishes or both are parallel: cone apexes,
            collapsed sides of splines. Spheres have their normal at the poles too.
        """
        normal = np.empty((3, len(self.point)))
        for part in slices(len(self.point), _BATCH):
            normal[:, part] = _unit_normal(self.du[part].T, self.dv[part].T, self.least[part].T)
        if self.radial is None:
            return normal.T
        return np.where(np.isnan(self.radial), normal.T, self.radial)

    def curvature(self, normal: Floats | None = None) -> PrincipalCurvature:
        """Return the principal curvatures towards `normal`.

        Parameters
        ----------
        normal : numpy.ndarray, optional
            ``(n, 3)`` unit normals of either side; by default those of `normal()`.
        """
        count = len(self.point)
        normal = self.normal() if normal is None else normal
        k_min, k_max = np.empty(count), np.empty(count)
        d_min, d_max = np.empty((3, count)), np.empty((3, count))
        for part in slices(count, _BATCH):
            first = self.du[part].T, self.dv[part].T
            second = self.duu[part].T, self.duv[part].T, self.dvv[part].T
            result = _principal(*first, *second, normal[part].T, self.least[part].T)
            k_min[part], k_max[part], d_min[:, part], d_max[:, part] = result
        if self.radial is not None and self.umbilic is not None:
            side = np.sign((normal * self.radial).sum(axis=1))
            known = self.umbilic * side
            k_min = np.where(np.isnan(known), k_min, known)
            k_max = np.where(np.isnan(known), k_max, known)
        return PrincipalCurvature(k_min, k_max, d_min.T, d_max.T)


def _unit_normal(du: Array, dv: Array, least: Array) -> Array:
    """Return the unit normals ``(3, n)`` of ``(3, n)`` tangents, NaN where undefined."""
    xp = namespace(du)
    a, b = length(du), length(dv)
    defined = (a > least[0]) & (b > least[1])
    normal = cross(du / xp.where(defined, a, 1.0), dv / xp.where(defined, b, 1.0))
    sine = length(normal)
    defined = defined & (sine > LEAST_ANGLE)
    return xp.where(defined, normal / xp.where(defined, sine, 1.0), xp.nan)


def _principal(
    du: Array, dv: Array, duu: Array, duv: Array, dvv: Array, normal: Array, least: Array
) -> tuple[Array, Array, Array, Array]:
    """Return k_min, k_max ``(n,)`` and d_min, d_max ``(3, n)``; all inputs ``(3, n)``.

    The second fundamental form is first written in an orthonormal basis of the tangent
    plane: eigenvalues of a symmetric matrix are then as accurate as its entries.
    """
    xp = namespace(du)
    a = length(du)
    defined = (a > least[0]) & (length(dv) > least[1])
    a = xp.where(defined, a, 1.0)
    t1 = du / a
    b = dot(dv, t1)
    rest = dv - b * t1  # the part of dv across du
    c = length(rest)
    defined = defined & (c > 0)
    c = xp.where(defined, c, 1.0)
    t2 = rest / c
    s11 = dot(duu, normal) / a / a
    mixed = dot(duv, normal) / a
    s12 = (mixed - b * s11) / c
    s22 = (dot(dvv, normal) - b * (2 * mixed - b * s11)) / c / c
    k1, k2, sine, cosine = _rotation(s11, s12, s22)
    d1, d2 = cosine * t1 - sine * t2, sine * t1 + cosine * t2
    swap = k1 > k2
    d_min, d_max = xp.where(swap, d2, d1), xp.where(swap, d1, d2)
    k_min, k_max = xp.where(swap, k2, k1), xp.where(swap, k1, k2)
    return (
        xp.where(defined, k_min, xp.nan),
        xp.where(defined, k_max, xp.nan),
        xp.where(defined, d_min, xp.nan),
        xp.where(defined, d_max, xp.nan),
    )


def _rotation(s11: Array, s12: Array, s22: Array) -> tuple[Array, Array, Array, Array]:
    """Diagonalise symmetric 2 x 2 matrices by one Jacobi rotation each.

    Unlike mean and difference, it keeps a small eigenvalue beside a large one exact when
    the matrix is diagonal already, as it is in the parameters of most surfaces.

    Returns
    -------
    k1, k2, sine, cosine : array
        ``(n,)`` eigenvalues, of the vectors ``(cosine, -sine)`` and ``(sine, cosine)``.
    """
    xp = namespace(s11)
    half = (s22 - s11) / 2
    below = abs(half) + xp.hypot(half, s12)
    turned = below > 0
    tangent = xp.where(half < 0, -s12, s12) / xp.where(turned, below, 1.0)
    tangent = xp.where(turned, tangent, 0.0)
    cosine = 1 / xp.sqrt(1 + tangent * tangent)
    return s11 - tangent * s12, s22 + tangent * s12, tangent * cosine, cosine
