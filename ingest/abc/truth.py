"""Positions, normals and curvatures of a published mesh, as exact as its files allow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from breplake.ingest.abc.geometry import ExactGeometry
from breplake.ingest.abc.obj import Obj
from breplake.ingest.abc.repair import Repairs
from breplake.ingest.mesh import Mesh
from breplake.ingest.truth import Truth, derive
from breplake.schema.jets import PrincipalCurvature

__all__ = ["Printed", "orientation", "refined", "truth"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]
_Bools = npt.NDArray[np.bool_]

_UNIT: Final = 1e-12
"""How far an exact normal may be from unit length."""

_SAME_NORMAL: Final = 1e-3
"""Difference of two normals that is rounding, in the file or of the place."""

_SAME_CURVATURE: Final = 1e-2
"""Relative difference of two curvatures that is rounding."""

_ROUNDING: Final = 1e-5
"""Curvature that is printed as zero, in whatever unit."""

_METRE: Final = 1000.0


def refined(mesh: Mesh, geometry: ExactGeometry, rounding: float) -> tuple[Mesh, int]:
    """Return the mesh with its vertices where the rounded positions come from.

    Vertices inside patches move to p(u, v), those on curves to c(t). What would move by more
    than the rounding stays: there the curve and the patch of the CAD file disagree.

    Parameters
    ----------
    mesh : Mesh
        Positions as printed.
    geometry : ExactGeometry
        Its curves and surfaces.
    rounding : float
        Half a unit of the last printed place, mm.

    Returns
    -------
    mesh : Mesh
        With exact positions.
    kept : int
        Number of vertices that stay.
    """
    exact = np.full_like(mesh.points, np.nan)
    place = geometry.jet(mesh.pair_patch, *mesh.uv.T).point
    exact[mesh.pair_vertex[::-1]] = place[::-1]  # the first patch of a vertex stays
    for ends in (False, True):  # corners are set last, by the first of their curves
        for curve in sorted(mesh.curves, reverse=True):
            nodes = mesh.curves[curve]
            mine = np.array([0, -1]) if ends else np.arange(1, len(nodes.t) - 1)
            exact[nodes.vertices[mine]] = geometry.curve_points(curve, nodes.t[mine])
    slack = rounding * (1 + 1e-6) + 1e-12 * float(np.abs(mesh.points).max())
    close: _Bools = np.all(np.abs(exact - mesh.points) <= slack, axis=1)
    points = np.where(close[:, None], exact, mesh.points)
    return replace(mesh, points=points), int((~close).sum())


def orientation(mesh: Mesh, geometry: ExactGeometry, count: int) -> _Bools:
    """Return by patch whether its triangles turn against du x dv, ``(count,)``."""
    normal = np.nan_to_num(geometry.jet(mesh.pair_patch, *mesh.uv.T).normal())
    row = mesh.pairs(np.repeat(mesh.patch, 3), mesh.triangles.ravel()).reshape(-1, 3)
    a, b, c = (mesh.points[mesh.triangles[:, i]] for i in range(3))
    votes = np.einsum("fi,fi->f", np.cross(b - a, c - a), normal[row].sum(axis=1))
    return np.asarray(np.bincount(mesh.patch, votes, minlength=count) < 0)


def truth(
    mesh: Mesh, printed: Printed, geometry: ExactGeometry, flipped: _Bools, repairs: Repairs
) -> tuple[Mesh, Truth]:
    """Return normals and curvatures: the printed ones if they are exact, else closed forms.

    Closed forms are taken at the foot points of the vertices, as for any other mesh; what is
    printed exactly stays as it is, parameters too. Where a surface has no closed form, there
    is the printed normal and no curvature.

    Parameters
    ----------
    mesh : Mesh
        Positions and parameters.
    printed : Printed
        What the OBJ says, by pair.
    geometry : ExactGeometry
        The surfaces.
    flipped : numpy.ndarray
        ``(p,)`` bool, patches that face against du x dv.
    repairs : Counter
        Takes up what was wrong.
    """
    diagonal = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
    found = _at(mesh, geometry, flipped)
    wrong = printed.compare(found.normal, found.curvature)
    repairs.update(wrong)
    known = np.asarray(geometry.surfaces.known)[mesh.pair_patch]
    if printed.is_exact and not wrong:
        return mesh, replace(found, normal=printed.normal, curvature=printed.curvature)
    mesh, found = derive(mesh, geometry, geometry.periods, flipped, diagonal)
    normal = np.where(known[:, None], found.normal, _unit(printed.normal))
    return mesh, replace(found, normal=normal)


def _at(mesh: Mesh, geometry: ExactGeometry, flipped: _Bools) -> Truth:
    """Return the truth at the parameters as they are."""
    jet = geometry.jet(mesh.pair_patch, *mesh.uv.T)
    normal = jet.normal() * np.where(flipped[mesh.pair_patch], -1.0, 1.0)[:, None]
    residual = np.linalg.norm(jet.point - mesh.points[mesh.pair_vertex], axis=1)
    return Truth(normal, jet.curvature(normal), residual)


def _unit(vectors: _Floats) -> _Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, np.nan)


@dataclass(frozen=True, slots=True)
class Printed:
    """Normals and curvatures of an OBJ by pair of patch and vertex; NaN where it has none.

    Parameters
    ----------
    normal : numpy.ndarray
        ``(m, 3)``.
    curvature : PrincipalCurvature
        As printed.
    is_exact : bool
        Whether numbers are written with all their digits, normals having unit length.
    """

    normal: _Floats
    curvature: PrincipalCurvature
    is_exact: bool

    @classmethod
    def of(cls, obj: Obj, pair_normal: _Ints) -> Printed:
        """Read them by the normals ``(m,)`` of the pairs, -1 where there is none."""
        there = pair_normal >= 0
        normal, values = np.full((len(there), 3), np.nan), np.full((len(there), 8), np.nan)
        normal[there] = obj.normals[pair_normal[there]]  # (m, 3)
        if len(obj.curvatures):
            values[there] = obj.curvatures[pair_normal[there]]
        length = np.linalg.norm(normal, axis=1)
        unit = np.isnan(length) | (np.abs(length - 1) <= _UNIT)
        k = PrincipalCurvature(
            values[:, 0].copy(), values[:, 1].copy(), values[:, 2:5].copy(), values[:, 5:8].copy()
        )
        exact = obj.decimals is None and len(obj.curvatures) > 0 and bool((there & unit).all())
        return cls(normal, k, exact)

    def compare(self, normal: _Floats, curvature: PrincipalCurvature) -> Repairs:
        """Return how often the printed values are not the true ones, by code.

        Published curvatures are per metre, and towards du x dv instead of the normal.
        """
        found: Repairs = Repairs()
        off = np.abs(self.normal - normal).max(axis=1) > _SAME_NORMAL
        _put(found, "normals", off)
        mine = self.curvature.k_min, self.curvature.k_max
        ways = {
            (): (curvature.k_min, curvature.k_max),
            ("curvature-side",): (-curvature.k_max, -curvature.k_min),
        }
        for codes, (least, most) in list(ways.items()):
            ways["curvature-unit", *codes] = (_METRE * least, _METRE * most)
        size = np.maximum(np.abs(curvature.k_min), np.abs(curvature.k_max))
        open_ = ~np.isnan(mine[0]) & ~np.isnan(size)
        for codes, (least, most) in sorted(ways.items(), key=lambda way: len(way[0])):
            scale = _METRE if "curvature-unit" in codes else 1.0
            error = np.maximum(np.abs(mine[0] - least), np.abs(mine[1] - most))
            right = open_ & (error <= _SAME_CURVATURE * scale * size + _ROUNDING)
            for code in codes:
                _put(found, code, right)
            open_ &= ~right
        _put(found, "curvatures", open_)
        return found


def _put(found: Repairs, code: str, where: _Bools) -> None:
    if number := int(where.sum()):
        found[code] += number
