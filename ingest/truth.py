"""Ground truth: parameters, normals and principal curvatures of every mesh vertex."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from breplake.ingest.mesh import Mesh, lengths_of
from breplake.ingest.refine import Geometry, Periods
from breplake.schema.jets import PrincipalCurvature
from breplake.schema.projection import project_points

__all__ = ["EXACT", "Truth", "derive", "wind"]

_Floats = npt.NDArray[np.float64]
_Bools = npt.NDArray[np.bool_]

EXACT: Final = 1e-12
"""Residual, as a fraction of the model's diagonal, that needs no improvement."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What is known of every (patch, vertex) pair, in the order of the mesh's pairs.

    Parameters
    ----------
    normal : numpy.ndarray
        ``(m, 3)`` outward unit normals; NaN where undefined.
    curvature : PrincipalCurvature
        Towards the normal, 1/mm; NaN where undefined.
    residual : numpy.ndarray
        ``(m,)`` mm from the vertex to the surface at its parameters.
    """

    normal: _Floats
    curvature: PrincipalCurvature
    residual: _Floats


def derive(
    mesh: Mesh, geometry: Geometry, periods: Periods, flipped: _Bools, diagonal: float
) -> tuple[Mesh, Truth]:
    """Derive the ground truth of a mesh.

    Vertices on curves got their parameters from pcurves, which follow the curve only within
    the edge's tolerance: they are projected onto the surface.

    Parameters
    ----------
    mesh : Mesh
        The final mesh; its pairs' parameters may be improved in the result.
    geometry : Geometry
        Evaluates the surfaces.
    periods : Periods
        Bounds of the surfaces' parameters.
    flipped : numpy.ndarray
        ``(p,)`` patches whose outward normal is opposite to du x dv.
    diagonal : float
        Of the model, mm.
    """
    patch, target = mesh.pair_patch, mesh.points.take(mesh.pair_vertex, 0)
    # Gmsh goes on past the seam of closed surfaces that are not periodic.
    uv = periods.inside(patch, mesh.uv)
    residual = lengths_of(geometry.jet(patch, uv[:, 0], uv[:, 1]).point - target)
    off = np.flatnonzero(~(residual <= EXACT * diagonal))
    if len(off):
        u, v, _ = project_points(
            geometry.jet,
            patch[off],
            target[off],
            uv[off, 0],
            uv[off, 1],
            periods.bounds[patch[off]],
        )
        uv[off] = np.column_stack([u, v])
    jet = geometry.jet(patch, uv[:, 0], uv[:, 1])
    residual = lengths_of(jet.point - target)
    sign = np.where(flipped[patch], -1.0, 1.0)[:, None]
    normal = jet.normal() * sign
    return replace(mesh, uv=uv), Truth(normal, jet.curvature(normal), residual)


def wind(mesh: Mesh, truth: Truth) -> tuple[Mesh, int]:
    """Turn the triangles of each patch counter-clockwise as seen from outside.

    Returns
    -------
    mesh : Mesh
        With whole patches turned where their triangles mostly oppose their normals.
    opposed : int
        Triangles that still oppose the mean normal of their corners: slivers and folds.
    """
    a, b, c = (mesh.points.take(mesh.triangles[:, i], 0) for i in range(3))
    (ux, uy, uz), (vx, vy, vz) = (b - a).T, (c - a).T
    normal = np.zeros_like(a)
    known = np.nan_to_num(truth.normal)
    for i in range(3):
        normal += known.take(mesh.pairs(mesh.patch, mesh.triangles[:, i]), 0)
    x, y, z = normal.T
    # (f,) along the triangle's own normal
    agreement = (uy * vz - uz * vy) * x + (uz * vx - ux * vz) * y + (ux * vy - uy * vx) * z
    votes = np.bincount(mesh.patch, weights=agreement)
    turn = votes[mesh.patch] < 0
    triangles = mesh.triangles.copy()
    triangles[turn] = triangles[turn][:, [0, 2, 1]]
    opposed = int(((agreement < 0) != turn).sum())
    return replace(mesh, triangles=triangles), opposed
