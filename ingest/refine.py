"""Split mesh edges until none is longer than the limit, on the exact geometry.

Gmsh treats the element size as a target. What exceeds the limit is bisected: the new vertex
lies on the B-Rep curve if the edge does, otherwise on the patch, and the triangles on both
sides are divided alike, so that the mesh stays conforming. The longest edge of a triangle is
always split first (Rivara's rule), which keeps small angles from arising.
"""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from breplake.ingest.brep import Brep
from breplake.ingest.mesh import CurveNodes, Mesh, edge_lengths, lengths_of, unique_edges
from breplake.schema.jets import SurfaceJet
from breplake.schema.projection import project_points

__all__ = ["Geometry", "Periods", "refine", "surface_periods"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]
_Bools = npt.NDArray[np.bool_]

_DIGITS: Final = 9
"""Decimals to which lengths are compared."""

_ROUNDS: Final = 30
"""Each round halves the longest edges, so thirty reach any limit above rounding."""


class Geometry(Protocol):
    """Exact geometry by our ids (``ingest.kernel.GmshModel``)."""

    def jet(self, patch_ids: _Ints, u: _Floats, v: _Floats) -> SurfaceJet:
        """Evaluate surfaces."""
        ...

    def curve_points(self, curve_id: int, t: _Floats) -> _Floats:
        """Evaluate a curve."""
        ...


class Periods:
    """Parameter periods and bounds of the patches of a model.

    Parameters
    ----------
    period : numpy.ndarray
        ``(n, 2)`` period in u and v; infinite where the surface is open.
    bounds : numpy.ndarray
        ``(n, 4)`` least and greatest u, least and greatest v that make sense on the surface;
        infinite where it is periodic or unbounded.
    """

    def __init__(self, period: _Floats, bounds: _Floats) -> None:
        self.period = period
        self.bounds = bounds

    def inside(self, patch: _Ints, uv: _Floats) -> _Floats:
        """Return `uv` within the bounds: by whole periods where closed, else the nearest."""
        bounds = self.bounds[patch]
        low, high = bounds[:, 0::2], bounds[:, 1::2]
        outside = (uv < low) | (uv > high)
        bounded = np.isfinite(low) & np.isfinite(high)
        middle = np.where(bounded, low, uv) / 2 + np.where(bounded, high, uv) / 2
        moved = np.where(outside, self.near(patch, uv, middle), uv)
        clipped: _Floats = np.clip(moved, low, high)
        return clipped

    def near(self, patch: _Ints, uv: _Floats, anchor: _Floats) -> _Floats:
        """Return `uv` moved by whole periods next to `anchor`; all ``(n, 2)``."""
        period = self.period[patch]
        finite = np.where(np.isfinite(period), period, 1.0)
        turns = np.where(np.isfinite(period), np.round((anchor - uv) / finite), 0.0)
        moved: _Floats = uv + turns * finite
        return moved


def surface_periods(brep: Brep) -> Periods:
    """Return the periods and bounds of a model's surfaces, from ``Geom_Surface``."""
    n = len(brep.surfaces)
    period, bounds = np.full((n, 2), np.inf), np.tile([-np.inf, np.inf] * 2, (n, 1))
    for i, surface in enumerate(brep.surfaces):
        limits = surface.Bounds()
        closed = (surface.IsUClosed(), surface.IsVClosed())
        periodic = (surface.IsUPeriodic(), surface.IsVPeriodic())
        for axis in (0, 1):
            low, high = limits[2 * axis : 2 * axis + 2]
            if closed[axis]:
                period[i, axis] = high - low
            if not periodic[axis]:
                bounds[i, 2 * axis : 2 * axis + 2] = low, high
    return Periods(period, bounds)


def refine(mesh: Mesh, geometry: Geometry, periods: Periods, limit: float, most: int) -> Mesh:
    """Return `mesh` with every edge at most `limit` long, as far as the geometry lets.

    Parameters
    ----------
    mesh : Mesh
        A conforming mesh.
    geometry : Geometry
        Where new vertices are placed.
    periods : Periods
        Of the model's patches.
    limit : float
        mm.
    most : int
        Stop before the mesh has more triangles than this.
    """
    frozen = np.empty(0, dtype=np.int64)  # edges whose middle is not where it should be
    for _ in range(_ROUNDS):
        edges, of_triangle, _ = unique_edges(mesh.triangles)
        # Rounded, so that equal edges stay equal: the last bit must not decide a mesh.
        lengths = np.round(edge_lengths(mesh.points, edges) / limit, _DIGITS)
        free = ~np.isin(_keys(edges), frozen)
        if not (free & (lengths > 1)).any():
            break
        split = _propagate(free & (lengths > 1), free, lengths, of_triangle)
        if len(mesh.triangles) + 2 * int(split.sum()) > most:
            break
        done = _Split(mesh, geometry, periods, edges, of_triangle, split)
        finer = done.mesh()
        astray = done.astray()
        if len(astray):
            frozen = np.concatenate([frozen, _keys(astray)])
        else:
            mesh = finer
    return mesh


def _keys(edges: _Ints) -> _Ints:
    """Return one number ``(e,)`` for each edge ``(e, 2)``, the same in every round."""
    keys: _Ints = edges[:, 0] << 32 | edges[:, 1]
    return keys


def _propagate(split: _Bools, free: _Bools, lengths: _Floats, of_triangle: _Ints) -> _Bools:
    """Add the longest free edge of every triangle that has an edge to split."""
    ranked = np.where(free, lengths, 0.0)[of_triangle]  # (f, 3)
    longest = of_triangle[np.arange(len(of_triangle)), ranked.argmax(axis=1)]
    while True:
        wanted = longest[split[of_triangle].any(axis=1)]
        if split[wanted].all():
            return split
        split = split.copy()
        split[wanted] = True


class _Split:
    """One round of bisection."""

    def __init__(
        self,
        mesh: Mesh,
        geometry: Geometry,
        periods: Periods,
        edges: _Ints,
        of_triangle: _Ints,
        split: _Bools,
    ) -> None:
        self.old, self.geometry, self.periods = mesh, geometry, periods
        self.of_triangle = of_triangle
        self.ends = edges[split]  # (s, 2)
        self.count = len(self.ends)
        self.fresh = np.full(len(edges), -1, dtype=np.int64)  # (e,) new vertex of each edge
        self.fresh[split] = len(mesh.points) + np.arange(self.count)
        self.index = np.full(len(edges), -1, dtype=np.int64)
        self.index[split] = np.arange(self.count)
        self.points = mesh.points[self.ends].mean(axis=1)  # (s, 3) until placed
        self.on_curve = np.full(self.count, -1, dtype=np.int64)
        self.curves: dict[int, CurveNodes] = {}

    def mesh(self) -> Mesh:
        self._place_on_curves()
        patch, fresh = self._new_pairs()
        uv = self._place_on_patches(patch, fresh)
        old = self.old
        pair_patch = np.concatenate([old.pair_patch, patch])
        pair_vertex = np.concatenate([old.pair_vertex, fresh + len(old.points)])
        order = np.lexsort([pair_vertex, pair_patch])
        triangles, owner = self._triangles()
        return Mesh(
            np.concatenate([old.points, self.points]),
            triangles,
            owner,
            np.concatenate([old.corner, np.full(self.count, -1, dtype=np.int64)]),
            self.curves,
            pair_patch[order],
            pair_vertex[order],
            np.concatenate([old.uv, uv])[order],
        )

    def astray(self) -> _Ints:
        """Return the edges ``(k, 2)`` whose new vertex is farther off than half of them.

        There the file's curve and surface disagree, and splitting would never end.
        """
        middle = self.old.points[self.ends].mean(axis=1)
        off = lengths_of(self.points - middle)
        length = edge_lengths(self.old.points, self.ends)
        found: _Ints = self.ends[~(off <= 0.5 * length)]
        return found

    def _place_on_curves(self) -> None:
        """Put the new vertices of curve segments on their curve, halfway in the parameter."""
        span = len(self.old.points)
        keys = self.ends[:, 0] * span + self.ends[:, 1]  # ascending
        for curve_id, nodes in self.old.curves.items():
            a, b = nodes.vertices[:-1], nodes.vertices[1:]
            wanted = np.minimum(a, b) * span + np.maximum(a, b)
            at = np.searchsorted(keys, wanted).clip(max=self.count - 1)
            # Two curves may share a short edge's ends; the first one owns its vertex.
            hit = np.flatnonzero((keys[at] == wanted) & (self.on_curve[at] < 0))
            if not len(hit):
                self.curves[curve_id] = nodes
                continue
            rows = at[hit]
            t = (nodes.t[hit] + nodes.t[hit + 1]) / 2
            self.on_curve[rows] = curve_id
            self.points[rows] = self.geometry.curve_points(curve_id, t)
            self.curves[curve_id] = CurveNodes(
                np.insert(nodes.vertices, hit + 1, rows + span), np.insert(nodes.t, hit + 1, t)
            )

    def _new_pairs(self) -> tuple[_Ints, _Ints]:
        """Return patch and index of every new vertex on every patch around it."""
        edge = self.index[self.of_triangle]  # (f, 3)
        owner = np.broadcast_to(self.old.patch[:, None], edge.shape)
        found = np.unique(owner[edge >= 0] * self.count + edge[edge >= 0])
        patch, fresh = np.divmod(found, self.count)
        return patch, fresh

    def _place_on_patches(self, patch: _Ints, fresh: _Ints) -> _Floats:
        """Return parameters ``(p, 2)`` of the pairs, and move inner vertices onto the patch."""
        start = self.periods.inside(patch, self._middle(patch, fresh))
        u, v, _ = project_points(
            self.geometry.jet,
            patch,
            self.points[fresh],
            start[:, 0],
            start[:, 1],
            self.periods.bounds[patch],
        )
        inner = self.on_curve[fresh] < 0
        self.points[fresh[inner]] = self.geometry.jet(patch[inner], u[inner], v[inner]).point
        return np.column_stack([u, v])

    def _middle(self, patch: _Ints, fresh: _Ints) -> _Floats:
        """Return the middle of both ends' parameters, across seams and beside poles."""
        a, b = (self.old.pairs(patch, self.ends[fresh, side]) for side in (0, 1))
        uv_a, uv_b = self.old.uv[a], self.periods.near(patch, self.old.uv[b], self.old.uv[a])
        jets = [self.geometry.jet(patch, uv[:, 0], uv[:, 1]) for uv in (uv_a, uv_b)]
        middle = (uv_a + uv_b) / 2
        for axis in (0, 1):
            # At a pole one parameter is arbitrary: only the other end knows the direction.
            for jet, other in zip(jets, (uv_b, uv_a), strict=True):
                derivative = jet.dv if axis else jet.du
                pole = lengths_of(derivative) <= jet.least[:, axis]
                middle[pole, axis] = other[pole, axis]
        return middle

    def _triangles(self) -> tuple[_Ints, _Ints]:
        """Divide the triangles: two, three or four for one, two or three split sides."""
        tri, side = self.old.triangles, self.fresh[self.of_triangle]  # (f, 3), (f, 3)
        n_split = (side >= 0).sum(axis=1)
        blocks, owners = [tri[n_split == 0]], [self.old.patch[n_split == 0]]
        points = np.concatenate([self.old.points, self.points])

        def emit(rows: _Ints, corners: list[_Ints]) -> None:
            blocks.append(np.stack(corners, axis=1))
            owners.append(self.old.patch[rows])

        for turn in range(3):
            # Rotate so that the pattern starts at corner 0: sides are (01), (12), (20).
            a, b, c = (tri[:, (turn + i) % 3] for i in range(3))
            ab, bc, ca = (side[:, (turn + i) % 3] for i in range(3))
            one = np.flatnonzero((n_split == 1) & (ab >= 0))
            emit(one, [a[one], ab[one], c[one]])
            emit(one, [ab[one], b[one], c[one]])
            two = np.flatnonzero((n_split == 2) & (ca < 0))
            emit(two, [ab[two], b[two], bc[two]])
            # The rest is a quadrilateral a, ab, bc, c: cut along its shorter diagonal.
            ratio = _lengths(points, a[two], bc[two]) / _lengths(points, ab[two], c[two])
            first = np.round(ratio, _DIGITS) <= 1
            x, y = two[first], two[~first]
            emit(x, [a[x], ab[x], bc[x]])
            emit(x, [a[x], bc[x], c[x]])
            emit(y, [a[y], ab[y], c[y]])
            emit(y, [ab[y], bc[y], c[y]])
        three = np.flatnonzero(n_split == 3)
        (a, b, c), (ab, bc, ca) = tri[three].T, side[three].T
        for corners in ([a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]):
            emit(three, corners)
        triangles, owner = np.concatenate(blocks), np.concatenate(owners)
        order = np.argsort(owner, kind="stable")
        return triangles[order], owner[order]


def _lengths(points: _Floats, a: _Ints, b: _Ints) -> _Floats:
    return lengths_of(points.take(a, 0) - points.take(b, 0))
