"""What a STEP file carries of a model: its tables against those that the file is ingested to."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from breplake.schema.contract import VEC3
from breplake.schema.curves import CurveSet
from breplake.schema.namespace import Floats, Ints
from breplake.schema.periods import curve_periods, surface_periods
from breplake.schema.surfaces import SurfaceSet

__all__ = ["CARRIED", "LOST", "MEASURED", "table_differences"]

CARRIED: Final = ("parts", "patches", "curves", "coedges", "corners")
"""Tables that a STEP file carries; the others hold how a model is stored, not what it is."""

LOST: Final = frozenset(
    {
        *("model_id", "tolerance", "shape", "pcurve", "stored_continuity"),
        *("vert_indices", "vert_parameters", "vertex_id"),
    }
)
"""Columns that STEP does not carry: it has one tolerance for all, neither shape graph nor mesh, and
no flags of smoothness."""

EXACT_LIMIT: Final = 1e-9
"""Difference that counts as none, relative to the number, or to 1, or of points to the model's
size: STEP is printed with 15 digits, of which sums and roots lose some."""

MEASURED: Final = {
    "parts": ("volume", "area", "centroid", "bbox_min", "bbox_max"),
    "patches": ("area", "u_min", "u_max", "v_min", "v_max"),
    "curves": ("length", "angle_min", "angle_max"),
}
"""Columns of integrals and extrema, which depend on pcurves and tolerances too: the kernel computes
pcurves anew where STEP has none, and adapts its quadrature."""

MEASURED_LIMIT: Final = 1e-5
"""Difference of those that counts as none, relative to the largest of the column."""

_WEIGHTS: Final = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0])
"""By which what tells rows apart is added up: no simple sum of it is the same for two of them."""


def table_differences(before: Mapping[str, pa.Table], after: Mapping[str, pa.Table]) -> list[str]:
    """Say which columns of the tables that STEP carries differ.

    STEP does not number curves and corners, nor does it say where a loop begins or in which turn
    a periodic parameter lies: those may differ.

    Parameters
    ----------
    before, after : mapping
        Tables of one model by name, of `CARRIED` at least.

    Returns
    -------
    list of str
        A phrase for each column with a difference beyond `EXACT` or `MEASURED`, columns of
        `LOST` aside.
    """
    found = [
        f"{name}: {after[name].num_rows} rows, not {before[name].num_rows}"
        for name in CARRIED
        if after[name].num_rows != before[name].num_rows
    ]
    if found:
        return found
    size = _diagonal(before["parts"])
    return [
        f"{name}.{column} differs{how}"
        for name, old, new, turns in _matched(before, after, size)
        for column in old.column_names
        if column not in LOST
        for how in _difference(
            _whole(old, column),
            _whole(new, column),
            measured=column in MEASURED.get(name, ()),
            size=size,
            turn=turns.get(column, np.inf),
        )
    ]


def _difference(
    old: pa.Array, new: pa.Array, *, measured: bool, size: float, turn: Floats | float
) -> list[str]:
    """Say by how much a column differs, if it does."""
    scale = size if old.type == VEC3 else 1.0
    if measured and pa.types.is_floating(old.type):
        known = _numbers(old)[old.is_valid().to_numpy(zero_copy_only=False)]
        scale = float(np.max(np.abs(known), initial=1.0))
    apart = _apart(old, new, scale, turn)
    if apart <= (MEASURED_LIMIT if measured else EXACT_LIMIT):
        return []
    return ["" if math.isinf(apart) else f" by up to {apart:.1e}"]


def _matched(
    before: Mapping[str, pa.Table], after: Mapping[str, pa.Table], size: float
) -> Iterator[tuple[str, pa.Table, pa.Table, dict[str, Floats]]]:
    """Yield name and both states of each table, rows that mean the same at the same place.

    With them come the periods of its columns that turn, ``(n,)`` each.
    """
    yield "parts", before["parts"], after["parts"], {}
    old = before["patches"]
    u, v = surface_periods(old, SurfaceSet.from_patches(old))
    yield "patches", old, after["patches"], {"u_min": u, "u_max": u, "v_min": v, "v_max": v}
    curves = _order(*(_curve_keys(tables["curves"], size) for tables in (before, after)))
    number = _inverse(curves)  # of each curve after, the one before
    corners = _order(
        _corner_keys(before, np.arange(len(curves)), size), _corner_keys(after, number, size)
    )
    new = _renumbered(after["curves"].take(curves), "curve_id", number)
    for column in ("start_corner", "end_corner"):
        new = _renumbered(new, column, _inverse(corners))
    turn = curve_periods(CurveSet.from_curves(before["curves"]))
    yield "curves", before["curves"], new, {"t_min": turn, "t_max": turn}
    order = [(name, "ascending") for name in ("patch_id", "curve_id", "reversed")]
    uses = before["coedges"], _renumbered(after["coedges"], "curve_id", number)
    old, new = (table.sort_by(order).drop_columns(["loop", "place"]) for table in uses)
    old, new = _both(old, new, "t_min", "t_max")
    turn = turn[_whole(old, "curve_id").to_numpy()]
    yield "coedges", old, new, {"t_min": turn, "t_max": turn}
    new = _renumbered(after["corners"].take(corners), "corner_id", _inverse(corners))
    yield "corners", before["corners"], new, {}


def _both(old: pa.Table, new: pa.Table, *columns: str) -> tuple[pa.Table, pa.Table]:
    """Empty columns where one of the two is: a plane's pcurves need not be stored."""
    for column in columns:
        at = old.schema.get_field_index(column)
        there = pc.and_(_whole(old, column).is_valid(), _whole(new, column).is_valid())
        old, new = (
            table.set_column(at, table.schema.field(at), pc.if_else(there, table[column], None))
            for table in (old, new)
        )
    return old, new


def _order(before: Floats, after: Floats) -> Ints:
    """Return which row after is which row before, by keys that differ by rounding alone."""
    found = np.empty(len(before), dtype=np.int64)
    found[np.argsort(before, kind="stable")] = np.argsort(after, kind="stable")
    return found


def _inverse(order: Ints) -> Ints:
    found = np.empty_like(order)
    found[order] = np.arange(len(order))
    return found


def _renumbered(table: pa.Table, column: str, number: Ints) -> pa.Table:
    at = table.schema.get_field_index(column)
    old = _whole(table, column)
    there = old.is_valid().to_numpy(zero_copy_only=False)
    new = pa.array(number[old.fill_null(0).to_numpy()], old.type, mask=~there)
    return table.set_column(at, table.schema.field(at), new)


def _curve_keys(curves: pa.Table, size: float) -> Floats:
    """Return numbers ``(n,)`` that tell curves apart by middle, length and patches."""
    t_min, t_max, length = (_numbers(_whole(curves, n)) for n in ("t_min", "t_max", "length"))
    rows = np.arange(curves.num_rows)
    middle = CurveSet.from_curves(curves).evaluate(rows, (t_min + t_max) / 2).point
    patches = np.stack(
        [_whole(curves, n).fill_null(-1).to_numpy() for n in ("left_patch", "right_patch")]
    )
    marks = [*middle.T, length, size * patches.sum(axis=0), size * patches.prod(axis=0)]
    keys: Floats = np.nan_to_num(np.stack(marks)).T @ _WEIGHTS
    return keys


def _corner_keys(tables: Mapping[str, pa.Table], number: Ints, size: float) -> Floats:
    """Return numbers ``(n,)`` that tell corners apart by place and curves."""
    corners, curves = tables["corners"], tables["curves"]
    used = np.zeros(corners.num_rows)
    for column in ("start_corner", "end_corner"):
        ends = _whole(curves, column)
        there = ends.is_valid().to_numpy(zero_copy_only=False)
        np.add.at(used, ends.drop_null().to_numpy(), size * np.sqrt(1.0 + number[there]))
    places = [_numbers(pc.struct_field(_whole(corners, "point"), axis)) for axis in ("x", "y", "z")]
    keys: Floats = np.stack([*places, used]).T @ _WEIGHTS[:4]
    return keys


def _diagonal(parts: pa.Table) -> float:
    """Return the size of a model, mm; 1 if it has none."""
    if not parts.num_rows:
        return 1.0
    corners = [
        [_numbers(pc.struct_field(_whole(parts, side), axis)) for axis in ("x", "y", "z")]
        for side in ("bbox_min", "bbox_max")
    ]
    extent = np.max(corners[1], axis=1) - np.min(corners[0], axis=1)
    return float(np.linalg.norm(extent)) or 1.0


def _whole(table: pa.Table, column: str) -> pa.Array:
    return table.column(column).combine_chunks()


def _numbers(values: pa.Array) -> Floats:
    found: Floats = values.fill_null(np.nan).to_numpy(zero_copy_only=False)
    return found


def _apart(old: Any, new: Any, scale: float, period: Floats | float = np.inf) -> float:
    """Return how far values are apart, relative to `scale` or to them; infinite if not a number."""
    if not old.is_valid().equals(new.is_valid()):
        return math.inf
    if pa.types.is_struct(old.type):
        fields = range(old.type.num_fields)
        parts = ((pc.struct_field(old, i), pc.struct_field(new, i)) for i in fields)
        return max((_apart(a, b, scale) for a, b in parts), default=0.0)
    if pa.types.is_list(old.type) or pa.types.is_fixed_size_list(old.type):
        if not pc.list_value_length(old).equals(pc.list_value_length(new)):
            return math.inf
        return _apart(old.flatten(), new.flatten(), scale)
    if not pa.types.is_floating(old.type):
        return 0.0 if old.equals(new) else math.inf
    a, b = (values.fill_null(0.0).to_numpy(zero_copy_only=False) for values in (old, new))
    same = (a == b) | (np.isnan(a) & np.isnan(b))  # also of bounds that are infinite
    with np.errstate(invalid="ignore"):
        difference = a - b
        turned = np.isfinite(period) & np.isfinite(difference)
        turns = np.round(np.divide(difference, period, out=np.zeros_like(a), where=turned))
        difference = difference - np.where(turned, turns * period, 0.0)
        size = np.maximum(scale, np.maximum(np.abs(a), np.abs(b)))
        relative = np.where(same, 0.0, np.abs(difference) / size)
    return float(np.max(np.where(np.isnan(relative), math.inf, relative), initial=0.0))
