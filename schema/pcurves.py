"""Curves in the parameter planes of patches, the table ``pcurves``, without a CAD kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa

from breplake.schema import ragged
from breplake.schema.curves import CurveSet
from breplake.schema.jets import PcurveJet
from breplake.schema.namespace import Array, Bools, Floats, Ints
from breplake.schema.shape_tables import CURVE_CLASSES
from breplake.schema.transfer import transferred
from breplake.schema.types import CURVE_TYPES

__all__ = ["PcurveSet"]

_PLACES: Final = {name: place for place, name in enumerate(CURVE_CLASSES)}
_AS_TYPE: Final = np.array(  # class of a stored curve -> type it is evaluated as; -1 if none
    [CURVE_TYPES.index(name) if name in CURVE_TYPES else -1 for name in CURVE_CLASSES] + [-1]
)
_AS_TYPE[_PLACES["Bezier"]] = CURVE_TYPES.index("BSpline")
_DEEPEST = 64  # curves nested deeper than this go round in a circle


@dataclass(frozen=True, slots=True)
class PcurveSet:
    """Curves in parameter planes, ready to be evaluated at many points of many rows at once.

    Build one with :meth:`from_pcurves`.

    Attributes
    ----------
    curves : CurveSet
        The same rows as curves in a plane; in the place of a curve that trims or offsets
        another stands that other one, with the distance of the offset.
    """

    curves: CurveSet

    @property
    def known(self) -> Array:
        """Whether each row can be evaluated, ``(n_rows,)``."""
        return self.curves.known

    @staticmethod
    def from_pcurves(table: pa.Table) -> PcurveSet:
        """Read rows of ``pcurves``, of one or more models.

        A row that trims or offsets another needs that row in the table as well, else it is
        not `known`. Columns that are missing count as null.

        Raises
        ------
        UsageError
            If the table has no column ``type``.
        """
        kind = ragged.codes(table, "type", CURVE_CLASSES)
        root, distance = _roots(table, kind)
        found = root >= 0
        if (root[found] != np.flatnonzero(found)).any():
            table = table.take(pa.array(np.where(found, root, np.arange(len(root)))))
            kind = np.where(found, kind[root], -1)
        bezier = kind == _PLACES["Bezier"]
        if bezier.any():
            table = _with_knots(table, bezier)
        moved = distance != 0
        return PcurveSet(CurveSet.build(table, _AS_TYPE[kind], moved, distance[None]))

    def to(self, like: Any = None, *, device: Any = None, dtype: Any = None) -> PcurveSet:
        """Return these curves as tensors of torch; see ``SurfaceSet.to``."""
        return transferred(self, like, device=device, dtype=dtype)

    def evaluate(self, row: Any, t: Any) -> PcurveJet:
        """Evaluate curves with their first two derivatives.

        Parameters
        ----------
        row : array_like
            ``(n,)`` row of the table, or one row for all.
        t : array_like
            ``(n,)`` parameter on that curve, also outside of what a trimmed curve keeps.
            Periodic splines wrap; others continue their end spans.

        Returns
        -------
        PcurveJet
            NaN for rows that are not `known`.

        Raises
        ------
        UsageError
            If a row is outside the table or the shapes do not match.
        """
        point, d1, d2 = self.curves.arrays(row, t)
        return PcurveJet(point.T, d1.T, d2.T)

    def breaks(self, row: int, low: float | None = None, high: float | None = None) -> Floats:
        """Return the parameters at which a curve may not be smooth: the knots of a spline.

        Between two of them, and beyond the last, the curve has all derivatives.

        Parameters
        ----------
        row : int
            Row of the table.
        low, high : float, optional
            The range wanted, by default the one that the knots span. A periodic spline has
            its knots again in every period.

        Returns
        -------
        numpy.ndarray
            ``(n,)`` ascending, each once, from `low` to `high`; empty where the curve is no
            spline.

        Raises
        ------
        UsageError
            If the row is outside the table.
        """
        return self.curves.breaks(row, low, high)


def _roots(table: pa.Table, kind: Ints) -> tuple[Ints, Floats]:
    """Follow curves that trim or offset others to the ones that do not.

    Returns
    -------
    root : numpy.ndarray
        ``(n_rows,)`` row of the curve that is evaluated; -1 where the table lacks it.
    distance : numpy.ndarray
        ``(n_rows,)`` sum of the offsets on the way, NaN where one is missing.
    """
    offset = kind == _PLACES["Offset"]
    nested = offset | (kind == _PLACES["Trimmed"])
    root = np.arange(len(kind))
    step = np.where(offset, ragged.scalars(table, "offset"), 0.0)
    distance = np.where(nested, 0.0, step)
    if not nested.any():
        return root, distance
    basis = _basis(table)
    for _ in range(_DEEPEST):
        moving = np.flatnonzero((root >= 0) & nested[root])
        if not len(moving):
            return root, distance
        distance[moving] += step[root[moving]]
        root[moving] = basis[root[moving]]
    root[nested[root]] = -1
    return root, distance


def _basis(table: pa.Table) -> Ints:
    """Return the row of each curve's basis, ``(n_rows,)``; -1 where the table lacks it."""
    _, place = np.unique(ragged.identifiers(table, "model_id"), return_inverse=True)
    own, basis = (ragged.identifiers(table, name) for name in ("pcurve_id", "basis"))
    span = max(int(own.max()), int(basis.max())) + 1
    keys, wanted = place * span + own, place * span + basis
    order = np.argsort(keys, kind="stable")
    at = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
    found = order[at]
    return np.where((keys[found] == wanted) & (basis >= 0), found, -1)


def _with_knots(table: pa.Table, bezier: Bools) -> pa.Table:
    """Return the table with degree and knots of Bezier curves, which need none of their own."""
    poles = ragged.lists(table, "poles").length
    knots = ragged.lists(table, "knots")
    length = np.where(bezier, 2 * poles, knots.length)
    owner = np.repeat(np.arange(len(length)), length)
    place = np.arange(len(owner)) - (np.cumsum(length) - length)[owner]
    values = (place >= poles[owner]).astype(np.float64)  # as many zeros as poles, then ones
    values[~bezier[owner]] = knots.values[~bezier[knots.owner]]
    columns = {
        "degree": pa.array(np.where(bezier, poles - 1, ragged.integers(table, "degree"))),
        "knots": pa.ListArray.from_arrays(np.append(0, np.cumsum(length)).astype(np.int32), values),
        "periodic": pa.array(ragged.flags(table, "periodic") & ~bezier),
    }
    for name, array in columns.items():
        if name in table.column_names:
            table = table.drop_columns(name)
        table = table.append_column(name, array)
    return table
