"""OCCT geometry → the parameters of the paper's appendix, as rows.

Follows ``Geom_Surface`` and ``Geom_Curve`` classes rather than adaptors: ``BRep_Tool``
hands them out with the location applied, and only they mirror a surface of revolution
correctly.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from breplake.ingest.lossless.bulk import spline_curve, spline_surface
from breplake.ingest.lossless.knots import flat_knots

__all__ = [
    "Row",
    "cone_coefficients",
    "curve_row",
    "plane_coefficients",
    "quadric_coefficients",
    "sphere_coefficients",
    "surface_row",
    "untrimmed",
]

Row: TypeAlias = dict[str, Any]
"""Column name → value."""

_Vector: TypeAlias = npt.NDArray[np.float64]
_Matrix: TypeAlias = npt.NDArray[np.float64]


def _xyz(point: Any) -> Row:
    return {"x": point.X(), "y": point.Y(), "z": point.Z()}


def _vector(point: Any) -> _Vector:
    return np.array([point.X(), point.Y(), point.Z()])


def _axes(placement: Any) -> Row:
    """Return location and axes of a ``gp_Ax2`` or ``gp_Ax3``, which may be left-handed."""
    return {
        "location": _xyz(placement.Location()),
        "x_axis": _xyz(placement.XDirection()),
        "y_axis": _xyz(placement.YDirection()),
        "z_axis": _xyz(placement.Direction()),
    }


def plane_coefficients(location: _Vector, normal: _Vector) -> list[float]:
    """Coefficients c of ``c0 x + c1 y + c2 z + c3 = 0`` (paper, appendix, Plane).

    Parameters
    ----------
    location : numpy.ndarray
        ``(3,)`` point on the plane, mm.
    normal : numpy.ndarray
        ``(3,)`` unit normal.
    """
    return [*normal.tolist(), -float(normal @ location)]


def quadric_coefficients(matrix: _Matrix, linear: _Vector, constant: float) -> list[float]:
    """Ten coefficients of ``x.Ax + 2 b.x + c = 0`` in the paper's order.

    Parameters
    ----------
    matrix : numpy.ndarray
        ``(3, 3)`` symmetric A.
    linear : numpy.ndarray
        ``(3,)`` b.
    constant : float
        c.
    """
    a = matrix
    values = (a[0, 0], a[1, 1], a[2, 2], a[0, 1], a[0, 2], a[1, 2], *linear, constant)
    return [float(value) for value in values]


def sphere_coefficients(location: _Vector, radius: float) -> list[float]:
    """Coefficients of ``|x - location|^2 = radius^2`` (paper, appendix, Sphere)."""
    return quadric_coefficients(np.eye(3), -location, float(location @ location) - radius**2)


def cone_coefficients(location: _Vector, axis: _Vector, radius: float, slope: float) -> list[float]:
    """Coefficients of a cone, or of a cylinder where `slope` is 0 (paper, appendix).

    With ``q = x - location``: ``|q|^2 - (q.a)^2 = (r + s q.a)^2``.

    Parameters
    ----------
    location : numpy.ndarray
        ``(3,)`` origin of the axes, mm.
    axis : numpy.ndarray
        ``(3,)`` unit axis a.
    radius : float
        Radius r at the origin, mm.
    slope : float
        Growth s of the radius along the axis, the tangent of the half angle.
    """
    matrix = np.eye(3) - (1.0 + slope**2) * np.outer(axis, axis)  # (3, 3)
    linear = -matrix @ location - radius * slope * axis  # (3,)
    height = float(location @ axis)
    constant = float(location @ matrix @ location) + 2 * radius * slope * height - radius**2
    return quadric_coefficients(matrix, linear, constant)


def curve_row(curve: Any) -> Row:
    """Type and parameters of a ``Geom_Curve``, as columns of ``schema.CURVE_GEOMETRY``.

    Trimmed curves are described by their basis, whose parameter is the same; Bézier curves
    by the equal B-spline; offset curves, as ``Other``, by what they are offset from.
    """
    from OCP import Geom

    if isinstance(curve, Geom.Geom_TrimmedCurve):
        return curve_row(curve.BasisCurve())
    if isinstance(curve, Geom.Geom_BezierCurve):
        from OCP.GeomConvert import GeomConvert

        return curve_row(GeomConvert.CurveToBSplineCurve_s(curve))
    if isinstance(curve, Geom.Geom_Line):
        position = curve.Position()
        row = {"location": _xyz(position.Location()), "direction": _xyz(position.Direction())}
        return {"type": "Line", **row}
    if isinstance(curve, Geom.Geom_Conic):
        return _conic_row(curve)
    if isinstance(curve, Geom.Geom_BSplineCurve):
        return _spline_curve_row(curve)
    if isinstance(curve, Geom.Geom_OffsetCurve):
        offset = {"offset": curve.Offset(), "offset_direction": _xyz(curve.Direction())}
        return _as_basis(curve_row(curve.BasisCurve())) | offset
    return {"type": "Other"}


def _as_basis(row: Row) -> Row:
    """Return the row of a curve or surface as that of what is offset from it.

    OCCT itself joins offsets of offsets into one when it makes them.
    """
    return row | {"type": "Other", "basis_type": row["type"]}


def _conic_row(curve: Any) -> Row:
    from OCP import Geom

    row = _axes(curve.Position())
    if isinstance(curve, Geom.Geom_Circle):
        return {"type": "Circle", "radius": curve.Radius(), **row}
    if isinstance(curve, Geom.Geom_Parabola):
        return {"type": "Parabola", "focal": curve.Focal(), "focus1": _xyz(curve.Focus()), **row}
    name = "Ellipse" if isinstance(curve, Geom.Geom_Ellipse) else "Hyperbola"
    radii = {"x_radius": curve.MajorRadius(), "y_radius": curve.MinorRadius()}
    foci = {"focus1": _xyz(curve.Focus1()), "focus2": _xyz(curve.Focus2())}
    return {"type": name, **radii, **foci, **row}


def _continuity(shape: Any) -> int:
    """Return the order of a ``GeomAbs_Shape``; 99 stands for CN."""
    name = str(shape.name).rpartition("_")[2]
    return 99 if name == "CN" else int(name[1:])


def _spline_curve_row(curve: Any) -> Row:
    spline = spline_curve(curve)
    return {
        "type": "BSpline",
        "degree": spline.degree,
        "rational": spline.weights is not None,
        "closed": curve.IsClosed(),
        "periodic": spline.periodic,
        "continuity": _continuity(curve.Continuity()),
        "poles": _points(spline.poles),
        "knots": flat_knots(spline.knots, spline.times, spline.degree if spline.periodic else None),
        "weights": None if spline.weights is None else spline.weights.tolist(),
    }


def _points(poles: _Matrix) -> list[Row]:
    """Return points ``(n, 3)`` as rows."""
    return [{"x": x, "y": y, "z": z} for x, y, z in poles.tolist()]


def untrimmed(surface: Any) -> Any:
    """Return what a rectangular trimmed surface trims, whose parameters are the same.

    The trimmed surface denies that it is periodic; the patch's own bounds trim enough.
    """
    from OCP import Geom

    while isinstance(surface, Geom.Geom_RectangularTrimmedSurface):
        surface = surface.BasisSurface()
    return surface


def surface_row(surface: Any) -> Row:
    """Type and parameters of an untrimmed ``Geom_Surface``, as columns of ``patches``.

    Bézier surfaces are described by the equal B-spline; offset surfaces, as ``Other``, by what
    they are offset from.
    """
    from OCP import Geom

    if isinstance(surface, Geom.Geom_BezierSurface):
        from OCP.GeomConvert import GeomConvert

        return surface_row(GeomConvert.SurfaceToBSplineSurface_s(surface))
    row: Row = {
        "u_closed": surface.IsUClosed(),
        "v_closed": surface.IsVClosed(),
        "u_periodic": surface.IsUPeriodic(),
        "v_periodic": surface.IsVPeriodic(),
    }
    if isinstance(surface, Geom.Geom_ElementarySurface):
        return row | _axes(surface.Position()) | _elementary_row(surface)
    if isinstance(surface, Geom.Geom_SurfaceOfRevolution):
        axis = surface.Axis()
        placed = {"location": _xyz(axis.Location()), "z_axis": _xyz(axis.Direction())}
        return row | placed | {"type": "Revolution", "curve": curve_row(surface.BasisCurve())}
    if isinstance(surface, Geom.Geom_SurfaceOfLinearExtrusion):
        direction = _xyz(surface.Direction())
        curve = curve_row(surface.BasisCurve())
        return row | {"type": "Extrusion", "direction": direction, "curve": curve}
    if isinstance(surface, Geom.Geom_BSplineSurface):
        return row | _spline_surface_row(surface)
    if isinstance(surface, Geom.Geom_OffsetSurface):
        basis = surface_row(untrimmed(surface.BasisSurface()))
        return _as_basis(basis) | {"offset": surface.Offset()} | row
    return row | {"type": "Other"}


def _elementary_row(surface: Any) -> Row:
    from OCP import Geom

    position = surface.Position()
    location, axis = _vector(position.Location()), _vector(position.Direction())
    if isinstance(surface, Geom.Geom_Plane):
        normal = axis if position.Direct() else -axis
        return {"type": "Plane", "coefficients": plane_coefficients(location, normal)}
    if isinstance(surface, Geom.Geom_ToroidalSurface):
        radii = {"min_radius": surface.MinorRadius(), "max_radius": surface.MajorRadius()}
        return {"type": "Torus", **radii}
    if isinstance(surface, Geom.Geom_SphericalSurface):
        radius = surface.Radius()
        coefficients = sphere_coefficients(location, radius)
        return {"type": "Sphere", "radius": radius, "coefficients": coefficients}
    if isinstance(surface, Geom.Geom_CylindricalSurface):
        radius = surface.Radius()
        coefficients = cone_coefficients(location, axis, radius, 0.0)
        return {"type": "Cylinder", "radius": radius, "coefficients": coefficients}
    radius, angle = surface.RefRadius(), surface.SemiAngle()
    return {
        "type": "Cone",
        "radius": radius,
        "angle": angle,
        "apex": _xyz(surface.Apex()),
        "coefficients": cone_coefficients(location, axis, radius, float(np.tan(angle))),
    }


def _spline_surface_row(surface: Any) -> Row:
    spline = spline_surface(surface)
    row: Row = {
        "type": "BSpline",
        "continuity": _continuity(surface.Continuity()),
        "poles": [_points(line) for line in spline.poles],
        "weights": None if spline.weights is None else spline.weights.tolist(),
    }
    for i, axis in enumerate("uv"):
        degree = spline.degree[i]
        row[f"{axis}_degree"] = degree
        row[f"{axis}_rational"] = spline.rational[i]
        row[f"{axis}_knots"] = flat_knots(
            spline.knots[i], spline.times[i], degree if spline.periodic[i] else None
        )
    return row
