"""Poles, weights and knots of whole splines at once, from the kernel and back.

The binding has no array access: asking for a surface's poles one by one costs some two hundred
times what OCCT's own binary writer takes (``BinTools_SurfaceSet``, ``BinTools_CurveSet`` and
``BinTools_Curve2dSet``), whose format is little-endian and exact. So splines are written to
memory and read from there, and the other way round.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from breplake.errors import InputError

__all__ = [
    "SplineCurve",
    "SplineSurface",
    "make_curve",
    "make_surface",
    "spline_curve",
    "spline_surface",
]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

_KNOT: Final = np.dtype([("value", "<f8"), ("times", "<i4")])
_BEZIER_SURFACE, _BSPLINE_SURFACE = 8, 9
_BEZIER_CURVE, _BSPLINE_CURVE = 6, 7


@dataclass(frozen=True, slots=True)
class SplineCurve:
    """A B-spline or Bézier curve.

    Parameters
    ----------
    degree : int
        Degree.
    periodic : bool
        Whether it is periodic.
    poles : numpy.ndarray
        ``(n, 2)`` or ``(n, 3)``.
    weights : numpy.ndarray or None
        ``(n,)``; None if not rational.
    knots, times : numpy.ndarray
        Distinct knots and their multiplicities; empty for a Bézier curve.
    """

    degree: int
    periodic: bool
    poles: _Floats
    weights: _Floats | None
    knots: _Floats
    times: _Ints


@dataclass(frozen=True, slots=True)
class SplineSurface:
    """A B-spline or Bézier surface; pairs are of u and v, otherwise as in `SplineCurve`.

    Parameters
    ----------
    degree : tuple of int
        Degrees.
    rational, periodic : tuple of bool
        By direction.
    poles : numpy.ndarray
        ``(n, m, 3)`` mm, u first.
    weights : numpy.ndarray or None
        ``(n, m)``; None if rational in neither direction.
    knots, times : tuple of numpy.ndarray
        Distinct knots and their multiplicities; empty for a Bézier surface.
    """

    degree: tuple[int, int]
    rational: tuple[bool, bool]
    periodic: tuple[bool, bool]
    poles: _Floats
    weights: _Floats | None
    knots: tuple[_Floats, _Floats]
    times: tuple[_Ints, _Ints]


class _Reader:
    """Takes values from the front of what OCCT wrote of one geometry."""

    def __init__(self, written: Any, geometry: Any) -> None:
        written.Add(geometry)
        stream = io.BytesIO()
        written.Write(stream)
        self.data = stream.getvalue()
        # A line with the name and the number of geometries comes first.
        self.place = self.data.index(b"\n") + 1

    def take(self, dtype: Any, count: int) -> Any:
        values = np.frombuffer(self.data, dtype, count, self.place)
        self.place += values.nbytes
        return values

    def flags(self, count: int) -> tuple[bool, ...]:
        return tuple(bool(flag) for flag in self.take("u1", count))

    def integers(self, dtype: str, count: int) -> tuple[int, ...]:
        return tuple(int(value) for value in self.take(dtype, count))

    def poles(self, count: int, size: int, rational: bool) -> tuple[_Floats, _Floats | None]:
        width = size + rational
        values = self.take("<f8", count * width).reshape(count, width)
        return np.ascontiguousarray(values[:, :size]), values[:, size].copy() if rational else None

    def knots(self, count: int) -> tuple[_Floats, _Ints]:
        values = self.take(_KNOT, count)
        return values["value"].astype(np.float64), values["times"].astype(np.int64)

    def close(self) -> None:
        if self.place != len(self.data):
            raise InputError(
                "error",
                f"OCCT wrote {len(self.data)} bytes of a spline where {self.place} were expected; "
                "install the version of OCCT that breplake names",
            )


def spline_curve(curve: Any) -> SplineCurve:
    """Return a B-spline or Bézier curve, in space or in a plane.

    Parameters
    ----------
    curve : Geom_BSplineCurve, Geom_BezierCurve, Geom2d_BSplineCurve or Geom2d_BezierCurve
        The curve.

    Raises
    ------
    InputError
        If OCCT's binary format is not the expected one.
    """
    from OCP.BinTools import BinTools_Curve2dSet, BinTools_CurveSet
    from OCP.Geom import Geom_Curve

    spatial = isinstance(curve, Geom_Curve)
    reader = _Reader(BinTools_CurveSet() if spatial else BinTools_Curve2dSet(), curve)
    size = 3 if spatial else 2
    none: Any = np.empty(0), np.empty(0, dtype=np.int64)
    (kind,) = reader.integers("u1", 1)
    if kind == _BEZIER_CURVE:
        (rational,) = reader.flags(1)
        (degree,) = reader.integers("<u2", 1)
        poles, weights = reader.poles(degree + 1, size, rational)
        reader.close()
        return SplineCurve(degree, False, poles, weights, *none)
    rational, periodic = reader.flags(2)
    (degree,) = reader.integers("<u2", 1)
    n_poles, n_knots = reader.integers("<i4", 2)
    poles, weights = reader.poles(n_poles, size, rational)
    knots, times = reader.knots(n_knots)
    reader.close()
    return SplineCurve(degree, periodic, poles, weights, knots, times)


def spline_surface(surface: Any) -> SplineSurface:
    """Return a B-spline or Bézier surface.

    Parameters
    ----------
    surface : Geom_BSplineSurface or Geom_BezierSurface
        The surface.

    Raises
    ------
    InputError
        If OCCT's binary format is not the expected one.
    """
    from OCP.BinTools import BinTools_SurfaceSet

    reader = _Reader(BinTools_SurfaceSet(), surface)
    (kind,) = reader.integers("u1", 1)
    u_rational, v_rational = reader.flags(2)
    periodic = (False, False) if kind == _BEZIER_SURFACE else reader.flags(2)
    degree = reader.integers("<u2", 2)
    if kind == _BEZIER_SURFACE:
        n, m, n_knots, m_knots = degree[0] + 1, degree[1] + 1, 0, 0
    else:
        n, m, n_knots, m_knots = reader.integers("<i4", 4)
    poles, weights = reader.poles(n * m, 3, u_rational or v_rational)
    (u_knots, u_times), (v_knots, v_times) = reader.knots(n_knots), reader.knots(m_knots)
    reader.close()
    return SplineSurface(
        (degree[0], degree[1]),
        (u_rational, v_rational),
        (periodic[0], periodic[1]),
        poles.reshape(n, m, 3),
        None if weights is None else weights.reshape(n, m),
        (u_knots, v_knots),
        (u_times, v_times),
    )


def make_curve(spline: SplineCurve) -> Any:
    """Return the kernel's curve, the inverse of `spline_curve`: in a plane if its poles are.

    Returns
    -------
    Geom_BSplineCurve, Geom_BezierCurve, Geom2d_BSplineCurve or Geom2d_BezierCurve
    """
    from OCP.BinTools import BinTools_Curve2dSet, BinTools_CurveSet

    rational = spline.weights is not None
    if len(spline.knots):
        head = struct.pack("<3BH", _BSPLINE_CURVE, rational, spline.periodic, spline.degree)
        head += struct.pack("<2i", len(spline.poles), len(spline.knots))
    else:
        head = struct.pack("<2BH", _BEZIER_CURVE, rational, spline.degree)
    body = _packed_poles(spline.poles, spline.weights) + _packed_knots(spline.knots, spline.times)
    if spline.poles.shape[1] == 2:
        return _read(BinTools_Curve2dSet(), b"Curve2ds 1\n" + head + body).Curve2d(1)
    return _read(BinTools_CurveSet(), b"Curves 1\n" + head + body).Curve(1)


def make_surface(spline: SplineSurface) -> Any:
    """Return the kernel's surface, the inverse of `spline_surface`.

    Returns
    -------
    Geom_BSplineSurface or Geom_BezierSurface
    """
    from OCP.BinTools import BinTools_SurfaceSet

    if len(spline.knots[0]):
        flags = (*spline.rational, *spline.periodic)
        head = struct.pack("<5B2H", _BSPLINE_SURFACE, *flags, *spline.degree)
        head += struct.pack("<4i", *spline.poles.shape[:2], *map(len, spline.knots))
    else:
        head = struct.pack("<3B2H", _BEZIER_SURFACE, *spline.rational, *spline.degree)
    body = _packed_poles(spline.poles, spline.weights)
    body += b"".join(map(_packed_knots, spline.knots, spline.times))
    return _read(BinTools_SurfaceSet(), b"Surfaces 1\n" + head + body).Surface(1)


def _read(written: Any, data: bytes) -> Any:
    written.Read(io.BytesIO(data))
    return written


def _packed_poles(poles: _Floats, weights: _Floats | None) -> bytes:
    rows = poles if weights is None else np.concatenate([poles, weights[..., None]], axis=-1)
    return np.ascontiguousarray(rows, dtype="<f8").tobytes()


def _packed_knots(knots: _Floats, times: _Ints) -> bytes:
    packed = np.empty(len(knots), _KNOT)
    packed["value"], packed["times"] = knots, times
    return packed.tobytes()
