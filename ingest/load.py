"""Read a CAD file into located shapes with names, colours and the declared unit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from breplake.errors import InputError
from breplake.ingest.failure import advise

__all__ = ["MILLIMETRES", "Document", "Label", "load"]

MILLIMETRES: Final[dict[str, float]] = {
    "METRE": 1000.0,
    "KILOMETRE": 1e6,
    "DECIMETRE": 100.0,
    "CENTIMETRE": 10.0,
    "MILLIMETRE": 1.0,
    "MICROMETRE": 1e-3,
    "NANOMETRE": 1e-6,
    "INCH": 25.4,
    "FOOT": 304.8,
    "YARD": 914.4,
    "MILE": 1_609_344.0,
    "MIL": 0.0254,
    "MICROINCH": 2.54e-5,
    # IGES unit flags as OCCT spells them
    "M": 1000.0,
    "KM": 1e6,
    "CM": 10.0,
    "MM": 1.0,
    "UM": 1e-3,
    "IN": 25.4,
    "INH": 25.4,
    "FT": 304.8,
    "MI": 1_609_344.0,
    "UIN": 2.54e-5,
}
"""Millimetres in one unit, by the unit's name in upper case."""


@dataclass(frozen=True, slots=True)
class Label:
    """What a file says of one shape: a name and a colour."""

    shape: Any
    name: str | None
    colour: str | None


@dataclass(slots=True)
class Document:
    """A file that was read.

    Parameters
    ----------
    shapes : list of TopoDS_Shape
        Located shapes without assembly structure, in file order, in millimetres.
    labels : list of Label
        Names and colours of solids, shells and faces, located as in `shapes`.
    length_unit : str, optional
        Unit the file declares; several are joined by a comma.
    scale_to_mm : float, optional
        Millimetres in one such unit; None if the name is unknown or there are several.
    """

    shapes: list[Any] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)
    length_unit: str | None = None
    scale_to_mm: float | None = None

    def declare(self, units: list[str]) -> None:
        """Record the declared length units."""
        unique = list(dict.fromkeys(unit.strip().upper() for unit in units if unit.strip()))
        if unique:
            self.length_unit = ",".join(unique)
            scales = {MILLIMETRES.get(unit) for unit in unique}
            self.scale_to_mm = scales.pop() if len(scales) == 1 else None


def load(path: Path, format: str) -> Document:
    """Read the file at `path`.

    Parameters
    ----------
    path : Path
        An uncompressed file.
    format : {"step", "iges", "brep"}
        How to read it.

    Raises
    ------
    InputError
        ``read-failed``, ``translate-failed`` or ``no-shape``.
    """
    document = {"step": _load_step, "iges": _load_iges, "brep": _load_brep}[format](path)
    document.shapes = [shape for shape in document.shapes if not _is_void(shape)]
    if not document.shapes:
        raise InputError("no-shape", advise("no-shape", ""))
    return document


def _is_void(shape: Any) -> bool:
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer

    return shape.IsNull() or not TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_VERTEX).More()


def _new_document() -> Any:
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFApp import XCAFApp_Application
    from OCP.XCAFDoc import XCAFDoc_ShapeTool

    # Else shapes without a name get one: COMPOUND, SOLID ...
    XCAFDoc_ShapeTool.SetAutoNaming_s(False)
    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    return document


def _transfer(reader: Any, path: Path) -> Any:
    """Run an XCAF reader over `path` and return its document."""
    from OCP.IFSelect import IFSelect_ReturnStatus

    reader.SetNameMode(True)
    reader.SetColorMode(True)
    reader.SetLayerMode(False)
    status = reader.ReadFile(str(path))
    if status != IFSelect_ReturnStatus.IFSelect_RetDone:
        detail = f"the parser answered {str(status).rpartition('_')[2]}"
        raise InputError("read-failed", advise("read-failed", detail))
    document = _new_document()
    if not reader.Transfer(document):
        raise InputError("translate-failed", advise("translate-failed", ""))
    return document


def _load_step(path: Path) -> Document:
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TColStd import TColStd_SequenceOfAsciiString

    reader = STEPCAFControl_Reader()
    reader.SetPropsMode(False)
    reader.SetGDTMode(False)
    reader.SetMatMode(False)
    reader.SetViewMode(False)
    result = _collect(_transfer(reader, path))
    lengths, angles, solid_angles = (TColStd_SequenceOfAsciiString() for _ in range(3))
    reader.ChangeReader().FileUnits(lengths, angles, solid_angles)
    units = [lengths.Value(i + 1).ToCString() for i in range(lengths.Length())]
    result.declare(units or _context_units(reader.ChangeReader().StepModel()))
    return result


def _context_units(model: Any) -> list[str]:
    """Return the length units of all representation contexts.

    ``FileUnits`` follows the product structure and finds nothing in some AP242 files.
    """
    from OCP.STEPConstruct import STEPConstruct_UnitContext

    names = {scale: name for name, scale in reversed(MILLIMETRES.items())}
    units = []
    for i in range(1, model.NbEntities() + 1):
        entity = model.Entity(i)
        if hasattr(entity, "GlobalUnitAssignedContext"):
            context = STEPConstruct_UnitContext()
            context.ComputeFactors(entity.GlobalUnitAssignedContext())
            if context.LengthDone():
                # OCCT states the factor in its own base unit, the millimetre.
                units.append(names.get(round(context.LengthFactor(), 12), "UNKNOWN"))
    return units


def _load_iges(path: Path) -> Document:
    from OCP.IGESCAFControl import IGESCAFControl_Reader

    reader = IGESCAFControl_Reader()
    result = _collect(_transfer(reader, path))
    unit = reader.IGESModel().GlobalSection().UnitName()
    result.declare([unit.ToCString()] if unit is not None else [])
    return result


def _load_brep(path: Path) -> Document:
    from OCP.BRep import BRep_Builder
    from OCP.BRepTools import BRepTools
    from OCP.TopoDS import TopoDS_Shape

    shape = TopoDS_Shape()
    if not BRepTools.Read_s(shape, str(path), BRep_Builder()) or shape.IsNull():
        raise InputError("read-failed", advise("read-failed", "BRepTools cannot read it"))
    # The format has no unit; OCCT's convention is the millimetre.
    return Document(shapes=[shape], scale_to_mm=1.0)


def _collect(document: Any) -> Document:
    """Walk the assembly tree and gather located shapes, names and colours."""
    from OCP.TDF import TDF_LabelSequence
    from OCP.TopLoc import TopLoc_Location
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    roots = TDF_LabelSequence()
    tool.GetFreeShapes(roots)
    result = Document()
    for root in _labels(roots):
        _walk(tool, colours, root, TopLoc_Location(), None, result)
    return result


def _labels(sequence: Any) -> Iterator[Any]:
    for i in range(sequence.Length()):
        yield sequence.Value(i + 1)


def _walk(
    tool: Any, colours: Any, label: Any, location: Any, name: str | None, out: Document
) -> None:
    """Add the shapes below `label`, which is placed by `location`, to `out`."""
    from OCP.TDF import TDF_Label, TDF_LabelSequence

    if tool.IsAssembly_s(label):
        components = TDF_LabelSequence()
        tool.GetComponents_s(label, components)
        for component in _labels(components):
            product = TDF_Label()
            if tool.GetReferredShape_s(component, product):
                placed = location.Multiplied(tool.GetLocation_s(component))
                _walk(tool, colours, product, placed, _name(component), out)
        return
    shape = tool.GetShape_s(label).Moved(location)
    out.shapes.append(shape)
    out.labels.append(Label(shape, _name(label) or name, _colour(colours, label)))
    parts = TDF_LabelSequence()
    tool.GetSubShapes_s(label, parts)
    for part in _labels(parts):
        sub = tool.GetShape_s(part).Moved(location)
        out.labels.append(Label(sub, _name(part), _colour(colours, part)))


def _name(label: Any) -> str | None:
    from OCP.TDataStd import TDataStd_Name

    # FindAttribute without the attribute present crashes in the binding, so ask first.
    if not label.IsAttribute(TDataStd_Name.GetID_s()):
        return None
    attribute = TDataStd_Name()
    label.FindAttribute(TDataStd_Name.GetID_s(), attribute)
    return str(attribute.Get().ToExtString()) or None


def _colour(colours: Any, label: Any) -> str | None:
    """Return the label's surface or generic colour as sRGB ``#rrggbb``."""
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
    from OCP.XCAFDoc import XCAFDoc_ColorType

    colour = Quantity_Color()
    for kind in (XCAFDoc_ColorType.XCAFDoc_ColorSurf, XCAFDoc_ColorType.XCAFDoc_ColorGen):
        if colours.GetColor_s(label, kind, colour):
            rgb = colour.Values(Quantity_TypeOfColor.Quantity_TOC_sRGB)
            return "#" + "".join(f"{round(max(0.0, min(1.0, c)) * 255):02x}" for c in rgb)
    return None
