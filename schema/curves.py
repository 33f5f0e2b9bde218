"""Curves of the table ``curves``, evaluated without a CAD kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from breplake.schema import ragged
from breplake.schema.conics import CONICS, conic_jet
from breplake.schema.grouping import grouped, query, selected
from breplake.schema.jets import CurveJet
from breplake.schema.namespace import Array, Bools, Floats, Ints, gather
from breplake.schema.offsets import offset_curve
from breplake.schema.parameters import with_parameters
from breplake.schema.splines import SplineCurves
from breplake.schema.transfer import transferred
from breplake.schema.types import CURVE_TYPES

__all__ = ["CurveKind", "CurveSet"]

_BATCH: Final = 8_192  # points whose temporaries stay in the cache
_VANISHING = 1e-9  # of a spline's mean speed: slower than this is standing still
_PLACES: Final = {name: place for place, name in enumerate(CURVE_TYPES)}


class CurveKind(NamedTuple):
    """What curves have in common that are evaluated together."""

    name: str
    degree: int
    rational: bool
    periodic: bool
    offset: bool


@dataclass(frozen=True, slots=True)
class CurveSet:
    """Curves of a table, ready to be evaluated at many points of many rows at once.

    Build one with :meth:`from_curves`.

    Attributes
    ----------
    known : array
        ``(n_rows,)`` bool: the row has a type that can be evaluated, with its parameters.
    least : array
        ``(n_rows,)`` length of the derivative at and below which rounding decides it.
    reach : array
        ``(n_rows,)`` greatest coordinate of the curve's own shape, its place left out, mm.
    kinds : tuple of CurveKind
        All kinds of curves of the table.
    group : array
        ``(n_rows,)`` place in `kinds`; negative if unknown.
    frame, size, splines, offset
        Parameters of the curves.
    """

    known: Array
    least: Array
    reach: Array
    kinds: tuple[CurveKind, ...]
    group: Array
    frame: Array  # (3 * dim, n_rows) origin and two axes
    size: Array  # (2, n_rows) radii or focal length
    splines: SplineCurves
    offset: Array  # (1 or 4, n_rows) distance, and reference direction in space

    @staticmethod
    def from_curves(table: pa.Table) -> CurveSet:
        """Read the columns of ``CURVE_GEOMETRY`` from `table`.

        Columns that are missing count as null.

        Raises
        ------
        UsageError
            If the table has no column ``type``.
        """
        kind = ragged.codes(table, "type", CURVE_TYPES)
        moved = kind == _PLACES["Other"]
        if "basis_type" in table.column_names:
            kind = np.where(moved, ragged.codes(table, "basis_type", CURVE_TYPES), kind)
        distance = np.where(moved, ragged.scalars(table, "offset"), 0.0)
        direction = np.where(moved, ragged.vectors(table, "offset_direction"), 0.0)
        return CurveSet.build(table, kind, moved, np.concatenate([distance[None], direction]))

    @staticmethod
    def build(table: pa.Table, kind: Ints, moved: Bools, offset: Floats) -> CurveSet:
        """Read curves in space or, where `offset` has no direction, in a plane.

        Parameters
        ----------
        table : pyarrow.Table
            With the columns of ``CURVE_GEOMETRY``.
        kind : numpy.ndarray
            ``(n_rows,)`` place of the type, or of that of the curve that is offset, in
            ``CURVE_TYPES``.
        moved : numpy.ndarray
            ``(n_rows,)`` bool: the curve is offset.
        offset : numpy.ndarray
            ``(1 or 4, n_rows)`` by how much, mm, and the reference direction.
        """
        dim = 3 if len(offset) == 4 else 2
        frame, size = _conic_parameters(table, kind, dim)
        degree = ragged.integers(table, "degree")
        splines = SplineCurves.build(
            ragged.lists(table, "knots"),
            degree,
            ragged.flags(table, "periodic"),
            ragged.lists(table, "poles"),
            ragged.lists(table, "weights"),
            dim,
        )
        spline, conic = kind == _PLACES["BSpline"], (kind >= 0) & (kind < _PLACES["BSpline"])
        complete = np.isfinite(frame).all(axis=0) & np.isfinite(size).all(axis=0)
        known = np.where(spline, splines.valid, conic & complete) & np.isfinite(offset).all(axis=0)
        kinds, group = _kinds(kind, moved, degree, splines, known)
        width = np.where(splines.valid, splines.knots.high - splines.knots.low, 1.0)
        extent = np.where(known & spline, splines.poles.extent, 0.0)
        reach = np.where(spline, extent, np.where(known, size.max(axis=0, initial=0), 0.0))
        return CurveSet(
            known=known,
            least=_VANISHING * extent / width,
            reach=reach + np.where(known, abs(offset[0]), 0.0),
            kinds=kinds,
            group=group,
            frame=np.where(spline, np.tile(splines.poles.centre, (3, 1)), frame),
            size=size,
            splines=splines,
            offset=offset,
        )

    def to(self, like: Any = None, *, device: Any = None, dtype: Any = None) -> CurveSet:
        """Return these curves as tensors of torch; see ``SurfaceSet.to``."""
        return transferred(self, like, device=device, dtype=dtype)

    def parameters(self) -> dict[str, Array]:
        """Return what the curves are made of, as `with_parameters` takes it.

        Returns
        -------
        dict
            ``frame`` ``(3 * dim, n_rows)`` origin and two axes, mm; ``size`` ``(2, n_rows)``
            radii or focal length, mm; ``offset`` ``(1 or 4, n_rows)`` distance and direction;
            ``poles`` ``(dim, n_poles)`` mm and ``weights`` ``(n_poles,)`` of all splines, end
            to end: those of row r are where ``splines.poles.owner`` is r.
        """
        poles = self.splines.poles
        own = {name: getattr(self, name) for name in ("frame", "size", "offset")}
        return {**own, "poles": poles.points, "weights": poles.buffer[-1]}

    def with_parameters(self, **changed: Array) -> CurveSet:
        """Return the same curves with other parameters; see ``SurfaceSet.with_parameters``.

        Raises
        ------
        UsageError
            If a name is no parameter, or the shape of one changes.
        """
        return with_parameters(self, changed)

    def evaluate(self, row: Any, t: Any) -> CurveJet:
        """Evaluate curves with their first two derivatives.

        Parameters
        ----------
        row : array_like
            ``(n,)`` row of the table, or one row for all.
        t : array_like
            ``(n,)`` parameter on that curve. Periodic splines wrap; others continue
            their end spans.

        Returns
        -------
        CurveJet
            NaN for rows that are not `known`, and where an offset curve's basis stands
            still.

        Raises
        ------
        UsageError
            If a row is outside the table or the shapes do not match.
        """
        point, d1, d2 = self.arrays(row, t)
        return CurveJet(point.T, d1.T, d2.T)

    def arrays(self, row: Any, t: Any) -> Array:
        """Return point and two derivatives, ``(3, dim, n)``; see `evaluate`."""
        rows, (ts,) = query(len(self.known), self.size, row, t)
        dim = len(self.frame) // 3

        def work(group: int, index: Any) -> list[Array]:
            return self.jet(group, selected(rows, index), ts[index])

        groups = gather(self.group, rows)
        out = grouped(groups, len(ts), [_BATCH] * len(self.kinds), work, 3 * dim, self.size)
        return out.reshape(3, dim, -1)

    def breaks(self, row: int, low: float | None = None, high: float | None = None) -> Floats:
        """Return the parameters at which a curve may not be smooth: the knots of a spline.

        See ``PcurveSet.breaks``.
        """
        query(len(self.known), self.size, row)
        group = int(self.group[row])
        if group < 0 or self.kinds[group].name != "BSpline":
            return np.zeros(0)
        return self.splines.knots.within(row, low, high)

    def jet(self, group: int, row: Array, t: Array, order: int = 2) -> list[Array]:
        """Return point and derivatives ``(dim, n)`` for rows that are all of `group`."""
        kind = self.kinds[group]
        needed = order + kind.offset
        if kind.name in CONICS:
            frame, size = gather(self.frame, row), gather(self.size, row)
            jet = conic_jet(kind.name, t, frame, size, needed)
        else:
            about = kind.degree, kind.rational, kind.periodic
            jet = self.splines.evaluate(row, t, *about, needed)
        if not kind.offset:
            return jet
        offset = gather(self.offset, row)
        return offset_curve(jet, offset[0], offset[1:] if len(offset) > 1 else None)


def _kinds(
    kind: Ints, moved: Bools, degree: Ints, splines: SplineCurves, known: Bools
) -> tuple[tuple[CurveKind, ...], Ints]:
    """Return the distinct kinds of known curves, and the place of each row's among them."""
    spline = kind == _PLACES["BSpline"]
    facts = [kind, degree * spline, splines.rational & spline, splines.knots.periodic & spline]
    distinct, place = np.unique(np.stack([*facts, moved])[:, known], axis=1, return_inverse=True)
    group = np.full(len(kind), -1)
    group[known] = place.reshape(-1)
    kinds = tuple(
        CurveKind(CURVE_TYPES[name], int(p), bool(rational), bool(periodic), bool(offset))
        for name, p, rational, periodic, offset in distinct.T
    )
    return kinds, group


def _conic_parameters(table: pa.Table, kind: Ints, dim: int) -> tuple[Floats, Floats]:
    """Return frames ``(3 * dim, n)`` and sizes ``(2, n)``, NaN where the table lacks a value."""
    line, circle, parabola = (kind == _PLACES[name] for name in ("Line", "Circle", "Parabola"))
    location, direction, x, y = (
        ragged.vectors(table, name, dim) for name in ("location", "direction", "x_axis", "y_axis")
    )
    radius, focal = ragged.scalars(table, "radius"), ragged.scalars(table, "focal")
    choices = [line, circle, parabola]
    size = np.stack(
        [
            np.select(choices, [0 * kind, radius, focal], ragged.scalars(table, name))
            for name in ("x_radius", "y_radius")
        ]
    )
    frame = [location, np.where(line, direction, x), np.where(line, 0.0, y)]
    return np.concatenate(frame), size
