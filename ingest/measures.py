"""Facts about a whole model that follow from its rows: primitives, duplicates."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence

from breplake.ingest.geometry import Row

__all__ = ["duplicate_group", "is_single_primitive"]


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


def duplicate_group(fingerprint: str | None, sha256: str) -> int:
    """Return the group of a model: equal for equal fingerprints, in every lake.

    A model without patches is alone with its exact copies.
    """
    digest = hashlib.sha256((fingerprint or sha256).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1
