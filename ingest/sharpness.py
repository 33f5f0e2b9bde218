"""Dihedral angle along a curve, and what follows from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.ingest.clock import KERNEL
from breplake.schema.surfaces import SurfaceSet

__all__ = [
    "SAMPLES",
    "SHARP_COSINE",
    "Crease",
    "Dihedral",
    "classify",
    "dihedrals",
    "measure",
]

_Floats = npt.NDArray[np.float64]
_Bools = npt.NDArray[np.bool_]

SHARP_COSINE: Final = 0.95
"""ABC's threshold: normals that differ by more than 18.2 degrees make a sharp curve."""

SAMPLES: Final = 11
"""Interior points of a curve at which its angle is measured."""

_CREASE: Final = math.radians(0.5)
"""Below this angle the side to which a curve bends is rounding noise."""


@dataclass(frozen=True, slots=True)
class Dihedral:
    """The angle between the outward normals of a curve's two patches.

    Parameters
    ----------
    angle_min, angle_max : float
        Extremes over the samples, rad; NaN where no sample has both normals.
    convexity : {"convex", "concave", "mixed"} or None
        Sides to which the material bends at the samples; None where no angle is above 0.5 degrees.
        A curve that `classify` calls smooth may have one: a single smooth sample makes it smooth.
    sharp : bool
        ABC's rule: ``|n0.n1| <= 0.95`` at every sample.
    """

    angle_min: float
    angle_max: float
    convexity: str | None
    sharp: bool

    @classmethod
    def between(cls, left: _Floats, right: _Floats, tangents: _Floats) -> Dihedral:
        """Derive the angles of one curve from samples.

        Parameters
        ----------
        left, right : numpy.ndarray
            ``(s, 3)`` outward unit normals of the patch whose loop runs along the curve and
            of the one whose loop runs against it; NaN rows are left out.
        tangents : numpy.ndarray
            ``(s, 3)`` tangents of the curve, any length.
        """
        return dihedrals(left[None], right[None], tangents[None])[0]


def dihedrals(left: _Floats, right: _Floats, tangents: _Floats) -> list[Dihedral]:
    """Derive the angles of many curves; arguments are ``(e, s, 3)`` as in `Dihedral.between`."""
    defined = np.isfinite(left + right).all(axis=2).astype(bool, copy=False)  # (e, s)
    cosine = np.einsum("esi,esi->es", left, right)
    cross = np.cross(left, right)  # (e, s, 3)
    # atan2 keeps small angles exact, where arccos loses half of the digits
    angle = np.arctan2(np.linalg.norm(cross, axis=2), cosine)
    side = np.einsum("esi,esi->es", cross, tangents)
    bent = defined & (angle > _CREASE)
    convex, concave = (bent & (side > 0)).any(axis=1), (bent & (side < 0)).any(axis=1)
    known = defined.sum(axis=1) > 0  # (e,)
    flat = defined & ~(np.abs(cosine) <= SHARP_COSINE)  # (e, s)
    sharp = known & (flat.sum(axis=1) == 0)
    least = np.where(defined, angle, np.inf).min(axis=1, initial=np.inf)
    most = np.where(defined, angle, -np.inf).max(axis=1, initial=-np.inf)
    names = np.select([convex & concave, convex, concave], ["mixed", "convex", "concave"], "")
    return [
        Dihedral(
            float(least[i]) if known[i] else math.nan,
            float(most[i]) if known[i] else math.nan,
            str(names[i]) or None,
            bool(sharp[i]),
        )
        for i in range(len(left))
    ]


@dataclass(frozen=True, slots=True)
class Crease:
    """A curve between two patches, to be measured.

    Parameters
    ----------
    edge : TopoDS_Edge
        The curve.
    left, right : int
        Patch whose loop runs along the curve, and the one whose loop runs against it.
    """

    edge: Any
    left: int
    right: int


def measure(
    creases: Sequence[Crease], faces: Sequence[Any], surfaces: Sequence[Any], patches: pa.Table
) -> list[Dihedral]:
    """Measure the dihedral angle of many curves through their pcurves.

    Parameters
    ----------
    creases : sequence of Crease
        The curves.
    faces, surfaces : sequence
        ``TopoDS_Face`` and untrimmed ``Geom_Surface`` by patch.
    patches : pyarrow.Table
        The rows of ``patches``, in order of patch_id.
    """
    if not creases:
        return []
    patch = np.array([[crease.left, crease.right] for crease in creases])  # (e, 2)
    tangents, uv = _sampled(creases, faces)
    rows = np.repeat(patch.ravel(), SAMPLES)
    u, v = uv.T
    known = SurfaceSet.from_patches(patches)
    normals = known.evaluate(rows, u, v).normal()  # (e 2 s, 3)
    for k in np.flatnonzero(~known.known[rows] & np.isfinite(u)):
        normals[k] = _kernel_normal(surfaces[rows[k]], u[k], v[k])
    flipped = patches.column("reversed").to_numpy(zero_copy_only=False)[rows]
    normals = np.where(flipped[:, None], -normals, normals).reshape(-1, 2, SAMPLES, 3)
    return dihedrals(normals[:, 0], normals[:, 1], tangents)


def _sampled(creases: Sequence[Crease], faces: Sequence[Any]) -> tuple[_Floats, _Floats]:
    """Return tangents ``(e, s, 3)`` and parameters ``(e 2 s, 2)`` on both patches.

    Parameters are NaN where an edge has no pcurve.
    """
    from OCP.BRep import BRep_Tool
    from OCP.BRepAdaptor import BRepAdaptor_Curve
    from OCP.gp import gp_Pnt, gp_Pnt2d, gp_Vec

    place, tangent, parameters = gp_Pnt(), gp_Vec(), gp_Pnt2d()
    tangents: list[tuple[float, float, float]] = []
    uv: list[tuple[float, float]] = []
    for crease in creases:
        edge, on_both = crease.edge, (faces[crease.left], faces[crease.right])
        with KERNEL():
            t_min, t_max = BRep_Tool.Range_s(edge)
            samples = [t_min + (i + 0.5) / SAMPLES * (t_max - t_min) for i in range(SAMPLES)]
            curve = BRepAdaptor_Curve(edge)
            for t in samples:
                curve.D1(t, place, tangent)
                tangents.append((tangent.X(), tangent.Y(), tangent.Z()))
            for face in on_both:
                # The adaptor would crash on a missing pcurve, so ask for the curve itself.
                pcurve = BRep_Tool.CurveOnSurface_s(edge, face, 0.0, 0.0)
                if pcurve is None:
                    uv += [(math.nan, math.nan)] * SAMPLES
                    continue
                for t in samples:
                    pcurve.D0(t, parameters)
                    uv.append((parameters.X(), parameters.Y()))
    return np.array(tangents).reshape(-1, SAMPLES, 3), np.array(uv)


def _kernel_normal(surface: Any, u: float, v: float) -> _Floats:
    """Return the unit normal ``(3,)`` of a surface without closed form; NaN if singular."""
    from OCP.gp import gp_Pnt, gp_Vec

    du, dv = gp_Vec(), gp_Vec()
    surface.D1(u, v, gp_Pnt(), du, dv)
    cross = du.Crossed(dv)
    if not cross.Magnitude() > 1e-9 * du.Magnitude() * dv.Magnitude():
        return np.full(3, np.nan)
    unit = cross.Normalized()
    return np.array([unit.X(), unit.Y(), unit.Z()])


def classify(dihedral: Dihedral) -> str:
    """Return ``sharp`` or ``smooth`` for a curve between two patches.

    Unlike ABC's flag this calls a knife edge, where the patches fold back by more than
    161.8 degrees, sharp.
    """
    return "sharp" if dihedral.angle_min >= math.acos(SHARP_COSINE) else "smooth"
