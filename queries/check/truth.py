"""The closed forms at every vertex row and along every curve of a model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from breplake.schema.curves import CurveSet
from breplake.schema.jets import LEAST_ANGLE, CurveJet, PrincipalCurvature, SurfaceJet

if TYPE_CHECKING:
    from breplake.queries.check.view import ModelView

__all__ = ["ELEMENTARY", "CurveTruth", "Side", "SurfaceTruth", "sides"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

ELEMENTARY: Final = ("Plane", "Cylinder", "Cone", "Sphere", "Torus")
"""Types whose normals are held to the tighter limit."""

_BESIDE: Final = 1e-8
"""Share of a patch's range of parameters that counts as just beside."""

_SURE: Final = 1e3
"""A derivative this many times the length that rounding decides has surely not vanished."""


@dataclass(frozen=True, slots=True)
class SurfaceTruth:
    """What the rows of ``patches`` say at the (u, v) of every vertex row.

    Parameters
    ----------
    known : numpy.ndarray
        ``(n,)`` the patch's type can be evaluated.
    elementary : numpy.ndarray
        ``(n,)`` the patch is of a type in `ELEMENTARY`.
    point : numpy.ndarray
        ``(n, 3)`` mm.
    normal : numpy.ndarray
        ``(n, 3)`` with the patch's orientation; NaN where undefined.
    curvature : PrincipalCurvature
        Towards that normal; NaN where undefined.
    regular : numpy.ndarray
        ``(n,)`` normal and curvature are defined beyond doubt: no derivative is near zero.
    noise : numpy.ndarray
        ``(n,)`` rad by which the rounding of (u, v) and of a small derivative turns the normal.
    """

    known: Flags
    elementary: Flags
    point: Floats
    normal: Floats
    curvature: PrincipalCurvature
    regular: Flags
    noise: Floats

    @classmethod
    def of(cls, view: ModelView) -> SurfaceTruth:
        """Evaluate all vertex rows of a model."""
        patch = view.ints("vertices", "patch_id")
        surfaces = view.surfaces
        jet = surfaces.evaluate(patch, view.floats("vertices", "u"), view.floats("vertices", "v"))
        normal = _outward(view, patch, jet)
        elementary = np.isin(view.words("patches", "type"), ELEMENTARY)[patch]
        return cls(
            known=surfaces.known[patch],
            elementary=elementary,
            point=jet.point,
            normal=normal,
            curvature=jet.curvature(normal),
            regular=_regular(jet),
            noise=_noise(view, jet),
        )

    def at(self, rows: Ints) -> Side:
        """Return normals and curvatures of some rows."""
        k = self.curvature
        return Side(
            self.normal[rows],
            PrincipalCurvature(k.k_min[rows], k.k_max[rows], k.d_min[rows], k.d_max[rows]),
        )


@dataclass(frozen=True, slots=True)
class Side:
    """Outward normals and curvatures of some vertex rows, seen from one side of their (u, v)."""

    normal: Floats
    curvature: PrincipalCurvature


def sides(view: ModelView, rows: Ints) -> Iterator[Side]:
    """Evaluate vertex rows a little beside their (u, v), in all eight directions.

    Where a knot lets a derivative jump, both its values are right: what kernels return
    there is that of the one or the other side.
    """
    patch = view.ints("vertices", "patch_id")[rows]
    u, v = (view.floats("vertices", name)[rows] for name in "uv")
    du, dv = (
        _BESIDE * (view.floats("patches", f"{x}_max") - view.floats("patches", f"{x}_min"))[patch]
        for x in "uv"
    )
    for one, two in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        jet = view.surfaces.evaluate(patch, u + one * du, v + two * dv)
        normal = _outward(view, patch, jet)
        yield Side(normal, jet.curvature(normal))


def _outward(view: ModelView, patch: Ints, jet: SurfaceJet) -> Floats:
    """Return the normals of `jet` with the orientation of their patches."""
    sign = np.where(view.flags("patches", "reversed"), -1.0, 1.0)[patch]
    return np.asarray(sign[:, None] * jet.normal())


@dataclass(frozen=True, slots=True)
class CurveTruth:
    """What the rows of ``curves`` say at every entry of ``vert_parameters``.

    Parameters
    ----------
    owner : numpy.ndarray
        ``(m,)`` curve of each entry.
    place : numpy.ndarray
        ``(m,)`` its index in the curve's list.
    vertex, parameter : numpy.ndarray
        ``(m,)`` the entries of both lists, end to end.
    offsets : numpy.ndarray
        ``(n_curves + 1,)`` first entry of each curve.
    known : numpy.ndarray
        ``(m,)`` the curve can be evaluated and is not degenerate.
    jet : CurveJet
        The curve there.
    """

    owner: Ints
    place: Ints
    vertex: Ints
    parameter: Floats
    offsets: Ints
    known: Flags
    jet: CurveJet

    @classmethod
    def of(cls, view: ModelView) -> CurveTruth:
        """Evaluate all curves of a model at their mesh vertices."""
        offsets, vertex = view.lists("curves", "vert_indices")
        _, parameter = view.lists("curves", "vert_parameters")
        owner = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
        curves = CurveSet.from_curves(view.table("curves"))
        degenerate = view.words("curves", "kind") == "degenerate"
        return cls(
            owner=owner,
            place=np.arange(len(owner)) - offsets[owner],
            vertex=vertex.astype(np.int64),
            parameter=parameter.astype(np.float64),
            offsets=offsets,
            known=(curves.known & ~degenerate)[owner],
            jet=curves.evaluate(owner, parameter),
        )


def _regular(jet: SurfaceJet) -> Flags:
    """Return where du and dv are surely neither zero nor parallel, or not needed (spheres)."""
    a, b = np.linalg.norm(jet.du, axis=1), np.linalg.norm(jet.dv, axis=1)
    area = np.linalg.norm(np.cross(jet.du, jet.dv), axis=1)
    sure = (a > _SURE * jet.least[:, 0]) & (b > _SURE * jet.least[:, 1])
    sure &= area > _SURE * LEAST_ANGLE * a * b
    return np.asarray(sure if jet.radial is None else sure | ~np.isnan(jet.radial[:, 0]))


def _noise(view: ModelView, jet: SurfaceJet) -> Floats:
    """Return how far rounding turns normals, rad.

    Coordinates are rounded to eps times their size, and so is every derivative; the
    normal turns by that error over the length of the part of one derivative across the
    other.  It matters only close to a place where the normal is not defined.
    """
    a, b = np.linalg.norm(jet.du, axis=1), np.linalg.norm(jet.dv, axis=1)
    area = np.linalg.norm(np.cross(jet.du, jet.dv), axis=1)
    size = np.finfo(np.float64).eps * (view.diagonal + np.abs(jet.point).max(axis=1, initial=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = 8 * size * np.maximum(a, b) / area
    return np.asarray(np.nan_to_num(turn, nan=0.0, posinf=np.pi))
