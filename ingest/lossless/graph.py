"""The shape graph (``TopoDS_TShape``) to the tables ``shapes``, ``edge_curves`` and ``motions``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
import pyarrow as pa

from breplake.ingest.lossless.columns import column_array, rows_table
from breplake.ingest.lossless.geometry_out import Geometry
from breplake.ingest.lossless.handles import Handles
from breplake.ingest.lossless.placements import Placement, motion_row, placement
from breplake.schema.shape_tables import (
    EDGE_CURVES,
    MOTIONS,
    ORIENTATIONS,
    PCURVES,
    PLACEMENT,
    SHAPE_TYPES,
    SHAPES,
    SPACE_CURVES,
    SURFACES,
)

__all__ = ["Child", "PcurveUse", "ShapeGraph"]

_Row: TypeAlias = dict[str, Any]

_FLAGS: Final = tuple(
    (name, name.title())
    for name in (
        *("free", "modified", "checked", "orientable"),
        *("closed", "infinite", "convex", "locked"),
    )
)
"""Columns of ``shapes`` and the methods of ``TopoDS_TShape`` of the same meaning."""


_GEOMETRY: Final = (SURFACES, SPACE_CURVES, PCURVES)


@dataclass(frozen=True, slots=True)
class Child:
    """A sub-shape: its number, index in ``ORIENTATIONS`` and placement."""

    shape: int
    orientation: int
    placement: Placement


@dataclass(frozen=True, slots=True)
class PcurveUse:
    """The pcurve of an edge on a face: its number and range, all None if there is none."""

    pcurve: int | None = None
    t_min: float | None = None
    t_max: float | None = None


class ShapeGraph:
    """All shapes below a compound, numbered depth first, and the geometry they refer to.

    Parameters
    ----------
    compound : TopoDS_Compound
        Without location, so that its own number 0 says all.
    """

    def __init__(self, compound: Any) -> None:
        self._shapes, self._motions = Handles(), Handles()
        self._geometry = Geometry()
        self._rows: dict[int, _Row] = {}
        self._children: dict[int, list[Child]] = {}
        self._edge_curves: dict[int, list[tuple[_Row, Any]]] = {}
        self._visit(compound)

    def number(self, shape: Any) -> int:
        """Return the row in ``shapes`` of a shape of the model, wherever it is placed."""
        return self._shapes.find(shape.TShape())

    def pcurve(self, edge: Any, surface: Any, location: Any) -> PcurveUse:
        """Return the stored pcurve of an edge as a face uses it.

        Parameters
        ----------
        edge : TopoDS_Edge
            Oriented as in the face that is oriented forward; on a seam this decides between its
            two pcurves.
        surface : Geom_Surface
            The face's.
        location : TopLoc_Location
            Where the face has it.
        """
        from OCP.TopAbs import TopAbs_Orientation

        location = location.Predivided(edge.Location())
        for row, stored in self._edge_curves[self.number(edge)]:
            if stored.IsCurveOnSurface(surface, location):
                backward = edge.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
                second = backward and row["kind"] == "seam"
                return PcurveUse(row["pcurve2" if second else "pcurve"], row["t_min"], row["t_max"])
        return PcurveUse()

    def tables(self, model_id: int) -> dict[str, pa.Table]:
        """Return the tables of ``schema.shape_tables``."""
        edge_curves = [
            {"shape_id": shape, "place": place, **row}
            for shape, rows in self._edge_curves.items()
            for place, (row, _) in enumerate(rows)
        ]
        motions = [{"motion_id": i} | motion_row(datum) for i, datum in enumerate(self._motions)]
        geometry = self._geometry.rows()
        return {
            SHAPES.name: self._shape_table(model_id),
            EDGE_CURVES.name: rows_table(EDGE_CURVES, model_id, edge_curves),
            MOTIONS.name: rows_table(MOTIONS, model_id, motions),
            **{t.name: rows_table(t, model_id, geometry[t.name]) for t in _GEOMETRY},
        }

    def _shape_table(self, model_id: int) -> pa.Table:
        rows = [{"shape_id": i} | self._rows[i] for i in range(len(self._shapes))]
        table = rows_table(SHAPES, model_id, rows)
        place = table.schema.get_field_index("children")
        return table.set_column(
            place, table.schema.field(place), _child_lists(list(self._children.values()))
        )

    def _visit(self, shape: Any) -> int:
        """Give a shape and everything below it numbers, and return its own."""
        from OCP.TopoDS import TopoDS_Iterator

        seen = len(self._shapes)
        number = self._shapes.add(shape.TShape())
        if number < seen:
            return number
        self._rows[number] = self._row(number, shape.TShape())
        children = self._children[number] = []
        iterator = TopoDS_Iterator(shape, False, False)
        while iterator.More():
            child = iterator.Value()
            children.append(
                Child(
                    self._visit(child),
                    child.Orientation().value,
                    placement(child.Location(), self._motions),
                )
            )
            iterator.Next()
        return number

    def _row(self, number: int, stored: Any) -> _Row:
        kind = SHAPE_TYPES[stored.ShapeType().value]
        row: _Row = {"type": kind, "children": ()}
        row |= {column: getattr(stored, method)() for column, method in _FLAGS}
        if kind == "vertex":
            point = stored.Pnt()
            row |= {"tolerance": stored.Tolerance(), "point": (point.X(), point.Y(), point.Z())}
        elif kind == "edge":
            row |= {
                "tolerance": stored.Tolerance(),
                "same_parameter": stored.SameParameter(),
                "same_range": stored.SameRange(),
                "degenerated": stored.Degenerated(),
            }
            self._edge_curves[number] = [
                (self._edge_curve(curve), curve) for curve in _representations(stored)
            ]
        elif kind == "face":
            row |= {
                "tolerance": stored.Tolerance(),
                "surface": self._geometry.surfaces.optional(stored.Surface()),
                "placement": placement(stored.Location(), self._motions),
                "natural_restriction": stored.NaturalRestriction(),
            }
        return row

    def _edge_curve(self, stored: Any) -> _Row:
        row: _Row = {"placement": placement(stored.Location(), self._motions)}
        if not (stored.IsCurve3D() or stored.IsCurveOnSurface()):
            return row | {
                "kind": "continuity",
                "surface": self._geometry.surfaces.add(stored.Surface()),
                "surface2": self._geometry.surfaces.add(stored.Surface2()),
                "placement2": placement(stored.Location2(), self._motions),
                "continuity": _continuity(stored.Continuity()),
            }
        row |= {"t_min": stored.First(), "t_max": stored.Last()}
        if stored.IsCurve3D():
            curve = self._geometry.space_curves.optional(stored.Curve3D())
            return row | {"kind": "curve", "space_curve": curve}
        row |= {
            "kind": "pcurve",
            "surface": self._geometry.surfaces.add(stored.Surface()),
            "pcurve": self._geometry.pcurves.add(stored.PCurve()),
        }
        if stored.IsCurveOnClosedSurface():
            row |= {
                "kind": "seam",
                "pcurve2": self._geometry.pcurves.add(stored.PCurve2()),
                "continuity": _continuity(stored.Continuity()),
            }
        return row


def _representations(edge: Any) -> list[Any]:
    """Return the representations of an edge that are geometry; triangulations are none.

    The end of an iteration over the kernel's list is a C++ exception, which costs a hundred
    times what taking a copy of the list apart does.
    """
    from OCP.BRep import BRep_ListOfCurveRepresentation

    left = BRep_ListOfCurveRepresentation()
    left.Assign(edge.Curves())
    found = []
    while not left.IsEmpty():
        curve = left.First()
        left.RemoveFirst()
        if curve.IsCurve3D() or curve.IsCurveOnSurface() or curve.IsRegularity():
            found.append(curve)
    return found


def _continuity(order: Any) -> str:
    return str(order.name).removeprefix("GeomAbs_")


def _child_lists(lists: list[list[Child]]) -> pa.Array:
    kind = SHAPES.column("children").type
    children = [child for found in lists for child in found]
    orientation = [ORIENTATIONS[child.orientation] for child in children]
    structs = pa.StructArray.from_arrays(
        [
            pa.array([child.shape for child in children], pa.int32()),
            pa.array(orientation, pa.string()),
            column_array(PLACEMENT, [child.placement for child in children]),
        ],
        fields=list(kind.value_type),
    )
    offsets = np.concatenate([[0], np.cumsum([len(found) for found in lists])]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), structs, type=kind)
