"""OBJ files with normals and curvatures, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from breplake.errors import InputError
from breplake.ingest.failure import advise

__all__ = ["Obj", "read_obj"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

_LEAST_DECIMALS: Final = 3
"""Fewer than this in every number are round numbers, not rounded ones."""


@dataclass(frozen=True, slots=True)
class Obj:
    """A triangle mesh with its own normals.

    Parameters
    ----------
    points : numpy.ndarray
        ``(n, 3)`` mm.
    normals : numpy.ndarray
        ``(m, 3)``; none if the file has none.
    curvatures : numpy.ndarray
        ``(m, 8)`` k_min, k_max, d_min, d_max of each normal; none if the file has none.
    triangles : numpy.ndarray
        ``(f, 3)`` points, from 0.
    triangle_normals : numpy.ndarray
        ``(f, 3)`` normals, from 0; -1 where the file has none.
    decimals : int, optional
        Digits to which all numbers are rounded; None if they are written exactly.
    """

    points: _Floats
    normals: _Floats
    curvatures: _Floats
    triangles: _Ints
    triangle_normals: _Ints
    decimals: int | None

    @property
    def rounding(self) -> float:
        """Half a unit of the last place of a number, 0 if they are written exactly."""
        return 0.0 if self.decimals is None else 0.5 * 10.0**-self.decimals


def read_obj(path: Path) -> Obj:
    """Read an OBJ file.

    Raises
    ------
    InputError
        ``bad-mesh`` if it is none, or holds other faces than triangles.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise _bad(f"{path.name} cannot be read ({error})") from error
    lines: dict[str, list[str]] = {"v": [], "vn": [], "vc": [], "f": []}
    for line in text.splitlines():
        keyword, _, rest = line.partition(" ")
        if keyword in lines:
            lines[keyword].append(rest)
    if not lines["v"] or not lines["f"]:
        raise _bad("it has no vertices or no triangles")
    points, normals = _numbers(lines["v"], 3, "v"), _numbers(lines["vn"], 3, "vn")
    curvatures = _numbers(lines["vc"], 8, "vc")
    if len(curvatures) not in (0, len(normals)):
        raise _bad(f"it has {len(normals)} normals but {len(curvatures)} curvatures")
    if not np.isfinite(points).all():
        raise _bad("it has vertices without a position")
    triangles, of_normal = _faces(lines["f"])
    for what, ids, count in (
        ("vertex", triangles, len(points)),
        ("normal", of_normal, len(normals)),
    ):
        least = 0 if what == "vertex" else -1
        if ids.min() < least or ids.max() >= count:
            raise _bad(f"a triangle refers to a {what} that is not there; there are {count}")
    decimals = _decimals([*lines["v"], *lines["vn"], *lines["vc"]])
    return Obj(points, normals, curvatures, triangles, of_normal, decimals)


def _bad(detail: str) -> InputError:
    return InputError("bad-mesh", advise("bad-mesh", detail))


def _numbers(lines: Sequence[str], width: int, keyword: str) -> _Floats:
    """Return numbers of lines as ``(n, width)``."""
    words = " ".join(lines).split()
    if len(words) != width * len(lines):
        raise _bad(f"not every line {keyword} has {width} numbers")
    try:
        return np.array(words, dtype=np.float64).reshape(-1, width)
    except ValueError as error:
        raise _bad(f"a line {keyword} holds what is no number ({error})") from error


def _faces(lines: Sequence[str]) -> tuple[_Ints, _Ints]:
    """Return vertices and normals ``(f, 3)`` of triangles ``v``, ``v//vn`` or ``v/vt/vn``."""
    words = " ".join(lines).split()
    if len(words) != 3 * len(lines):
        raise _bad("it has faces that are no triangles")
    parts = [word.split("/") for word in words]
    if len({len(part) for part in parts}) != 1 or len(parts[0]) not in (1, 2, 3):
        raise _bad("its faces are written in different ways")
    try:
        vertices = np.array([part[0] for part in parts], dtype=np.int64) - 1
        normals = np.full(len(parts), -1)
        if len(parts[0]) == 3:
            normals = np.array([part[2] for part in parts], dtype=np.int64) - 1
    except ValueError as error:
        raise _bad(f"a face holds what is no number ({error})") from error
    return vertices.reshape(-1, 3), normals.reshape(-1, 3)


def _decimals(lines: Sequence[str]) -> int | None:
    """Return how many decimals all numbers have; None if they differ, as in exact files."""
    counts = set()
    for word in " ".join(lines).split():
        fraction = word.partition(".")[2]
        if word.strip("+-").lower() == "nan":
            continue
        if not fraction.isdigit():
            return None
        counts.add(len(fraction))
        if len(counts) > 1:
            return None
    count = max(counts, default=0)
    return count if count >= _LEAST_DECIMALS else None
