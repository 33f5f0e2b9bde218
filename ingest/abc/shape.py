"""Rows of curves, coedges, corners, patches and parts of a published model."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from breplake.ingest.abc.facts import Stats
from breplake.ingest.abc.features import Features
from breplake.ingest.abc.geometry import ExactGeometry
from breplake.ingest.abc.measure import Masses, arc_lengths, masses
from breplake.ingest.abc.topology import Use, loops, parts_of_patches, uses
from breplake.ingest.mesh import Mesh
from breplake.ingest.sharpness import Dihedral, classify, dihedrals
from breplake.ingest.truth import Truth

__all__ = ["Shape", "shape"]

Row = dict[str, Any]
_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]
_Bools = npt.NDArray[np.bool_]

_ELEMENTARY: Final = ("Plane", "Cylinder", "Cone", "Sphere", "Torus")
"""Types of patches whose areas are integrated to nearly all digits."""


@dataclass(frozen=True, slots=True)
class Shape:
    """Rows without model_id, as ``ingest.brep.Brep`` has them of a CAD file, and their sums.

    The sums are the stated ones where these are right, to the last bit.
    """

    parts: list[Row]
    patches: list[Row]
    curves: list[Row]
    coedges: list[Row]
    corners: list[Row]
    area: float
    volume: float | None


def shape(
    features: Features,
    mesh: Mesh,
    geometry: ExactGeometry,
    truth: Truth,
    flipped: _Bools,
    stats: Stats,
    *,
    is_exact: bool,
) -> Shape:
    """Derive all rows from the features and their mesh.

    Coedges, loops, kinds of curves and parts are read off the mesh, areas and volumes are
    integrated over the exact surfaces. Tolerances are what the stats of exact files state;
    otherwise the greatest distance between curves, patches and vertices that the mesh shows.

    Parameters
    ----------
    features : Features
        Geometry, and which curves are sharp.
    mesh, truth
        The mesh, with its normals.
    geometry : ExactGeometry
        Of the features.
    flipped : numpy.ndarray
        ``(p,)`` bool, patches that face against du x dv.
    stats : Stats
        What is stated of masses and tolerances.
    is_exact : bool
        Whether the OBJ has all digits, as only exports of a lake do.
    """
    used = uses(mesh)
    found = masses(mesh, geometry, used, len(features.patches))
    gaps = _Gaps.of(features, mesh, geometry, truth)
    tolerance = stats.tolerance(float(np.linalg.norm(np.ptp(mesh.points, axis=0))))
    if is_exact and tolerance is not None:
        gaps = gaps.all_of(tolerance)
    coedges = [
        {
            "patch_id": use.patch,
            "loop": loop,
            "place": place,
            "curve_id": use.curve,
            "reversed": use.reversed,
            "internal": False,
        }
        for use, loop, place in loops(mesh, used)
    ]
    n_loops = Counter(patch for patch, _ in {(row["patch_id"], row["loop"]) for row in coedges})
    parts, part_of, volume = _parts(features, mesh, used, found, stats)
    area, total = _areas(found, stats, [row["type"] for row in features.patches])
    patches = [
        row
        | {
            "patch_id": i,
            "part_id": int(part_of[i]),
            "reversed": bool(flipped[i]),
            "u_min": float(found.low[i, 0]),
            "u_max": float(found.high[i, 0]),
            "v_min": float(found.low[i, 1]),
            "v_max": float(found.high[i, 1]),
            "area": float(area[i]),
            "n_loops": n_loops[i],
            "tolerance": float(gaps.patch[i]),
        }
        for i, row in enumerate(features.patches)
    ]
    for part in parts:
        part["area"] = sum(row["area"] for row in patches if row["part_id"] == part["part_id"])
    curves = _curves(features, mesh, geometry, truth, used, gaps)
    return Shape(parts, patches, curves, coedges, _corner_rows(mesh, gaps), total, volume)


def _areas(found: Masses, stats: Stats, types: Sequence[str]) -> tuple[_Floats, float]:
    """Return the areas of all patches, mm^2, and their sum, which is the stated one if it fits.

    What patches differ from it is put down to those that the mesh is too coarse to tell, or
    else to those whose integrals are the least certain.
    """
    exact, loose = float(found.area.sum()), found.loose
    total = stats.mass("surface", exact, float(found.area[loose].sum()))
    uncertain: _Bools = ~np.isin(types, _ELEMENTARY)
    blamed = next(some for some in (loose, uncertain, ~np.zeros_like(loose)) if some.any())
    share = float(found.area[blamed].sum())
    factor = 1.0 + (total - exact) / share if share else 1.0
    return np.where(blamed, found.area * factor, found.area), total


@dataclass(frozen=True, slots=True)
class _Gaps:
    """How far curves, patches and vertices are apart, mm: ``(p,)``, ``(c,)`` and by corner."""

    patch: _Floats
    curve: _Floats
    corner: _Floats

    @classmethod
    def of(cls, features: Features, mesh: Mesh, geometry: ExactGeometry, truth: Truth) -> _Gaps:
        """Measure them at the mesh vertices."""
        patch, curve = np.zeros(len(features.patches)), np.zeros(len(features.curves))
        corner = np.zeros(int(mesh.corner.max(initial=-1)) + 1)
        off = np.nan_to_num(truth.residual)  # NaN where there is no closed form
        np.maximum.at(patch, mesh.pair_patch, off)
        at_vertex = np.zeros(len(mesh.points))
        np.maximum.at(at_vertex, mesh.pair_vertex, off)
        for i, nodes in mesh.curves.items():
            away = geometry.curve_points(i, nodes.t) - mesh.points[nodes.vertices]
            distance = np.nan_to_num(np.linalg.norm(away, axis=1))
            curve[i] = max(distance.max(), at_vertex[nodes.vertices].max())
            np.maximum.at(corner, mesh.corner[nodes.vertices[[0, -1]]], distance[[0, -1]])
        return cls(patch, curve, corner)

    def all_of(self, tolerance: float) -> _Gaps:
        """Return as many with one value, mm."""
        sizes = (len(self.patch), len(self.curve), len(self.corner))
        return _Gaps(*(np.full(size, tolerance) for size in sizes))


def _corner_rows(mesh: Mesh, gaps: _Gaps) -> list[Row]:
    vertices = np.flatnonzero(mesh.corner >= 0)
    return [
        {
            "corner_id": int(mesh.corner[vertex]),
            "point": _xyz(mesh.points[vertex]),
            "tolerance": float(gaps.corner[mesh.corner[vertex]]),
        }
        for vertex in vertices[np.argsort(mesh.corner[vertices])]
    ]


def _xyz(point: _Floats) -> Row:
    return dict(zip("xyz", point.tolist(), strict=True))


def _curves(
    features: Features,
    mesh: Mesh,
    geometry: ExactGeometry,
    truth: Truth,
    used: Sequence[Use],
    gaps: _Gaps,
) -> list[Row]:
    of_curve: dict[int, list[Use]] = defaultdict(list)
    for use in used:
        of_curve[use.curve].append(use)
    angles = _angles(mesh, geometry, truth, of_curve)
    knots = [np.asarray(row.get("knots") or ()) for row in features.curves]
    lengths = arc_lengths(mesh, geometry, knots)
    rows = []
    for i, given in enumerate(features.curves):
        nodes = mesh.curves.get(i)
        row = given | {"curve_id": i, "tolerance": float(gaps.curve[i])}
        if nodes is not None:
            ends = mesh.corner[nodes.vertices[[0, -1]]].tolist()
            row |= {"start_corner": ends[0], "end_corner": ends[1]}
            row |= {"t_min": float(nodes.t[0]), "t_max": float(nodes.t[-1])}
            if np.isfinite(lengths[i]):
                row["length"] = float(lengths[i])
        rows.append(row | _role(nodes is None, of_curve[i], angles.get(i)))
    return rows


def _role(is_point: bool, mine: Sequence[Use], angle: Dihedral | None) -> Row:
    """Return what a curve is to its patches."""
    row: Row = {
        "left_patch": next((use.patch for use in mine if not use.reversed), None),
        "right_patch": next((use.patch for use in mine if use.reversed), None),
        "n_patches": len({use.patch for use in mine}),
    }
    if angle is not None:
        row["kind"] = classify(angle)
        if np.isfinite(angle.angle_min):
            row |= {"angle_min": angle.angle_min, "angle_max": angle.angle_max}
            # where the patches' orientations disagree, no side is the material's
            row["convexity"] = angle.convexity if mine[0].reversed != mine[1].reversed else None
    elif is_point:
        row["kind"] = "degenerate"
    else:
        row["kind"] = {0: "free", 1: "boundary", 2: "seam"}.get(len(mine), "nonmanifold")
    return row


def _angles(
    mesh: Mesh, geometry: ExactGeometry, truth: Truth, of_curve: dict[int, list[Use]]
) -> dict[int, Dihedral]:
    """Measure the angle between the two patches of curves at their mesh vertices."""
    creases = {
        curve: sorted(mine, key=lambda use: use.reversed)
        for curve, mine in of_curve.items()
        if len(mine) == 2 and mine[0].patch != mine[1].patch
    }
    if not creases:
        return {}
    samples = max(len(mesh.curves[curve].t) for curve in creases)
    sides = np.full((2, len(creases), samples, 3), np.nan)
    tangents = np.zeros((len(creases), samples, 3))
    for i, (curve, pair) in enumerate(creases.items()):
        nodes = mesh.curves[curve]
        inner = slice(1, -1) if len(nodes.t) > 2 else slice(None)
        vertices, t = nodes.vertices[inner], nodes.t[inner]
        for side, use in enumerate(pair):
            rows = mesh.pairs(np.full(len(t), use.patch), vertices)
            sides[side, i, : len(t)] = truth.normal[rows]
        tangents[i, : len(t)] = np.nan_to_num(geometry.curves.evaluate(curve, t).d1)
    return dict(zip(creases, dihedrals(sides[0], sides[1], tangents), strict=True))


def _parts(
    features: Features, mesh: Mesh, used: Sequence[Use], found: Masses, stats: Stats
) -> tuple[list[Row], _Ints, float | None]:
    """Return the parts, the part of each patch, and the volume of all solids."""
    owner = _owner(features, used, found)
    closed = _closed(owner, used)
    count = int(owner.max(initial=-1)) + 1
    solid = closed & (not stats.has_no_volume)
    area = np.bincount(owner, found.area, minlength=count)
    volume = np.bincount(owner, found.volume, minlength=count)
    solids = float(volume[solid].sum())
    coarse = float(np.abs(found.volume[found.loose]).sum())
    total = stats.mass("volume", solids, coarse) if solid.any() else None
    share = total / solids if total is not None and solids else 1.0
    rows = []
    for part in range(count):
        mine = owner == part
        mass, moment = area[part], found.first[mine].sum(axis=0)
        if solid[part] and volume[part]:
            mass, moment = volume[part], found.moment[mine].sum(axis=0)
        points = mesh.points[mesh.pair_vertex[mine[mesh.pair_patch]]]
        rows.append(
            {
                "part_id": part,
                "kind": "solid" if solid[part] else "shell" if mine.sum() > 1 else "face",
                "volume": float(volume[part] * share) if solid[part] else None,
                "centroid": _xyz(moment / mass if mass else points.mean(axis=0)),
                "bbox_min": _xyz(points.min(axis=0)),
                "bbox_max": _xyz(points.max(axis=0)),
                "is_closed": bool(closed[part]),
            }
        )
    return rows, owner, total


def _owner(features: Features, used: Sequence[Use], found: Masses) -> _Ints:
    """Return the part of each patch: the stated one, else that of all connected patches.

    A closed surface that faces inwards is a cavity of the one solid around it.
    """
    if features.patches and all("part_id" in row for row in features.patches):
        stated = np.array([row["part_id"] for row in features.patches])
        return np.unique(stated, return_inverse=True)[1]
    owner = parts_of_patches(len(features.patches), used)
    count = int(owner.max(initial=-1)) + 1
    volume = np.bincount(owner, found.volume, minlength=count)
    closed = _closed(owner, used)
    hollow = closed & (volume < 0)
    around = np.flatnonzero(closed & (volume > 0))
    if len(around) == 1:
        owner = np.where(hollow[owner], around[0], owner)
    return np.unique(owner, return_inverse=True)[1]


def _closed(owner: _Ints, used: Sequence[Use]) -> _Bools:
    """Return by part whether each of its curves is used an even number of times."""
    count = int(owner.max(initial=-1)) + 1
    times = Counter((int(owner[use.patch]), use.curve) for use in used)
    closed = np.ones(count, dtype=bool)
    seen = np.zeros(count, dtype=bool)
    for (part, _), number in times.items():
        closed[part] &= number % 2 == 0
        seen[part] = True
    return closed & seen
