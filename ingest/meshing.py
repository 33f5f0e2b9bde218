"""Make a mesh: Gmsh uniform or adaptive, or OCCT's tessellation."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from breplake.errors import InputError
from breplake.ingest.brep import Brep
from breplake.ingest.clock import KERNEL
from breplake.ingest.failure import advise
from breplake.ingest.kernel import GmshModel, groups
from breplake.ingest.mesh import CurveNodes, Mesh
from breplake.ingest.settings import Settings
from breplake.ingest.watch import watched

__all__ = ["SIZE", "gmsh_mesh"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

SIZE = 1 / 1.1
"""Element size asked of Gmsh, in limits. Gmsh's sizes are targets that a third of the edges
exceed; a little less leaves few edges to split afterwards (``bench/speed/mesh_size.py``)."""


def gmsh_mesh(
    model: GmshModel,
    limit: float,
    settings: Settings,
    kind: str,
    size: float = SIZE,
    hangs: Callable[[str], None] | None = None,
) -> Mesh:
    """Mesh a model with Gmsh (Frontal-Delaunay).

    Parameters
    ----------
    model : GmshModel
        The imported model.
    limit : float
        Edge length aimed at, mm.
    settings : Settings
        ``grading`` and ``per_turn`` shape the adaptive mesh.
    kind : {"uniform", "adaptive"}
        Uniform, or sized by curvature between the two bounds.
    size : float
        Element size to ask for, in limits.
    hangs : callable, optional
        Called from another thread, with the reason, if Gmsh will not come to an end.

    Raises
    ------
    InputError
        ``mesh-failed`` if Gmsh gives up on a patch, ``mesh-incomplete`` if it leaves one empty
        without a word. Patches of no area may stay empty.
    """
    gmsh = model.gmsh
    adaptive = kind == "adaptive"
    least = limit * settings.grading if adaptive else 0.0
    gmsh.option.setNumber("Mesh.MeshSizeMax", limit * size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", least)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", settings.per_turn if adaptive else 0)
    gmsh.logger.start()
    complaint: InputError | None = None
    try:
        with KERNEL(), watched(gmsh, hangs) if hangs else nullcontext():
            gmsh.model.mesh.generate(2)
    except Exception as error:  # gmsh raises plain Exception for everything
        errors = [line for line in gmsh.logger.get() if line.startswith("Error")]
        detail = f"{kind}: {error}; {' / '.join(errors[:3])}"
        complaint = InputError("mesh-failed", advise("mesh-failed", detail))
    finally:
        gmsh.logger.stop()
    try:
        return _Extract(model).mesh()
    except InputError as incomplete:
        raise complaint or incomplete from incomplete


class _Extract:
    """Turn Gmsh's nodes and elements into a `Mesh`, numbered by corner, curve, patch."""

    def __init__(self, model: GmshModel) -> None:
        self.brep: Brep = model.brep
        self.model = model
        self.api: Any = model.gmsh.model.mesh
        with KERNEL():
            tags, points, _ = self.api.getNodes()
        self.top = int(max(tags, default=0))
        self.points = np.empty((self.top + 1, 3))  # by node tag
        self.points[np.asarray(tags, dtype=np.int64)] = np.reshape(points, (-1, 3))

    def mesh(self) -> Mesh:
        triangles, patch = self._triangles()
        order = self._node_order(triangles)
        number = np.full(self.top + 1, -1, dtype=np.int64)
        number[order] = np.arange(len(order))
        corner = np.full(len(order), -1, dtype=np.int64)
        for corner_id, node in enumerate(self.corner_nodes):
            if node >= 0 and number[node] >= 0:
                corner[number[node]] = corner_id
        mesh = Mesh(
            self.points[order],
            number[triangles],
            patch,
            corner,
            self._curves(number),
            *self._pairs(number),
        )
        return self._completed(mesh).with_used_pairs()

    def _completed(self, mesh: Mesh) -> Mesh:
        """Add the parameters of vertices inside patches that Gmsh does not list there.

        They lie on curves that bound nothing. Gmsh projects them.
        """
        patch, vertex = mesh.unpaired()
        uv = np.empty((len(patch), 2))
        for patch_id, rows in groups(patch):
            points = mesh.points[vertex[rows]].ravel()
            with KERNEL():
                found = self.model.gmsh.model.getParametrization(2, patch_id + 1, points)
            uv[rows] = np.reshape(found, (-1, 2))
        return replace(
            mesh,
            pair_patch=np.concatenate([mesh.pair_patch, patch]),
            pair_vertex=np.concatenate([mesh.pair_vertex, vertex]),
            uv=np.concatenate([mesh.uv, uv]),
        )

    def _triangles(self) -> tuple[_Ints, _Ints]:
        blocks, owners = [], []
        for patch_id, row in enumerate(self.brep.patches):
            with KERNEL():
                types, _, nodes = self.api.getElements(2, patch_id + 1)
            if list(types) != [2] or not len(nodes[0]):
                self.brep.require_no_area(row)
                continue
            block = np.asarray(nodes[0], dtype=np.int64).reshape(-1, 3)
            blocks.append(block)
            owners.append(np.full(len(block), patch_id, dtype=np.int64))
        if not blocks:
            raise InputError("mesh-incomplete", advise("mesh-incomplete", "there is no triangle"))
        return np.concatenate(blocks), np.concatenate(owners)

    def _node_order(self, triangles: _Ints) -> _Ints:
        """Return the used node tags: corners by id, then along curves, then in patches."""
        used = np.zeros(self.top + 1, dtype=bool)
        used[triangles] = True
        self.corner_nodes: list[int] = []
        parts: list[_Ints] = []
        for corner_id in range(len(self.brep.vertices)):
            with KERNEL():
                tags = self.api.getNodes(0, corner_id + 1)[0]
            self.corner_nodes.append(int(tags[0]) if len(tags) else -1)
        parts.append(np.array([n for n in self.corner_nodes if n >= 0], dtype=np.int64))
        self.curve_data: dict[int, tuple[_Ints, _Floats]] = {}
        for curve_id in self.model.curve_ids:
            with KERNEL():
                tags, _, t = self.api.getNodes(1, self.model.curve_tag[curve_id])
            tags, t = np.asarray(tags, dtype=np.int64), np.asarray(t, dtype=np.float64)
            along = np.argsort(t, kind="stable")
            self.curve_data[curve_id] = tags[along], t[along]
            parts.append(tags[along])
        for patch_id in range(len(self.brep.faces)):
            with KERNEL():
                tags = self.api.getNodes(2, patch_id + 1)[0]
            parts.append(np.sort(np.asarray(tags, dtype=np.int64)))
        order = np.concatenate(parts)
        return order[used[order]]

    def _curves(self, number: _Ints) -> dict[int, CurveNodes]:
        """Return the vertices of the curves that bound a patch, degenerate ones aside."""
        curves = {}
        for curve_id, (tags, t) in self.curve_data.items():
            row = self.brep.curves[curve_id]
            if row["kind"] in ("degenerate", "free"):
                continue
            ends = [
                self.corner_nodes[row[key]] if row[key] is not None else -1
                for key in ("start_corner", "end_corner")
            ]
            there = np.array([ends[0] >= 0, *[True] * len(tags), ends[1] >= 0])
            vertices = number[np.concatenate([ends[:1], tags, ends[1:]])[there]]
            values = np.concatenate([[row["t_min"]], t, [row["t_max"]]])[there]
            if (vertices >= 0).all():
                curves[curve_id] = CurveNodes(vertices, values)
        return curves

    def _pairs(self, number: _Ints) -> tuple[_Ints, _Ints, _Floats]:
        """Return patch, vertex and parameters of what Gmsh lists in each patch, in order."""
        patches, vertices, parameters = [], [], []
        for patch_id in range(len(self.brep.faces)):
            with KERNEL():
                tags, _, uv = self.api.getNodes(2, patch_id + 1, includeBoundary=True)
            # Seam and corner nodes come more than once; the first is as good as the others.
            unique, first = np.unique(number[np.asarray(tags, dtype=np.int64)], return_index=True)
            unique, first = unique[unique >= 0], first[unique >= 0]  # those of some triangle
            patches.append(np.full(len(unique), patch_id, dtype=np.int64))
            vertices.append(unique)
            parameters.append(np.reshape(uv, (-1, 2))[first])
        return np.concatenate(patches), np.concatenate(vertices), np.concatenate(parameters)
