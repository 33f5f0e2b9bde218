"""Exact areas and volumes of patches that are known by their triangles and curves.

A patch is its triangles, mapped into (u, v), and what lies between the chords and the curves of
its rim. Both are maps of the unit square, over which Gauss quadrature integrates on the exact
surface, halving squares until it is sure. The error is thus not that of the chords.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from breplake.ingest.abc.corners import Corners, cross
from breplake.ingest.abc.geometry import ExactGeometry
from breplake.ingest.abc.topology import Use
from breplake.ingest.mesh import Mesh

__all__ = ["Masses", "arc_lengths", "masses"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]
_Bools = npt.NDArray[np.bool_]


def _rule(points: int) -> tuple[_Floats, _Floats]:
    """Return places and weights on [0, 1] that integrate degree ``2 points - 1`` exactly."""
    places, weights = np.polynomial.legendre.leggauss(points)
    return (places + 1) / 2, weights / 2


_FINE, _COARSE = _rule(4), _rule(3)
_LINE, _COARSE_LINE = _rule(8), _rule(5)

_SURE: Final = 1e-7
"""Relative difference of two rules at which the finer one is sure of much more."""

_NEGLIGIBLE: Final = 1e-10
"""Share of a patch's area that does not matter in a triangle or on a piece of its rim."""

_HALVINGS: Final = 3
"""Across a knot, where a second derivative jumps, each gains a digit."""

_BLOCK: Final = 8_192
"""Squares that are integrated together."""

_COLUMNS: Final = 8
"""Integrals: of 1, x, y, z over the area, of 1, x, y, z over the volume."""

_LOOSE: Final = 0.5
"""A patch whose flat triangles lack this share of its area, or have as much too much, is meshed
too coarsely to tell how it lies in (u, v)."""

_FOLDED: Final = 1e-3
"""So is one of whose triangles this share, by area in (u, v), turn the other way."""

_SEAM: Final = 1e-6
"""Share of a period within which a parameter is constant."""


@dataclass(frozen=True, slots=True)
class Masses:
    """Integrals over patches, each ``(p,)`` or ``(p, 3)``.

    Parameters
    ----------
    area : numpy.ndarray
        mm^2.
    first : numpy.ndarray
        ``(p, 3)`` integral of the position over the patch, mm^3.
    volume : numpy.ndarray
        The patch's share of the volume that a closed surface encloses, mm^3: a third of the
        integral of position times outward normal.
    moment : numpy.ndarray
        ``(p, 3)`` its share of the volume's integral of the position, mm^4.
    low, high : numpy.ndarray
        ``(p, 2)`` range of u and v of its triangles.
    loose : numpy.ndarray
        ``(p,)`` bool: flat triangles stand in for the patch.
    """

    area: _Floats
    first: _Floats
    volume: _Floats
    moment: _Floats
    low: _Floats
    high: _Floats
    loose: _Bools


def masses(mesh: Mesh, geometry: ExactGeometry, used: Iterable[Use], n_patches: int) -> Masses:
    """Integrate over all patches.

    Parameters
    ----------
    mesh : Mesh
        Triangles, counter-clockwise seen from outside, with parameters.
    geometry : ExactGeometry
        What is integrated over; patches without closed form count by their flat triangles.
    used : iterable of Use
        The uses of curves by patches.
    n_patches : int
        Number of patches.
    """
    corners, flat = Corners.of(mesh, geometry), _flat(mesh, n_patches)
    curved = np.asarray(geometry.surfaces.known) & ~geometry.is_plane
    total = np.where(curved[:, None], 0.0, flat)
    # the parameters of a patch may turn either way, while its triangles face outwards
    side = np.sign(np.bincount(corners.patch, corners.turn, minlength=n_patches))
    signs = np.column_stack([*[side] * 4, np.ones((n_patches, 4))])
    inner, rim = np.flatnonzero(curved[corners.patch]), _Rim.of(corners, geometry, mesh, used)
    enough = _NEGLIGIBLE * flat[:, 0]
    total += signs * _integral(corners, geometry, inner, enough)
    total += signs * _integral(rim, geometry, np.arange(len(rim.patch)), enough)
    loose = ~(np.abs(total[:, 0] - flat[:, 0]) <= _LOOSE * total[:, 0])
    loose = curved & (loose | (corners.folded(n_patches) > _FOLDED))
    total = np.where(loose[:, None], flat, total)
    low, high = corners.ranges(geometry, rim.seams(), n_patches)
    return Masses(
        *(total[:, 0], total[:, 1:4], total[:, 4], total[:, 5:8]), low=low, high=high, loose=loose
    )


class _Maps(Protocol):
    """Maps of the unit square into the parameters of patches, one in each row."""

    @property
    def patch(self) -> _Ints:
        """Patch of each row."""
        ...

    def at(self, row: _Ints, s: _Floats, t: _Floats) -> tuple[_Floats, _Floats]:
        """Return (u, v) ``(n, 2)`` and by how much the map stretches areas there ``(n,)``."""
        ...


def _integral(maps: _Maps, geometry: ExactGeometry, rows: _Ints, enough: _Floats) -> _Floats:
    """Return the integrals over patches, ``(p, 8)``, halving squares until two rules agree.

    By `enough` ``(p,)`` mm^2 they may differ in any case.
    """
    n_patches = len(enough)
    total = np.zeros((n_patches, _COLUMNS))
    low, width = np.zeros((len(rows), 2)), 1.0
    for halving in range(_HALVINGS + 1):
        again: list[_Ints] = []
        for start in range(0, len(rows), _BLOCK):
            part = slice(start, start + _BLOCK)
            row, corner = rows[part], low[part]
            fine = _square(maps, geometry, row, corner, width, _FINE)
            rough = np.abs(fine - _square(maps, geometry, row, corner, width, _COARSE))[:, 0]
            sure = ~(rough > _SURE * np.abs(fine[:, 0]) + enough[maps.patch[row]])
            sure |= halving == _HALVINGS
            for column in range(_COLUMNS):
                total[:, column] += np.bincount(
                    maps.patch[row[sure]], fine[sure, column], minlength=n_patches
                )
            again.append(start + np.flatnonzero(~sure))
        rest = np.concatenate([np.empty(0, np.int64), *again])
        width /= 2
        quarters = width * np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        low = (low[rest, None] + quarters).reshape(-1, 2)
        rows = np.repeat(rows[rest], 4)
    return total


def _square(
    maps: _Maps,
    geometry: ExactGeometry,
    row: _Ints,
    low: _Floats,
    width: float,
    rule: tuple[_Floats, _Floats],
) -> _Floats:
    """Integrate over a square of each row by one rule, ``(n, 8)``."""
    total = np.zeros((len(row), _COLUMNS))
    for a, da in zip(*rule, strict=True):
        for b, db in zip(*rule, strict=True):
            uv, stretch = maps.at(row, low[:, 0] + a * width, low[:, 1] + b * width)
            weight = stretch * (da * db * width * width)
            total += _densities(geometry, maps.patch[row], uv) * weight[:, None]
    return total


@dataclass(frozen=True, slots=True)
class _Rim:
    """Segments of curves on patches, in the direction of the patch's loop.

    Parameters
    ----------
    patch, curve : numpy.ndarray
        ``(s,)``.
    t : numpy.ndarray
        ``(s, 2)`` first and last parameter on the curve.
    start, stop : numpy.ndarray
        ``(s, 2)`` ends on the patch.
    geometry : ExactGeometry
        Curves and surfaces.
    """

    patch: _Ints
    curve: _Ints
    t: _Floats
    start: _Floats
    stop: _Floats
    geometry: ExactGeometry

    @classmethod
    def of(cls, corners: Corners, geometry: ExactGeometry, mesh: Mesh, used: Iterable[Use]) -> _Rim:
        known = np.asarray(geometry.surfaces.known), np.asarray(geometry.curves.known)
        rows: list[tuple[_Ints, _Floats]] = []
        for use in used:
            if known[0][use.patch] and known[1][use.curve]:
                nodes = mesh.curves[use.curve]
                step = -1 if use.reversed else 1
                vertices, t = nodes.vertices[::step], nodes.t[::step]
                count = len(t) - 1
                owner = np.tile([use.patch, use.curve], (count, 1))
                segments = np.column_stack([owner, vertices[:-1], vertices[1:]])
                rows.append((segments, np.column_stack([t[:-1], t[1:]])))
        ids = np.concatenate([np.empty((0, 4), np.int64), *(row[0] for row in rows)])
        t = np.concatenate([np.empty((0, 2)), *(row[1] for row in rows)])
        face, side = _sides(corners, ids[:, 0], ids[:, 2], ids[:, 3], len(mesh.points))
        found = face >= 0  # a few segments of a curve may be no sides of triangles
        ids, t, face, side = ids[found], t[found], face[found], side[found]
        start, stop = corners.uv[face, side], corners.uv[face, (side + 1) % 3]
        free = corners.free[face]
        start = np.where(free & (side == 2)[:, None], stop, start)
        stop = np.where(free & (side == 1)[:, None], start, stop)
        return cls(ids[:, 0], ids[:, 1], t, start, stop, geometry)

    def seams(self) -> _Floats:
        """Return the constant u or v of a seam of each patch, ``(p, 2)``; NaN without one."""
        n_patches = len(self.geometry.is_plane)
        found = np.full((n_patches, 2), np.nan)
        keys, times = np.unique(
            np.column_stack([self.patch, self.curve]), axis=0, return_counts=True
        )
        segments = {(int(p), int(c)): int(n) for (p, c), n in zip(keys, times, strict=True)}
        for (patch, curve), count in segments.items():
            mine = np.flatnonzero((self.patch == patch) & (self.curve == curve))
            if count % 2 or len(np.unique(self.t[mine].mean(axis=1))) != count // 2:
                continue  # not run along both ways
            for axis in (0, 1):
                period = self.geometry.periods.period[patch, axis]
                if np.isfinite(period):
                    value = self.start[mine, axis]
                    off = np.abs(value - value[0] - period * np.round((value - value[0]) / period))
                    if (off <= _SEAM * period).all():
                        found[patch, axis] = value.min()
        return found

    def at(self, row: _Ints, s: _Floats, t: _Floats) -> tuple[_Floats, _Floats]:
        """Map s along the chord and t from there to the curve; see `_Maps`.

        The patch lies to the left of its rim, so what bulges to the right counts.
        """
        start, stop = self.start[row], self.stop[row]
        chord = start + s[:, None] * (stop - start)
        first, span = self.t[row, 0], self.t[row, 1] - self.t[row, 0]
        jet = self.geometry.curves.evaluate(self.curve[row], first + s * span)
        patch = self.patch[row]
        bounds = self.geometry.periods.bounds[patch]
        u, v, _ = self.geometry.surfaces.project(patch, jet.point, chord[:, 0], chord[:, 1], bounds)
        surface = self.geometry.jet(patch, u, v)
        slope = _components(surface.du, surface.dv, jet.d1 * span[:, None])
        away = np.column_stack([u, v]) - chord
        along = (1 - t)[:, None] * (stop - start) + t[:, None] * slope
        return chord + t[:, None] * away, -cross(along, away)


def _sides(
    corners: Corners, patch: _Ints, start: _Ints, stop: _Ints, n_vertices: int
) -> tuple[_Ints, _Ints]:
    """Return triangle and corner of directed sides of patches, -1 where there is none."""
    vertex = corners.vertex
    owner = np.repeat(corners.patch, 3)
    keys = (owner * n_vertices + vertex.ravel()) * n_vertices
    keys += np.roll(vertex, -1, axis=1).ravel()
    order = np.argsort(keys)
    wanted = (patch * n_vertices + start) * n_vertices + stop
    at = np.searchsorted(keys[order], wanted).clip(max=len(keys) - 1)
    face, side = np.divmod(order[at], 3)
    return np.where(keys[order[at]] == wanted, face, -1), side


def _components(du: _Floats, dv: _Floats, vector: _Floats) -> _Floats:
    """Return the components ``(n, 2)`` of tangent vectors along du and dv; 0 at poles."""
    a, b, c = (np.einsum("ij,ij->i", p, q) for p, q in ((du, du), (du, dv), (dv, dv)))
    x, y = (np.einsum("ij,ij->i", p, vector) for p in (du, dv))
    determinant = a * c - b * b
    safe = np.where(determinant > 0, determinant, np.inf)
    return np.column_stack([(c * x - b * y) / safe, (a * y - b * x) / safe])


def _densities(geometry: ExactGeometry, patch: _Ints, uv: _Floats) -> _Floats:
    """Return what is integrated over (u, v), ``(n, 8)``: see `Masses`."""
    jet = geometry.jet(patch, *uv.T)
    normal = np.cross(jet.du, jet.dv)
    size = np.linalg.norm(normal, axis=1)
    through = np.einsum("ij,ij->i", jet.point, normal)
    return np.column_stack(
        # the moment's divergence theorem: the field x p / 4 has the divergence x
        [size, jet.point * size[:, None], through / 3, jet.point * through[:, None] / 4]
    )


def _flat(mesh: Mesh, n_patches: int) -> _Floats:
    """Return the integrals over flat triangles, ``(p, 8)``."""
    a, b, c = (mesh.points[mesh.triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a) / 2
    middle, size = (a + b + c) / 3, np.linalg.norm(normal, axis=1)
    through = np.einsum("ij,ij->i", a, normal)
    values = np.column_stack(
        [size, middle * size[:, None], through / 3, middle * through[:, None] / 4]
    )
    return np.column_stack(
        [np.bincount(mesh.patch, values[:, i], minlength=n_patches) for i in range(8)]
    )


def arc_lengths(mesh: Mesh, geometry: ExactGeometry, knots: Sequence[_Floats]) -> _Floats:
    """Return the lengths ``(c,)`` of curves between their first and last vertex, mm.

    NaN for curves without vertices or without closed form.

    Parameters
    ----------
    mesh : Mesh
        With the vertices along each curve.
    geometry : ExactGeometry
        The curves.
    knots : sequence of numpy.ndarray
        By curve, where its derivatives may jump.
    """
    lengths = np.full(len(knots), np.nan)
    for curve, nodes in mesh.curves.items():
        inside = knots[curve]
        inside = inside[(inside > nodes.t[0]) & (inside < nodes.t[-1])]
        cuts = np.unique(np.concatenate([nodes.t, inside]))
        lengths[curve] = _length(geometry, curve, cuts[:-1], np.diff(cuts))
    return lengths


def _length(geometry: ExactGeometry, curve: int, start: _Floats, width: _Floats) -> float:
    """Return the length of pieces of a curve, mm, halving them until two rules agree."""
    total = 0.0
    for halving in range(_HALVINGS + 1):
        fine, rough = (
            _speeds(geometry, curve, start, width, places) @ weights * width
            for places, weights in (_LINE, _COARSE_LINE)
        )
        sure = ~(np.abs(fine - rough) > _SURE * fine) | (halving == _HALVINGS)
        total += float(fine[sure].sum())
        start, width = start[~sure], width[~sure] / 2
        start, width = np.concatenate([start, start + width]), np.tile(width, 2)
    return total


def _speeds(
    geometry: ExactGeometry, curve: int, start: _Floats, width: _Floats, places: _Floats
) -> _Floats:
    """Return the speed of a curve at places of pieces, ``(n, places)``."""
    t = start[:, None] + places * width[:, None]
    speed = np.linalg.norm(geometry.curves.evaluate(curve, t.ravel()).d1, axis=1)
    return np.asarray(speed.reshape(t.shape))
