"""The figures of a model as the published stats files hold them, computed from its rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from breplake.schema.abc import CURVE_KEYS, SURFACE_KEYS

__all__ = ["stats"]


def stats(
    model: Mapping[str, Any], curves: pa.Table, patches: pa.Table, vertices: pa.Table
) -> dict[str, Any]:
    """Return the content of a stats file.

    Parameters
    ----------
    model : mapping
        The row in ``models``.
    curves, patches, vertices : pyarrow.Table
        The model's rows of those tables, in order of their ids.

    Returns
    -------
    dict
        Counts of the B-Rep: ``#parts``, ``#surfs``, ``#edges``, ``#points`` (corners),
        ``#sharp`` (sharp curves); of the mesh: ``#verts``, ``#norms``, ``#faces``.
        ``surfs`` and ``curves``: types by id. ``bbox``: lower corner, upper corner, extents,
        mm; ``diag``: its diagonal, mm. ``surface`` and ``volume``: exact area, mm^2, and
        volume, mm^3, null without a solid. ``max_length``: edge length that was asked of the
        mesh, mm. ``tolerance``: greatest tolerance of the patches, mm. ``mean_curv`` and
        ``gaus_curv``: means over all normals of the mesh of (k_min + k_max) / 2, 1/mm, and of
        k_min k_max, 1/mm^2, null where there are none. ``model``: path of the source.
    """
    low, high = ([model[key][axis] for axis in "xyz"] for key in ("bbox_min", "bbox_max"))
    least, most = (vertices.column(name).to_numpy() for name in ("k_min", "k_max"))
    defined = np.isfinite(least) & np.isfinite(most)
    least, most = least[defined], most[defined]
    tolerance = patches.column("tolerance").to_numpy()
    facts = dict(model["metadata"] or {})
    return {
        "#parts": model["n_parts"],
        "#surfs": model["n_patches"],
        "#edges": model["n_curves"],
        "#points": model["n_corners"],
        "#sharp": model["n_sharp_curves"],
        "#verts": model["n_vertices"] or 0,
        "#norms": model["n_normals"] or 0,
        "#faces": model["n_faces"] or 0,
        "bbox": [*low, *high, *(b - a for a, b in zip(low, high, strict=True))],
        "diag": model["diagonal"],
        "surface": model["area"],
        "volume": model["volume"],
        "max_length": model["mesh_limit"],
        "tolerance": float(tolerance.max()) if len(tolerance) else 0.0,
        "mean_curv": float(np.mean(least + most) / 2) if len(least) else None,
        "gaus_curv": float(np.mean(least * most)) if len(least) else None,
        "surfs": [t if t in SURFACE_KEYS else "Other" for t in patches.column("type").to_pylist()],
        "curves": [t if t in CURVE_KEYS else "Other" for t in curves.column("type").to_pylist()],
        "model": facts.get("model", model["path"]),
    }
