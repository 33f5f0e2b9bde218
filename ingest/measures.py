"""Facts about a whole model that follow from its rows: primitives, fingerprint."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from typing import Final

from breplake.ingest.geometry import Row

__all__ = ["duplicate_group", "fingerprint", "is_single_primitive"]

_STEP: Final = 5e-6
"""Relative width of the classes into which a fingerprint sorts lengths and areas."""


def is_single_primitive(parts: int, patches: Sequence[Row], corners: int, curves: int) -> bool:
    """Tell a box, cylinder, cone, sphere, torus or single plane from a real part.

    These are the models that the paper's filters drop (appendix, "Model Filtering").
    A patch may be split in halves, as some systems write full turns.
    """
    if parts != 1:
        return False
    types = Counter(row["type"] for row in patches)
    planes = types.pop("Plane", 0)
    if not types:
        return planes == 1 or (planes == 6 and corners == 8 and curves == 12)
    (kind, count), *others = types.items()
    most_planes = {"Cylinder": 2, "Cone": 2, "Sphere": 0, "Torus": 0}.get(kind, -1)
    return not others and count <= 2 and planes <= most_planes


def fingerprint(patches: Sequence[Row], curves: Sequence[Row], volume: float | None) -> str | None:
    """Hash what rigid motion and file formatting leave alone.

    Types and areas of patches, types and lengths of curves, and the volume, each rounded to
    five or six digits and sorted. Parts that differ in a dimension by more than that differ in
    their fingerprint; a value on the border of two classes can keep equal parts apart.

    Returns
    -------
    str or None
        32 hexadecimal digits; None without patches.
    """
    if not patches:
        return None
    words = sorted(f"{row['type']} {_class(row['area'])}" for row in patches)
    words += sorted(f"{row['type']} {_class(row['length'])}" for row in curves)
    words.append(f"volume {_class(volume)}")
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:32]


def _class(value: float | None) -> str:
    """Return the class of a measure on a logarithmic scale."""
    if value is None or not value:
        return "0"
    return str(round(math.log(abs(value)) / _STEP))


def duplicate_group(fingerprint: str | None, sha256: str) -> int:
    """Return the group of a model: equal for equal fingerprints, in every lake.

    A model without patches is alone with its exact copies.
    """
    digest = hashlib.sha256((fingerprint or sha256).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1
