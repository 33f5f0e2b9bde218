"""The canonical compound: one order of solids, faces, edges and vertices for all libraries.

Gmsh numbers what it imports by walking solids, then free shells and faces, then free wires,
edges and vertices. Building a compound in that very order makes OCCT's ``TopExp::MapShapes`` on it
agree with Gmsh's tags, and gives every entity of a model one id.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from breplake.ingest.clock import KERNEL

__all__ = ["Canonical", "PartShape", "canonical", "explore", "shape_list"]


@dataclass(frozen=True, slots=True)
class PartShape:
    """A solid, or a shell or face outside any solid."""

    kind: str
    shape: Any


@dataclass(frozen=True, slots=True)
class Canonical:
    """A model's shapes in canonical order.

    Parameters
    ----------
    compound : TopoDS_Compound
        Everything, in canonical order.
    parts : list of PartShape
        Solids first, then free shells, then free faces.
    faces, edges, vertices : TopTools_IndexedMapOfShape
        1-based maps of the compound's entities; an id is its index minus one.
    n_shells : int
        Number of shells, those of solids included.
    """

    compound: Any
    parts: list[PartShape]
    faces: Any
    edges: Any
    vertices: Any
    n_shells: int


def explore(shape: Any, kind: Any, avoid: Any = None) -> Iterator[Any]:
    """Yield the sub-shapes of one kind, with repetition, orientation and location applied."""
    from OCP.TopExp import TopExp_Explorer

    explorer = (
        TopExp_Explorer(shape, kind) if avoid is None else TopExp_Explorer(shape, kind, avoid)
    )
    while explorer.More():
        yield explorer.Current()
        explorer.Next()


def shape_list(shapes: Any, cast: Callable[[Any], Any]) -> list[Any]:
    """Return a 1-based map's shapes as a 0-based list of `cast` shapes."""
    return [cast(shapes.FindKey(i + 1)) for i in range(shapes.Extent())]


def canonical(shapes: Sequence[Any]) -> Canonical:
    """Bring `shapes` into canonical order; the same shape at the same place counts once."""
    from OCP.BRep import BRep_Builder
    from OCP.TopAbs import TopAbs_ShapeEnum as Kind
    from OCP.TopExp import TopExp
    from OCP.TopoDS import TopoDS_Compound
    from OCP.TopTools import TopTools_IndexedMapOfShape

    builder, compound = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(compound)
    parts: list[PartShape] = []
    levels = (
        ("solid", Kind.TopAbs_SOLID, None),
        ("shell", Kind.TopAbs_SHELL, Kind.TopAbs_SOLID),
        ("face", Kind.TopAbs_FACE, Kind.TopAbs_SHELL),
        ("wire", Kind.TopAbs_WIRE, Kind.TopAbs_FACE),
        ("edge", Kind.TopAbs_EDGE, Kind.TopAbs_WIRE),
        ("vertex", Kind.TopAbs_VERTEX, Kind.TopAbs_EDGE),
    )
    for name, kind, avoid in levels:
        seen = TopTools_IndexedMapOfShape()
        for shape in shapes:
            for found in explore(shape, kind, avoid):
                if seen.Contains(found):
                    continue
                seen.Add(found)
                placed = _outward(found) if name == "solid" else found
                builder.Add(compound, placed)
                if name in ("solid", "shell", "face"):
                    parts.append(PartShape(name, placed))
    maps = []
    for kind in (Kind.TopAbs_FACE, Kind.TopAbs_EDGE, Kind.TopAbs_VERTEX, Kind.TopAbs_SHELL):
        shape_map = TopTools_IndexedMapOfShape()
        TopExp.MapShapes_s(compound, kind, shape_map)
        maps.append(shape_map)
    return Canonical(compound, parts, maps[0], maps[1], maps[2], maps[3].Extent())


def _outward(solid: Any) -> Any:
    """Return `solid` so oriented that its volume is not negative.

    Some writers turn solids inside out; normals are to point out of the material.
    """
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    with KERNEL():
        BRepGProp.VolumeProperties_s(solid, properties)
    return solid.Reversed() if properties.Mass() < 0 else solid
