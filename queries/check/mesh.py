"""Measures of a triangle mesh, recomputed from its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["MeshEdges", "Triangles", "angle_between"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class MeshEdges:
    """The edges of a triangle mesh.

    Parameters
    ----------
    ends : numpy.ndarray
        ``(e, 2)`` vertex ids, the lesser first, ascending.
    count : numpy.ndarray
        ``(e,)`` triangles at the edge.
    forward : numpy.ndarray
        ``(e,)`` triangles that run from the lesser id to the greater.
    of_triangle : numpy.ndarray
        ``(f, 3)`` edge from corner i to corner i + 1 of each triangle.
    """

    ends: Ints
    count: Ints
    forward: Ints
    of_triangle: Ints

    @classmethod
    def of(cls, triangles: Ints, n_vertices: int) -> MeshEdges:
        """Find the edges of triangles ``(f, 3)``."""
        start, stop = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
        low, high = np.minimum(start, stop), np.maximum(start, stop)
        codes, inverse, count = np.unique(
            low * max(n_vertices, 1) + high, return_inverse=True, return_counts=True
        )
        ends = np.stack([codes // max(n_vertices, 1), codes % max(n_vertices, 1)], axis=1)
        forward = np.bincount(inverse, weights=start < stop, minlength=len(codes)).astype(np.int64)
        return cls(ends, count.astype(np.int64), forward, inverse.reshape(-1, 3))

    @property
    def boundary(self) -> Ints:
        """Edges with one triangle."""
        return np.flatnonzero(self.count == 1)

    @property
    def nonmanifold(self) -> Ints:
        """Edges with three or more triangles."""
        return np.flatnonzero(self.count > 2)

    def find(self, start: Ints, stop: Ints, n_vertices: int) -> NDArray[np.bool_]:
        """Return whether each pair of vertices is joined by an edge."""
        if not len(self.ends):
            return np.zeros(len(start), dtype=bool)
        codes = self.ends[:, 0] * n_vertices + self.ends[:, 1]
        wanted = np.minimum(start, stop) * n_vertices + np.maximum(start, stop)
        place = np.minimum(np.searchsorted(codes, wanted), len(codes) - 1)
        return np.asarray(codes[place] == wanted)


@dataclass(frozen=True, slots=True)
class Triangles:
    """Sides, normals and areas of triangles.

    Parameters
    ----------
    sides : numpy.ndarray
        ``(f, 3, 3)`` vector from corner i to corner i + 1, mm.
    cross : numpy.ndarray
        ``(f, 3)`` normal of the winding, twice the area long.
    """

    corners: Floats
    sides: Floats
    cross: Floats

    @classmethod
    def of(cls, corners: Floats) -> Triangles:
        """Measure triangles by their corners ``(f, 3, 3)``."""
        sides = np.roll(corners, -1, axis=1) - corners
        return cls(corners, sides, np.cross(sides[:, 0], sides[:, 1]))

    @property
    def lengths(self) -> Floats:
        """Lengths of the sides, ``(f, 3)`` mm."""
        return np.asarray(np.linalg.norm(self.sides, axis=2))

    @property
    def areas(self) -> Floats:
        """Areas, ``(f,)`` mm^2."""
        return np.asarray(np.linalg.norm(self.cross, axis=1) / 2)

    @property
    def angles(self) -> Floats:
        """Angle at each corner, ``(f, 3)`` rad."""
        after, before = self.sides, -np.roll(self.sides, 1, axis=1)
        return angle_between(after, before)

    def volume(self, origin: Floats) -> float:
        """Return the volume that a closed mesh encloses, mm^3, summed about `origin` (3,)."""
        return float(np.einsum("fi,fi->", self.corners[:, 0] - origin, self.cross) / 6)


def angle_between(a: Floats, b: Floats) -> Floats:
    """Return the angle between vectors ``(..., 3)`` in rad, exact also when it is tiny."""
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.arctan2(cross, np.einsum("...i,...i->...", a, b)))
