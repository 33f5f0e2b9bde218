"""Locations (``TopLoc_Location``) as powers of numbered motions."""

from __future__ import annotations

from typing import Any, TypeAlias

from breplake.ingest.lossless.handles import Handles

__all__ = ["Placement", "motion_row", "placement"]

Placement: TypeAlias = tuple[tuple[int, int], ...]
"""Pairs of motion and power, the leftmost applied last; empty for no motion."""


def placement(location: Any, motions: Handles) -> Placement:
    """Return a location as powers of motions, adding new ones to `motions`."""
    items = []
    while not location.IsIdentity():
        # OCCT's list starts with what is applied first.
        items.append((motions.add(location.FirstDatum()), int(location.FirstPower())))
        location = location.NextLocation()
    return tuple(reversed(items))


def motion_row(datum: Any) -> dict[str, Any]:
    """Return a ``TopLoc_Datum3D`` as a row of ``motions``."""
    motion = datum.Trsf()
    matrix, shift = motion.HVectorialPart(), motion.TranslationPart()
    rows = [tuple(matrix.Value(i, j) for j in (1, 2, 3)) for i in (1, 2, 3)]
    return {
        "form": str(motion.Form().name).removeprefix("gp_"),
        "scale": motion.ScaleFactor(),
        **dict(zip(("row_x", "row_y", "row_z"), rows, strict=True)),
        "translation": (shift.X(), shift.Y(), shift.Z()),
    }
