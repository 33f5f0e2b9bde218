"""What the datasets return: named tuples of tensors, which say where they came from."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

__all__ = [
    "GraphSample",
    "GridSample",
    "LabelledMesh",
    "LocalPatch",
    "MeshSample",
    "PointCloudSample",
]


class MeshSample(NamedTuple):
    """The mesh of one model, with exact differential properties.

    A mesh vertex on a crease has a normal for each of its patches, so there are more normals
    than positions; `triangles` and `triangle_normals` tie them together.

    Parameters
    ----------
    positions : Tensor
        ``(n, 3)`` float32, mm.
    normals : Tensor
        ``(m, 3)`` float32, outward unit normals; NaN where undefined.
    curvatures : Tensor
        ``(m, 2)`` float32, k_min and k_max in 1/mm, positive towards the normal; NaN where
        undefined.
    normal_patch : Tensor
        ``(m,)`` int64, patch of each normal.
    triangles : Tensor
        ``(f, 3)`` int64, rows of `positions`, counter-clockwise seen from outside.
    triangle_normals : Tensor
        ``(f, 3)`` int64, rows of `normals`.
    triangle_patch : Tensor
        ``(f,)`` int64, patch of each triangle.
    features : Tensor
        ``(n,)`` uint8: 0 interior, 1 on a smooth curve, 2 on a sharp curve, 3 corner.
    model_id : int
        Id of the model.
    name : str
        Its name.
    snapshot : int
        Number of the lake's snapshot.
    """

    positions: Tensor
    normals: Tensor
    curvatures: Tensor
    normal_patch: Tensor
    triangles: Tensor
    triangle_normals: Tensor
    triangle_patch: Tensor
    features: Tensor
    model_id: int
    name: str
    snapshot: int


class PointCloudSample(NamedTuple):
    """Points of one model; PyTorch's default collation stacks them.

    Parameters
    ----------
    positions : Tensor
        ``(n, 3)`` float32, mm.
    normals : Tensor
        ``(n, 3)`` float32, outward unit normals on the point's patch.
    curvatures : Tensor
        ``(n, 2)`` float32, k_min and k_max in 1/mm; NaN where undefined.
    patches : Tensor
        ``(n,)`` int64, patch of each point.
    types : Tensor
        ``(n,)`` uint8, type of that patch: its place in
        `breplake.schema.types.SURFACE_TYPES`.
    features : Tensor
        ``(n,)`` uint8, as in `MeshSample`.
    model_id, name, snapshot
        As in `MeshSample`.
    """

    positions: Tensor
    normals: Tensor
    curvatures: Tensor
    patches: Tensor
    types: Tensor
    features: Tensor
    model_id: int
    name: str
    snapshot: int


class LabelledMesh(NamedTuple):
    """A mesh with labels for patch segmentation and for finding sharp features.

    Types are places in `breplake.schema.types.SURFACE_TYPES`. Sharp is what ABC's rule calls so
    (the column ``sharp`` of ``curves``).

    Parameters
    ----------
    positions, normals, triangles, triangle_normals, triangle_patch, normal_patch
        As in `MeshSample`.
    patch_types : Tensor
        ``(p,)`` uint8, type of each patch.
    normal_types : Tensor
        ``(m,)`` uint8, type of the patch of each normal.
    triangle_types : Tensor
        ``(f,)`` uint8, type of the patch of each triangle.
    sharp_edges : Tensor
        ``(e, 2)`` int64, rows of `positions`: mesh edges along sharp curves.
    sharp_vertices : Tensor
        ``(n,)`` bool, whether a vertex lies on a sharp curve.
    model_id, name, snapshot
        As in `MeshSample`.
    """

    positions: Tensor
    normals: Tensor
    triangles: Tensor
    triangle_normals: Tensor
    triangle_patch: Tensor
    normal_patch: Tensor
    patch_types: Tensor
    normal_types: Tensor
    triangle_types: Tensor
    sharp_edges: Tensor
    sharp_vertices: Tensor
    model_id: int
    name: str
    snapshot: int


class LocalPatch(NamedTuple):
    """A piece of a mesh of exactly `n` vertices, grown around one of them.

    Parameters
    ----------
    positions : Tensor
        ``(n, 3)`` float32, mm; the first one is where the piece was grown from.
    normals : Tensor
        ``(n, 3)`` float32, the unit mean of a vertex's outward normals on its patches, as the
        paper's benchmark takes it; NaN where no patch has one or where they cancel out.
    features : Tensor
        ``(n,)`` uint8, as in `MeshSample`.
    triangles : Tensor
        ``(f, 3)`` int64, rows of `positions`.
    vertices : Tensor
        ``(n,)`` int64, the vertices of the model's mesh.
    model_id, name, snapshot
        As in `MeshSample`.
    """

    positions: Tensor
    normals: Tensor
    features: Tensor
    triangles: Tensor
    vertices: Tensor
    model_id: int
    name: str
    snapshot: int


class GraphSample(NamedTuple):
    """The B-Rep of a model as a graph: patches are nodes, curves between two of them are edges.

    Parameters
    ----------
    x : Tensor
        ``(p, 14)`` float32, features of the patches; see `breplake.loaders.graphs.NODE_FEATURES`.
    edge_index : Tensor
        ``(2, e)`` int64, patches; each pair of neighbours comes both ways.
    edge_attr : Tensor
        ``(e, 14)`` float32, features of the curves; see `breplake.loaders.graphs.EDGE_FEATURES`.
    patch_types : Tensor
        ``(p,)`` uint8, place of the type in `breplake.schema.types.SURFACE_TYPES`.
    curves : Tensor
        ``(e,)`` int64, the curve of each edge.
    model_id, name, snapshot
        As in `MeshSample`.
    """

    x: Tensor
    edge_index: Tensor
    edge_attr: Tensor
    patch_types: Tensor
    curves: Tensor
    model_id: int
    name: str
    snapshot: int


class GridSample(NamedTuple):
    """UV-grids of a model: regular samples in the parameters of its patches and curves.

    Parameters
    ----------
    patch_grids : Tensor
        ``(p, ...)`` float32, a grid for each patch, laid out as the lake's array ``patch_grid``.
    curve_grids : Tensor
        ``(c, ...)`` float32, a grid for each curve, laid out as the array ``curve_grid``.
    edge_index : Tensor
        ``(2, e)`` int64, as in `GraphSample`.
    curves : Tensor
        ``(e,)`` int64, the curve of each edge.
    patch_types : Tensor
        ``(p,)`` uint8, as in `GraphSample`.
    model_id, name, snapshot
        As in `MeshSample`.
    """

    patch_grids: Tensor
    curve_grids: Tensor
    edge_index: Tensor
    curves: Tensor
    patch_types: Tensor
    model_id: int
    name: str
    snapshot: int
