"""Curves of the table ``curves``, evaluated without a CAD kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from breplake.errors import UsageError
from breplake.schema import ragged
from breplake.schema.conics import conic_jet
from breplake.schema.jets import CurveJet
from breplake.schema.namespace import Array, Bools, Floats, Ints, batches, gather
from breplake.schema.splines import SplineCurves
from breplake.schema.types import CURVE_TYPES

__all__ = ["CurveSet", "query"]

_BATCH = 16_384  # points whose temporaries stay in the cache
_RATIONAL = 1000  # added to the group of rational splines
_VANISHING = 1e-9  # of a spline's mean speed: slower than this is standing still


@dataclass(frozen=True, slots=True)
class CurveSet:
    """Curves of a table, ready to be evaluated at many points of many rows at once.

    Build one with :meth:`from_curves`.

    Attributes
    ----------
    known : numpy.ndarray
        ``(n_rows,)`` bool: the row has a type that can be evaluated, with its parameters.
    least : numpy.ndarray
        ``(n_rows,)`` length of the derivative at and below which rounding decides it.
    reach : numpy.ndarray
        ``(n_rows,)`` greatest coordinate of the curve's own shape, its place left out, mm.
    group : numpy.ndarray
        ``(n_rows,)`` rows of one group are evaluated together; negative if unknown.
    frame, size, splines
        Parameters of the curves.
    """

    known: Bools
    least: Floats
    reach: Floats
    group: Ints
    frame: Floats  # (9, n_rows) origin and two axes
    size: Floats  # (2, n_rows) radii or focal length
    splines: SplineCurves

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
        frame, size = _conic_parameters(table, kind)
        degree = ragged.integers(table, "degree")
        splines = SplineCurves.build(
            ragged.lists(table, "knots"),
            degree,
            ragged.flags(table, "periodic"),
            ragged.lists(table, "poles"),
            ragged.lists(table, "weights"),
        )
        spline = kind == CURVE_TYPES.index("BSpline")
        complete = np.isfinite(frame).all(axis=0) & np.isfinite(size).all(axis=0)
        conic = (kind >= 0) & (kind < CURVE_TYPES.index("BSpline"))
        known = np.where(spline, splines.valid, conic & complete)
        group = np.where(spline, len(CURVE_TYPES) + degree + _RATIONAL * splines.rational, kind)
        width = np.where(splines.valid, splines.knots.high - splines.knots.low, 1.0)
        extent = np.where(known & spline, splines.poles.extent, 0.0)
        return CurveSet(
            known=known,
            least=_VANISHING * extent / width,
            reach=np.where(spline, extent, np.where(known, size.max(axis=0, initial=0), 0.0)),
            group=np.where(known, group, -1),
            frame=np.where(spline, np.tile(splines.poles.centre, (3, 1)), frame),
            size=size,
            splines=splines,
        )

    def evaluate(self, row: ArrayLike, t: ArrayLike) -> CurveJet:
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
            NaN for rows that are not `known`.

        Raises
        ------
        UsageError
            If a row is outside the table or the shapes do not match.
        """
        rows, (parameter,) = query(len(self.known), row, t)
        groups = self.group[rows]
        out = np.empty((3, 3, len(rows)))
        out[:, :, groups < 0] = np.nan
        for group, index in batches(groups, _BATCH):
            for part, values in zip(
                out, self.jet(group, rows[index], parameter[index]), strict=True
            ):
                part[:, index] = values
        return CurveJet(out[0].T, out[1].T, out[2].T)

    def jet(self, group: int, row: Array, t: Array) -> tuple[Array, Array, Array]:
        """Return point and two derivatives ``(3, n)`` for rows that are all of `group`."""
        if group < len(CURVE_TYPES):
            return conic_jet(CURVE_TYPES[group], t, gather(self.frame, row), gather(self.size, row))
        rational, degree = divmod(group - len(CURVE_TYPES), _RATIONAL)
        return self.splines.evaluate(row, t, degree, bool(rational))


def _conic_parameters(table: pa.Table, kind: Ints) -> tuple[Floats, Floats]:
    """Return frames ``(9, n)`` and sizes ``(2, n)``, NaN where the table lacks a value."""
    line, circle, parabola = (kind == CURVE_TYPES.index(n) for n in ("Line", "Circle", "Parabola"))
    first = np.where(line, ragged.vectors(table, "direction"), ragged.vectors(table, "x_axis"))
    second = np.where(line, 0.0, ragged.vectors(table, "y_axis"))
    radius, focal = ragged.scalars(table, "radius"), ragged.scalars(table, "focal")
    choices = [line, circle, parabola]
    size = np.stack(
        [
            np.select(choices, [0 * kind, radius, focal], ragged.scalars(table, name))
            for name in ("x_radius", "y_radius")
        ]
    )
    return np.concatenate([ragged.vectors(table, "location"), first, second]), size


def query(rows: int, row: ArrayLike, *parameters: ArrayLike) -> tuple[Ints, list[Any]]:
    """Check a query and bring its parts to one length.

    Parameters
    ----------
    rows : int
        Number of rows of the table.
    row : array_like
        ``(n,)`` integers, or one.
    *parameters : array_like
        ``(n,)`` numbers, or one.

    Raises
    ------
    UsageError
        If a row is outside the table, is no integer, or the shapes do not match.
    """
    index = np.asarray(row)
    if index.size and not np.issubdtype(index.dtype, np.integer):
        raise UsageError(f"rows are integers, not {index.dtype}")
    if index.size and (index.min() < 0 or index.max() >= rows):
        raise UsageError(f"rows lie in 0..{rows - 1}, got {index.min()}..{index.max()}")
    try:
        index, *rest = np.broadcast_arrays(
            index, *(np.asarray(p, dtype=np.float64) for p in parameters)
        )
    except ValueError as error:
        raise UsageError(f"rows and parameters must have one length: {error}") from error
    if index.ndim > 1:
        raise UsageError(f"rows and parameters are one-dimensional, got {index.shape}")
    return index.reshape(-1).astype(np.int64), [p.reshape(-1) for p in rest]
