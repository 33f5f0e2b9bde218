"""Knots with their multiplicities expanded, and the way back."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["flat_knots", "grouped_knots"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]


def flat_knots(
    knots: npt.ArrayLike, multiplicities: npt.ArrayLike, periodic_degree: int | None
) -> list[float]:
    """Repeat knots by their multiplicity, and continue a periodic spline's on both sides.

    The result is OCCT's ``KnotSequence``, which itself is wrong for periodic splines with no
    more poles than their degree.

    Parameters
    ----------
    knots : array_like
        Distinct knots, ascending.
    multiplicities : array_like
        How often each counts.
    periodic_degree : int or None
        Degree if the spline is periodic: its first and last knot are then the same place.
    """
    knots = np.asarray(knots, dtype=np.float64)
    times = np.asarray(multiplicities, dtype=np.int64)
    flat: list[float]
    if periodic_degree is None:
        flat = np.repeat(knots, times).tolist()
        return flat
    period = np.repeat(knots[:-1], times[:-1])
    n, first = len(period), int(times[0])
    margin = periodic_degree + 1 - first
    turn, place = np.divmod(np.arange(-margin, n + first + margin), n)
    continued = period[place] + turn * (knots[-1] - knots[0])
    # The last knot as it is stored, not as the sum of the first one and the period.
    continued[margin + n : margin + n + first] = knots[-1]
    flat = continued.tolist()
    return flat


def grouped_knots(
    flat: npt.ArrayLike, n_poles: int, periodic_degree: int | None
) -> tuple[_Floats, _Ints]:
    """Return the distinct knots and their multiplicities, the inverse of `flat_knots`.

    Parameters
    ----------
    flat : array_like
        What `flat_knots` gave.
    n_poles : int
        Number of poles in this direction, which says where a periodic spline's turn ends.
    periodic_degree : int or None
        Degree if the spline is periodic.

    Returns
    -------
    tuple of numpy.ndarray
        Knots and multiplicities, ``(k,)`` each.
    """
    flat = np.asarray(flat, dtype=np.float64)
    if periodic_degree is not None:
        # n poles, the last knot and a margin on both sides: see flat_knots
        first = n_poles + 2 * (periodic_degree + 1) - len(flat)
        margin = periodic_degree + 1 - first
        flat = flat[margin : len(flat) - margin]
    starts = np.flatnonzero(np.concatenate([[True], np.diff(flat) != 0]))
    return flat[starts], np.diff(np.append(starts, len(flat)))
