"""XCAF documents to STEP files whose bytes depend on the document alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

__all__ = ["TIME_STAMP", "Paint", "new_document", "set_name", "write_document"]

TIME_STAMP: Final = "2000-01-01T00:00:00"
"""Time stamp in the header of every file, so that equal models give equal bytes."""


_UNNAMED: Final = "breplake: a product without a name"
"""Stands in for no name, for which the kernel would write one of its own."""


@dataclass(frozen=True, slots=True)
class Paint:
    """Name and colour of a part of a product's shape.

    Parameters
    ----------
    item : TopoDS_Shape
        Solid, shell or face.
    name : str
        Its name; empty for none.
    colour : Quantity_Color or None
        Its colour.
    product : TopoDS_Shape
        The shape of the product that it belongs to.
    """

    item: Any
    name: str
    colour: Any
    product: Any


def new_document() -> Any:
    """Return an empty ``TDocStd_Document``."""
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document

    return TDocStd_Document(TCollection_ExtendedString("BinXCAF"))


def set_name(label: Any, name: str) -> None:
    """Name a label of a document; no name stays none."""
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name

    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name or _UNNAMED, True))  # UTF-8


def write_document(
    document: Any, path: Path, *, name: str, unit: str, author: str, paints: Sequence[Paint]
) -> None:
    """Write a document with an assembly as STEP (AP214).

    Parameters
    ----------
    document : TDocStd_Document
        Shapes in millimetres, with names.
    path : Path
        File to write; an existing one is replaced.
    name, author : str
        For the header.
    unit : str
        Unit of the numbers in the file, as OCCT's ``write.step.unit`` calls it.
    paints : sequence of Paint
        Names and colours below the products. The writer's own order of colours follows
        addresses in memory, so they are not taken from the document.

    Raises
    ------
    OSError
        If the kernel cannot write the file.
    """
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.STEPControl import STEPControl_Controller, STEPControl_StepModelType

    STEPControl_Controller.Init_s()
    with _settings({"write.step.unit": unit, "write.step.schema": "AP214IS"}):
        writer = STEPCAFControl_Writer()
        writer.SetColorMode(False)
        writer.SetNameMode(True)
        written = writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
        _paint(writer, paints)
        _unname(writer)
        _number_instances(writer)
        _set_header(writer, name, author)
        status = writer.Write(str(path)) if written else None
    if status != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise OSError(f"cannot write {path}: the STEP writer returned {status}")


def _paint(writer: Any, paints: Sequence[Paint]) -> None:
    """Add names and surface colours in a fixed order."""
    from OCP.STEPConstruct import STEPConstruct, STEPConstruct_Styles
    from OCP.StepRepr import StepRepr_HArray1OfRepresentationItem
    from OCP.StepVisual import StepVisual_MechanicalDesignGeometricPresentationRepresentation
    from OCP.TCollection import TCollection_HAsciiString

    styles = STEPConstruct_Styles(writer.ChangeWriter().WS())
    for paint in paints:
        item = STEPConstruct.FindEntity_s(styles.FinderProcess(), paint.item)
        if item is None:  # a broken face, which the kernel did not write
            continue
        if paint.name:
            item.SetName(TCollection_HAsciiString(paint.name))
        if paint.colour is None:
            continue
        rgb = STEPConstruct_Styles.EncodeColor_s(paint.colour)
        style = styles.MakeColorPSA(item, rgb, None, None, 0.0)
        items = StepRepr_HArray1OfRepresentationItem(1, 1)
        items.SetValue(1, styles.AddStyle(item, style, None))
        painted = StepVisual_MechanicalDesignGeometricPresentationRepresentation()
        painted.Init(TCollection_HAsciiString(""), items, styles.FindContext(paint.product))
        writer.ChangeWriter().Model().AddWithRefs(painted)


def _unname(writer: Any) -> None:
    """Empty the names of products and instances that have none."""
    from OCP.StepBasic import StepBasic_Product
    from OCP.StepRepr import StepRepr_NextAssemblyUsageOccurrence
    from OCP.TCollection import TCollection_HAsciiString

    model = writer.ChangeWriter().Model()
    for i in range(1, model.NbEntities() + 1):
        entity = model.Value(i)
        named = isinstance(entity, StepBasic_Product | StepRepr_NextAssemblyUsageOccurrence)
        if named and entity.Name().ToCString() == _UNNAMED:
            entity.SetName(TCollection_HAsciiString(""))
            entity.SetId(TCollection_HAsciiString(""))


def _number_instances(writer: Any) -> None:
    """Count the instances of an assembly from 1: the kernel counts on from file to file."""
    from OCP.StepRepr import StepRepr_NextAssemblyUsageOccurrence
    from OCP.TCollection import TCollection_HAsciiString

    model = writer.ChangeWriter().Model()
    count = 0
    for i in range(1, model.NbEntities() + 1):
        entity = model.Value(i)
        if isinstance(entity, StepRepr_NextAssemblyUsageOccurrence):
            count += 1
            entity.SetId(TCollection_HAsciiString(str(count)))


def _set_header(writer: Any, name: str, author: str) -> None:
    """Replace what the kernel puts into the header by fixed values."""
    from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
    from OCP.TCollection import TCollection_HAsciiString

    header = APIHeaderSection_MakeHeader(writer.ChangeWriter().Model())
    header.SetName(TCollection_HAsciiString(name))
    header.SetTimeStamp(TCollection_HAsciiString(TIME_STAMP))
    header.SetAuthorValue(1, TCollection_HAsciiString(author))
    header.SetOrganizationValue(1, TCollection_HAsciiString("breplake"))


@contextmanager
def _settings(values: dict[str, str]) -> Iterator[None]:
    """Set options of the kernel's STEP translator, which are global, and restore them."""
    from OCP.Interface import Interface_Static

    before = {key: Interface_Static.CVal_s(key) for key in values}
    try:
        for key, value in values.items():
            Interface_Static.SetCVal_s(key, value)
        yield
    finally:
        for key, value in before.items():
            Interface_Static.SetCVal_s(key, value)
