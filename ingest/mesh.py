"""A triangle mesh whose vertices know their curve and patch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

__all__ = ["CurveNodes", "Mesh", "edge_lengths", "unique_edges"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]


@dataclass(slots=True)
class CurveNodes:
    """Mesh vertices along one curve, both ends included.

    Parameters
    ----------
    vertices : numpy.ndarray
        ``(n,)`` vertex ids; first and last are equal on a closed curve.
    t : numpy.ndarray
        ``(n,)`` parameters, ascending.
    """

    vertices: _Ints
    t: _Floats


@dataclass(slots=True)
class Mesh:
    """Triangles of a model with their correspondence to its B-Rep.

    Parameters
    ----------
    points : numpy.ndarray
        ``(n, 3)`` mm, vertices on corners first, then on curves, then inside patches.
    triangles : numpy.ndarray
        ``(f, 3)`` vertex ids, counter-clockwise seen from outside, sorted by patch.
    patch : numpy.ndarray
        ``(f,)`` patch of each triangle.
    corner : numpy.ndarray
        ``(n,)`` corner on which a vertex lies, or -1.
    curves : dict of int to CurveNodes
        Vertices along each meshed curve.
    pair_patch, pair_vertex : numpy.ndarray
        ``(m,)`` the patches on which each vertex lies, as pairs in ascending order. The index
        of a pair is its ``normal_id``.
    uv : numpy.ndarray
        ``(m, 2)`` parameters of the pair. On a seam one of the two equivalent ones.
    """

    points: _Floats
    triangles: _Ints
    patch: _Ints
    corner: _Ints
    curves: dict[int, CurveNodes]
    pair_patch: _Ints
    pair_vertex: _Ints
    uv: _Floats

    def pairs(self, patch: _Ints, vertex: _Ints) -> _Ints:
        """Return the index of each pair (patch, vertex), which must exist."""
        span = len(self.points)
        keys = self.pair_patch * span + self.pair_vertex
        return np.searchsorted(keys, patch * span + vertex)

    def with_used_pairs(self) -> Mesh:
        """Return the mesh with just the pairs that some triangle uses, in ascending order."""
        span = len(self.points)
        keys = self.pair_patch * span + self.pair_vertex
        used = np.unique(np.repeat(self.patch, 3) * span + self.triangles.ravel())
        order = np.argsort(keys, kind="stable")
        rows = order[np.searchsorted(keys[order], used)]
        return replace(
            self,
            pair_patch=self.pair_patch[rows],
            pair_vertex=self.pair_vertex[rows],
            uv=self.uv[rows],
        )

    def curve_of_vertex(self) -> _Ints:
        """Return the curve ``(n,)`` on whose inside each vertex lies, or -1."""
        owner = np.full(len(self.points), -1, dtype=np.int64)
        for curve_id in sorted(self.curves, reverse=True):
            owner[self.curves[curve_id].vertices] = curve_id
        owner[self.corner >= 0] = -1
        return owner


def unique_edges(triangles: _Ints) -> tuple[_Ints, _Ints, _Ints]:
    """List the edges of triangles.

    Parameters
    ----------
    triangles : numpy.ndarray
        ``(f, 3)`` vertex ids.

    Returns
    -------
    edges : numpy.ndarray
        ``(e, 2)`` vertex ids, the smaller first, in ascending order.
    of_triangle : numpy.ndarray
        ``(f, 3)`` edge index of the sides (0,1), (1,2), (2,0).
    count : numpy.ndarray
        ``(e,)`` number of triangles at each edge.
    """
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    low, high = sides.min(axis=1), sides.max(axis=1)
    span = int(high.max(initial=0)) + 1
    keys, inverse, count = np.unique(low * span + high, return_inverse=True, return_counts=True)
    edges = np.column_stack([keys // span, keys % span])
    return edges, inverse.reshape(-1, 3), count


def edge_lengths(points: _Floats, edges: _Ints) -> _Floats:
    """Return the lengths ``(e,)`` mm of edges ``(e, 2)``."""
    lengths: _Floats = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    return lengths
