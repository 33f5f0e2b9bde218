"""Measures of a triangle mesh: edge lengths, angles, watertightness."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from breplake.ingest.mesh import edge_lengths, unique_edges

__all__ = ["Quality", "measure"]


@dataclass(frozen=True, slots=True)
class Quality:
    """Columns of ``models`` that describe its mesh."""

    max_edge: float
    min_angle: float
    regular_angles: float
    is_watertight: bool
    n_boundary_edges: int
    n_nonmanifold_edges: int


def measure(points: npt.NDArray[np.float64], triangles: npt.NDArray[np.int64]) -> Quality:
    """Measure a mesh.

    Parameters
    ----------
    points : numpy.ndarray
        ``(n, 3)`` mm.
    triangles : numpy.ndarray
        ``(f, 3)`` vertex ids, f at least 1.
    """
    edges, _, count = unique_edges(triangles)
    angles = _angles(points, triangles)
    regular = (angles >= math.radians(30)) & (angles <= math.radians(90))
    return Quality(
        max_edge=float(edge_lengths(points, edges).max()),
        min_angle=float(angles.min()),
        regular_angles=float(regular.mean()),
        is_watertight=bool((count == 2).all()),
        n_boundary_edges=int((count == 1).sum()),
        n_nonmanifold_edges=int((count > 2).sum()),
    )


def _angles(
    points: npt.NDArray[np.float64], triangles: npt.NDArray[np.int64]
) -> npt.NDArray[np.float64]:
    """Return the angles ``(f, 3)`` rad of triangles; 0 where two vertices coincide."""
    corner = points[triangles]  # (f, 3, 3)
    to_next = np.roll(corner, -1, axis=1) - corner
    to_last = np.roll(corner, 1, axis=1) - corner
    cross = np.linalg.norm(np.cross(to_next, to_last), axis=2)
    angles: npt.NDArray[np.float64] = np.arctan2(cross, np.einsum("fij,fij->fi", to_next, to_last))
    return angles
