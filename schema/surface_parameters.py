"""The parameters of surfaces as columns of ``patches``, read into flat arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from breplake.schema import ragged
from breplake.schema.closed_forms import CLOSED_FORMS
from breplake.schema.curves import CurveSet
from breplake.schema.elementary_offsets import moved_elementary
from breplake.schema.namespace import VANISHING, Bools, Floats, Ints, cross, dot
from breplake.schema.splines import Knots, SplineSurfaces
from breplake.schema.types import SURFACE_TYPES

__all__ = ["SurfaceKind", "SurfaceParameters"]

_ORTHONORMAL: Final = 1e-12  # axes further from it are taken as they are
_PLACES: Final = {name: place for place, name in enumerate(SURFACE_TYPES)}
_SPLINE: Final = _PLACES["BSpline"]
_SWEPT: Final = (_PLACES["Revolution"], _PLACES["Extrusion"])
_CLOSED: Final = tuple(_PLACES[name] for name in CLOSED_FORMS)


class SurfaceKind(NamedTuple):
    """What surfaces have in common that are evaluated together.

    ``closed``: normal and curvature have a closed form. ``curve``: group of the swept curve.
    """

    name: str
    degrees: tuple[int, int]
    rational: bool
    periodic: tuple[bool, bool]
    curve: int
    offset: bool
    closed: bool


@dataclass(frozen=True, slots=True)
class SurfaceParameters:
    """Parameters of surfaces by row of a table.

    Attributes
    ----------
    kind : numpy.ndarray
        ``(n_rows,)`` place of the type, or of that of the surface that is offset, in
        ``SURFACE_TYPES``.
    moved : numpy.ndarray
        ``(n_rows,)`` bool: the surface is offset.
    offset : numpy.ndarray
        ``(n_rows,)`` how far, mm.
    axes : numpy.ndarray
        ``(12, n_rows)`` location, x, y and z axis; zero where a type has none.
    size : numpy.ndarray
        ``(3, n_rows)`` as ``elementary.ELEMENTARY`` wants them.
    curves, splines
        Curves that are swept, and splines.
    """

    kind: Ints
    moved: Bools
    offset: Floats
    axes: Floats
    size: Floats
    curves: CurveSet
    splines: SplineSurfaces

    @staticmethod
    def read(table: pa.Table) -> SurfaceParameters:
        """Read the columns of ``patches`` that describe geometry."""
        kind = ragged.codes(table, "type", SURFACE_TYPES)
        moved = kind == _PLACES["Other"]
        if "basis_type" in table.column_names:
            kind = np.where(moved, ragged.codes(table, "basis_type", SURFACE_TYPES), kind)
        offset = np.where(moved, ragged.scalars(table, "offset"), 0.0)
        axes, size = _axes(table, kind), _sizes(table, kind)
        equal = moved_elementary(kind, axes, size, offset)
        return SurfaceParameters(
            kind,
            moved & ~equal,
            np.where(equal, 0.0, offset),
            axes,
            size,
            CurveSet.from_curves(ragged.struct(table, "curve")),
            _splines(table),
        )

    @property
    def complete(self) -> Bools:
        """Whether each row has all that its type needs, ``(n_rows,)``."""
        swept, spline = np.isin(self.kind, _SWEPT), self.kind == _SPLINE
        known = (self.kind >= 0) & (self.kind < _PLACES["Other"]) & np.isfinite(self.offset)
        known &= np.isfinite(self.axes).all(axis=0) | spline
        known &= np.isfinite(self.size).all(axis=0)
        known &= (self.curves.known | ~swept) & (self.splines.valid | ~spline)
        return known

    @property
    def mirrored(self) -> Bools:
        """Whether the axes are left-handed, ``(n_rows,)``."""
        x, y, z = self.axes[3:6], self.axes[6:9], self.axes[9:12]
        return np.asarray(dot(cross(x, y), z) < 0)

    @property
    def orthonormal(self) -> Bools:
        """Whether the axes are unit and at right angles, ``(n_rows,)``."""
        x, y, z = self.axes[3:6], self.axes[6:9], self.axes[9:12]
        products = [dot(x, x) - 1, dot(y, y) - 1, dot(z, z) - 1, dot(x, y), dot(y, z), dot(z, x)]
        return np.asarray((np.abs(products) <= _ORTHONORMAL).all(axis=0))

    def kinds(self, known: Bools) -> tuple[tuple[SurfaceKind, ...], Ints]:
        """Return the distinct kinds of known rows, and the place of each row's among them."""
        spline, swept = self.kind == _SPLINE, np.isin(self.kind, _SWEPT)
        u, v = self.splines.u_knots, self.splines.v_knots
        facts = [
            self.kind,
            u.degree * spline,
            v.degree * spline,
            self.splines.rational & spline,
            u.periodic & spline,
            v.periodic & spline,
            np.where(swept, self.curves.group, -1),
            self.moved,
            np.isin(self.kind, _CLOSED) & self.orthonormal,
        ]
        distinct, place = np.unique(np.stack(facts)[:, known], axis=1, return_inverse=True)
        group = np.full(len(known), -1)
        group[known] = place.reshape(-1)
        kinds = tuple(
            SurfaceKind(
                SURFACE_TYPES[name],
                (p, q),
                bool(rational),
                (bool(u), bool(v)),
                curve,
                bool(offset),
                bool(closed),
            )
            for name, p, q, rational, u, v, curve, offset, closed in distinct.T.tolist()
        )
        return kinds, group

    @property
    def least(self) -> Floats:
        """Lengths of du and dv below which these count as vanished, ``(2, n_rows)``.

        Those of an offset are compared with the turn of the normal, a unit vector, times
        the distance, too.
        """
        kind, size, curves = self.kind, self.size, self.curves
        u_width, v_width = (
            np.where(self.splines.valid, knots.high - knots.low, 1.0)
            for knots in (self.splines.u_knots, self.splines.v_knots)
        )
        extent, far = self.splines.poles.extent, np.abs(self.offset)
        away = np.linalg.norm(curves.frame[0:3] - self.axes[0:3], axis=0)  # of a revolved curve
        revolution, extrusion, spline, torus = (
            kind == _PLACES[name] for name in ("Revolution", "Extrusion", "BSpline", "Torus")
        )
        choices = [spline, revolution, extrusion]
        u_usual = np.select(
            choices,
            [(extent + far) / u_width, away + curves.reach + far, curves.least / VANISHING],
            size[0] + size[1] * torus + far,
        )
        v_usual = np.select(
            choices, [(extent + far) / v_width, curves.least / VANISHING, 0 * far], 0.0
        )
        return VANISHING * np.stack([u_usual, v_usual])


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
