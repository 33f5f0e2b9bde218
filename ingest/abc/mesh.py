"""The published mesh with its correspondence to curves and patches, put right."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from breplake.errors import InputError
from breplake.ingest.abc.features import Features
from breplake.ingest.abc.geometry import ExactGeometry
from breplake.ingest.abc.obj import Obj
from breplake.ingest.abc.repair import (
    Listed,
    Repairs,
    changed_parameters,
    is_same,
    listed,
    numbered,
    owners,
    scaled,
)
from breplake.ingest.failure import advise
from breplake.ingest.mesh import CurveNodes, Mesh

__all__ = ["build_mesh"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]
_Bools = npt.NDArray[np.bool_]

_BLOCK: Final = 512
"""Points whose distances to all vertices are taken at once."""


def build_mesh(
    features: Features, obj: Obj, geometry: ExactGeometry, repairs: Repairs
) -> tuple[Mesh, _Ints]:
    """Return the mesh of an OBJ with the parameters that its features give.

    Triangles keep their order unless patches are mixed; positions are those of the OBJ.

    Parameters
    ----------
    features, obj
        What the files say.
    geometry : ExactGeometry
        The curves and surfaces that `features` means, by their places in it.
    repairs : Counter
        Takes up what was wrong.

    Returns
    -------
    mesh : Mesh
        Vertices, triangles and parameters, in order of patches.
    normals : numpy.ndarray
        ``(m,)`` normal in the OBJ of each pair of patch and vertex, -1 for none.

    Raises
    ------
    InputError
        ``features-mismatch`` if the files do not speak of the same mesh.
    """
    patch = owners(features.on_patches, len(obj.triangles), repairs)
    order = np.argsort(patch, kind="stable")
    triangles, patch = obj.triangles[order], patch[order]
    pairs = np.unique(np.column_stack([np.repeat(patch, 3), triangles.ravel()]), axis=0)
    size = float(np.linalg.norm(np.ptp(obj.points, axis=0)))
    lists = listed(features.on_curves), listed(features.on_patches)
    matching = _Matching(geometry, obj.points, size, *lists)
    matching.match(repairs)
    uv = _PairParameters(matching, pairs).all(triangles, patch, repairs)
    curves = matching.curve_nodes(repairs)
    mesh = Mesh(
        points=obj.points,
        triangles=triangles,
        patch=patch,
        corner=_corners(curves, len(obj.points)),
        curves=curves,
        pair_patch=pairs[:, 0],
        pair_vertex=pairs[:, 1],
        uv=uv,
    )
    return _without_unused(mesh, repairs), _normals(mesh, obj, order, repairs)


def _normals(mesh: Mesh, obj: Obj, order: _Ints, repairs: Repairs) -> _Ints:
    """Return the normal in the OBJ of each pair; `order` is that of the triangles."""
    row = mesh.pairs(np.repeat(mesh.patch, 3), mesh.triangles.ravel())
    normals = np.full(len(mesh.uv), -1)
    normals[row[::-1]] = obj.triangle_normals[order].ravel()[::-1]  # the first one stays
    if unused := len(obj.normals) - len(np.unique(normals[normals >= 0])):
        repairs["unused-normals"] += unused
    return normals


class _Matching:
    """Which mesh vertex each entry of the features means, and with what parameter."""

    def __init__(
        self,
        geometry: ExactGeometry,
        points: _Floats,
        size: float,
        on_curves: Listed,
        on_patches: Listed,
    ) -> None:
        self.geometry, self.points, self.size = geometry, points, size
        self.on_curves, self.on_patches = on_curves, on_patches

    def match(self, repairs: Repairs) -> None:
        """Choose the numbering and the scales with which most entries are right."""
        best, chosen = -1, ""
        for code, vertices in numbered([self.on_curves, self.on_patches], len(self.points)):
            found = [
                scaled(part, vertex, self.points, self.size, evaluate)
                for part, vertex, evaluate in zip(
                    (self.on_curves, self.on_patches),
                    vertices,
                    (self._curve_points, self._surface_points),
                    strict=True,
                )
            ]
            right = [is_same(error, self.size) for _, _, error in found]
            total = sum(int(part.sum()) for part in right)
            if total > best:
                best, chosen = total, code
                self.curve_vertex, self.patch_vertex = vertices
                (t, self.curve_places, _), (self.uv, self.patch_places, _) = found
                self.t = t[:, 0]
                self.curve_right, self.patch_right = right
        if chosen:
            for part, vertex in zip(
                (self.on_curves, self.on_patches),
                (self.curve_vertex, self.patch_vertex),
                strict=True,
            ):
                _count(repairs, chosen, vertex != part.vertex)
        t, uv = self.on_curves.parameter, self.on_patches.parameter
        repairs.update(changed_parameters("curve-parameters", self.t[:, None], t))
        repairs.update(changed_parameters("patch-parameters", self.uv, uv))

    def _curve_points(self, owner: _Ints, t: _Floats) -> _Floats:
        return np.asarray(self.geometry.curves.evaluate(owner, t[:, 0]).point)

    def _surface_points(self, owner: _Ints, uv: _Floats) -> _Floats:
        return np.asarray(self.geometry.surfaces.evaluate(owner, uv[:, 0], uv[:, 1]).point)

    def curve_nodes(self, repairs: Repairs) -> dict[int, CurveNodes]:
        """Return the vertices along each curve that is longer than a point.

        Raises
        ------
        InputError
            ``features-mismatch`` if a curve has no vertex where it says.
        """
        owner, vertex = self.on_curves.owner, self.curve_vertex.copy()
        known = np.asarray(self.geometry.curves.known)[owner]
        wrong = np.flatnonzero(np.where(known, ~self.curve_right, vertex < 0))
        if len(wrong):
            near, distance = _nearest(self.curve_places[wrong], self.points)
            lost = ~is_same(distance, self.size)
            if lost.any():
                raise _mismatch(
                    f"curve {owner[wrong[lost][0]]} passes no vertex of the OBJ where it should"
                )
            vertex[wrong] = near
            repairs["missing-vertices"] += len(wrong)
        found = {}
        for curve in np.unique(owner):
            mine = np.flatnonzero(owner == curve)
            if len(np.unique(vertex[mine])) < 2:
                continue  # a degenerate curve, the pole of a sphere say
            mine = mine[np.argsort(self.t[mine], kind="stable")]
            if not (np.diff(self.t[mine]) > 0).all():
                raise _mismatch(f"curve {curve} has two vertices at one parameter")
            found[int(curve)] = CurveNodes(vertex[mine], self.t[mine])
        return found


class _PairParameters:
    """The parameters of each vertex on each of its patches."""

    def __init__(self, matching: _Matching, pairs: _Ints) -> None:
        self.matching, self.pairs = matching, pairs
        self.uv = np.full((len(pairs), 2), np.nan)

    @property
    def missing(self) -> _Bools:
        return np.asarray(np.isnan(self.uv).any(axis=1))

    def all(self, triangles: _Ints, patch: _Ints, repairs: Repairs) -> _Floats:
        """Return the parameters ``(m, 2)`` of each pair of patch and vertex."""
        known = self.matching
        owner, vertex = known.on_patches.owner, known.patch_vertex
        # a patch without closed form cannot tell right from wrong
        blind = ~np.asarray(known.geometry.surfaces.known)[owner] & (vertex >= 0)
        right = known.patch_right | blind
        row = _find(self.pairs, np.column_stack([owner, vertex]))
        _count(repairs, "foreign-vertices", right & (row < 0))
        use = np.flatnonzero(right & (row >= 0))[::-1]  # of entries that repeat, the first stays
        self.uv[row[use]] = known.uv[use]
        self._find_vertices(np.flatnonzero(~right), repairs)
        if self.missing.any():
            _count(repairs, "lost-parameters", self.missing)
            self._fill(triangles, patch)
        return self.uv

    def _find_vertices(self, wrong: _Ints, repairs: Repairs) -> None:
        """Give entries whose vertex is wrong to the vertex of their patch that is there."""
        known = self.matching
        owner = known.on_patches.owner[wrong]
        for patch in np.unique(owner):
            free = np.flatnonzero((self.pairs[:, 0] == patch) & self.missing)
            rows = wrong[owner == patch]
            near, distance = _nearest(known.patch_places[rows], known.points[self.pairs[free, 1]])
            found = is_same(distance, known.size)
            self.uv[free[near[found]]] = known.uv[rows[found]]
            _count(repairs, "missing-vertices", found)

    def _fill(self, triangles: _Ints, patch: _Ints) -> None:
        """Project vertices without parameters, from those of their neighbours on the patch."""
        known = self.matching
        sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
        owner = np.repeat(patch, 3)
        one, two = (_find(self.pairs, np.column_stack([owner, sides[:, i]])) for i in (0, 1))
        start, stop = np.concatenate([one, two]), np.concatenate([two, one])
        while True:
            missing = self.missing
            ready = np.flatnonzero(missing[stop] & ~missing[start])
            rows, first = np.unique(stop[ready], return_index=True)
            if not len(rows):
                break
            on, target = self.pairs[rows].T
            near = self.uv[start[ready[first]]]
            bounds = known.geometry.periods.bounds[on]
            u, v, away = known.geometry.surfaces.project(
                on, known.points[target], near[:, 0], near[:, 1], bounds
            )
            lost = ~is_same(away, known.size)
            if lost.any():
                raise _off(self.pairs[rows[lost][0]])
            self.uv[rows] = np.column_stack([u, v])
        if self.missing.any():
            raise _off(self.pairs[self.missing][0])


def _count(repairs: Repairs, code: str, where: _Bools) -> None:
    """Add how often a fault was repaired; a fault that there was not is not listed."""
    if number := int(where.sum()):
        repairs[code] += number


def _mismatch(detail: str) -> InputError:
    return InputError("features-mismatch", advise("features-mismatch", detail))


def _off(pair: _Ints) -> InputError:
    patch, vertex = pair
    return _mismatch(
        f"vertex {vertex} of the OBJ is not on surface {patch}, whose triangles use it"
    )


def _find(pairs: _Ints, wanted: _Ints) -> _Ints:
    """Return the row ``(k,)`` in ascending `pairs` of each of `wanted`; -1 where there is none."""
    span = int(max(pairs.max(initial=0), wanted.max(initial=0))) + 1
    keys, asked = pairs[:, 0] * span + pairs[:, 1], wanted[:, 0] * span + wanted[:, 1]
    row = np.searchsorted(keys, asked).clip(max=len(keys) - 1)
    return np.where((keys[row] == asked) & (wanted[:, 1] >= 0), row, -1)


def _nearest(places: _Floats, points: _Floats) -> tuple[_Ints, _Floats]:
    """Return the nearest of `points` to each of `places`, and its distance; infinite if none."""
    near, away = np.zeros(len(places), dtype=np.int64), np.full(len(places), np.inf)
    for start in range(0, len(places) if len(points) else 0, _BLOCK):
        part = slice(start, start + _BLOCK)
        distance = np.linalg.norm(places[part, None] - points[None], axis=2)
        distance = np.nan_to_num(distance, nan=np.inf)
        near[part] = distance.argmin(axis=1)
        away[part] = distance.min(axis=1)
    return near, away


def _corners(curves: dict[int, CurveNodes], count: int) -> _Ints:
    """Return the corner ``(n,)`` of each vertex, -1 for none: curves end at corners."""
    ends = np.unique([nodes.vertices[i] for nodes in curves.values() for i in (0, -1)])
    corner = np.full(count, -1, dtype=np.int64)
    corner[ends.astype(np.int64)] = np.arange(len(ends))
    return corner


def _without_unused(mesh: Mesh, repairs: Repairs) -> Mesh:
    """Leave out vertices that no triangle has, and curves that then have none."""
    used = np.zeros(len(mesh.points), dtype=bool)
    used[mesh.triangles.ravel()] = True
    if used.all():
        return mesh
    _count(repairs, "unused-vertices", ~used)
    rank = np.cumsum(used) - 1
    curves = {
        curve: CurveNodes(rank[nodes.vertices], nodes.t)
        for curve, nodes in mesh.curves.items()
        if used[nodes.vertices].all()
    }
    return replace(
        mesh,
        points=mesh.points[used],
        triangles=rank[mesh.triangles],
        corner=_corners(curves, int(used.sum())),
        curves=curves,
        pair_vertex=rank[mesh.pair_vertex],
    )
