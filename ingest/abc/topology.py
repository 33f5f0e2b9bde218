"""How curves bound patches, read off the mesh: uses of curves, loops, parts.

Original files say which triangles a patch has and which vertices a curve has. A curve bounds a
patch where its vertices are joined by sides of the patch's triangles; the loop runs on where
the fan of triangles around the curve's end ends.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from breplake.ingest.mesh import Mesh

__all__ = ["Use", "loops", "parts_of_patches", "uses"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Use:
    """A use of a curve by a patch.

    Parameters
    ----------
    patch, curve : int
        Their ids.
    reversed : bool
        The patch, seen from outside, lies to the right of the curve.
    """

    patch: int
    curve: int
    reversed: bool


def uses(mesh: Mesh) -> list[Use]:
    """Return the uses of all curves, by patch, curve and direction.

    A curve is used where most of its segments are sides of triangles of the patch: both ways on
    a seam, and on a curve that lies inside a patch.
    """
    owner, start, stop = _segments(mesh)
    triangles, count = mesh.triangles, len(mesh.points)
    side_from, side_to = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    patch = np.repeat(mesh.patch, 3)
    keys = side_from * count + side_to  # a directed side may be of several patches
    order = np.argsort(keys, kind="stable")
    keys, patch = keys[order], patch[order]
    n_segments = np.bincount(owner, minlength=int(owner.max(initial=-1)) + 1)
    found = []
    for backward in (False, True):
        wanted = stop * count + start if backward else start * count + stop
        low, high = np.searchsorted(keys, wanted), np.searchsorted(keys, wanted, side="right")
        hits = np.repeat(np.arange(len(wanted)), high - low)
        place = np.arange(len(hits)) - np.repeat(np.cumsum(high - low) - (high - low), high - low)
        pairs = np.column_stack([patch[low[hits] + place], owner[hits]])
        used, times = np.unique(pairs, axis=0, return_counts=True)
        most = 2 * times > n_segments[used[:, 1]]
        found += [Use(int(p), int(c), backward) for p, c in used[most]]
    return sorted(found, key=lambda use: (use.patch, use.curve, use.reversed))


def _segments(mesh: Mesh) -> tuple[_Ints, _Ints, _Ints]:
    """Return curve, first and last vertex of all segments of curves, each ``(s,)``."""
    empty = np.empty(0, dtype=np.int64)
    curves = mesh.curves.items()
    return (
        np.concatenate([empty, *(np.full(len(n.t) - 1, curve) for curve, n in curves)]),
        np.concatenate([empty, *(nodes.vertices[:-1] for _, nodes in curves)]),
        np.concatenate([empty, *(nodes.vertices[1:] for _, nodes in curves)]),
    )


def loops(mesh: Mesh, used: Iterable[Use]) -> list[tuple[Use, int, int]]:
    """Return each use with its loop and its place in it, the widest loop of a patch first.

    Sorted by patch, loop and place.
    """
    by_patch: dict[int, list[Use]] = defaultdict(list)
    for use in used:
        by_patch[use.patch].append(use)
    fans = _fans(mesh)
    found = []
    for _, mine in sorted(by_patch.items()):
        rings = _rings(mesh, mine, fans)
        rings.sort(key=lambda ring: -_extent(mesh, ring))
        for loop, ring in enumerate(rings):
            found += [(use, loop, place) for place, use in enumerate(ring)]
    return found


def _path(mesh: Mesh, use: Use) -> _Ints:
    """Return the vertices of a use, in its direction."""
    vertices = mesh.curves[use.curve].vertices
    return vertices[::-1] if use.reversed else vertices


def _extent(mesh: Mesh, ring: list[Use]) -> float:
    points = np.concatenate([mesh.points[_path(mesh, use)] for use in ring])
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _fans(mesh: Mesh) -> dict[tuple[int, int, int], int]:
    """Return the third vertex of triangles at corners by patch and directed side from or to one."""
    at_corner = (mesh.corner >= 0)[mesh.triangles].any(axis=1)
    fans: dict[tuple[int, int, int], int] = {}
    for patch, (a, b, c) in zip(
        mesh.patch[at_corner].tolist(), mesh.triangles[at_corner].tolist(), strict=True
    ):
        fans |= {(patch, a, b): c, (patch, b, c): a, (patch, c, a): b}
    return fans


def _rings(
    mesh: Mesh, mine: list[Use], fans: Mapping[tuple[int, int, int], int]
) -> list[list[Use]]:
    """Chain the uses of one patch head to tail."""
    leaving = {tuple(_path(mesh, use)[:2].tolist()): use for use in mine}
    left = dict.fromkeys(mine)
    rings = []
    while left:
        use = next(iter(left))
        ring: list[Use] = []
        while use in left:
            del left[use]
            ring.append(use)
            follower = _follower(use.patch, _path(mesh, use), leaving, fans)
            if follower is None:
                break
            use = follower
        rings.append(ring)
    return rings


def _follower(
    patch: int,
    path: _Ints,
    leaving: Mapping[tuple[int, ...], Use],
    fans: Mapping[tuple[int, int, int], int],
) -> Use | None:
    """Turn around the end of a use, through triangles of the patch, to the next one."""
    before, end = path[-2:].tolist()
    seen: set[int] = set()
    while before not in seen:
        seen.add(before)
        ahead = fans.get((patch, before, end))
        if ahead is None:
            return None  # the mesh ends here without a curve
        if (end, ahead) in leaving:
            return leaving[end, ahead]
        before = ahead
    return None


def parts_of_patches(count: int, used: Iterable[Use]) -> _Ints:
    """Return the part ``(count,)`` of each patch: patches that curves connect are one."""
    parent = list(range(count))

    def root(patch: int) -> int:
        while parent[patch] != patch:
            parent[patch] = parent[parent[patch]]
            patch = parent[patch]
        return patch

    at_curve: dict[int, int] = {}
    for use in used:
        one, two = root(at_curve.setdefault(use.curve, use.patch)), root(use.patch)
        parent[max(one, two)] = min(one, two)
    roots = np.array([root(patch) for patch in range(count)], dtype=np.int64)
    return np.unique(roots, return_inverse=True)[1]
