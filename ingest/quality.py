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
    a, b, c = (points.take(triangles[:, i], 0).T for i in range(3))  # (3, f) each
    sides = b - a, c - b, a - c
    (ux, uy, uz), (vx, vy, vz) = sides[:2]
    # twice the area, which all three angles share
    area = np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2)
    angles = np.empty((len(triangles), 3))
    for corner in range(3):
        x, y, z = sides[corner - 1] * sides[corner]  # they meet there head to tail
        angles[:, corner] = np.arctan2(area, -(x + y + z))
    return angles
