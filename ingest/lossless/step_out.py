"""A rebuilt model as a STEP file, with the names and colours of its parts and patches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

from breplake.ingest.canonical import explore
from breplake.ingest.step_writer import Paint, new_document, set_name, write_document

__all__ = ["STEP_UNITS", "write_step"]

_Row: TypeAlias = Mapping[str, Any]

STEP_UNITS: Final[dict[float, str]] = {
    1.0: "MM",
    10.0: "CM",
    1000.0: "M",
    1e6: "KM",
    1e-3: "UM",
    25.4: "INCH",
    0.0254: "MIL",
    2.54e-5: "UIN",
    304.8: "FT",
    1_609_344.0: "MI",
}
"""Units that OCCT writes, by their millimetres."""


def write_step(
    compound: Any,
    path: Path,
    *,
    name: str,
    parts: Sequence[_Row],
    patches: Sequence[_Row],
    scale_to_mm: float | None = None,
) -> None:
    """Write a model as STEP (AP214).

    A part that is placed several times becomes one product with several instances, unless its
    instances differ in names or colours. Several parts without names are bodies of one product: in
    an assembly, readers call a part without a name by the number of its instance.

    Parameters
    ----------
    compound : TopoDS_Compound
        The model as ``rebuild`` made it.
    path : Path
        File to write; an existing one is replaced.
    name : str
        Name of the whole.
    parts, patches : sequence of mapping
        Rows of the model in order of their ids.
    scale_to_mm : float, optional
        Millimetres in the unit of the file; millimetres themselves if not given, or if OCCT
        cannot write that unit.

    Raises
    ------
    OSError
        If the kernel cannot write the file.
    """
    document = _Document(compound, name)
    document.add(parts, patches)
    unit = STEP_UNITS.get(scale_to_mm or 1.0, "MM")
    write_document(
        document.native, path, name=name, unit=unit, author="breplake", paints=document.paints
    )


class _Document:
    """An XCAF document of a model: one product, or an assembly of them."""

    def __init__(self, compound: Any, name: str) -> None:
        from OCP.TopAbs import TopAbs_ShapeEnum
        from OCP.TopExp import TopExp
        from OCP.TopoDS import TopoDS_Iterator
        from OCP.TopTools import TopTools_IndexedMapOfShape
        from OCP.XCAFDoc import XCAFDoc_DocumentTool

        self.native = new_document()
        self.paints: list[Paint] = []
        self._name = name
        self._tool = XCAFDoc_DocumentTool.ShapeTool_s(self.native.Main())
        self._products: dict[tuple[Any, ...], Any] = {}
        self._used: set[int] = set()
        self._faces = TopTools_IndexedMapOfShape()
        TopExp.MapShapes_s(compound, TopAbs_ShapeEnum.TopAbs_FACE, self._faces)
        self._items = []
        iterator = TopoDS_Iterator(compound)
        while iterator.More():
            self._items.append(iterator.Value())
            iterator.Next()

    def add(self, parts: Sequence[_Row], patches: Sequence[_Row]) -> None:
        """Add all parts, and what belongs to none as one more."""
        from OCP.TopLoc import TopLoc_Location

        loose = self._items[len(parts) :]
        if len(parts) == 1 and not loose and self._items[0].Location().IsIdentity():
            self._product(self._items[0], parts[0], patches)
            return
        once = len({part["shape"] for part in parts}) == len(parts)
        if once and all(part["name"] is None and self._is_rigid(i) for i, part in enumerate(parts)):
            self._one_product(parts, patches)
            return
        root = self._tool.NewShape()
        set_name(root, self._name)
        for i, (item, part) in enumerate(zip(self._items, parts, strict=False)):
            # STEP places by rigid motions alone: others become part of the geometry.
            rigid = self._is_rigid(i)
            product = self._product(item, part, patches, bake=not rigid)
            location = item.Location() if rigid else TopLoc_Location()
            set_name(self._tool.AddComponent(root, product, location), part["name"] or "")
        if loose:
            product = self._tool.AddShape(_compound(loose), False)
            set_name(product, "")
            set_name(self._tool.AddComponent(root, product, TopLoc_Location()), "")
        self._tool.UpdateAssemblies()

    def _is_rigid(self, i: int) -> bool:
        return bool(self._items[i].Location().Transformation().ScaleFactor() == 1)

    def _one_product(self, parts: Sequence[_Row], patches: Sequence[_Row]) -> None:
        """Add everything as one product without a name.

        In an assembly, readers would call the parts by the numbers of their instances.
        """
        from OCP.ShapeCustom import ShapeCustom
        from OCP.TopoDS import TopoDS_Iterator

        whole = ShapeCustom.DirectFaces_s(_compound(self._items))
        set_name(self._tool.AddShape(whole, False), "")
        iterator = TopoDS_Iterator(whole)
        for item, part in zip(self._items, parts, strict=False):
            looks = self._looks(item, patches)
            self._paint(iterator.Value(), part["colour"], looks, whole)
            iterator.Next()

    def _looks(self, item: Any, patches: Sequence[_Row]) -> tuple[tuple[Any, Any], ...]:
        """Return name and colour of each face of a part."""
        from OCP.TopAbs import TopAbs_ShapeEnum

        found = [self._faces.FindIndex(f) for f in explore(item, TopAbs_ShapeEnum.TopAbs_FACE)]
        rows = [patches[i - 1] if i else {} for i in found]
        return tuple((row.get("name"), row.get("colour")) for row in rows)

    def _product(
        self, item: Any, part: _Row, patches: Sequence[_Row], *, bake: bool = False
    ) -> Any:
        """Return the label of a part's shape, painted and named like this instance of it."""
        from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy, BRepBuilderAPI_Transform
        from OCP.ShapeCustom import ShapeCustom
        from OCP.TopLoc import TopLoc_Location

        looks = self._looks(item, patches)
        key = (part["shape"], str(item.Orientation()), part["name"], part["colour"], looks)
        if not bake and key in self._products:
            return self._products[key]
        shape = item.Located(TopLoc_Location())
        if bake:
            motion = item.Location().Transformation()
            shape = BRepBuilderAPI_Transform(shape, motion, True).Shape()
        elif part["shape"] in self._used:
            shape = BRepBuilderAPI_Copy(shape, False).Shape()
        # STEP has no left-handed axes. What the writer would replace by itself, it would not
        # find again to be painted.
        shape = ShapeCustom.DirectFaces_s(shape)
        label = self._tool.AddShape(shape, False)
        if not bake:
            self._used.add(part["shape"])
            self._products[key] = label
        set_name(label, part["name"] or "")
        self._paint(shape, part["colour"], looks, shape)
        return label

    def _paint(
        self, shape: Any, colour: str | None, looks: Sequence[tuple[Any, Any]], product: Any
    ) -> None:
        from OCP.TopAbs import TopAbs_ShapeEnum

        if colour is not None:
            self.paints.append(Paint(shape, "", _colour(colour), product))
        faces = explore(shape, TopAbs_ShapeEnum.TopAbs_FACE)
        for face, (name, own) in zip(faces, looks, strict=True):
            # A patch without a colour of its own has that of its part.
            own = None if own is None or own == colour else _colour(own)
            if name or own is not None:
                self.paints.append(Paint(face, name or "", own, product))


def _compound(shapes: Sequence[Any]) -> Any:
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    builder, compound = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(compound)
    for shape in shapes:
        builder.Add(compound, shape)
    return compound


def _colour(code: str) -> Any:
    """Return the ``Quantity_Color`` of ``#rrggbb`` in sRGB."""
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor

    red, green, blue = (int(code[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return Quantity_Color(red, green, blue, Quantity_TypeOfColor.Quantity_TOC_sRGB)
