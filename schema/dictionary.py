"""The data dictionary: every table and array of a lake as one Markdown page.

``docs/tables.md`` is this page, written by ``make docs``; a test compares the two.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa

from breplake.schema.arrays import ARRAYS, AXES, CHUNK_ROWS, ArraySpec
from breplake.schema.contract import VEC2, VEC3, Column, Table
from breplake.schema.tables import CURVE_GEOMETRY, SCHEMA_VERSION, TABLES

__all__ = ["array_section", "dictionary", "table_section", "type_name"]

_NAMES: Final = {
    pa.int8(): "int8",
    pa.int16(): "int16",
    pa.int32(): "int32",
    pa.int64(): "int64",
    pa.float32(): "float32",
    pa.float64(): "float64",
    pa.bool_(): "bool",
    pa.string(): "string",
    VEC2: "vec2",
    VEC3: "vec3",
}

_CURVE: Final = pa.struct([column.field() for column in CURVE_GEOMETRY])
"""The type of a column that holds a whole curve."""

_AXIS_MEANING: Final = {
    "vertex": "mesh vertex",
    "normal": "(vertex, patch) pair: a vertex on a crease has one for each patch",
    "face": "triangle",
    "patch": "patch (B-Rep face); only in lakes with UV-grids, `breplake ingest --uv-grid N`",
    "curve": "curve (B-Rep edge); likewise",
}

_HEAD: Final = """\
# Tables and arrays

<!-- Written by `make docs` from schema/tables.py and schema/arrays.py: edit those. -->

What a lake of schema version {version} holds. Each table is a folder of Parquet files,
`tables/<table>/<shard>.parquet`; the arrays are one Zarr group per shard, `arrays/<shard>.zarr`.

- Lengths are millimetres, angles radians, curvatures 1/mm, whatever the file's own unit.
- Ids are 0-based and local to their model: `(model_id, patch_id)` is one patch.
- `vec3` is a struct of `x`, `y` and `z`, `vec2` one of `u` and `v`, all float64.
- Normals point out of the solid. A surface that bends toward its normal has positive curvature,
  so a sphere of radius R has `k_min = k_max = -1/R`.
- A quantity that is not defined is null (NaN in arrays), never a guess. Only columns marked
  with "null" can be.
"""


def type_name(kind: pa.DataType) -> str:
    """Return the name of a column type as the dictionary writes it: ``list of vec3``.

    Parameters
    ----------
    kind : pyarrow.DataType
        A type of the contract.

    Raises
    ------
    KeyError
        If it is none that the contract uses: give it a name here first.
    """
    if pa.types.is_list(kind):
        return f"list of {type_name(kind.value_type)}"
    if pa.types.is_map(kind):
        return f"map of {type_name(kind.key_type)} to {type_name(kind.item_type)}"
    if kind == _CURVE:
        first, last = CURVE_GEOMETRY[0].name, CURVE_GEOMETRY[-1].name
        return f"struct of the columns `{first}` to `{last}` of [curves](#curves)"
    if pa.types.is_struct(kind) and kind not in _NAMES:
        fields = ", ".join(f"`{field.name}` {type_name(field.type)}" for field in kind)
        return f"struct ({fields})"
    if kind not in _NAMES:
        raise KeyError(f"the data dictionary has no name for the type {kind}")
    return _NAMES[kind]


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _column_row(column: Column) -> str:
    cells = (
        f"`{column.name}`",
        type_name(column.type),
        column.unit,
        "null" if column.nullable else "",
        _cell(column.description),
    )
    return "| " + " | ".join(cells) + " |"


def table_section(table: Table) -> str:
    """Return the Markdown of one table: what a row is, its key, its columns.

    Parameters
    ----------
    table : Table
        A table of the contract.
    """
    key = ", ".join(f"`{name}`" for name in table.key)
    rows = "\n".join(_column_row(column) for column in table.columns)
    return (
        f"## {table.name}\n\n"
        f"A row is {_cell(table.row)}. Sorted by {key}.\n\n"
        f"| column | type | unit | null | meaning |\n|---|---|---|---|---|\n{rows}\n"
    )


def _array_row(spec: ArraySpec) -> str:
    tail = ["N"] * spec.grid + [str(spec.columns)] * bool(spec.columns)
    shape = f"(n, {', '.join(tail)})" if tail else "(n,)"
    cells = (f"`{spec.name}`", np.dtype(spec.dtype).name, shape, spec.axis, _cell(spec.description))
    return "| " + " | ".join(cells) + " |"


def array_section() -> str:
    """Return the Markdown of the arrays of a shard."""
    rows = "\n".join(_array_row(spec) for spec in ARRAYS.values())
    axes = "\n".join(f"- {axis}: a {_AXIS_MEANING[axis]}" for axis in AXES)
    return (
        "## Arrays\n\n"
        "The meshes once more, for readers that want tensors: the models of a shard one after the\n"
        "other. `vertex_offset`, `normal_offset`, `face_offset`, `patch_offset` and\n"
        "`curve_offset` of `models` say where one begins, and are null where it has none.\n"
        f"Compressed in chunks of {CHUNK_ROWS} rows. A row, by axis, is\n\n"
        f"{axes}\n\n"
        f"| array | type | shape | axis | meaning |\n|---|---|---|---|---|\n{rows}\n"
    )


def _contents() -> str:
    lines = [f"- [{t.name}](#{t.name}): {_cell(t.row)}" for t in TABLES.values()]
    return "\n".join([*lines, "- [arrays](#arrays): the meshes as Zarr arrays", ""])


def dictionary() -> str:
    """Return the data dictionary of all tables and arrays, as Markdown."""
    head = _HEAD.format(version=SCHEMA_VERSION)
    tables = [table_section(table) for table in TABLES.values()]
    return "\n".join([head, _contents(), *tables, array_section()])
