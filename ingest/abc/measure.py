"""Exact areas and volumes of patches that are known by their triangles and curves.

A patch is its triangles, mapped into (u, v), and what lies between the chords and the curves of
its rim. Both are maps of the unit square, over which Gauss quadrature integrates on the exact
surface, halving squares until it is sure. The error is thus not that of the chords.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

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

_WIDE: Final = 0.3
"""A side of a triangle that covers this share of a period may go round the other way."""

_LOOSE: Final = 0.5
"""A patch whose flat triangles lack this share of its area, or have as much too much, is meshed
too coarsely to tell how it lies in (u, v)."""

_POLE: Final = 1e-6
"""Share of the greatest length of a derivative on a patch at which one vanishes."""


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
    corners, flat = _Corners.of(mesh, geometry), _flat(mesh, n_patches)
    curved = np.asarray(geometry.surfaces.known) & ~geometry.is_plane
    total = np.where(curved[:, None], 0.0, flat)
    # the parameters of a patch may turn either way, while its triangles face outwards
    side = np.sign(np.bincount(corners.patch, corners.turn, minlength=n_patches))
    signs = np.column_stack([*[side] * 4, np.ones((n_patches, 4))])
    inner, rim = np.flatnonzero(curved[corners.patch]), _Rim.of(corners, geometry, mesh, used)
    enough = _NEGLIGIBLE * flat[:, 0]
    total += signs * _integral(corners, geometry, inner, enough)
    total += signs * _integral(rim, geometry, np.arange(len(rim.patch)), enough)
    loose = curved & ~(np.abs(total[:, 0] - flat[:, 0]) <= _LOOSE * total[:, 0])
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
class _Corners:
    """Triangles in the parameters of their patches.

    A corner at a pole, where one parameter is any, is the last one of its triangle.

    Parameters
    ----------
    patch : numpy.ndarray
        ``(f,)``.
    vertex : numpy.ndarray
        ``(f, 3)`` mesh vertices.
    uv : numpy.ndarray
        ``(f, 3, 2)``, across seams too.
    free : numpy.ndarray
        ``(f, 2)`` bool: u or v of the last corner may be any.
    """

    patch: _Ints
    vertex: _Ints
    uv: _Floats
    free: _Bools

    @classmethod
    def of(cls, mesh: Mesh, geometry: ExactGeometry) -> _Corners:
        jet = geometry.jet(mesh.pair_patch, *mesh.uv.T)
        speed = np.column_stack([np.linalg.norm(jet.du, axis=1), np.linalg.norm(jet.dv, axis=1)])
        usual = np.zeros((int(mesh.pair_patch.max()) + 1, 2))
        np.maximum.at(usual, mesh.pair_patch, np.nan_to_num(speed))
        pole = speed <= _POLE * usual[mesh.pair_patch]  # (m, 2)
        patch = mesh.patch
        pair = mesh.pairs(np.repeat(patch, 3), mesh.triangles.ravel()).reshape(-1, 3)
        first = (pole[pair].any(axis=2).argmax(axis=1) + 1) % 3  # the corner after the pole
        first[~pole[pair].any(axis=(1, 2))] = 0
        turned = (first[:, None] + np.arange(3)) % 3
        pair = np.take_along_axis(pair, turned, axis=1)
        uv = mesh.uv[pair]  # (f, 3, 2)
        periods = geometry.periods
        for corner in (1, 2):
            uv[:, corner] = periods.near(patch, uv[:, corner], uv[:, 0])
        # a closed surface that is not periodic ends at its bounds: on which side, all corners say
        middle = uv.mean(axis=1)
        uv += (periods.inside(patch, middle) - middle)[:, None]
        free = pole[pair[:, 2]]
        found = cls(patch, mesh.pair_vertex[pair], uv, free)
        found._unfold(np.asarray(periods.period[patch]))
        return found

    def _unfold(self, period: _Floats) -> None:
        """Take sides that cover much of a period the way round that suits the patch.

        All triangles of a patch turn the same way in (u, v); of those ways, the shortest.
        """
        last = np.where(self.free, self.uv[:, 1], self.uv[:, 2])
        sides = np.stack([self.uv[:, 1] - self.uv[:, 0], last - self.uv[:, 1]], axis=1)
        wide: _Bools = np.any(np.abs(sides) >= _WIDE * period[:, None], axis=1)  # (f, 2)
        votes = np.bincount(self.patch, np.where(wide.any(axis=1), 0.0, self.turn))
        for axis in (0, 1):
            rows = np.flatnonzero(wide[:, axis])
            best = np.full(len(rows), np.inf)
            chosen = self.uv[rows].copy()
            for one, two in product((0, -1, 1), repeat=2):
                uv = self.uv[rows].copy()
                uv[:, 1, axis] += one * period[rows, axis]
                uv[:, 2, axis] += two * period[rows, axis]
                free = self.free[rows]
                turn = _turn(uv, free) * np.sign(votes[self.patch[rows]])
                end = np.where(free[:, axis], uv[:, 1, axis], uv[:, 2, axis])
                first, second = uv[:, 0, axis], uv[:, 1, axis]
                length = (second - first) ** 2 + (end - second) ** 2 + (first - end) ** 2
                better = (turn > 0) & (length < best * (1 - 1e-9))
                chosen[better], best[better] = uv[better], length[better]
            self.uv[rows] = chosen

    def ranges(
        self, geometry: ExactGeometry, seams: _Floats, n_patches: int
    ) -> tuple[_Floats, _Floats]:
        """Return least and greatest parameters of patches, ``(p, 2)`` each.

        Around a period a patch begins at its seam ``(p, 2)`` or, where that is NaN, behind the
        widest gap between its triangles.
        """
        low, high = np.full((n_patches, 2), np.inf), np.full((n_patches, 2), -np.inf)
        for patch in np.unique(self.patch):
            uv = self.uv[self.patch == patch].copy()  # (f, 3, 2)
            for axis in (0, 1):
                period = geometry.periods.period[patch, axis]
                if np.isfinite(period):
                    middle = uv[:, :, axis].mean(axis=1)
                    start = seams[patch, axis]
                    start = _behind_gap(middle, period) if np.isnan(start) else start
                    turns = np.floor((middle - start) / period)
                    uv[:, :, axis] -= (turns * period)[:, None]
            low[patch], high[patch] = uv.min(axis=(0, 1)), uv.max(axis=(0, 1))
        return low, high

    @property
    def turn(self) -> _Floats:
        """Twice the area of each triangle in (u, v), negative if clockwise, ``(f,)``."""
        return _turn(self.uv, self.free)

    def at(self, row: _Ints, s: _Floats, t: _Floats) -> tuple[_Floats, _Floats]:
        """Map s along the first side and t from there to the last corner; see `_Maps`."""
        one, two, last = (self.uv[row, i] for i in range(3))
        free, s, t = self.free[row], s[:, None], t[:, None]
        base = two - one
        at_base = one + s * base
        to_last = np.where(free, at_base, last) - at_base
        along = base * np.where(free, 1.0, 1 - t)
        return at_base + t * to_last, _cross(along, to_last)


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
    def of(
        cls, corners: _Corners, geometry: ExactGeometry, mesh: Mesh, used: Iterable[Use]
    ) -> _Rim:
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
                    if (off <= _POLE * period).all():
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
        return chord + t[:, None] * away, -_cross(along, away)


def _turn(uv: _Floats, free: _Bools) -> _Floats:
    """Return twice the area of triangles ``(f, 3, 2)``; of free corners, the square's."""
    base = uv[:, 1] - uv[:, 0]
    to_last = np.where(free, 0.0, uv[:, 2] - uv[:, 0])
    return _cross(base, to_last)


def _behind_gap(values: _Floats, period: float) -> float:
    """Return the first of values around a period behind their widest gap, less half of it."""
    ordered = np.unique(np.mod(values, period))
    gaps = np.diff(ordered, prepend=ordered[-1] - period)
    widest = int(gaps.argmax())
    return float(ordered[widest] - gaps[widest] / 2)


def _sides(
    corners: _Corners, patch: _Ints, start: _Ints, stop: _Ints, n_vertices: int
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


def _cross(a: _Floats, b: _Floats) -> _Floats:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


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
