"""Stored geometry (``Geom_Surface``, ``Geom_Curve``, ``Geom2d_Curve``) to rows.

Unlike ``breplake.ingest.geometry``, which describes what a patch or curve is, this keeps how
it is stored: classes, nesting, parametrisation and bits.
"""

from __future__ import annotations

from typing import Any, TypeAlias

from breplake.errors import InputError
from breplake.ingest.failure import advise
from breplake.ingest.lossless.bulk import spline_curve, spline_surface
from breplake.ingest.lossless.handles import Handles
from breplake.ingest.lossless.knots import flat_knots

__all__ = ["Geometry"]

_Row: TypeAlias = dict[str, Any]


class Geometry:
    """The surfaces and curves that a model refers to, numbered by first reference."""

    def __init__(self) -> None:
        self.surfaces, self.space_curves, self.pcurves = Handles(), Handles(), Handles()

    def rows(self) -> dict[str, list[_Row]]:
        """Return the rows of ``surfaces``, ``space_curves`` and ``pcurves``.

        Raises
        ------
        InputError
            ``unknown-geometry`` if OCCT has a class that the tables do not know.
        """
        # Surfaces first: they add the curves that they sweep to the others.
        rows = {"surfaces": _numbered("surface_id", map(self._surface, self.surfaces))}
        rows["space_curves"] = _numbered(
            "space_curve_id", (self._curve(c, self.space_curves) for c in self.space_curves)
        )
        rows["pcurves"] = _numbered(
            "pcurve_id", (self._curve(c, self.pcurves) for c in self.pcurves)
        )
        return rows

    def _surface(self, surface: Any) -> _Row:
        kind = _class(surface)
        row: _Row = {"type": kind}
        if kind in ("BSpline", "Bezier"):
            return row | _spline_surface(surface)
        if kind in ("Revolution", "Extrusion"):
            curve = self.space_curves.add(surface.BasisCurve())
            row |= {"direction" if kind == "Extrusion" else "z_axis": _xyz(surface.Direction())}
            if kind == "Revolution":
                row["location"] = _xyz(surface.Location())
            return row | {"space_curve": curve}
        if kind in ("Offset", "Trimmed"):
            row["basis"] = self.surfaces.add(surface.BasisSurface())
            return row | ({"offset": surface.Offset()} if kind == "Offset" else _trim(surface))
        return row | _axes(surface.Position(), _xyz) | _radii(surface, kind)

    def _curve(self, curve: Any, pool: Handles) -> _Row:
        """Return a curve in space or in a plane as a row; `pool` numbers what it nests."""
        kind = _class(curve)
        spatial = pool is self.space_curves
        leaf = _xyz if spatial else _xy
        row: _Row = {"type": kind}
        if kind in ("BSpline", "Bezier"):
            return row | _spline_curve(curve)
        if kind == "Trimmed":
            ends = {"t_min": curve.FirstParameter(), "t_max": curve.LastParameter()}
            return row | {"basis": pool.add(curve.BasisCurve()), **ends}
        if kind == "Offset":
            row |= {"basis": pool.add(curve.BasisCurve()), "offset": curve.Offset()}
            return row | ({"direction": leaf(curve.Direction())} if spatial else {})
        if kind == "Line":
            line = curve.Position()
            return row | {
                "location": leaf(line.Location()),
                "direction": leaf(line.Direction()),
            }
        return row | _axes(curve.Position(), leaf) | _radii(curve, kind)


_CLASSES = {
    "Plane": "Plane",
    "CylindricalSurface": "Cylinder",
    "ConicalSurface": "Cone",
    "SphericalSurface": "Sphere",
    "ToroidalSurface": "Torus",
    "SurfaceOfRevolution": "Revolution",
    "SurfaceOfLinearExtrusion": "Extrusion",
    "BSplineSurface": "BSpline",
    "BezierSurface": "Bezier",
    "OffsetSurface": "Offset",
    "RectangularTrimmedSurface": "Trimmed",
    "Line": "Line",
    "Circle": "Circle",
    "Ellipse": "Ellipse",
    "Parabola": "Parabola",
    "Hyperbola": "Hyperbola",
    "BSplineCurve": "BSpline",
    "BezierCurve": "Bezier",
    "OffsetCurve": "Offset",
    "TrimmedCurve": "Trimmed",
}
"""OCCT's classes, without ``Geom_`` or ``Geom2d_`` -> their names in the tables."""


def _class(geometry: Any) -> str:
    name = type(geometry).__name__
    found = _CLASSES.get(name.partition("_")[2])
    if found is None:
        raise InputError("unknown-geometry", advise("unknown-geometry", name))
    return found


def _numbered(key: str, rows: Any) -> list[_Row]:
    return [{key: i} | row for i, row in enumerate(rows)]


def _xyz(value: Any) -> tuple[float, ...]:
    return (value.X(), value.Y(), value.Z())


def _xy(value: Any) -> tuple[float, ...]:
    return (value.X(), value.Y())


def _axes(position: Any, leaf: Any) -> _Row:
    row = {
        "location": leaf(position.Location()),
        "x_axis": leaf(position.XDirection()),
        "y_axis": leaf(position.YDirection()),
    }
    return row | ({"z_axis": leaf(position.Direction())} if leaf is _xyz else {})


def _radii(geometry: Any, kind: str) -> _Row:
    """Return the sizes of an elementary surface or a conic."""
    if kind in ("Cylinder", "Sphere", "Circle"):
        return {"radius": geometry.Radius()}
    if kind == "Cone":
        return {"radius": geometry.RefRadius(), "angle": geometry.SemiAngle()}
    if kind == "Torus":
        return {"min_radius": geometry.MinorRadius(), "max_radius": geometry.MajorRadius()}
    if kind in ("Ellipse", "Hyperbola"):
        return {"x_radius": geometry.MajorRadius(), "y_radius": geometry.MinorRadius()}
    return {"focal": geometry.Focal()} if kind == "Parabola" else {}


def _trim(surface: Any) -> _Row:
    """Return the bounds of a trimmed surface, none in a direction in which it is not trimmed.

    OCCT does not tell which directions those are. They are the ones that kept the period of
    the basis, or run on to infinity; bounds that equal those of the basis trim nothing.
    """
    from OCP.Precision import Precision

    u_min, u_max, v_min, v_max = surface.Bounds()
    row: _Row = {}
    if not (surface.IsUPeriodic() or Precision.IsInfinite_s(u_min)):
        row |= {"u_min": u_min, "u_max": u_max}
    if not (surface.IsVPeriodic() or Precision.IsInfinite_s(v_min)):
        row |= {"v_min": v_min, "v_max": v_max}
    return row


def _spline_curve(curve: Any) -> _Row:
    spline = spline_curve(curve)
    row: _Row = {"degree": spline.degree, "poles": spline.poles, "weights": spline.weights}
    if len(spline.knots):
        period = spline.degree if spline.periodic else None
        knots = flat_knots(spline.knots, spline.times, period)
        row |= {"periodic": spline.periodic, "knots": knots}
    return row


def _spline_surface(surface: Any) -> _Row:
    spline = spline_surface(surface)
    row: _Row = {"poles": spline.poles, "weights": spline.weights}
    for i, axis in enumerate("uv"):
        degree, periodic = spline.degree[i], spline.periodic[i]
        row[f"{axis}_degree"] = degree
        if len(spline.knots[i]):
            row[f"{axis}_periodic"] = periodic
            row[f"{axis}_knots"] = flat_knots(
                spline.knots[i], spline.times[i], degree if periodic else None
            )
    return row
