"""Dihedral angle along a curve, and what follows from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

__all__ = ["SAMPLES", "SHARP_COSINE", "Dihedral", "classify"]

SHARP_COSINE: Final = 0.95
"""ABC's threshold: normals that differ by more than 18.2 degrees make a sharp curve."""

SAMPLES: Final = 11
"""Interior points of a curve at which its angle is measured."""

_CREASE: Final = math.radians(0.5)
"""Below this angle the side to which a curve bends is rounding noise."""


class _Use(Protocol):
    """What is needed of a coedge."""

    @property
    def patch_id(self) -> int: ...
    @property
    def reversed(self) -> bool: ...


@dataclass(frozen=True, slots=True)
class Dihedral:
    """The angle between the outward normals of a curve's two patches.

    Parameters
    ----------
    angle_min, angle_max : float
        Extremes over the samples, rad; NaN where no sample has both normals.
    convexity : {"convex", "concave", "mixed"} or None
        Side to which the material bends; None where the curve is smooth.
    sharp : bool
        ABC's rule: ``|n0.n1| <= 0.95`` at every sample.
    """

    angle_min: float
    angle_max: float
    convexity: str | None
    sharp: bool

    @classmethod
    def measure(
        cls, edge: Any, uses: Sequence[_Use], faces: Sequence[Any], surfaces: Sequence[Any]
    ) -> Dihedral:
        """Sample the outward normals of both patches through the curve's pcurves."""
        from OCP.BRep import BRep_Tool
        from OCP.BRepAdaptor import BRepAdaptor_Curve
        from OCP.gp import gp_Pnt, gp_Vec

        t_min, t_max = BRep_Tool.Range_s(edge)
        parameters = t_min + (np.arange(SAMPLES) + 0.5) / SAMPLES * (t_max - t_min)  # (s,)
        left, right = sorted(uses, key=lambda use: use.reversed)
        normals = [
            _normals(edge, faces[use.patch_id], surfaces[use.patch_id], parameters)
            for use in (left, right)
        ]
        curve, point, vector = BRepAdaptor_Curve(edge), gp_Pnt(), gp_Vec()
        tangents = np.empty((SAMPLES, 3))  # (s, 3)
        for i, t in enumerate(parameters):
            curve.D1(t, point, vector)
            tangents[i] = vector.X(), vector.Y(), vector.Z()
        return cls.between(normals[0], normals[1], tangents)

    @classmethod
    def between(
        cls,
        left: npt.NDArray[np.float64],
        right: npt.NDArray[np.float64],
        tangents: npt.NDArray[np.float64],
    ) -> Dihedral:
        """Derive the angles from samples.

        Parameters
        ----------
        left, right : numpy.ndarray
            ``(s, 3)`` outward unit normals of the patch whose loop runs along the curve and
            of the one whose loop runs against it; NaN rows are left out.
        tangents : numpy.ndarray
            ``(s, 3)`` tangents of the curve, any length.
        """
        defined = np.isfinite(left).all(axis=1) & np.isfinite(right).all(axis=1)
        if not defined.any():
            return cls(math.nan, math.nan, None, False)
        a, b = left[defined], right[defined]
        cosine = np.einsum("ij,ij->i", a, b)
        cross = np.cross(a, b)  # (s, 3)
        # atan2 keeps small angles exact, where arccos loses half of the digits
        angle = np.arctan2(np.linalg.norm(cross, axis=1), cosine)
        side = np.einsum("ij,ij->i", cross, tangents[defined])
        signs = {float(s) for s in np.sign(side[angle > _CREASE])} - {0.0}
        convexity = None
        if signs:
            convexity = "mixed" if len(signs) == 2 else "convex" if 1.0 in signs else "concave"
        sharp = bool((np.abs(cosine) <= SHARP_COSINE).all())
        return cls(float(angle.min()), float(angle.max()), convexity, sharp)


def _normals(
    edge: Any, face: Any, surface: Any, parameters: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return ``(s, 3)`` outward normals of a face along its pcurve; NaN where singular."""
    from OCP.BRepAdaptor import BRepAdaptor_Curve2d
    from OCP.gp import gp_Pnt, gp_Pnt2d, gp_Vec
    from OCP.TopAbs import TopAbs_Orientation

    pcurve = BRepAdaptor_Curve2d(edge, face)
    point2, point, du, dv = gp_Pnt2d(), gp_Pnt(), gp_Vec(), gp_Vec()
    tangents = np.empty((2, len(parameters), 3))  # (2, s, 3)
    for i, t in enumerate(parameters):
        pcurve.D0(t, point2)
        surface.D1(point2.X(), point2.Y(), point, du, dv)
        tangents[0, i] = du.X(), du.Y(), du.Z()
        tangents[1, i] = dv.X(), dv.Y(), dv.Z()
    normals = np.cross(tangents[0], tangents[1])  # (s, 3)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    scale = np.linalg.norm(tangents, axis=2).prod(axis=0)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        normals = np.where(size > 1e-9 * scale, normals / size, np.nan)
    return -normals if face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED else normals


def classify(dihedral: Dihedral) -> str:
    """Return ``sharp`` or ``smooth`` for a curve between two patches.

    Unlike ABC's flag this calls a knife edge, where the patches fold back by more than
    161.8 degrees, sharp.
    """
    return "sharp" if dihedral.angle_min >= math.acos(SHARP_COSINE) else "smooth"
