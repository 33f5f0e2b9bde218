"""The mesh of a model as the published OBJ files hold it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

__all__ = ["obj_text"]

_Floats = npt.NDArray[np.float64]


def obj_text(vertices: pa.Table, faces: pa.Table, decimals: int | None = None) -> str:
    """Return a mesh with normals and curvatures as OBJ.

    Lines are ``v x y z`` by vertex_id; ``vn nx ny nz`` and ``vc k_min k_max d_min(3) d_max(3)``
    by normal_id, so that there are as many of both; ``f v//vn v//vn v//vn`` by face_id, counted
    from 1. Lengths are mm, curvatures 1/mm towards the normal; what is not defined is ``nan``.

    Parameters
    ----------
    vertices, faces : pyarrow.Table
        One model's rows of those tables, in order of their ids.
    decimals : int, optional
        Digits after the point; 6 are what the published files have. By default as many as it
        takes to read every number back exactly.
    """
    position = _columns(vertices, "x", "y", "z")
    by_vertex = np.empty((_count(vertices), 3))
    by_vertex[vertices.column("vertex_id").to_numpy()] = position
    curvature = np.column_stack(
        [_columns(vertices, "k_min", "k_max"), *(_vectors(vertices, n) for n in ("d_min", "d_max"))]
    )  # (m, 8)
    corners = np.stack(
        [_columns(faces, *(f"{kind}{i}" for i in range(3))) for kind in "vn"], axis=2
    )  # (f, 3, 2)
    return "".join(
        [
            *_lines("v", by_vertex, decimals),
            *_lines("vn", _columns(vertices, "nx", "ny", "nz"), decimals),
            *_lines("vc", curvature, decimals),
            *map("f %d//%d %d//%d %d//%d\n".__mod__, _tuples(corners.reshape(-1, 6) + 1)),
        ]
    )


def _count(vertices: pa.Table) -> int:
    ids = vertices.column("vertex_id").to_numpy()
    return int(ids.max(initial=-1)) + 1


def _columns(table: pa.Table, *names: str) -> npt.NDArray[Any]:
    """Return columns side by side; a null is NaN."""
    return np.column_stack([table.column(name).to_numpy() for name in names])


def _vectors(table: pa.Table, name: str) -> _Floats:
    """Return a column of vectors as ``(n, 3)``, NaN where null."""
    array = table.column(name).combine_chunks()
    flat = [leaf.to_numpy(zero_copy_only=False) for leaf in array.flatten()]
    return np.column_stack(flat).astype(np.float64)


def _lines(keyword: str, values: _Floats, decimals: int | None) -> Iterable[str]:
    number = " %r" if decimals is None else f" %.{decimals}f"
    return map((keyword + number * values.shape[1] + "\n").__mod__, _tuples(values))


def _tuples(values: npt.NDArray[Any]) -> Iterable[tuple[Any, ...]]:
    return map(tuple, values.tolist())
