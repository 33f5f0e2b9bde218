"""The tables of a model back to the B-Rep in the kernel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, Protocol, TypeAlias

import pyarrow as pa

from breplake.errors import LakeFormatError
from breplake.ingest.lossless import exact
from breplake.ingest.lossless.columns import table_rows
from breplake.ingest.lossless.geometry_in import GeometryBuilder
from breplake.schema.shape_tables import SHAPE_TABLES

__all__ = ["ModelTables", "rebuild", "rebuilt_shapes"]

_Row: TypeAlias = Mapping[str, Any]

_MAKERS: Final = {
    "compound": ("TopoDS_Compound", "MakeCompound"),
    "compsolid": ("TopoDS_CompSolid", "MakeCompSolid"),
    "solid": ("TopoDS_Solid", "MakeSolid"),
    "shell": ("TopoDS_Shell", "MakeShell"),
    "face": ("TopoDS_Face", "MakeFace"),
    "wire": ("TopoDS_Wire", "MakeWire"),
    "edge": ("TopoDS_Edge", "MakeEdge"),
    "vertex": ("TopoDS_Vertex", "MakeVertex"),
}
"""Class and builder method of each type of shape."""

_SCALED_TOO: Final = False
"""Placements that scale are not refused: files have them."""

_FLAGS: Final = (
    *("free", "orientable", "closed", "infinite", "convex"),
    *("modified", "checked", "locked"),
)
"""Flags in an order in which none changes one that is set already."""


class ModelTables(Protocol):
    """A lake that gives the rows of one model: ``breplake.open`` returns one."""

    def model(self, name_or_id: str | int) -> dict[str, Any]:
        """Return the row of a model in ``models``."""

    def read(self, table: str, model_id: int) -> pa.Table:
        """Return the rows of one model in a table, sorted by its key."""


def rebuild(lake: ModelTables, model: str | int) -> Any:
    """Return the B-Rep of a model, made from the tables of `lake` alone.

    Parameters
    ----------
    lake : breplake.queries.session.Lake
        The lake.
    model : str or int
        Name or id.

    Returns
    -------
    TopoDS_Compound
        Its patches, curves and corners have the ids of their places in OCCT's
        ``TopExp::MapShapes``, less one. Lengths are millimetres.

    Raises
    ------
    NameNotFoundError
        If there is no such model.
    LakeFormatError
        If the lake has no shapes of the model, or they contradict each other.
    """
    model_id = lake.model(model)["model_id"]
    return rebuilt_shapes({t.name: lake.read(t.name, model_id) for t in SHAPE_TABLES})[0]


def rebuilt_shapes(tables: Mapping[str, pa.Table]) -> list[Any]:
    """Return all shapes of a model by their ids, without location.

    Parameters
    ----------
    tables : mapping
        The tables of ``schema.shape_tables`` by name, with the rows of one model by key.

    Raises
    ------
    LakeFormatError
        If there are no shapes, or they contradict each other.
    """
    if not tables["shapes"].num_rows:
        raise LakeFormatError(
            "the model has no rows in shapes: its lake was written before they were kept, or "
            "the model came without a B-Rep; ingest it again from its CAD file"
        )
    return _ShapeBuilder(tables).build()


class _ShapeBuilder:
    def __init__(self, tables: Mapping[str, pa.Table]) -> None:
        rows = {
            name: table_rows(tables[name])
            for name in ("edge_curves", "motions", "surfaces", "space_curves", "pcurves")
        }
        self._geometry = GeometryBuilder(rows["surfaces"], rows["space_curves"], rows["pcurves"])
        self._motions = [_datum(row) for row in rows["motions"]]
        self._edge_curves: dict[int, list[_Row]] = {}
        for row in rows["edge_curves"]:
            self._edge_curves.setdefault(row["shape_id"], []).append(row)
        shapes = tables["shapes"]
        self._children = shapes.column("children").to_pylist()
        self._rows = table_rows(shapes.drop_columns("children"))
        self._made: dict[int, Any] = {}

    def build(self) -> list[Any]:
        """Return all shapes by id, each made once however often it is used."""
        shapes = [self._shape(number) for number in range(len(self._rows))]
        # Only now, because adding a shape to another changes flags of both.
        for shape, row in zip(shapes, self._rows, strict=True):
            for flag in _FLAGS:
                getattr(shape.TShape(), flag.title())(row[flag])
        return shapes

    def _shape(self, number: int) -> Any:
        if not 0 <= number < len(self._rows):
            raise LakeFormatError(f"there is no shape {number}; run breplake check")
        if number not in self._made:
            self._made[number] = None  # met again while it is made: it lies within itself
            self._made[number] = self._make(number, self._rows[number])
        if self._made[number] is None:
            raise LakeFormatError(f"shape {number} lies within itself; run breplake check")
        return self._made[number]

    def _make(self, number: int, row: _Row) -> Any:
        from OCP import TopoDS
        from OCP.BRep import BRep_Builder

        if row["type"] not in _MAKERS:
            raise LakeFormatError(f"shapes: no shape is called {row['type']!r}")
        name, method = _MAKERS[row["type"]]
        shape, builder = getattr(TopoDS, name)(), BRep_Builder()
        getattr(builder, method)(shape)
        self._fill(number, row, shape)
        for child in self._children[number]:
            placed = self._shape(child["shape"]).Oriented(_orientation(child["orientation"]))
            powers = [(item["motion"], item["power"]) for item in child["placement"]]
            placed.Location(self._location(powers), _SCALED_TOO)
            builder.Add(shape, placed)
        return shape

    def _fill(self, number: int, row: _Row, shape: Any) -> None:
        """Give a face, edge or vertex its geometry."""
        stored = shape.TShape()
        if row["type"] == "face":
            stored.Surface(self._geometry.surface(row["surface"]))
            stored.Location(self._location(row["placement"]))
            stored.NaturalRestriction(row["natural_restriction"])
        elif row["type"] == "edge":
            stored.SameParameter(row["same_parameter"])
            stored.SameRange(row["same_range"])
            stored.Degenerated(row["degenerated"])
            curves = stored.ChangeCurves()
            for curve in self._edge_curves.get(number, ()):
                curves.Append(self._edge_curve(curve))
        elif row["type"] == "vertex":
            stored.Pnt(exact.point(row["point"]))
        if row["tolerance"] is not None:
            stored.Tolerance(row["tolerance"])

    def _edge_curve(self, row: _Row) -> Any:
        from OCP import BRep

        geometry, location = self._geometry, self._location(row["placement"])
        kind = row["kind"]
        if kind == "continuity":
            location2 = self._location(row["placement2"])
            sides = geometry.surface(row["surface"]), geometry.surface(row["surface2"])
            order = _continuity(row["continuity"])
            return BRep.BRep_CurveOn2Surfaces(*sides, location, location2, order)
        if kind == "curve":
            made = BRep.BRep_Curve3D(geometry.space_curve(row["space_curve"]), location)
        else:
            surface, pcurve = geometry.surface(row["surface"]), geometry.pcurve(row["pcurve"])
            if kind == "seam":
                second = geometry.pcurve(row["pcurve2"])
                order = _continuity(row["continuity"])
                made = BRep.BRep_CurveOnClosedSurface(pcurve, second, surface, location, order)
            elif kind == "pcurve":
                made = BRep.BRep_CurveOnSurface(pcurve, surface, location)
            else:
                raise LakeFormatError(f"edge_curves: nothing is called {kind!r}")
        made.SetRange(row["t_min"], row["t_max"])
        return made

    def _location(self, placement: Sequence[tuple[int, int]]) -> Any:
        """Return the ``TopLoc_Location`` of powers of motions, the leftmost applied last."""
        from OCP.TopLoc import TopLoc_Location

        location = TopLoc_Location()
        for motion, power in placement:
            step = TopLoc_Location(self._motions[int(motion)]).Powered(int(power))
            location = location.Multiplied(step)
        return location


def _datum(row: _Row) -> Any:
    from OCP.TopLoc import TopLoc_Datum3D

    rows = (row["row_x"], row["row_y"], row["row_z"])
    return TopLoc_Datum3D(exact.motion(row["form"], row["scale"], rows, row["translation"]))


def _orientation(name: str) -> Any:
    from OCP.TopAbs import TopAbs_Orientation

    return getattr(TopAbs_Orientation, f"TopAbs_{name.upper()}")


def _continuity(name: str) -> Any:
    from OCP.GeomAbs import GeomAbs_Shape

    return getattr(GeomAbs_Shape, f"GeomAbs_{name}")
