"""Exact rows of a B-Rep: parts, patches, curves, coedges and corners."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.errors import InputError
from breplake.ingest.canonical import Canonical, PartShape, explore, shape_list
from breplake.ingest.clock import KERNEL
from breplake.ingest.failure import advise
from breplake.ingest.geometry import Row, curve_row, surface_row, untrimmed
from breplake.ingest.load import Label
from breplake.ingest.lossless.graph import PcurveUse, ShapeGraph
from breplake.ingest.mass import body_mass, faces_mass, patch_ids, surface_mass
from breplake.ingest.sharpness import Crease, Dihedral, classify, measure
from breplake.schema.tables import PATCHES

__all__ = ["INFINITE", "Brep", "Coedge", "extract"]

INFINITE: Final = 1e50
"""Parameters beyond this are OCCT's way of saying infinite (``Precision::Infinite``)."""


NO_AREA: Final = 1e-10
"""A patch of less area than this share of the squared diagonal is a fault of the file."""


@dataclass(frozen=True, slots=True)
class Coedge:
    """A use of a curve in a patch's loop; `internal` uses bound nothing."""

    patch_id: int
    loop: int
    place: int
    curve_id: int
    reversed: bool
    internal: bool
    pcurve: PcurveUse


@dataclass(slots=True)
class Brep:
    """A model's exact rows, with the shapes they came from.

    Parameters
    ----------
    canonical : Canonical
        The model's shapes.
    faces, edges, vertices : list
        Typed OCCT shapes by patch, curve and corner id.
    surfaces : list
        ``Geom_Surface`` by patch id, location applied.
    parts, patches, curves, corners : list of dict
        Rows without model_id.
    coedges : list of Coedge
        In order of patch, loop and place.
    graph : ShapeGraph
        The shapes as they are stored.
    patch_table : pyarrow.Table
        `patches` as a table, with model_id 0.
    """

    canonical: Canonical
    faces: list[Any]
    edges: list[Any]
    vertices: list[Any]
    surfaces: list[Any]
    parts: list[Row]
    patches: list[Row]
    curves: list[Row]
    coedges: list[Coedge]
    corners: list[Row]
    graph: ShapeGraph
    patch_table: pa.Table

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box of all parts and corners, mm."""
        low, high = self.bounds()
        return float(np.linalg.norm(high - low))

    def bounds(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the corners ``(3,)`` mm of the model's bounding box."""
        keys = ("bbox_min", "bbox_max")
        free = [i for i, row in enumerate(self.curves) if row["kind"] == "free"]
        boxes = [*self.parts, *(_bounds(self.edges[i]) for i in free)]
        points = [[box[key][a] for a in "xyz"] for box in boxes for key in keys]
        points += [[corner["point"][a] for a in "xyz"] for corner in self.corners]
        return np.min(points, axis=0), np.max(points, axis=0)

    def set_areas(self, areas: Mapping[int, float]) -> None:
        """Put areas, mm^2 by patch id, in place of those that Open CASCADE measured."""
        for i, part in enumerate(self.canonical.parts):
            for patch_id in patch_ids(self.canonical, part):
                if patch_id in areas:
                    self.parts[i]["area"] += areas[patch_id] - self.patches[patch_id]["area"]
        for patch_id, area in areas.items():
            self.patches[patch_id]["area"] = area
        at = self.patch_table.column_names.index("area")
        column = pa.array([row["area"] for row in self.patches], pa.float64())
        field = self.patch_table.schema.field(at)
        self.patch_table = self.patch_table.set_column(at, field, column)

    def require_no_area(self, patch: Row) -> None:
        """Accept that a patch has no triangles because it has no area.

        Raises
        ------
        InputError
            ``mesh-incomplete`` if it has area.
        """
        if not abs(patch["area"]) <= NO_AREA * self.diagonal**2:
            detail = f"patch {patch['patch_id']} of {patch['area']:.3g} mm^2 got no triangles"
            raise InputError("mesh-incomplete", advise("mesh-incomplete", detail))

    @property
    def internal_curves(self) -> set[int]:
        """Curves that lie inside patches without bounding any; Gmsh may leave them out."""
        bounding = {use.curve_id for use in self.coedges if not use.internal}
        return {use.curve_id for use in self.coedges if use.internal} - bounding


def extract(canonical: Canonical, labels: Sequence[Label]) -> Brep:
    """Derive all exact rows of a model.

    Raises
    ------
    InputError
        ``no-geometry`` if a face has no surface, ``unbounded`` if something is infinite.
    """
    from OCP.TopoDS import TopoDS

    faces = shape_list(canonical.faces, TopoDS.Face_s)
    edges = shape_list(canonical.edges, TopoDS.Edge_s)
    vertices = shape_list(canonical.vertices, TopoDS.Vertex_s)
    surfaces = _surfaces(faces)
    names = _names(canonical, labels)
    graph = ShapeGraph(canonical.compound)
    coedges = [use for i, face in enumerate(faces) for use in _coedges(canonical, graph, i, face)]
    patches, masses = _patch_rows(canonical, faces, surfaces)
    parts = [
        _part_row(i, part, faces_mass(canonical, part, masses))
        | names["part", i]
        | {"shape": graph.number(part.shape)}
        for i, part in enumerate(canonical.parts)
    ]
    for i, patch in enumerate(patches):
        patch |= names["patch", i] | {"shape": graph.number(faces[i])}
        patch.setdefault("colour", parts[patch["part_id"]].get("colour"))
    table = PATCHES.from_rows({"model_id": 0, **row} for row in patches)
    roles = _role_rows(edges, coedges, faces, surfaces, table)
    return Brep(
        canonical=canonical,
        faces=faces,
        edges=edges,
        vertices=vertices,
        surfaces=surfaces,
        parts=parts,
        patches=patches,
        curves=[
            _curve_row(i, edge, canonical) | roles[i] | {"shape": graph.number(edge)}
            for i, edge in enumerate(edges)
        ],
        coedges=coedges,
        corners=[_corner_row(i, v) | {"shape": graph.number(v)} for i, v in enumerate(vertices)],
        graph=graph,
        patch_table=table,
    )


def _surfaces(faces: Sequence[Any]) -> list[Any]:
    """Return the ``Geom_Surface`` of each face.

    Raises
    ------
    InputError
        ``no-geometry`` if a face has none.
    """
    from OCP.BRep import BRep_Tool

    surfaces = [untrimmed(BRep_Tool.Surface_s(face)) for face in faces]
    for patch_id, surface in enumerate(surfaces):
        if surface is None:
            raise InputError("no-geometry", advise("no-geometry", f"patch {patch_id}"))
    return surfaces


def _patch_rows(
    canonical: Canonical, faces: Sequence[Any], surfaces: Sequence[Any]
) -> tuple[list[Row], list[Any]]:
    """Return the row of each patch, and the mass of its surface (``GProp_GProps``)."""
    part_of = _part_of_patch(canonical, len(faces))
    ranges = [_parameter_range(i, face) for i, face in enumerate(faces)]
    geometry = [surface_row(surface) for surface in surfaces]
    masses = [surface_mass(face, row) for face, row in zip(faces, geometry, strict=True)]
    rows = [
        _patch_row(i, face, part_of[i])
        | ranges[i]
        | {"area": float(masses[i].Mass())}
        | geometry[i]
        for i, face in enumerate(faces)
    ]
    return rows, masses


def _role_rows(
    edges: Sequence[Any],
    coedges: Sequence[Coedge],
    faces: list[Any],
    surfaces: list[Any],
    patches: pa.Table,
) -> list[Row]:
    """Return what each curve is to its patches."""
    uses: dict[int, list[Coedge]] = defaultdict(list)
    for use in coedges:
        uses[use.curve_id].append(use)
    creases = {i: c for i, edge in enumerate(edges) if (c := _crease(edge, uses[i]))}
    dihedrals = measure(list(creases.values()), faces, surfaces, patches)
    angles = dict(zip(creases, dihedrals, strict=True))
    return [_role_row(edge, uses[i], angles.get(i), faces) for i, edge in enumerate(edges)]


def _xyz(point: Any) -> Row:
    return {"x": point.X(), "y": point.Y(), "z": point.Z()}


def _corner_row(corner_id: int, vertex: Any) -> Row:
    from OCP.BRep import BRep_Tool

    return {
        "corner_id": corner_id,
        "point": _xyz(BRep_Tool.Pnt_s(vertex)),
        "tolerance": BRep_Tool.Tolerance_s(vertex),
    }


def _names(canonical: Canonical, labels: Sequence[Label]) -> dict[tuple[str, int], Row]:
    """Return names and colours by ("part" | "patch", id).

    A label on a compound speaks for the parts in it that have no label of their own.
    """
    from OCP.TopAbs import TopAbs_ShapeEnum as Kind
    from OCP.TopTools import TopTools_IndexedMapOfShape

    part_map = TopTools_IndexedMapOfShape()
    for part in canonical.parts:
        part_map.Add(part.shape)
    found: dict[tuple[str, int], Row] = defaultdict(dict)

    def put(key: str, index: int, label: Label) -> None:
        if index:
            for column in ("name", "colour"):
                if (value := getattr(label, column)) is not None:
                    found[key, index - 1].setdefault(column, value)

    wide = (Kind.TopAbs_COMPOUND, Kind.TopAbs_COMPSOLID)
    for label in labels:
        if label.shape.ShapeType() == Kind.TopAbs_FACE:
            put("patch", canonical.faces.FindIndex(label.shape), label)
        put("part", part_map.FindIndex(label.shape), label)
    for label in labels:
        if label.shape.ShapeType() in wide:
            for kind in (Kind.TopAbs_SOLID, Kind.TopAbs_SHELL, Kind.TopAbs_FACE):
                for shape in explore(label.shape, kind):
                    put("part", part_map.FindIndex(shape), label)
    return found


def _part_of_patch(canonical: Canonical, n_patches: int) -> list[int]:
    owner = [-1] * n_patches
    for part_id, part in enumerate(canonical.parts):
        for patch_id in patch_ids(canonical, part):
            if owner[patch_id] < 0:
                owner[patch_id] = part_id
    return owner


def _bounds(shape: Any) -> Row:
    """Return the bounding box of a shape's geometry, without its tolerances."""
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib

    for optimal in (True, False):
        box = Bnd_Box()
        with KERNEL():
            if optimal:
                BRepBndLib.AddOptimal_s(shape, box, False, False)
            else:
                BRepBndLib.Add_s(shape, box, False)
        # The optimal box fails on faulty faces, the plain one is wider but sturdier.
        if not (box.IsVoid() or box.IsOpen()):
            return {"bbox_min": _xyz(box.CornerMin()), "bbox_max": _xyz(box.CornerMax())}
    raise InputError("unbounded", advise("unbounded", "a part has no finite bounding box"))


def _part_row(part_id: int, part: PartShape, surface: Any) -> Row:
    """Return a part's row; one of no volume has its surface's centre of mass."""
    body = body_mass(part)
    centre = (body if body is not None and body.Mass() else surface).CentreOfMass()
    return {
        "part_id": part_id,
        "kind": part.kind,
        "area": float(surface.Mass()),
        "is_closed": _is_closed(part.shape),
        "volume": None if body is None else body.Mass(),
        "centroid": _xyz(centre),
        **_bounds(part.shape),
    }


def _is_closed(shape: Any) -> bool:
    """Tell whether every edge of the part is used an even number of times by its faces."""
    from OCP.BRep import BRep_Tool
    from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
    from OCP.TopoDS import TopoDS
    from OCP.TopTools import TopTools_IndexedMapOfShape

    bounding = (TopAbs_Orientation.TopAbs_FORWARD, TopAbs_Orientation.TopAbs_REVERSED)
    edges = TopTools_IndexedMapOfShape()
    uses: dict[int, int] = defaultdict(int)
    for face in explore(shape, TopAbs_ShapeEnum.TopAbs_FACE):
        for edge in explore(face, TopAbs_ShapeEnum.TopAbs_EDGE):
            if edge.Orientation() in bounding and not BRep_Tool.Degenerated_s(TopoDS.Edge_s(edge)):
                uses[edges.Add(edge)] += 1
    return bool(uses) and all(count % 2 == 0 for count in uses.values())


def _parameter_range(patch_id: int, face: Any) -> Row:
    """Return the parameters that a face spans.

    Raises
    ------
    InputError
        ``unbounded`` if it is infinite: no area could be measured.
    """
    from OCP.BRepTools import BRepTools

    values = BRepTools.UVBounds_s(face)
    if max(abs(value) for value in values) > INFINITE:
        raise InputError("unbounded", advise("unbounded", f"patch {patch_id}"))
    return dict(zip(("u_min", "u_max", "v_min", "v_max"), values, strict=True))


def _patch_row(patch_id: int, face: Any, part_id: int) -> Row:
    from OCP.BRep import BRep_Tool
    from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum

    kinds = (TopAbs_ShapeEnum.TopAbs_FACE, TopAbs_ShapeEnum.TopAbs_EDGE)
    tolerances = [BRep_Tool.MaxTolerance_s(face, kind) for kind in kinds]
    tolerances.append(BRep_Tool.MaxTolerance_s(face, TopAbs_ShapeEnum.TopAbs_VERTEX))
    return {
        "patch_id": patch_id,
        "part_id": part_id,
        "reversed": face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED,
        "n_loops": sum(1 for _ in explore(face, TopAbs_ShapeEnum.TopAbs_WIRE)),
        "tolerance": max(tolerances),
    }


def _coedges(canonical: Canonical, graph: ShapeGraph, patch_id: int, face: Any) -> list[Coedge]:
    """Return a patch's coedges, outer loop first, each loop in the patch's orientation."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepTools import BRepTools
    from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
    from OCP.TopLoc import TopLoc_Location
    from OCP.TopoDS import TopoDS

    flipped = face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
    forward = TopoDS.Face_s(face.Oriented(TopAbs_Orientation.TopAbs_FORWARD))
    wires = list(explore(forward, TopAbs_ShapeEnum.TopAbs_WIRE))
    outer = BRepTools.OuterWire_s(forward)
    wires.sort(key=lambda wire: not wire.IsSame(outer))
    location = TopLoc_Location()
    surface = BRep_Tool.Surface_s(forward, location)
    found = []
    for loop, wire in enumerate(wires):
        edges = _ordered_edges(TopoDS.Wire_s(wire), forward)
        for place, edge in enumerate(reversed(edges) if flipped else edges):
            orientation = edge.Orientation()
            backward = orientation == TopAbs_Orientation.TopAbs_REVERSED
            internal = orientation in (
                TopAbs_Orientation.TopAbs_INTERNAL,
                TopAbs_Orientation.TopAbs_EXTERNAL,
            )
            curve_id = canonical.edges.FindIndex(edge) - 1
            pcurve = graph.pcurve(edge, surface, location)
            found.append(
                Coedge(patch_id, loop, place, curve_id, backward != flipped, internal, pcurve)
            )
    return found


def _ordered_edges(wire: Any, face: Any) -> list[Any]:
    """Return a wire's edges head to tail, or in stored order where they do not connect."""
    from OCP.BRepTools import BRepTools_WireExplorer
    from OCP.TopAbs import TopAbs_ShapeEnum

    stored = list(explore(wire, TopAbs_ShapeEnum.TopAbs_EDGE))
    ordered: list[Any] = []
    explorer = BRepTools_WireExplorer(wire, face)
    while explorer.More() and len(ordered) <= len(stored):
        ordered.append(explorer.Current())
        explorer.Next()
    return ordered if len(ordered) == len(stored) else stored


def _curve_row(curve_id: int, edge: Any, canonical: Canonical) -> Row:
    from OCP.BRep import BRep_Tool
    from OCP.BRepAdaptor import BRepAdaptor_Curve
    from OCP.GCPnts import GCPnts_AbscissaPoint
    from OCP.TopExp import TopExp

    curve = BRep_Tool.Curve_s(edge, 0.0, 0.0)
    t_min, t_max = BRep_Tool.Range_s(edge)
    if max(abs(t_min), abs(t_max)) > INFINITE:
        raise InputError("unbounded", advise("unbounded", f"curve {curve_id}"))
    length = None
    if curve is not None:
        with KERNEL():
            # Without a tolerance the length of an ellipse is off by up to 0.4 %.
            length = GCPnts_AbscissaPoint.Length_s(BRepAdaptor_Curve(edge), 1e-9)
    ends = [TopExp.FirstVertex_s(edge), TopExp.LastVertex_s(edge)]
    corners = [None if v.IsNull() else canonical.vertices.FindIndex(v) - 1 for v in ends]
    return {
        "curve_id": curve_id,
        **({"type": "Other"} if curve is None else curve_row(curve)),
        "t_min": t_min,
        "t_max": t_max,
        "length": length,
        "tolerance": BRep_Tool.Tolerance_s(edge),
        "start_corner": corners[0],
        "end_corner": corners[1],
    }


def _crease(edge: Any, uses: list[Coedge]) -> Crease | None:
    """Return the edge as a crease if exactly two patches meet at it."""
    from OCP.BRep import BRep_Tool

    bounding = [use for use in uses if not use.internal]
    if len(bounding) != 2 or BRep_Tool.Degenerated_s(edge):
        return None
    left, right = sorted(bounding, key=lambda use: use.reversed)
    return Crease(edge, left.patch_id, right.patch_id) if left.patch_id != right.patch_id else None


def _role_row(edge: Any, uses: list[Coedge], dihedral: Dihedral | None, faces: list[Any]) -> Row:
    """Return what the curve is to its patches."""
    from OCP.BRep import BRep_Tool

    bounding = [use for use in uses if not use.internal]
    row: Row = {
        "left_patch": next((use.patch_id for use in bounding if not use.reversed), None),
        "right_patch": next((use.patch_id for use in bounding if use.reversed), None),
        "n_patches": len({use.patch_id for use in uses}),
        "sharp": False,
    }
    if dihedral is not None:
        row |= {"kind": classify(dihedral), "sharp": dihedral.sharp}
        if np.isfinite(dihedral.angle_min):
            row |= {"angle_min": dihedral.angle_min, "angle_max": dihedral.angle_max}
            # Where the patches' orientations disagree, no side is the material's.
            coherent = bounding[0].reversed != bounding[1].reversed
            row["convexity"] = dihedral.convexity if coherent else None
        pair = (faces[bounding[0].patch_id], faces[bounding[1].patch_id])
        if BRep_Tool.HasContinuity_s(edge, *pair):
            continuity = BRep_Tool.Continuity_s(edge, *pair)
            row["stored_continuity"] = str(continuity.name).rpartition("_")[2]
    elif BRep_Tool.Degenerated_s(edge):
        row["kind"] = "degenerate"
    elif not uses:
        row["kind"] = "free"
    elif len(bounding) == 2:
        row["kind"] = "seam"
    else:
        # A curve inside a patch, which bounds nothing, is smooth.
        row["kind"] = {0: "smooth", 1: "boundary"}.get(len(bounding), "nonmanifold")
    return row
