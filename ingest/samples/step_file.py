"""Models to STEP files whose bytes depend on the model alone."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cadquery as cq
from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Interface import Interface_Static
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.STEPConstruct import STEPConstruct, STEPConstruct_Styles
from OCP.STEPControl import STEPControl_Controller, STEPControl_StepModelType
from OCP.StepRepr import StepRepr_HArray1OfRepresentationItem, StepRepr_NextAssemblyUsageOccurrence
from OCP.StepVisual import StepVisual_MechanicalDesignGeometricPresentationRepresentation
from OCP.TCollection import TCollection_ExtendedString, TCollection_HAsciiString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_Label
from OCP.TDocStd import TDocStd_Document
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Shape
from OCP.XCAFDoc import XCAFDoc_DocumentTool

from .registry import Unit

NamedFace = tuple[cq.Face, str, cq.Color]
"""Face of a leaf of an assembly with its name and colour: ``metadata={"faces": [...]}``."""

TIME_STAMP = "2000-01-01T00:00:00"
"""Time stamp in the header of every sample, so that equal models give equal bytes."""

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
    STEPControl_Controller.Init_s()
    document = _Document()
    document.add(model, name)
    with _settings({"write.step.unit": _UNITS[unit], "write.step.schema": "AP214IS"}):
        writer = STEPCAFControl_Writer()
        writer.SetColorMode(False)  # its order follows addresses in memory: see _paint
        writer.SetNameMode(True)
        written = writer.Transfer(document.native, STEPControl_StepModelType.STEPControl_AsIs)
        _paint(writer, document.paints)
        _number_instances(writer)
        _set_header(writer, name)
        status = writer.Write(str(path)) if written else None
    if status != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise OSError(f"cannot write {path}: the STEP writer returned {status}")


@dataclass(frozen=True, slots=True)
class _Paint:
    """Name and colour of a solid or face of a product's shape."""

    item: TopoDS_Shape
    name: str
    colour: cq.Color
    product: TopoDS_Shape


class _Document:
    """An XCAF document that holds one model."""

    def __init__(self) -> None:
        self.native = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
        self._shapes: Any = XCAFDoc_DocumentTool.ShapeTool_s(self.native.Main())
        self.paints: list[_Paint] = []
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
        _set_name(label, name)
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
        _set_name(self._shapes.AddComponent(assembly, product, location), name)

    def _add_shape(
        self, model: Any, name: str, colour: cq.Color | None, faces: Sequence[NamedFace] = ()
    ) -> TDF_Label:
        """Add a product without parts of its own, once per model object."""
        known = self._products.get(id(model))
        if known is not None:
            return known
        shape = _unplaced(as_shape(model).wrapped)
        label: TDF_Label = self._shapes.AddShape(shape, False)
        _set_name(label, name)
        if colour is not None:
            self.paints += [
                _Paint(s.wrapped, "", colour, shape) for s in cq.Shape.cast(shape).Solids()
            ]
        self.paints += [_Paint(face.wrapped, text, tint, shape) for face, text, tint in faces]
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


def _set_name(label: TDF_Label, name: str) -> None:
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))


def _paint(writer: STEPCAFControl_Writer, paints: Sequence[_Paint]) -> None:
    """Add names and surface colours of solids and faces in a fixed order."""
    styles = STEPConstruct_Styles(writer.ChangeWriter().WS())
    for paint in paints:
        item = STEPConstruct.FindEntity_s(styles.FinderProcess(), paint.item)
        if paint.name:
            item.SetName(TCollection_HAsciiString(paint.name))
        rgb = STEPConstruct_Styles.EncodeColor_s(paint.colour.wrapped.GetRGB())
        style = styles.MakeColorPSA(item, rgb, None, None, 0.0)
        items = StepRepr_HArray1OfRepresentationItem(1, 1)
        items.SetValue(1, styles.AddStyle(item, style, None))
        painted = StepVisual_MechanicalDesignGeometricPresentationRepresentation()
        painted.Init(TCollection_HAsciiString(""), items, styles.FindContext(paint.product))
        writer.ChangeWriter().Model().AddWithRefs(painted)


def _number_instances(writer: STEPCAFControl_Writer) -> None:
    """Count the instances of an assembly from 1: the kernel counts on from file to file."""
    model = writer.ChangeWriter().Model()
    count = 0
    for i in range(1, model.NbEntities() + 1):
        entity = model.Value(i)
        if isinstance(entity, StepRepr_NextAssemblyUsageOccurrence):
            count += 1
            entity.SetId(TCollection_HAsciiString(str(count)))


def _set_header(writer: STEPCAFControl_Writer, name: str) -> None:
    """Replace what the kernel puts into the header by fixed values."""
    header = APIHeaderSection_MakeHeader(writer.ChangeWriter().Model())
    header.SetName(TCollection_HAsciiString(name))
    header.SetTimeStamp(TCollection_HAsciiString(TIME_STAMP))
    header.SetAuthorValue(1, TCollection_HAsciiString("breplake samples"))
    header.SetOrganizationValue(1, TCollection_HAsciiString("breplake"))


@contextmanager
def _settings(values: dict[str, str]) -> Iterator[None]:
    """Set options of the kernel's STEP translator, which are global, and restore them."""
    before = {key: Interface_Static.CVal_s(key) for key in values}
    try:
        for key, value in values.items():
            Interface_Static.SetCVal_s(key, value)
        yield
    finally:
        for key, value in before.items():
            Interface_Static.SetCVal_s(key, value)
