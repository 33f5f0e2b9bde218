"""What is drawn of a model: its mesh with exact normals, patch colours and curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from breplake.errors import UsageError
from breplake.schema.types import SURFACE_TYPES

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["COLOURS", "Scene"]

COLOURS: Final = {
    "Plane": "#e1e4e8",
    "Cylinder": "#77aadd",
    "Cone": "#ee8866",
    "Sphere": "#ffaabb",
    "Torus": "#44bb99",
    "Revolution": "#eedd88",
    "Extrusion": "#99ddff",
    "BSpline": "#bbcc33",
    "Other": "#aa8f66",
}
"""Colour of each surface type: Paul Tol's light scheme, which the colour-blind can tell apart."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Scene:
    """A model as it is drawn.

    Parameters
    ----------
    title : str
        Its name.
    counts : dict
        Number of patches of each surface type it has.
    facts : str
        Its sizes in words.
    points : numpy.ndarray
        ``(n, 3)`` mm.
    normals : numpy.ndarray
        ``(m, 3)`` exact outward normals, NaN where undefined.
    triangles, triangle_normals : numpy.ndarray
        ``(f, 3)`` rows of `points` and of `normals`.
    patches, kinds : numpy.ndarray
        ``(f,)`` patch of each triangle, and place of its type in `SURFACE_TYPES`.
    strong, weak : numpy.ndarray
        ``(k, 2)`` segments of curves that are drawn dark, and of those drawn light.
    closed : bool
        No back of a triangle can be seen.
    """

    title: str
    counts: dict[str, int]
    facts: str
    points: Floats
    normals: Floats
    triangles: Ints
    triangle_normals: Ints
    patches: Ints
    kinds: Ints
    strong: Ints
    weak: Ints
    closed: bool

    @classmethod
    def of(cls, lake: Lake, model: str | int) -> Scene:
        """Read a model.

        Raises
        ------
        NameNotFoundError
            If the lake has no such model.
        UsageError
            If the model has no mesh.
        """
        row = lake.model(model)
        if not row["n_faces"]:
            raise UsageError(f"{row['name']} has no mesh, so there is nothing to draw")
        arrays = lake.arrays(row["shard"])
        starts = {"vertex": row["vertex_offset"], "normal": row["normal_offset"]}
        stops = {axis: start + row[f"n_{_PLURAL[axis]}"] for axis, start in starts.items()}
        face = row["face_offset"], row["face_offset"] + row["n_faces"]
        patches = lake.read("patches", row["model_id"])
        types = np.array([SURFACE_TYPES.index(t) for t in patches["type"].to_pylist()])
        counts = {t: int(np.count_nonzero(types == i)) for i, t in enumerate(SURFACE_TYPES)}
        patch = arrays.read("triangle_patch", *face).astype(np.int64)
        strong, weak = _segments(lake, row["model_id"])
        return cls(
            title=row["name"],
            counts={name: n for name, n in counts.items() if n},
            facts=_facts(row),
            points=arrays.read("position", starts["vertex"], stops["vertex"]).astype(np.float64),
            normals=arrays.read("normal", starts["normal"], stops["normal"]).astype(np.float64),
            triangles=arrays.read("triangle", *face).astype(np.int64),
            triangle_normals=arrays.read("triangle_normal", *face).astype(np.int64),
            patches=patch,
            kinds=types[patch],
            strong=strong,
            weak=weak,
            closed=bool(row["is_closed"] and row["is_watertight"]),
        )

    @property
    def corner_normals(self) -> Floats:
        """Normal at each corner, ``(f, 3, 3)``; where it is undefined, that of the triangle."""
        normals = self.normals[self.triangle_normals]
        missing = np.asarray(np.isnan(normals).any(axis=2))
        if missing.any():
            a, b, c = (self.points[self.triangles[:, i]] for i in range(3))
            flat = np.cross(b - a, c - a)
            flat /= np.maximum(np.linalg.norm(flat, axis=1), 1e-300)[:, None]
            normals = np.where(missing[:, :, None], flat[:, None, :], normals)
        return np.asarray(normals)


_PLURAL: Final = {"vertex": "vertices", "normal": "normals"}


def _segments(lake: Lake, model_id: int) -> tuple[Ints, Ints]:
    """Return the segments of sharp and open curves, and of the others, each ``(k, 2)``."""
    found: tuple[list[Ints], list[Ints]] = ([], [])
    curves = lake.read("curves", model_id).select(["kind", "sharp", "vert_indices"])
    for curve in curves.to_pylist():
        vertices = np.array(curve["vert_indices"] or [], dtype=np.int64)
        weak = curve["kind"] == "seam" or not (curve["sharp"] or curve["kind"] == "boundary")
        found[weak].append(np.stack([vertices[:-1], vertices[1:]], axis=1))
    nothing = np.empty((0, 2), dtype=np.int64)
    strong, weak_ones = (np.concatenate([nothing, *some]) for some in found)
    return strong, weak_ones


def _facts(row: dict[str, object]) -> str:
    def plural(count: object, word: str) -> str:
        many = word[:-1] + "ies" if word.endswith("y") else word + "s"
        return f"{count:,} {word if count == 1 else many}"

    return "  ·  ".join(
        [
            plural(row["n_patches"], "patch").replace("patchs", "patches"),
            f"{plural(row['n_curves'], 'curve')}, {row['n_sharp_curves']:,} sharp",
            plural(row["n_faces"], "triangle"),
            f"diagonal {row['diagonal']:,.4g} mm",
        ]
    )
