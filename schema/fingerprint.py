"""Fingerprints of models: equal for copies, wherever they lie and however they were written.

A fingerprint has three parts, ``<form>-<hand>-<size>``: the form leaves out size and handedness,
so that scaled copies and mirror images are recognised as such without being taken for copies.
All parts come from the exact rows of a model (types, areas, lengths, places of corners and of
the middles of curves), by sums that need no order and no axes.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from breplake.schema import ragged
from breplake.schema.curves import CurveSet
from breplake.schema.namespace import Floats, Ints
from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES

__all__ = ["CELL", "Fingerprint", "fingerprint", "mirrored"]

CELL: Final = 1e-3
"""Width of the classes into which the sums fall. Copies differ by 1e-7 in their sums, so one pair
in some thousand falls on both sides of a border; a length that changes by a thousandth changes
the sums of the patches and curves about it by several thousandths."""

_SLIGHT: Final = 1e-6
"""Handedness below this is none: rounding makes 1e-9 of it in symmetric parts."""

_TINY_AREA, _TINY_LENGTH, _TINY_DISTANCE = 1e-7, 1e-6, 1e-3
"""Shares of the whole at which areas, lengths and distances begin to matter."""


class Fingerprint(NamedTuple):
    """The parts of a fingerprint.

    Parameters
    ----------
    form : str
        16 hexadecimal digits: the same for copies, scaled copies and mirror images.
    hand : str
        Two of ``+``, ``-`` and ``0``: both signs are opposite in a mirror image; ``00`` where
        the model is its own mirror image.
    size : int
        Class of the size.
    """

    form: str
    hand: str
    size: int

    def __str__(self) -> str:
        """Return the text that is stored."""
        return f"{self.form}-{self.hand}-{self.size}"

    @staticmethod
    def parse(text: str) -> Fingerprint:
        """Read the text back."""
        form, rest = text[:16], text[17:]
        return Fingerprint(form, rest[:2], int(rest[3:]))


def mirrored(hand: str) -> str:
    """Return the handedness of the mirror image."""
    return hand.translate(str.maketrans("+-", "-+"))


def fingerprint(
    patches: pa.Table, curves: pa.Table, coedges: pa.Table, corners: pa.Table, volume: float | None
) -> Fingerprint | None:
    """Return the fingerprint of a model from its rows; None without patches.

    Parameters
    ----------
    patches, curves, coedges, corners : pyarrow.Table
        The model's rows, in the order of their ids.
    volume : float or None
        Of all solids, mm^3.
    """
    if not patches.num_rows:
        return None
    area = np.abs(np.nan_to_num(ragged.scalars(patches, "area")))
    length = np.nan_to_num(ragged.scalars(curves, "length"))
    whole = float(area.sum()) or 1.0
    total = float(length.sum()) or 1.0
    kinds = ragged.codes(patches, "type", SURFACE_TYPES)
    curve_kinds = ragged.codes(curves, "type", CURVE_TYPES)
    places = _Places.of(curves, coedges, corners, length, patches.num_rows)
    sums = [
        *_sums(kinds, np.log(area / whole + _TINY_AREA)),
        *_sums(curve_kinds, np.log(length / total + _TINY_LENGTH)),
        *places.spread(),
        np.log(total / np.sqrt(whole)),
        0.0 if not volume else np.log(abs(volume) / whole**1.5),
    ]
    words = [
        str(sorted(Counter(kinds.tolist()).items())),
        str(sorted(Counter(curve_kinds.tolist()).items())),
        str(corners.num_rows),
        *(str(round(value / CELL)) for value in sums),
    ]
    form = hashlib.sha256(" ".join(words).encode()).hexdigest()[:16]
    return Fingerprint(form, places.hand(), round(float(np.log(whole) / CELL)))


def _sums(kinds: Ints, values: Floats) -> list[float]:
    """Return the sum of `values` for each kind, and one that tells kinds' roles apart."""
    found = [float(values[kinds == kind].sum()) for kind in np.unique(kinds)]
    # Squares part two features of one kind of which one grew as the other shrank.
    return [*found, float((values**2).sum())]


class _Places(NamedTuple):
    """Places that belong to a model, about their centre, in units of their spread.

    Parameters
    ----------
    points : numpy.ndarray
        ``(n, 3)`` corners and middles of curves.
    middles, tangents : numpy.ndarray
        ``(m, 3)`` of the curves, tangents unit.
    beside : numpy.ndarray
        ``(m, 3)`` sum of the centres of the patches at each curve.
    share : numpy.ndarray
        ``(m,)`` length of each curve, as a share of the sum.
    """

    points: Floats
    middles: Floats
    tangents: Floats
    beside: Floats
    share: Floats

    @staticmethod
    def of(
        curves: pa.Table, coedges: pa.Table, corners: pa.Table, length: Floats, n_patches: int
    ) -> _Places:
        """Evaluate the curves and centre everything."""
        every = CurveSet.from_curves(curves)
        rows = np.flatnonzero(every.known & (length > 0))
        middle = (ragged.scalars(curves, "t_min") + ragged.scalars(curves, "t_max"))[rows] / 2
        jet = every.evaluate(rows, middle)
        weight = length[rows]
        ends = ragged.vectors(corners, "point").T  # (k, 3) mm
        centre = _mean(jet.point, weight) if len(rows) else _mean(ends, np.ones(len(ends)))
        points = np.concatenate([ends, jet.point]) - centre
        spread = float(np.sqrt((points**2).sum(axis=1).mean())) if len(points) else 0.0
        unit = spread or 1.0
        speed = np.linalg.norm(jet.d1, axis=1, keepdims=True)
        middles = (jet.point - centre) / unit
        return _Places(
            points / unit,
            middles,
            jet.d1 / np.where(speed > 0, speed, 1.0),
            _beside(coedges, rows, middles, weight, n_patches),
            weight / (weight.sum() or 1.0),
        )

    def spread(self) -> list[float]:
        """Return sums of the distances from two centres."""
        found = []
        for centre in (np.zeros(3), self._second_centre()):
            distance = np.linalg.norm(self.points - centre, axis=1)
            found.append(float(np.log(distance + _TINY_DISTANCE).sum()))
        return found

    def _second_centre(self) -> Floats:
        """Return a centre that lies elsewhere unless the model's symmetry forbids it."""
        distance = np.linalg.norm(self.points, axis=1)
        return _mean(self.points, distance**2)

    def hand(self) -> str:
        """Return the signs of two numbers that change theirs under reflection.

        The first is the volume spanned by three moments of the places, nil in parts with any
        symmetry. The second adds up, curve by curve, how its tangent turns about the centre
        as seen from its patches; a propeller has it too.
        """
        radius = np.linalg.norm(self.points, axis=1, keepdims=True)
        moments = [(self.points * radius**power).mean(axis=0) for power in (1, 2, 4)]
        volume = float(np.linalg.det(np.stack(moments)))
        along = (self.tangents * self.middles).sum(axis=1)
        turn = (self.middles * np.cross(self.tangents, self.beside)).sum(axis=1)
        twist = float((self.share * along * turn).sum())
        return "".join("0" if abs(x) < _SLIGHT else "+" if x > 0 else "-" for x in (volume, twist))


def _mean(points: Floats, weight: Floats) -> Floats:
    total = weight.sum()
    if not total:
        return np.zeros(3)
    mean: Floats = (points * weight[:, None]).sum(axis=0) / total
    return mean


def _beside(
    coedges: pa.Table, rows: Ints, middles: Floats, weight: Floats, n_patches: int
) -> Floats:
    """Return for each curve of `rows` the sum of the centres of its patches, ``(m, 3)``."""
    if not len(rows):
        return np.zeros((0, 3))
    place = np.full(int(rows.max()) + 1, -1)
    place[rows] = np.arange(len(rows))
    curve, patch = ragged.integers(coedges, "curve_id"), ragged.integers(coedges, "patch_id")
    used = curve <= rows.max()
    curve, patch = place[curve[used]], patch[used]
    patch, curve = patch[curve >= 0], curve[curve >= 0]
    total = np.bincount(patch, weight[curve], minlength=n_patches)
    centres = (
        np.stack(
            [
                np.bincount(patch, weight[curve] * middles[curve, i], minlength=n_patches)
                for i in range(3)
            ],
            axis=1,
        )
        / np.where(total > 0, total, 1.0)[:, None]
    )  # (n_patches, 3)
    return np.stack(
        [np.bincount(curve, centres[patch, i], minlength=len(rows)) for i in range(3)], axis=1
    )
