"""A rebuilt model through a STEP file and back: what its tables say then."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from breplake.ingest.brep import extract
from breplake.ingest.canonical import canonical
from breplake.ingest.heal import add_missing_pcurves
from breplake.ingest.load import load
from breplake.ingest.lossless.rebuild import rebuilt_shapes
from breplake.ingest.lossless.step_out import write_step
from breplake.ingest.rows import brep_tables

__all__ = ["CARRIED", "LOST", "TOLERANCE", "step_differences", "table_differences"]

CARRIED: Final = ("parts", "patches", "curves", "coedges", "corners")
"""Tables that a STEP file carries; the others hold how a model is stored, not what it is."""

LOST: Final = frozenset(
    {"model_id", "tolerance", "shape", "pcurve", "vert_indices", "vert_parameters", "vertex_id"}
)
"""Columns that STEP does not carry: it has one tolerance for all, no shape graph and no mesh."""

TOLERANCE: Final = 1e-9
"""Difference that counts as none, relative to the number or to 1 if that is more: STEP is printed
with 15 digits, of which sums, roots and integrals lose some."""

_BOUNDS: Final = frozenset({"u_min", "u_max", "v_min", "v_max"})


def step_differences(
    tables: Mapping[str, pa.Table], scale_to_mm: float | None, name: str
) -> list[str]:
    """Write a model as STEP from its tables, ingest that, and say which columns differ.

    Parameters
    ----------
    tables : mapping
        All tables of the model by name, mesh and arrays aside.
    scale_to_mm : float or None
        Millimetres in the unit to write.
    name : str
        Name of the model.

    Returns
    -------
    list of str
        As of `table_differences`.

    Raises
    ------
    LakeFormatError, InputError, OSError
        If the model cannot be rebuilt, or the file not be written or read.
    """
    rows = {table: tables[table].to_pylist() for table in ("parts", "patches")}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "again.step"
        compound = rebuilt_shapes(tables)[0]
        write_step(compound, path, name=name, scale_to_mm=scale_to_mm, **rows)
        document = load(path, "step")
    shapes = canonical(document.shapes)
    add_missing_pcurves(shapes.compound)
    return table_differences(tables, brep_tables(0, extract(shapes, document.labels)))


def table_differences(before: Mapping[str, pa.Table], after: Mapping[str, pa.Table]) -> list[str]:
    """Say which columns of the tables that STEP carries differ.

    Parameters
    ----------
    before, after : mapping
        Tables of one model by name, of `CARRIED` at least.

    Returns
    -------
    list of str
        A phrase for each column with a difference beyond `TOLERANCE`, columns of `LOST` aside. The
        bounds of a patch may be whole turns apart where it is periodic.
    """
    found = []
    for name in CARRIED:
        old, new = before[name], after[name]
        if len(old) != len(new):
            found.append(f"{name}: {len(new)} rows, not {len(old)}")
            continue
        for column in old.column_names:
            if column in LOST:
                continue
            turns = _turns(old, column) if name == "patches" and column in _BOUNDS else None
            apart = _apart(_whole(old, column), _whole(new, column), turns)
            if not apart <= TOLERANCE:
                how = "" if math.isinf(apart) else f" by up to {apart:.1e}"
                found.append(f"{name}.{column} differs{how}")
    return found


def _whole(table: pa.Table, column: str) -> pa.Array:
    chunks: Sequence[pa.Array] = table.column(column).chunks
    return chunks[0] if len(chunks) == 1 else pa.concat_arrays(chunks)


def _turns(patches: pa.Table, column: str) -> npt.NDArray[np.float64]:
    """Return the length of a turn, 0 where there is none, in the direction of a bound."""
    periodic = patches.column(f"{column[0]}_periodic").to_numpy()
    return np.where(periodic, 2 * math.pi, 0.0)


def _apart(old: Any, new: Any, turns: npt.NDArray[np.float64] | None = None) -> float:
    """Return how far values are apart, relative to them or to 1; infinity if not by a number."""
    if not old.is_valid().equals(new.is_valid()):
        return math.inf
    if pa.types.is_struct(old.type):
        fields = range(old.type.num_fields)
        parts = ((pc.struct_field(old, i), pc.struct_field(new, i)) for i in fields)
        return max((_apart(a, b) for a, b in parts), default=0.0)
    if pa.types.is_list(old.type) or pa.types.is_fixed_size_list(old.type):
        if not pc.list_value_length(old).equals(pc.list_value_length(new)):
            return math.inf
        return _apart(old.flatten(), new.flatten())
    if not pa.types.is_floating(old.type):
        return 0.0 if old.equals(new) else math.inf
    a, b = (values.fill_null(0.0).to_numpy(zero_copy_only=False) for values in (old, new))
    difference = a - b
    if turns is not None:
        whole = np.round(np.divide(difference, turns, out=np.zeros_like(a), where=turns > 0))
        difference = difference - whole * turns
    size = np.maximum(1.0, np.maximum(np.abs(a), np.abs(b)))
    # Bounds that do not exist are infinite, and NaN never counts as equal to anything else.
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore"):
        relative = np.where(same, 0.0, np.abs(difference) / size)
    return float(np.max(np.where(np.isnan(relative), math.inf, relative), initial=0.0))
