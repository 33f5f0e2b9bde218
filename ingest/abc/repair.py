"""Faults of published files that change numbers: which vertex is meant, which parameter."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
import numpy.typing as npt

from breplake.errors import InputError
from breplake.ingest.abc.features import Entry
from breplake.ingest.failure import advise

__all__ = [
    "REPAIRS",
    "Listed",
    "Repairs",
    "changed_parameters",
    "is_same",
    "listed",
    "numbered",
    "owners",
    "ranged",
    "scaled",
]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

Repairs = Counter[str]
"""How often each fault was repaired, by its code in `REPAIRS`."""

REPAIRS: Final[dict[str, str]] = {
    "one-based-vertices": "vertices were counted from 1 in the features",
    "one-based-faces": "triangles were counted from 1 in the features",
    "shifted-vertices": "vertices behind one that the OBJ leaves out were one too high",
    "missing-vertices": "vertices that the features call -1, or wrongly, were found by place",
    "foreign-vertices": "vertices listed for a patch that none of its triangles has",
    "curve-parameters": "parameters of curves were multiplied by 1000",
    "patch-parameters": "parameters of patches were multiplied by 1000",
    "lost-parameters": "parameters of patches were missing or wrong and were found by projection",
    "curvature-unit": "curvatures of the OBJ were per metre, while its lengths are millimetres",
    "curvature-side": "curvatures of the OBJ were not towards the normal",
    "normals": "normals of the OBJ were not those of the surface",
    "curvatures": "curvatures of the OBJ were not those of the surface",
    "unused-normals": "normals of the OBJ that no triangle uses",
    "unused-vertices": "vertices of the OBJ that no triangle uses",
    "stats-box": "bounding box in the stats was not that of the model",
    "stats-surface": "surface in the stats was not the area of the model",
    "stats-volume": "volume in the stats was not that of the model",
    "stats-length": "edge length in the stats was in metres",
    "stats-counts": "counts in the stats were not those of the files",
}
"""Stable, append-only codes of ``models.import_repairs``, with what was wrong."""

_THOUSAND: Final = 1e-3
"""The published files give all parameters as if they were metres to be made millimetres."""

_SAME: Final = 1e-4
"""Share of the model's size within which a vertex is the one that a parameter means. Mesh edges
are a hundred times as long; tolerances of CAD files are shorter."""


@dataclass(frozen=True, slots=True)
class Listed:
    """The mesh vertices of all curves, or of all patches, end to end.

    Parameters
    ----------
    owner : numpy.ndarray
        ``(n,)`` curve or patch.
    vertex : numpy.ndarray
        ``(n,)`` mesh vertex; -1 where it is not known.
    parameter : numpy.ndarray
        ``(n, 1)`` t or ``(n, 2)`` u and v.
    count : int
        Number of curves or patches.
    """

    owner: _Ints
    vertex: _Ints
    parameter: _Floats
    count: int

    @property
    def is_end(self) -> npt.NDArray[np.bool_]:
        """Whether an entry is the first or last one of its owner, ``(n,)``."""
        change = np.diff(self.owner, prepend=-1, append=self.count) != 0
        return np.asarray(change[:-1] | change[1:])


def listed(entries: Sequence[Entry]) -> Listed:
    """Join the entries of all curves, or of all patches."""
    owner = np.repeat(np.arange(len(entries)), [len(entry.vertices) for entry in entries])
    vertex = np.concatenate([np.empty(0, np.int64), *(entry.vertices for entry in entries)])
    widths = {entry.parameters.shape[1] for entry in entries if entry.parameters.ndim == 2}
    width = widths.pop() if widths else 1
    flat = (entry.parameters.reshape(-1, width) for entry in entries)
    parameter = np.concatenate([np.empty((0, width)), *flat])
    return Listed(owner, np.where(vertex < 0, -1, vertex), parameter, len(entries))


def owners(entries: Sequence[Entry], n_faces: int, repairs: Repairs) -> _Ints:
    """Return the patch ``(f,)`` of each triangle.

    Raises
    ------
    InputError
        ``features-mismatch`` unless each triangle is listed once.
    """
    faces = np.concatenate([np.empty(0, np.int64), *(entry.faces for entry in entries)])
    owner = np.repeat(np.arange(len(entries)), [len(entry.faces) for entry in entries])
    ordered = np.sort(faces)
    if len(faces) != n_faces or (np.diff(ordered) != 1).any():
        detail = f"face_indices do not hold each of the {n_faces} triangles of the OBJ once"
        raise InputError("features-mismatch", advise("features-mismatch", detail))
    first = int(ordered[0])
    if first == 1:
        repairs["one-based-faces"] += n_faces
    elif first != 0:
        detail = f"face_indices begin with {first}"
        raise InputError("features-mismatch", advise("features-mismatch", detail))
    patch = np.empty(n_faces, dtype=np.int64)
    patch[faces - first] = owner
    return patch


def numbered(lists: Sequence[Listed], n_vertices: int) -> list[tuple[str, list[_Ints]]]:
    """Return the ways in which the listed vertices may be meant, the plain one first.

    Returns
    -------
    list of (str, list of numpy.ndarray)
        Code of the fault, empty for none, and the vertices of each of the `lists`, -1 where
        there is no such vertex.
    """
    used = np.unique(np.concatenate([part.vertex for part in lists]))
    used = used[used >= 0]

    def within(vertex: _Ints) -> _Ints:
        return np.where((vertex >= 0) & (vertex < n_vertices), vertex, -1)

    ways = [("", [within(part.vertex) for part in lists])]
    if len(used) and used[0] >= 1:
        ways.append(("one-based-vertices", [within(part.vertex - 1) for part in lists]))
    if len(used) == n_vertices and used[-1] >= n_vertices:
        # the OBJ leaves some out: the n-th that is listed is the n-th there is
        ranked = [
            np.where(part.vertex < 0, -1, np.searchsorted(used, part.vertex)) for part in lists
        ]
        ways.append(("shifted-vertices", ranked))
    return ways


def scaled(
    part: Listed,
    vertex: _Ints,
    points: _Floats,
    size: float,
    evaluate: Callable[[_Ints, _Floats], _Floats],
) -> tuple[_Floats, _Floats, _Floats]:
    """Find which parameters were multiplied by 1000, owner by owner.

    Parameters
    ----------
    part : Listed
        Entries; the ends of curves are judged apart from what is between.
    vertex : numpy.ndarray
        ``(n,)`` the mesh vertices that are meant, -1 where unknown.
    points : numpy.ndarray
        ``(v, 3)`` mm, of mesh vertices.
    size : float
        Diagonal of the model, mm.
    evaluate : callable
        Takes owners ``(n,)`` and parameters ``(n, d)``, returns points ``(n, 3)``.

    Returns
    -------
    parameter : numpy.ndarray
        ``(n, d)`` put right.
    place : numpy.ndarray
        ``(n, 3)`` mm, the exact point there.
    error : numpy.ndarray
        ``(n,)`` mm to the vertex that is meant; infinite where that is unknown.
    """
    width = part.parameter.shape[1]
    groups, n_groups = part.owner, part.count
    if width == 1:
        groups, n_groups = 2 * part.owner + part.is_end, 2 * part.count
    known = vertex >= 0
    target = points[np.where(known, vertex, 0)]
    factors = np.array(list(product([1.0, _THOUSAND], repeat=width)))  # (k, d)
    scaled = part.parameter * factors[:, None]  # (k, n, d)
    places = np.stack([evaluate(part.owner, parameter) for parameter in scaled])
    errors = np.linalg.norm(places - target, axis=2)
    errors = np.where(known, np.nan_to_num(errors, nan=np.inf), np.inf)  # (k, n)
    # a wrong vertex or two must not decide; what is equally good stays as it is
    worth = np.minimum(errors, _SAME * size) + 1e-9 * size * (factors != 1).sum(axis=1)[:, None]
    best = _cheapest(worth, groups, n_groups)
    if width == 1:
        # a full turn times 1000 is a whole number of turns: only the ends tell them apart
        ends = np.take_along_axis(scaled[..., 0], best[None], axis=0)[0]
        low, high = _range(ends, part)
        worth += _SAME * size * ((scaled[..., 0] < low) | (scaled[..., 0] > high)) * ~part.is_end
        best = _cheapest(worth, groups, n_groups)
    rows = np.arange(len(vertex))
    return scaled[best, rows], places[best, rows], errors[best, rows]


def ranged(part: Listed, low: _Floats, high: _Floats) -> _Floats:
    """Find which parameters of curves were multiplied by 1000 from the ranges they must be in.

    Parameters
    ----------
    part : Listed
        Entries of curves.
    low, high : numpy.ndarray
        ``(c,)`` range of each curve; NaN where it has none.

    Returns
    -------
    numpy.ndarray
        ``(n, 1)`` put right.
    """
    groups = 2 * part.owner + part.is_end
    least, most = low[part.owner], high[part.owner]
    parameters = np.stack([part.parameter[:, 0], part.parameter[:, 0] * _THOUSAND])
    beyond = np.maximum(np.maximum(least - parameters, parameters - most), 0.0)
    width = np.where(most > least, most - least, 1.0)
    worth = np.nan_to_num(np.minimum(beyond / width, 1.0))
    worth[1] += 1e-9  # what is equally good stays as it is
    best = _cheapest(worth, groups, 2 * part.count)
    return np.asarray(np.take_along_axis(parameters, best[None], axis=0)[0][:, None])


def changed_parameters(code: str, after: _Floats, before: _Floats) -> Repairs:
    """Return how many rows of parameters were changed, under `code`; nothing if none was."""
    number = int((after != before).any(axis=1).sum())
    return Repairs({code: number} if number else {})


def _cheapest(worth: _Floats, groups: _Ints, n_groups: int) -> _Ints:
    """Return the row of `worth` ``(k, n)`` of least sum over each entry's group, ``(n,)``."""
    cost = np.stack([np.bincount(groups, row, minlength=n_groups) for row in worth])
    return np.asarray(cost.argmin(axis=0)[groups])


def _range(t: _Floats, part: Listed) -> tuple[_Floats, _Floats]:
    """Return least and greatest parameter of the ends of each entry's curve, ``(n,)``."""
    low, high = np.full(part.count, np.inf), np.full(part.count, -np.inf)
    np.minimum.at(low, part.owner[part.is_end], t[part.is_end])
    np.maximum.at(high, part.owner[part.is_end], t[part.is_end])
    return low[part.owner], high[part.owner]


def is_same(error: _Floats, size: float) -> npt.NDArray[np.bool_]:
    """Tell where a vertex is the one that its parameter means."""
    return np.asarray(error <= _SAME * size)
