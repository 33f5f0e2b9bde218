"""OCCT's own tessellation as a mesh: the rung below Gmsh."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from breplake.ingest.clock import KERNEL
from breplake.ingest.kernel import ClosedForm, GmshModel
from breplake.ingest.mesh import CurveNodes, Mesh

__all__ = ["tessellate"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]


_ANGLE: Final = math.radians(30)
"""Turn of the surface within a triangle. Less makes slivers on fillets, which stay."""


def tessellate(model: GmshModel | ClosedForm, limit: float) -> Mesh:
    """Mesh a model with ``BRepMesh_IncrementalMesh``, vertices moved onto the geometry.

    Parameters
    ----------
    model : GmshModel or ClosedForm
        The model, which evaluates the geometry.
    limit : float
        Edge length aimed at, mm; edges longer than that are left to ``ingest.refine``.

    Raises
    ------
    InputError
        ``mesh-incomplete`` if a patch that has area gets no triangles.
    """
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.BRepTools import BRepTools

    brep = model.brep
    BRepTools.Clean_s(brep.canonical.compound)
    with KERNEL():
        BRepMesh_IncrementalMesh(brep.canonical.compound, limit / 2, False, _ANGLE, False)
    return _Tessellation(model).mesh()


class _Tessellation:
    """Joins the faces' triangulations, which share nothing but their edges' polygons."""

    def __init__(self, model: GmshModel | ClosedForm) -> None:
        self.model, self.brep = model, model.brep
        self.points: list[_Floats] = []
        self.count = 0
        self.corner_vertex = np.full(len(self.brep.vertices), -1, dtype=np.int64)
        self.curves: dict[int, CurveNodes] = {}
        self.curves_of: dict[int, list[int]] = defaultdict(list)
        for use in self.brep.coedges:
            self.curves_of[use.patch_id].append(use.curve_id)

    def mesh(self) -> Mesh:
        ends = {r[k] for r in self.brep.curves for k in ("start_corner", "end_corner")}
        for corner_id, corner in enumerate(self.brep.corners):
            if corner_id in ends:
                point = np.array([[corner["point"][axis] for axis in "xyz"]])
                self.corner_vertex[corner_id] = self._add(point)[0]
        triangles, patches, pairs, uv = [], [], [], []
        for patch_id in range(len(self.brep.faces)):
            tri, vertices, parameters = self._patch(patch_id)
            triangles.append(tri)
            patches.append(np.full(len(tri), patch_id, dtype=np.int64))
            pairs.append(np.column_stack([np.full(len(vertices), patch_id), vertices]))
            uv.append(parameters)
        pair = np.concatenate(pairs)
        points = np.concatenate(self.points)
        on_corner = np.full(len(points), -1, dtype=np.int64)
        used = np.flatnonzero(self.corner_vertex >= 0)
        on_corner[self.corner_vertex[used]] = used
        mesh = Mesh(
            points,
            np.concatenate(triangles),
            np.concatenate(patches),
            on_corner,
            self.curves,
            pair[:, 0].astype(np.int64),
            pair[:, 1].astype(np.int64),
            np.concatenate(uv),
        )
        return _compact(mesh)

    def _add(self, points: _Floats) -> _Ints:
        self.points.append(points)
        self.count += len(points)
        return np.arange(self.count - len(points), self.count)

    def _patch(self, patch_id: int) -> tuple[_Ints, _Ints, _Floats]:
        """Return triangles by vertex id, and the patch's vertices with their parameters."""
        from OCP.BRep import BRep_Tool
        from OCP.TopLoc import TopLoc_Location

        face = self.brep.faces[patch_id]
        location = TopLoc_Location()
        data = BRep_Tool.Triangulation_s(face, location)
        if data is None or not data.NbTriangles():
            self.brep.require_no_area(self.brep.patches[patch_id])
            return np.empty((0, 3), np.int64), np.empty(0, np.int64), np.empty((0, 2))
        n = data.NbNodes()
        nodes = (data.UVNode(i + 1) for i in range(n))
        uv = np.array([(p.X(), p.Y()) for p in nodes])  # (n, 2)
        tri = np.array(
            [data.Triangle(i + 1).Get() for i in range(data.NbTriangles())], dtype=np.int64
        )
        vertex = np.full(n, -1, dtype=np.int64)
        for curve_id in self.curves_of[patch_id]:
            self._edge(curve_id, face, data, location, vertex)
        inner = np.flatnonzero(vertex < 0)
        owner = np.full(len(inner), patch_id, dtype=np.int64)
        vertex[inner] = self._add(self.model.points(owner, uv[inner, 0], uv[inner, 1]))
        mapped = vertex[tri - 1]
        # Nodes of a collapsed edge are one vertex, which leaves triangles without area.
        flat = (mapped == np.roll(mapped, 1, axis=1)).any(axis=1)
        unique, first = np.unique(vertex, return_index=True)
        return mapped[~flat], unique, uv[first]

    def _edge(self, curve_id: int, face: Any, data: Any, location: Any, vertex: _Ints) -> None:
        """Give the nodes of a curve in this triangulation their shared vertex ids."""
        from OCP.BRep import BRep_Tool

        row, edge = self.brep.curves[curve_id], self.brep.edges[curve_id]
        for oriented in (edge, edge.Reversed()):
            polygon = BRep_Tool.PolygonOnTriangulation_s(_edge(oriented), data, location)
            if polygon is None:
                continue
            nodes = np.array([polygon.Node(i + 1) for i in range(polygon.NbNodes())]) - 1
            if row["kind"] == "degenerate":
                vertex[nodes] = self.corner_vertex[row["start_corner"]]
                continue
            if curve_id not in self.curves:
                t = np.array([polygon.Parameter(i + 1) for i in range(len(nodes))])
                self.curves[curve_id] = self._curve(curve_id, t)
            vertex[nodes] = self.curves[curve_id].vertices

    def _curve(self, curve_id: int, t: _Floats) -> CurveNodes:
        row = self.brep.curves[curve_id]
        ends = [
            self._add(self.model.curve_points(curve_id, t[[i]]))[0]
            if row[key] is None
            else self.corner_vertex[row[key]]
            for i, key in ((0, "start_corner"), (-1, "end_corner"))
        ]
        inner = self._add(self.model.curve_points(curve_id, t[1:-1]))
        return CurveNodes(np.array([ends[0], *inner, ends[1]], dtype=np.int64), t)


def _edge(shape: Any) -> Any:
    from OCP.TopoDS import TopoDS

    return TopoDS.Edge_s(shape)


def _compact(mesh: Mesh) -> Mesh:
    """Drop vertices that no triangle uses and number the rest in the order of `Mesh`."""
    used = np.zeros(len(mesh.points), dtype=bool)
    used[mesh.triangles] = True
    curve = mesh.curve_of_vertex()
    rank = np.where(mesh.corner >= 0, 0, np.where(curve >= 0, 1, 2))
    order = np.lexsort([np.arange(len(rank)), np.where(rank == 1, curve, 0), rank])
    order = order[used[order]]
    number = np.full(len(mesh.points), -1, dtype=np.int64)
    number[order] = np.arange(len(order))
    curves = {
        i: CurveNodes(number[nodes.vertices], nodes.t)
        for i, nodes in mesh.curves.items()
        if used[nodes.vertices].all()
    }
    keep = used[mesh.pair_vertex]
    return Mesh(
        mesh.points[order],
        number[mesh.triangles],
        mesh.patch,
        mesh.corner[order],
        curves,
        mesh.pair_patch[keep],
        number[mesh.pair_vertex[keep]],
        mesh.uv[keep],
    ).with_used_pairs()
