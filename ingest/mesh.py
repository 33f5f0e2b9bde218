"""A triangle mesh whose vertices know their curve and patch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

__all__ = ["CurveNodes", "Mesh", "edge_lengths", "lengths_of", "unique_edges"]

_BITS: Final = 32
"""Bits of a vertex id in the key of an edge."""

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
        """Return the index of each pair (patch, vertex).

        Raises
        ------
        LookupError
            If there is no such pair.
        """
        found = self._find(patch, vertex)
        if (found < 0).any():
            at = int(np.flatnonzero(found < 0)[0])
            raise LookupError(f"vertex {vertex[at]} has no parameters on patch {patch[at]}")
        return found

    def _find(self, patch: _Ints, vertex: _Ints) -> _Ints:
        """Return the index of each pair, -1 where there is none."""
        span, count = len(self.points), len(self.pair_vertex)
        found = np.zeros(span, dtype=np.int64)  # of a vertex that is on one patch alone: its pair
        found[self.pair_vertex] = np.arange(count)
        found = found.take(vertex)
        several = np.flatnonzero((np.bincount(self.pair_vertex, minlength=span) > 1).take(vertex))
        keys = self.pair_patch * span + self.pair_vertex
        at = np.searchsorted(keys, patch[several] * span + vertex[several])
        found[several] = np.minimum(at, count - 1)
        there = (self.pair_patch.take(found) == patch) & (self.pair_vertex.take(found) == vertex)
        return np.where(there, found, -1)

    def unpaired(self) -> tuple[_Ints, _Ints]:
        """Return patch and vertex ``(k,)`` of triangles' corners that are no pair yet."""
        patch, vertex = np.repeat(self.patch, 3), self.triangles.ravel()
        lost = self._find(patch, vertex) < 0
        keys = np.unique(patch[lost] * len(self.points) + vertex[lost])
        return keys // len(self.points), keys % len(self.points)

    def with_used_pairs(self) -> Mesh:
        """Return the mesh with just the pairs that some triangle uses, in ascending order."""
        order = np.argsort(self.pair_patch * len(self.points) + self.pair_vertex, kind="stable")
        mesh = self._with_pairs(order)
        used = np.zeros(len(order), dtype=bool)
        for corner in self.triangles.T:
            used[mesh.pairs(self.patch, corner)] = True
        return mesh._with_pairs(np.flatnonzero(used))

    def _with_pairs(self, rows: _Ints) -> Mesh:
        return replace(
            self,
            pair_patch=self.pair_patch[rows],
            pair_vertex=self.pair_vertex[rows],
            uv=self.uv.take(rows, 0),
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
    first, second = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    keys = np.minimum(first, second) << _BITS | np.maximum(first, second)
    unique, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
    edges = np.column_stack([unique >> _BITS, unique & (1 << _BITS) - 1])
    return edges, inverse.reshape(-1, 3), count


def edge_lengths(points: _Floats, edges: _Ints) -> _Floats:
    """Return the lengths ``(e,)`` mm of edges ``(e, 2)``."""
    lengths: _Floats = lengths_of(points.take(edges[:, 0], 0) - points.take(edges[:, 1], 0))
    return lengths


def lengths_of(vectors: _Floats) -> _Floats:
    """Return the lengths ``(n,)`` of vectors ``(n, 3)``; NumPy's norm reduces row by row."""
    x, y, z = vectors.T
    lengths: _Floats = np.sqrt(x * x + y * y + z * z)
    return lengths
