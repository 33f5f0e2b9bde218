"""Rows of ``surfaces``, ``space_curves`` and ``pcurves`` to the kernel's geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np

from breplake.errors import LakeFormatError
from breplake.ingest.lossless import exact
from breplake.ingest.lossless.bulk import SplineCurve, SplineSurface, make_curve, make_surface
from breplake.ingest.lossless.knots import grouped_knots

__all__ = ["GeometryBuilder"]

_Row: TypeAlias = Mapping[str, Any]

_UNCHECKED: Final = True
"""Whether the basis of an offset is smooth enough was checked when it was first made."""

_ELEMENTARY: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "Plane": ("Geom_Plane", ()),
    "Cylinder": ("Geom_CylindricalSurface", ("radius",)),
    "Cone": ("Geom_ConicalSurface", ("angle", "radius")),
    "Sphere": ("Geom_SphericalSurface", ("radius",)),
    "Torus": ("Geom_ToroidalSurface", ("max_radius", "min_radius")),
}
"""OCCT's class of a surface, and the columns that it takes after the axes."""

_CONICS: Final[dict[str, tuple[str, ...]]] = {
    "Circle": ("radius",),
    "Ellipse": ("x_radius", "y_radius"),
    "Hyperbola": ("x_radius", "y_radius"),
    "Parabola": ("focal",),
}
"""The columns that a conic takes after the axes."""


class GeometryBuilder:
    """Makes the geometry of one model, each row once.

    Parameters
    ----------
    surfaces, space_curves, pcurves : sequence of mapping
        Rows in order of their ids, values as of ``columns.table_rows``.
    """

    def __init__(
        self, surfaces: Sequence[_Row], space_curves: Sequence[_Row], pcurves: Sequence[_Row]
    ) -> None:
        self._rows = {"surface": surfaces, "space_curve": space_curves, "pcurve": pcurves}
        self._made: dict[tuple[str, int], Any] = {}

    def surface(self, number: int | None) -> Any:
        """Return the ``Geom_Surface`` of a row, None for None."""
        return self._get("surface", number)

    def space_curve(self, number: int | None) -> Any:
        """Return the ``Geom_Curve`` of a row, None for None."""
        return self._get("space_curve", number)

    def pcurve(self, number: int | None) -> Any:
        """Return the ``Geom2d_Curve`` of a row, None for None."""
        return self._get("pcurve", number)

    def _get(self, what: str, number: int | None) -> Any:
        if number is None:
            return None
        key = (what, number)
        if key not in self._made:
            self._made[key] = None  # met again while it is made: the rows go round in a circle
            self._made[key] = self._make(what, self._row(what, number))
        if self._made[key] is None:
            raise LakeFormatError(f"{what} {number} is its own basis; run breplake check")
        return self._made[key]

    def _row(self, what: str, number: int) -> _Row:
        rows = self._rows[what]
        if not 0 <= number < len(rows):
            raise LakeFormatError(f"there is no {what} {number}; run breplake check")
        return rows[number]

    def _make(self, what: str, row: _Row) -> Any:
        if row["type"] in ("BSpline", "Bezier"):
            return _spline_surface(row) if what == "surface" else make_curve(_spline_curve(row))
        return self._surface(row) if what == "surface" else self._curve(what, row)

    def _surface(self, row: _Row) -> Any:
        from OCP import Geom

        kind = row["type"]
        if kind == "Revolution":
            axis = exact.ax1(row["location"], row["z_axis"])
            return Geom.Geom_SurfaceOfRevolution(self.space_curve(row["space_curve"]), axis)
        if kind == "Extrusion":
            curve = self.space_curve(row["space_curve"])
            return Geom.Geom_SurfaceOfLinearExtrusion(curve, exact.direction(row["direction"]))
        if kind == "Offset":
            return Geom.Geom_OffsetSurface(self.surface(row["basis"]), row["offset"], _UNCHECKED)
        if kind == "Trimmed":
            return _trimmed(self.surface(row["basis"]), row)
        if kind not in _ELEMENTARY:
            raise _unknown("surfaces", kind)
        name, sizes = _ELEMENTARY[kind]
        axes = exact.ax3(row["location"], row["x_axis"], row["y_axis"], row["z_axis"])
        return getattr(Geom, name)(axes, *(row[size] for size in sizes))

    def _curve(self, what: str, row: _Row) -> Any:
        """Return the curve of a row, in space or in a plane."""
        from OCP import Geom, Geom2d

        kind, spatial = row["type"], what == "space_curve"

        def made(name: str, *arguments: Any) -> Any:
            return getattr(Geom if spatial else Geom2d, f"Geom{'' if spatial else '2d'}_{name}")(
                *arguments
            )

        if kind == "Line":
            return made("Line", *_line(row, spatial))
        if kind == "Trimmed":
            ends = (row["t_min"], row["t_max"])
            # In the sense of the basis, and without moving the ends by periods.
            return made("TrimmedCurve", self._get(what, row["basis"]), *ends, True, False)
        if kind == "Offset":
            towards = [exact.direction(row["direction"])] if spatial else []
            basis = self._get(what, row["basis"])
            return made("OffsetCurve", basis, row["offset"], *towards, _UNCHECKED)
        if kind not in _CONICS:
            raise _unknown(f"{what}s", kind)
        axes = (
            exact.ax2(row["location"], row["x_axis"], row["y_axis"], row["z_axis"])
            if spatial
            else exact.ax22d(row["location"], row["x_axis"], row["y_axis"])
        )
        return made(kind, axes, *(row[size] for size in _CONICS[kind]))


def _line(row: _Row, spatial: bool) -> tuple[Any, ...]:
    if spatial:
        return (exact.ax1(row["location"], row["direction"]),)
    return exact.point2d(row["location"]), exact.direction2d(row["direction"])


def _spline_curve(row: _Row) -> SplineCurve:
    degree, poles, periodic = row["degree"], row["poles"], bool(row["periodic"])
    knots = _knots(row["knots"], len(poles), degree, periodic)
    return SplineCurve(degree, periodic, poles, row["weights"], *knots)


def _spline_surface(row: _Row) -> Any:
    degree = (row["u_degree"], row["v_degree"])
    periodic = (bool(row["u_periodic"]), bool(row["v_periodic"]))
    poles, weights = row["poles"], row["weights"]
    (u_knots, u_times), (v_knots, v_times) = (
        _knots(row[f"{axis}_knots"], poles.shape[i], degree[i], periodic[i])
        for i, axis in enumerate("uv")
    )
    knots, times = (u_knots, v_knots), (u_times, v_times)
    # OCCT finds out by itself in which direction the weights differ.
    rational = (weights is not None, weights is not None)
    return make_surface(SplineSurface(degree, rational, periodic, poles, weights, knots, times))


def _knots(flat: Any, n_poles: int, degree: int, periodic: bool) -> tuple[Any, Any]:
    """Return distinct knots and multiplicities; none for a Bézier curve or surface."""
    if flat is None:
        return np.empty(0), np.empty(0, dtype=np.int64)
    return grouped_knots(flat, n_poles, degree if periodic else None)


def _trimmed(basis: Any, row: _Row) -> Any:
    from OCP.Geom import Geom_RectangularTrimmedSurface

    u, v = (row["u_min"], row["u_max"]), (row["v_min"], row["v_max"])
    if u[0] is not None and v[0] is not None:
        return Geom_RectangularTrimmedSurface(basis, *u, *v, True, True)
    if u[0] is None:
        return Geom_RectangularTrimmedSurface(basis, *v, False, True)
    return Geom_RectangularTrimmedSurface(basis, *u, True, True)


def _unknown(table: str, kind: str) -> LakeFormatError:
    return LakeFormatError(f"{table}: no geometry is called {kind!r}; a newer breplake may know it")
