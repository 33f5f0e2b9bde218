"""Surfaces of the package ``abs-hdf5``, which evaluates B-Reps without a kernel, too.

Its STEP converter is not on PyPI; but its surfaces can be made from their parameters, by the
same classes that its reader makes from HDF5 files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

import numpy as np

from breplake.schema.namespace import Floats

__all__ = ["abs_available", "abs_points", "abs_surface"]

Row = Mapping[str, Any]

_NOWHERE = np.zeros((3, 4))  # placement of its surfaces in an assembly, not used to evaluate


def abs_available() -> bool:
    """Return whether ``abs-hdf5`` is installed."""
    try:
        return hasattr(import_module("abs"), "read_parts")
    except ImportError:
        return False


def abs_surface(row: Row) -> Any | None:
    """Return the surface of a row of ``patches``; None if the package has no such type."""
    builders: dict[str, Callable[[Row], dict[str, Any]]] = {
        "Plane": lambda r: {"coefficients": np.zeros(4), **_axes(r)},
        "Cylinder": lambda r: {"coefficients": np.zeros(10), "radius": r["radius"], **_axes(r)},
        "Sphere": lambda r: {"coefficients": np.zeros(10), "radius": r["radius"], **_axes(r)},
        "Cone": _cone,
        "Torus": lambda r: {k: r[k] for k in ("max_radius", "min_radius")} | _axes(r),
        "BSpline": _spline,
        "Extrusion": lambda r: {"direction": _vector(r["direction"]), "curve": _curve(r["curve"])},
        "Revolution": lambda r: {
            "location": _vector(r["location"]),
            "z_axis": _vector(r["z_axis"]),
            "curve": _curve(r["curve"]),
        },
    }
    build = builders.get(row["type"])
    if build is None:
        return None
    given = build(row)
    if "curve" in given and given["curve"] is None:
        return None
    bounds = np.array([[row["u_min"], row["u_max"]], [row["v_min"], row["v_max"]]])
    name = "BSplineSurface" if row["type"] == "BSpline" else row["type"]
    made = getattr(import_module("abs.surface"), name)
    return made(None, trim_domain=bounds, transform=_NOWHERE, **given)


def _vector(value: Mapping[str, float]) -> Floats:
    return np.array([value[axis] for axis in "xyz"])


def _axes(row: Row) -> dict[str, Floats]:
    return {name: _vector(row[name]) for name in ("location", "x_axis", "y_axis", "z_axis")}


def _cone(row: Row) -> dict[str, Any]:
    more = {"coefficients": np.zeros(10), "apex": _vector(row["apex"])}
    return {"radius": row["radius"], "angle": row["angle"], **more, **_axes(row)}


def _spline(row: Row) -> dict[str, Any]:
    poles = np.array([[[p[axis] for axis in "xyz"] for p in line] for line in row["poles"]])
    weights = np.ones(poles.shape[:2]) if row["weights"] is None else np.array(row["weights"])
    knots = {f"{side}_knots": np.array(row[f"{side}_knots"]) for side in "uv"}
    same = ("u_degree", "v_degree", "u_closed", "v_closed", "u_periodic", "v_periodic")
    return {
        **{name: row[name] for name in same},
        **knots,
        "continuity": row["continuity"],
        "face_domain": np.zeros(4),
        "is_trimmed": False,
        "poles": poles,
        "weights": weights.T,  # its constructor transposes
        "u_rational": row["weights"] is not None,
        "v_rational": row["weights"] is not None,
    }


def _curve(row: Row) -> Any | None:
    """Return the curve that is swept; None if the package has no such type."""
    curve: Any = import_module("abs.curve")
    bounds = np.array([0.0, 1.0])
    if row["type"] == "Line":
        place = {name: _vector(row[name]) for name in ("location", "direction")}
        return curve.Line(None, interval=bounds, **place)
    if row["type"] == "Circle":
        return curve.Circle(None, interval=bounds, radius=row["radius"], **_axes(row))
    if row["type"] == "Ellipse":
        axes = {name: _vector(row[name]) for name in ("x_axis", "y_axis", "z_axis")}
        foci = {name: _vector(row[name]) for name in ("focus1", "focus2")}
        radii = {"maj_radius": row["x_radius"], "min_radius": row["y_radius"]}
        return curve.Ellipse(None, interval=bounds, **foci, **radii, **axes)
    if row["type"] != "BSpline":
        return None
    poles = np.array([[p[axis] for axis in "xyz"] for p in row["poles"]])
    same = ("closed", "degree", "continuity", "knots", "rational", "periodic")
    weights = np.ones(len(poles)) if row["weights"] is None else row["weights"]
    return curve.BSplineCurve(
        None, interval=bounds, poles=poles, weights=weights, **{name: row[name] for name in same}
    )


def abs_points(surface: Any, uv: Floats, curvature: bool) -> tuple[Floats, ...]:
    """Evaluate a surface: point and normal and, from its derivatives, principal curvatures.

    Parameters
    ----------
    surface : abs.surface.Surface
    uv : numpy.ndarray
        ``(n, 2)`` parameters.
    curvature : bool
        Whether curvatures are wanted; the package has no function for them.
    """
    point, normal = surface.sample(uv), surface.normal(uv)
    if not curvature:
        return point, normal
    first, second = surface.derivative(uv, 1), surface.derivative(uv, 2)
    du, dv = first[:, :, 0], first[:, :, 1]
    e, f, g = ((a * b).sum(axis=1) for a, b in ((du, du), (du, dv), (dv, dv)))
    bends = second[:, :, 0, 0], second[:, :, 0, 1], second[:, :, 1, 1]
    uu, uv_, vv = ((bend * normal).sum(axis=1) for bend in bends)
    area = e * g - f * f
    mean = (e * vv - 2 * f * uv_ + g * uu) / (2 * area)
    root = np.sqrt(np.maximum(mean * mean - (uu * vv - uv_ * uv_) / area, 0.0))
    return point, normal, mean - root, mean + root
