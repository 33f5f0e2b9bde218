"""Models to STEP files whose bytes depend on the model alone."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cadquery as cq
from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
from OCP.TDF import TDF_Label
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Shape
from OCP.XCAFDoc import XCAFDoc_DocumentTool

from breplake.ingest.step_writer import Paint, new_document, set_name, write_document

from .registry import Unit

NamedFace = tuple[cq.Face, str, cq.Color]
"""Face of a leaf of an assembly with its name and colour: ``metadata={"faces": [...]}``."""

_UNITS: dict[Unit, str] = {"mm": "MM", "inch": "INCH"}


def write_step(model: Any, path: Path, *, name: str, unit: Unit = "mm") -> None:
    """Write a model as a STEP file (AP214) with names and colours.

    Parameters
    ----------
    model : cadquery Workplane, Shape or Assembly
        The model, in millimetres.
    path : Path
        File to write; an existing one is replaced.
    name : str
        Name of the product, and of the header's file.
    unit : {"mm", "inch"}
        Length unit of the numbers in the file.

    Raises
    ------
    OSError
        If the kernel cannot write the file.
    """
    document = _Document()
    document.add(model, name)
    write_document(
        document.native,
        path,
        name=name,
        unit=_UNITS[unit],
        author="breplake samples",
        paints=document.paints,
    )


class _Document:
    """An XCAF document that holds one model."""

    def __init__(self) -> None:
        self.native = new_document()
        self._shapes: Any = XCAFDoc_DocumentTool.ShapeTool_s(self.native.Main())
        self.paints: list[Paint] = []
        self._products: dict[int, TDF_Label] = {}

    def add(self, model: Any, name: str) -> None:
        """Add a whole model under a product name."""
        if isinstance(model, cq.Assembly):
            self._add_assembly(model, name)
        else:
            self._add_shape(model, name, None)
        self._shapes.UpdateAssemblies()

    def _add_assembly(self, node: cq.Assembly, name: str) -> TDF_Label:
        """Add a node of the tree as a product; a leaf used twice becomes one product.

        Nodes ``bolt.1`` and ``bolt.2`` are instances of the product ``bolt``.
        """
        if not node.children:
            faces = node.metadata.get("faces", [])
            return self._add_shape(node.obj, name, node.color, faces)
        label: TDF_Label = self._shapes.NewShape()
        set_name(label, name)
        if node.obj is not None:
            body = f"{name}_body"
            self._place(label, self._add_shape(node.obj, body, node.color), cq.Location(), body)
        for child in node.children:
            product = self._add_assembly(child, child.name.split(".")[0])
            self._place(label, product, child.loc, child.name)
        return label

    def _place(
        self, assembly: TDF_Label, product: TDF_Label, where: cq.Location, name: str
    ) -> None:
        """Add a named instance of a product to an assembly."""
        location: TopLoc_Location = where.wrapped
        set_name(self._shapes.AddComponent(assembly, product, location), name)

    def _add_shape(
        self, model: Any, name: str, colour: cq.Color | None, faces: Sequence[NamedFace] = ()
    ) -> TDF_Label:
        """Add a product without parts of its own, once per model object."""
        known = self._products.get(id(model))
        if known is not None:
            return known
        shape = _unplaced(as_shape(model).wrapped)
        label: TDF_Label = self._shapes.AddShape(shape, False)
        set_name(label, name)
        if colour is not None:
            self.paints += [
                Paint(s.wrapped, "", colour.wrapped.GetRGB(), shape)
                for s in cq.Shape.cast(shape).Solids()
            ]
        self.paints += [
            Paint(face.wrapped, text, tint.wrapped.GetRGB(), shape) for face, text, tint in faces
        ]
        self._products[id(model)] = label
        return label


def as_shape(model: Any) -> cq.Shape:
    """One shape for a Workplane (its whole stack) or a Shape.

    Parameters
    ----------
    model : cadquery Workplane or Shape
        What a part's function returned.

    Returns
    -------
    cadquery.Shape
        The only shape, or a compound of all.
    """
    if isinstance(model, cq.Shape):
        return model
    found: list[cq.Shape] = []
    for value in model.vals():
        found.extend(value if isinstance(value, cq.Compound) else [value])
    return found[0] if len(found) == 1 else cq.Compound.makeCompound(found)


def _unplaced(shape: TopoDS_Shape) -> TopoDS_Shape:
    """Move a shape's location into its geometry: a placed shape would become a nameless product."""
    location = shape.Location()
    if location.IsIdentity():
        return shape
    bare = shape.Located(TopLoc_Location())
    return BRepBuilderAPI_Transform(bare, location.Transformation(), True).Shape()
