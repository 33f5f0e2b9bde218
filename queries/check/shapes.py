"""Rules on the shape graph from which a B-Rep is rebuilt."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import pyarrow as pa

from breplake.queries.check.rules import Measure, model_rule, place
from breplake.queries.check.view import MISSING, Ints, ModelView
from breplake.schema.shape_tables import ORIENTATIONS, SHAPE_TYPES

__all__: list[str] = []

_NEEDS = ("ids-dense", "references", "words")

_OF_TYPE: Final = (
    ("patches", "face"),
    ("curves", "edge"),
    ("corners", "vertex"),
)
"""Tables whose rows name shapes of one type each."""

_RANK: Final = {name: rank for rank, name in enumerate(SHAPE_TYPES)}


@model_rule(
    "shape-graph",
    "sub-shapes are there, of a lower type than their shape, and all hang on shape 0",
    needs=_NEEDS,
)
def shape_graph(view: ModelView) -> Iterator[Measure]:
    """Measure each child; only compounds may hold compounds, so that no shape holds itself."""
    count = view.count("shapes")
    parent, child, orientation, _ = _children(view)
    inside = (child >= 0) & (child < count)
    yield Measure.of_truth(inside, place("shape {0}: child {1}", parent, child))
    known = np.isin(orientation, ORIENTATIONS)
    yield Measure.of_truth(known, place("shape {0}: orientation {1!r}", parent, orientation))
    if not inside.all():
        return
    rank = np.array([_RANK[word] for word in view.words("shapes", "type")], dtype=np.int64)
    both_compound = (rank[parent] == 0) & (rank[child] == 0) & (child > parent)
    lower = (rank[child] > rank[parent]) | both_compound
    # An internal vertex may hang on a face, and such: any lower type will do.
    yield Measure.of_truth(lower, place("shape {0}: child {1} is of no lower type", parent, child))
    used = np.zeros(count, dtype=bool)
    used[child] = True
    used[:1] = True
    yield Measure.of_truth(used, lambda i: f"shape {i} hangs on no other")


@model_rule("placements", "locations refer to motions that are there", needs=_NEEDS)
def placements(view: ModelView) -> Iterator[Measure]:
    """Measure every motion that a child, a surface or a curve's location names."""
    count = view.count("motions")
    *_, nested = _children(view)
    columns = [("shapes", "children", nested)]
    for table, column in (
        ("shapes", "placement"),
        ("edge_curves", "placement"),
        ("edge_curves", "placement2"),
    ):
        columns.append((table, column, _flat(view, table, column)))
    for table, column, steps in columns:
        motion = _numbers(_field(steps, "motion"))
        ok = (motion >= 0) & (motion < count)
        yield Measure.of_truth(ok, place("{t}.{c}: motion {0}", motion, t=table, c=column))


@model_rule(
    "shape-rows",
    "patches, curves and corners name faces, edges and vertices of the shape graph, and every one "
    "is named",
    needs=(*_NEEDS, "shape-graph"),
)
def shape_rows(view: ModelView) -> Iterator[Measure]:
    """Measure the types of named shapes, and that no shape of the type is left out.

    Models without a shape graph, which come from meshes, name none.
    """
    if not view.count("shapes"):
        return
    types = view.words("shapes", "type")
    for table, kind in _OF_TYPE:
        shape = view.ints(table, "shape")
        ok = (shape != MISSING) & (types[np.where(shape == MISSING, 0, shape)] == kind)
        yield Measure.of_truth(ok, place("{t} row {i}: shape {0}", shape, t=table))
        wanted = np.flatnonzero(types == kind)
        yield Measure.of_truth(
            np.isin(wanted, shape), place("shape {0}: no row of {t}", wanted, t=table)
        )


@model_rule(
    "edge-curves",
    "what an edge carries has its parts: a curve, a pcurve and its surface, two on a seam ...",
    needs=_NEEDS,
)
def edge_curves(view: ModelView) -> Iterator[Measure]:
    """Measure which columns are null in each kind of row."""
    kinds = view.words("edge_curves", "kind")
    given = {
        name: view.ints("edge_curves", name) != MISSING
        for name in ("surface", "pcurve", "pcurve2", "surface2")
    }
    ranged = ~np.isnan(view.floats("edge_curves", "t_min"))
    ranged &= ~np.isnan(view.floats("edge_curves", "t_max"))
    # A degenerate edge has a curve in space that is none.
    wanted = {
        "curve": ((), ranged),
        "pcurve": (("surface", "pcurve"), ranged),
        "seam": (("surface", "pcurve", "pcurve2"), ranged),
        "continuity": (("surface", "surface2"), ~ranged),
    }
    for kind, (names, rest) in wanted.items():
        rows = np.flatnonzero(kinds == kind)
        ok = rest[rows]
        for name, there in given.items():
            ok = ok & (there[rows] == (name in names))
        yield Measure.of_truth(ok, place("edge_curves row {0}: {k}", rows, k=kind))


def _children(view: ModelView) -> tuple[Ints, Ints, Any, pa.Array]:
    """Return parent, child and orientation of each use of a shape, and all its placements' steps.

    Returns
    -------
    parent, child : numpy.ndarray
        ``(n,)`` int64.
    orientation : numpy.ndarray
        ``(n,)`` of str.
    steps : pyarrow.StructArray
        Motions and powers of all uses.
    """
    lists = _combined(view, "shapes", "children")
    lengths = lists.value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
    uses = lists.flatten()
    parent = np.repeat(np.arange(len(lengths)), lengths.astype(np.int64))
    orientation = np.asarray(_field(uses, "orientation").to_pylist(), dtype=object)
    return parent, _numbers(_field(uses, "shape")), orientation, _field(uses, "placement").flatten()


def _flat(view: ModelView, table: str, column: str) -> pa.Array:
    return _combined(view, table, column).flatten()


def _combined(view: ModelView, table: str, column: str) -> pa.Array:
    chunked = view.table(table).column(column)
    array = chunked.combine_chunks()
    if isinstance(array, pa.ChunkedArray):  # combine_chunks keeps the class when empty
        array = pa.array([], type=array.type)
    return array


def _field(array: pa.Array, name: str) -> pa.Array:
    return array.field(array.type.get_field_index(name))


def _numbers(array: pa.Array) -> Ints:
    return np.asarray(array.to_numpy(zero_copy_only=False), dtype=np.int64)
