"""Surfaces of the table ``patches``, evaluated without a CAD kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from breplake.schema import ragged
from breplake.schema.curves import CurveSet, query
from breplake.schema.elementary import ELEMENTARY, extruded, revolved, sphere_normal
from breplake.schema.jets import SurfaceJet
from breplake.schema.namespace import Array, Bools, Floats, Ints, batches, gather
from breplake.schema.projection import project_points
from breplake.schema.splines import MAX_DEGREE, Knots, SplineSurfaces
from breplake.schema.types import SURFACE_TYPES

__all__ = ["SurfaceSet"]

_BATCH = 16_384  # points whose temporaries stay in the cache
_SPLINE_BATCH = 4_096  # the same, a spline's point having many poles
_VANISHING = 1e-9  # of the usual length of a derivative: shorter than this is zero
_PLACES: Final = {name: place for place, name in enumerate(SURFACE_TYPES)}
_SPLINE = _PLACES["BSpline"]
_SWEPT = (_PLACES["Revolution"], _PLACES["Extrusion"])
_KINDS = 16  # groups are kind + 16 * (group of the basis curve, or degrees of the spline)
_DEGREES = MAX_DEGREE + 1


@dataclass(frozen=True, slots=True)
class SurfaceSet:
    """Surfaces of a table, ready to be evaluated at many points of many rows at once.

    Build one with :meth:`from_patches`. Normals are those of du x dv: the caller applies
    the column ``reversed``.

    Attributes
    ----------
    known : numpy.ndarray
        ``(n_rows,)`` bool: the row has a type that can be evaluated, with its parameters.
    least : numpy.ndarray
        ``(2, n_rows)`` lengths of du and dv at and below which rounding decides them.
    group : numpy.ndarray
        ``(n_rows,)`` rows of one group are evaluated together; negative if unknown.
    axes, size, curves, splines
        Parameters of the surfaces.
    """

    known: Bools
    least: Floats
    group: Ints
    axes: Floats  # (12, n_rows) location, x, y and z axis
    size: Floats  # (3, n_rows)
    curves: CurveSet
    splines: SplineSurfaces

    @staticmethod
    def from_patches(table: pa.Table) -> SurfaceSet:
        """Read the columns of ``patches`` that describe geometry.

        Columns that are missing count as null; ids, areas and the like are not needed.

        Raises
        ------
        UsageError
            If the table has no column ``type``.
        """
        kind = ragged.codes(table, "type", SURFACE_TYPES)
        axes, size = _axes(table, kind), _sizes(table, kind)
        curves = CurveSet.from_curves(ragged.struct(table, "curve"))
        splines = _splines(table)
        swept, spline = np.isin(kind, _SWEPT), kind == _SPLINE
        known = (kind >= 0) & (kind < _PLACES["Other"])
        known &= np.isfinite(axes).all(axis=0) | spline
        known &= np.isfinite(size).all(axis=0)
        known &= (curves.known | ~swept) & (splines.valid | ~spline)
        degrees = splines.u_knots.degree * _DEGREES + splines.v_knots.degree
        inner = np.select([swept, spline], [curves.group, 2 * degrees + splines.rational], 0)
        return SurfaceSet(
            known=known,
            least=np.where(known, _least(kind, axes, size, curves, splines), 0.0),
            group=np.where(known, kind + _KINDS * inner, -1),
            axes=axes,
            size=size,
            curves=curves,
            splines=splines,
        )

    def evaluate(self, row: ArrayLike, u: ArrayLike, v: ArrayLike) -> SurfaceJet:
        """Evaluate surfaces with their first and second derivatives.

        Parameters
        ----------
        row : array_like
            ``(n,)`` row of the table, or one row for all.
        u, v : array_like
            ``(n,)`` parameters on that surface. Periodic splines wrap; others continue
            their end spans.

        Returns
        -------
        SurfaceJet
            NaN for rows that are not `known`. It takes 160 bytes a point.

        Raises
        ------
        UsageError
            If a row is outside the table or the shapes do not match.
        """
        rows, (us, vs) = query(len(self.known), row, u, v)
        groups = self.group[rows]
        out = np.empty((6, 3, len(rows)))
        out[:, :, groups < 0] = np.nan
        radial = umbilic = None
        if bool((groups == _PLACES["Sphere"]).any()):
            radial, umbilic = np.full((3, len(rows)), np.nan), np.full(len(rows), np.nan)
        for group, index in batches(groups, self._batch(groups)):
            some, su, sv = rows[index], us[index], vs[index]
            for part, values in zip(out, self.jet(group, some, su, sv), strict=True):
                part[:, index] = values
            if radial is not None and umbilic is not None and group == _PLACES["Sphere"]:
                axes, size = gather(self.axes, some), gather(self.size, some)
                radial[:, index], umbilic[index] = sphere_normal(axes, size, su, sv)
        point, du, dv, duu, duv, dvv = (part.T for part in out)
        return SurfaceJet(
            point,
            du,
            dv,
            duu,
            duv,
            dvv,
            least=gather(self.least, rows).T,
            radial=None if radial is None else radial.T,
            umbilic=umbilic,
        )

    def jet(self, group: int, row: Array, u: Array, v: Array) -> tuple[Array, ...]:
        """Return point, du, dv, duu, duv, dvv ``(3, n)`` for rows that are all of `group`."""
        inner, kind = divmod(group, _KINDS)
        if kind == _SPLINE:
            degrees, rational = divmod(inner, 2)
            return self.splines.evaluate(row, u, v, divmod(degrees, _DEGREES), bool(rational))
        axes, name = gather(self.axes, row), SURFACE_TYPES[kind]
        if name == "Revolution":
            return revolved(axes, u, self.curves.jet(inner, row, v))
        if name == "Extrusion":
            return extruded(axes, v, self.curves.jet(inner, row, u))
        return ELEMENTARY[name](axes, gather(self.size, row), u, v)

    def project(
        self,
        row: ArrayLike,
        points: ArrayLike,
        u0: ArrayLike,
        v0: ArrayLike,
        bounds: ArrayLike | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Find the foot points of 3D points on their surfaces, near a first guess.

        Parameters
        ----------
        row : array_like
            ``(n,)`` row of the table, or one row for all.
        points : array_like
            ``(n, 3)`` mm.
        u0, v0 : array_like
            ``(n,)`` parameters to start from. No branch is jumped: the search only
            ever goes downhill.
        bounds : array_like, optional
            ``(n, 4)`` or ``(4,)``: least and greatest u, least and greatest v. By default
            splines are left by no more than the length of their knot range.

        Returns
        -------
        u, v : numpy.ndarray
            ``(n,)``; the start itself where nothing nearer was found.
        residual : numpy.ndarray
            ``(n,)`` distance of p(u, v) to the point, mm; NaN for unknown rows.

        Raises
        ------
        UsageError
            If a row is outside the table or the shapes do not match.
        """
        rows, (us, vs) = query(len(self.known), row, u0, v0)
        if bounds is None:
            bounds = self._around(rows, us, vs)
        return project_points(self.evaluate, rows, points, us, vs, bounds)

    def _around(self, row: Ints, u: Floats, v: Floats) -> Floats:
        """Return bounds ``(n, 4)`` that keep the search near splines and hold its start."""
        kind, curve, own = self.group[row] % _KINDS, self.curves.splines, self.splines
        spline = kind == _SPLINE
        curved = np.isin(kind, _SWEPT) & curve.valid[row]
        box = np.tile([-np.inf, np.inf], (2, len(row), 1))  # (u and v, n, least and greatest)
        for side, knots, mine in (
            (0, own.u_knots, spline),
            (1, own.v_knots, spline),
            (0, curve.knots, curved & (kind == _PLACES["Extrusion"])),
            (1, curve.knots, curved & (kind == _PLACES["Revolution"])),
        ):
            mine = mine & ~knots.periodic[row]
            low, high = knots.low[row[mine]], knots.high[row[mine]]
            start = (u, v)[side][mine]
            box[side, mine, 0] = np.minimum(2 * low - high, start)
            box[side, mine, 1] = np.maximum(2 * high - low, start)
        return np.concatenate([box[0], box[1]], axis=1)

    @staticmethod
    def _batch(groups: Ints) -> int:
        return _SPLINE_BATCH if bool((groups % _KINDS == _SPLINE).any()) else _BATCH


def _axes(table: pa.Table, kind: Ints) -> Floats:
    """Return ``(12, n)``: axes that a type does not have are zero, missing ones NaN."""
    extrusion = kind == _PLACES["Extrusion"]
    location, x, y, z = (
        ragged.vectors(table, name) for name in ("location", "x_axis", "y_axis", "z_axis")
    )
    swept = np.isin(kind, _SWEPT)
    return np.concatenate(
        [
            np.where(extrusion, 0.0, location),
            np.where(swept, 0.0, x),
            np.where(swept, 0.0, y),
            np.where(extrusion, ragged.vectors(table, "direction"), z),
        ]
    )


def _sizes(table: pa.Table, kind: Ints) -> Floats:
    """Return ``(3, n)`` as `ELEMENTARY` wants them; missing ones NaN."""
    cone, torus = kind == _PLACES["Cone"], kind == _PLACES["Torus"]
    round_ = cone | (kind == _PLACES["Cylinder"]) | (kind == _PLACES["Sphere"])
    angle = ragged.scalars(table, "angle")
    zero = np.zeros(len(kind))
    first = np.select(
        [round_, torus], [ragged.scalars(table, "radius"), ragged.scalars(table, "max_radius")], 0.0
    )
    second = np.select([cone, torus], [np.sin(angle), ragged.scalars(table, "min_radius")], 0.0)
    return np.stack([first, second, np.where(cone, np.cos(angle), zero)])


def _splines(table: pa.Table) -> SplineSurfaces:
    poles, u_count = ragged.grids(table, "poles")
    weights, _ = ragged.grids(table, "weights")
    v_count = np.where(u_count > 0, poles.length // np.maximum(u_count, 1), -1)
    u_knots, v_knots = (
        Knots.build(
            ragged.lists(table, f"{side}_knots"),
            ragged.integers(table, f"{side}_degree"),
            count,
            ragged.flags(table, f"{side}_periodic"),
        )
        for side, count in (("u", u_count), ("v", v_count))
    )
    return SplineSurfaces.build(u_knots, v_knots, poles, weights)


def _least(
    kind: Ints, axes: Floats, size: Floats, curves: CurveSet, splines: SplineSurfaces
) -> Floats:
    """Return ``(2, n)``: the lengths below which du and dv count as vanished."""
    spans = [
        np.where(splines.valid, knots.high - knots.low, 1.0)
        for knots in (splines.u_knots, splines.v_knots)
    ]
    extent = splines.poles.extent
    away = np.linalg.norm(curves.frame[0:3] - axes[0:3], axis=0)  # a revolved curve's place
    revolution, extrusion, spline = (
        kind == _PLACES[name] for name in ("Revolution", "Extrusion", "BSpline")
    )
    choices = [spline, revolution, extrusion]
    u_least = np.select(
        choices,
        [_VANISHING * extent / spans[0], _VANISHING * (away + curves.reach), curves.least],
        _VANISHING * (size[0] + size[1] * (kind == _PLACES["Torus"])),
    )
    v_least = np.select(choices, [_VANISHING * extent / spans[1], curves.least, 0 * extent], 0.0)
    return np.stack([u_least, v_least])
