"""Names of surface, curve and other kinds, as the paper writes them."""

from __future__ import annotations

__all__ = [
    "CURVE_KINDS",
    "CURVE_TYPES",
    "FEATURES",
    "MESH_KINDS",
    "SURFACE_TYPES",
    "count_column",
]

SURFACE_TYPES = (
    "Plane",
    "Cylinder",
    "Cone",
    "Sphere",
    "Torus",
    "Revolution",
    "Extrusion",
    "BSpline",
    "Other",
)
"""Types of patches (paper, appendix "Curve and Patch Features")."""

CURVE_TYPES = ("Line", "Circle", "Ellipse", "Parabola", "Hyperbola", "BSpline", "Other")
"""Types of curves. The paper puts Parabola and Hyperbola under Other."""

CURVE_KINDS = ("sharp", "smooth", "seam", "boundary", "nonmanifold", "degenerate", "free")
"""What a curve is to its patches; ``free`` has none."""

FEATURES = ("interior", "smooth_curve", "sharp_curve", "corner")
"""Meaning of the values 0..3 of the array ``feature``."""

MESH_KINDS = ("uniform", "adaptive", "tessellation")
"""How a mesh was made; ``tessellation`` is OCCT's, the last rung of the ladder."""


def count_column(type_name: str, *, curve: bool = False) -> str:
    """Return the column of ``models`` that counts a type: ``n_torus``, ``n_bspline_curve``.

    Parameters
    ----------
    type_name : str
        A member of `SURFACE_TYPES`, or of `CURVE_TYPES` if `curve`.
    curve : bool
        Whether it is a curve type. ``BSpline`` and ``Other`` are both, so curve columns
        that would clash carry the suffix ``_curve``.
    """
    suffix = "_curve" if curve and type_name in SURFACE_TYPES else ""
    return f"n_{type_name.lower()}{suffix}"
