"""Directions, axes and motions with given bits.

OCCT normalises every direction that it is given and makes axes orthogonal anew, which moves
their last bits. The functions here find arguments for which the result has the bits that are
asked for; where there are none they return what OCCT makes of the numbers themselves, which is
at most a few units in the last place off.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from breplake.errors import LakeFormatError

__all__ = ["ax1", "ax2", "ax3", "ax22d", "direction", "direction2d", "motion", "point", "point2d"]

_Floats: TypeAlias = npt.NDArray[np.float64]
_Numbers: TypeAlias = Sequence[float]

_WIDE: Final = np.linspace(1.0, 2.0, 2001)[1:-1]
"""Multiples of a direction that are tried; the first ten suffice for nearly all."""

_NUDGES: Final = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
"""Units in the last place by which the coordinates of some multiples are moved."""

_CLOSE: Final = 1 + np.arange(-1500, 1501) * 2.0**-52
"""Multiples of a frame's axes, so close to each other that OCCT takes them for orthogonal."""

_TILTS: Final = np.linspace(-2.0, 2.0, 4001)
"""How far, along the main axis, first axes are tilted that OCCT makes orthogonal."""


def point(values: _Numbers) -> Any:
    """Return a ``gp_Pnt``."""
    from OCP.gp import gp_Pnt

    return gp_Pnt(*values)


def point2d(values: _Numbers) -> Any:
    """Return a ``gp_Pnt2d``."""
    from OCP.gp import gp_Pnt2d

    return gp_Pnt2d(*values)


def direction(values: _Numbers) -> Any:
    """Return the ``gp_Dir`` of the unit vector ``(3,)``."""
    from OCP.gp import gp_Dir

    return gp_Dir(*_unnormalised(values))


def direction2d(values: _Numbers) -> Any:
    """Return the ``gp_Dir2d`` of the unit vector ``(2,)``."""
    from OCP.gp import gp_Dir2d

    return gp_Dir2d(*_unnormalised(values))


def _unnormalised(values: _Numbers) -> list[float]:
    """Return a vector that becomes `values` when it is divided by its length."""
    wanted = np.asarray(values, dtype=np.float64)  # (d,)
    if np.array_equal(_normalised(wanted[None])[0], wanted):
        return list(values)
    multiples = wanted * _WIDE[:, None]  # (n, d)
    found = _first_hit(multiples, _normalised(multiples), wanted)
    if found is None:
        some = multiples[::10, None, :]
        nudged = (some + np.spacing(np.abs(some)) * _NUDGES[:, : len(wanted)]).reshape(
            -1, len(wanted)
        )
        found = _first_hit(nudged, _normalised(nudged), wanted)
    return list(values) if found is None else found


def _first_hit(tries: _Floats, results: _Floats, wanted: _Floats) -> list[float] | None:
    """Return the first of the `tries` ``(n, d)`` whose result is what is wanted."""
    hits = np.flatnonzero((results == wanted).all(axis=1))
    found: list[float] | None = tries[hits[0]].tolist() if len(hits) else None
    return found


def _normalised(vectors: _Floats) -> _Floats:
    """Normalise ``(n, d)`` in the order of operations of ``gp_Dir``."""
    squared = vectors[:, 0] * vectors[:, 0]
    for i in range(1, vectors.shape[1]):
        squared = squared + vectors[:, i] * vectors[:, i]
    unit: _Floats = vectors / np.sqrt(squared)[:, None]
    return unit


def _cross(a: _Floats, b: _Floats) -> _Floats:
    """Return cross products ``(n, 3)`` in the order of operations of ``gp_XYZ``."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.column_stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def ax1(location: _Numbers, axis: _Numbers) -> Any:
    """Return a ``gp_Ax1``."""
    from OCP.gp import gp_Ax1

    return gp_Ax1(point(location), direction(axis))


def ax3(location: _Numbers, x: _Numbers, y: _Numbers, z: _Numbers) -> Any:
    """Return a ``gp_Ax3``, which may be left-handed, from its location and unit axes ``(3,)``."""
    from OCP.gp import gp_Ax3

    plain = gp_Ax3(point(location), direction(z), direction(x))
    if np.dot(np.cross(z, x), y) < 0:
        plain.YReverse()
    wanted = (x, y, z)
    return _best(plain, (lambda: _moved(gp_Ax3(), location, wanted),), wanted)


def ax2(location: _Numbers, x: _Numbers, y: _Numbers, z: _Numbers) -> Any:
    """Return the right-handed ``gp_Ax2`` of a location and unit axes ``(3,)``."""
    from OCP.gp import gp_Ax2, gp_Dir

    start, main = point(location), direction(z)
    plain, wanted = gp_Ax2(start, main, direction(x)), (x, y, z)
    others = (
        lambda: gp_Ax2(start, main, gp_Dir(*_tilted(x, z))),
        lambda: _moved(gp_Ax2(), location, wanted),
    )
    return _best(plain, others, wanted)


def ax22d(location: _Numbers, x: _Numbers, y: _Numbers) -> Any:
    """Return a ``gp_Ax22d`` of either hand from its location and unit axes ``(2,)``."""
    from OCP.gp import gp_Ax22d

    return gp_Ax22d(point2d(location), direction2d(x), direction2d(y))


def _axes(axes: Any) -> list[tuple[float, ...]]:
    found = (axes.XDirection(), axes.YDirection(), axes.Direction())
    return [(axis.X(), axis.Y(), axis.Z()) for axis in found]


def _best(plain: Any, others: Sequence[Callable[[], Any]], wanted: Sequence[_Numbers]) -> Any:
    """Return the first that has the wanted axes of `plain` and what `others` give, else `plain`."""
    axes = [tuple(axis) for axis in wanted]
    if _axes(plain) == axes:
        return plain
    made = (make() for make in others)
    return next((found for found in made if found is not None and _axes(found) == axes), plain)


def _tilted(x: _Numbers, z: _Numbers) -> list[float]:
    """Return a vector that OCCT turns into `x` when it makes it orthogonal to `z`.

    It takes ``z x (v x z)``, which is the same for all tilts of v but for rounding. Readers do
    it twice, so that what a first time gives is tried as well.
    """
    wanted, main = np.asarray(x), np.asarray(z)

    def results(tries: _Floats) -> _Floats:
        axis = np.broadcast_to(main, tries.shape)
        return _normalised(_cross(axis, _cross(_normalised(tries), axis)))

    tries = wanted + main * _TILTS[:, None]  # (n, 3)
    once = results(tries)
    found = _first_hit(tries, once, wanted) or _first_hit(once, results(once), wanted)
    return list(x) if found is None else found


def _moved(standard: Any, location: _Numbers, wanted: Sequence[_Numbers]) -> Any:
    """Return the standard axes moved to the wanted ones, None if no motion does that.

    OCCT transforms and normalises each axis by itself, so that none spoils another. The
    columns of the motion's matrix may have any length, if only it is the same for all.
    """
    axes = [np.asarray(axis) for axis in wanted]
    for length in 1 + np.arange(16) / 16:
        tries = [axis * (length * _CLOSE[:, None]) for axis in axes]
        columns = [_first_hit(t, _normalised(t), axis) for t, axis in zip(tries, axes, strict=True)]
        if None not in columns:
            frame = _compound(np.array(columns).T, location, 1.0)
            return None if frame is None else standard.Transformed(frame)
    return None


def _compound(matrix: _Floats, translation: _Numbers, scale: float) -> Any:
    """Return a ``gp_Trsf`` with the very numbers given, which ``SetValues`` would change.

    None if the matrix ``(3, 3)`` is not orthogonal to 1e-12.
    """
    from OCP.gp import gp_GTrsf, gp_Mat, gp_TrsfForm, gp_XYZ

    general = gp_GTrsf(gp_Mat(*matrix.ravel().tolist()), gp_XYZ(*translation))
    general.SetForm()
    if general.Form() == gp_TrsfForm.gp_Other:
        return None
    made = general.Trsf()
    made.SetScaleFactor(scale)
    return made


def motion(form: str, scale: float, rows: Sequence[_Numbers], translation: _Numbers) -> Any:
    """Return a ``gp_Trsf``.

    Parameters
    ----------
    form : str
        Name of its ``gp_TrsfForm`` without ``gp_``.
    scale : float
        Scale factor.
    rows : sequence
        ``(3, 3)`` matrix without the scale factor.
    translation : sequence of float
        ``(3,)`` mm.

    Raises
    ------
    LakeFormatError
        If the matrix is not orthogonal to 1e-12, as OCCT demands.
    """
    from OCP.gp import gp_TrsfForm

    made = _compound(np.array(rows), translation, scale)
    if made is None:
        raise LakeFormatError(
            f"the matrix of a motion must be orthogonal to 1e-12, got {rows}; run breplake check"
        )
    made.SetForm(getattr(gp_TrsfForm, f"gp_{form}"))
    return made
