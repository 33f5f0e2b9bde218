"""Curves and patches of a features file, as rows of a lake."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.errors import InputError
from breplake.ingest.abc.geometry import ExactGeometry
from breplake.ingest.failure import advise
from breplake.schema.abc import CONTINUITY_CODES, CURVE_KEYS, SURFACE_KEYS
from breplake.schema.contract import VEC3, Column
from breplake.schema.tables import CURVE_GEOMETRY, PATCHES

__all__ = ["Entry", "Features", "read_features"]

Row = dict[str, Any]
_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

_ALIASES: Final = {"Ellipse": {"x_radius": "maj_radius", "y_radius": "min_radius"}}
"""How the published files call keys of the paper."""

_CURVE_TYPES: Final = {column.name: column.type for column in CURVE_GEOMETRY}
_SURFACE_TYPES: Final = {column.name: column.type for column in PATCHES.columns}

_ROUND: Final = {
    "Cylinder": (True, False),
    "Cone": (True, False),
    "Sphere": (True, False),
    "Torus": (True, True),
}
"""Whether u and v are angles that go round."""


@dataclass(frozen=True, slots=True)
class Entry:
    """The mesh vertices of a curve or patch.

    Parameters
    ----------
    vertices : numpy.ndarray
        ``(k,)`` as the file has them.
    parameters : numpy.ndarray
        ``(k,)`` t, or ``(k, 2)`` u and v.
    faces : numpy.ndarray
        ``(f,)`` triangles of a patch; none of a curve.
    """

    vertices: _Ints
    parameters: _Floats
    faces: _Ints


@dataclass(frozen=True, slots=True)
class Features:
    """What a features file says.

    Parameters
    ----------
    curves, patches : list of dict
        Geometry as columns of the tables; curves with ``sharp``, patches with ``part_id``
        where the file has it.
    on_curves, on_patches : list of Entry
        Mesh vertices by curve and by patch.
    """

    curves: list[Row]
    patches: list[Row]
    on_curves: list[Entry]
    on_patches: list[Entry]

    def geometry(self) -> ExactGeometry:
        """Return curves and patches, ready to be evaluated."""
        curves = _table(self.curves, CURVE_GEOMETRY)
        return ExactGeometry.of(curves, _table(self.patches, PATCHES.columns))


def _table(rows: list[Row], columns: Sequence[Column]) -> pa.Table:
    """Return the columns that any row has, all of them nullable."""
    used = {name for row in rows for name in row} | {"type"}
    schema = pa.schema([pa.field(c.name, c.type) for c in columns if c.name in used])
    return pa.Table.from_pylist(rows, schema=schema)


def read_features(content: Any) -> Features:
    """Turn the content of a features file into rows.

    Raises
    ------
    InputError
        ``bad-features`` if something is missing, or is not of its kind.
    """
    lists = {}
    for part in ("curves", "surfaces"):
        found = content.get(part) if isinstance(content, Mapping) else None
        if not isinstance(found, list) or not all(isinstance(row, Mapping) for row in found):
            raise _bad("the file", f"there is no list of {part}")
        lists[part] = found
    curves, on_curves = [], []
    for number, given in enumerate(lists["curves"]):
        where = f"curve {number}"
        curves.append(_curve(given, where) | {"sharp": _typed(given, "sharp", pa.bool_(), where)})
        on_curves.append(_entry(given, 1, where))
    patches, on_patches = [], []
    for number, given in enumerate(lists["surfaces"]):
        where = f"surface {number}"
        row = _surface(given, where)
        if "part" in given:
            row["part_id"] = _typed(given, "part", pa.int32(), where)
        patches.append(row)
        on_patches.append(_entry(given, 2, where))
    found = Features(curves, patches, on_curves, on_patches)
    geometry = found.geometry()
    for what, rows, known in (
        ("curve", curves, geometry.curves.known),
        ("surface", patches, geometry.surfaces.known),
    ):
        for place, row in enumerate(rows):
            if not known[place] and row["type"] != "Other":
                raise _bad(f"{what} {place}", f"its parameters do not make a {row['type']}")
    return found


def _bad(where: str, detail: str) -> InputError:
    return InputError("bad-features", advise("bad-features", f"{where}: {detail}"))


def _entry(given: Mapping[str, Any], dimension: int, where: str) -> Entry:
    """Return the mesh vertices of a curve or patch; lists that are missing are empty."""
    try:
        vertices = np.asarray(given.get("vert_indices") or [], dtype=np.int64)
        parameters = np.asarray(given.get("vert_parameters") or [], dtype=np.float64)
        faces = np.asarray(given.get("face_indices") or [], dtype=np.int64)
    except (TypeError, ValueError, OverflowError) as error:
        raise _bad(where, f"its lists hold what is no number ({error})") from error
    shape = (len(vertices),) if dimension == 1 else (len(vertices), 2)
    if vertices.ndim != 1 or faces.ndim != 1 or parameters.size != dimension * len(vertices):
        raise _bad(where, "vert_indices and vert_parameters do not match")
    return Entry(vertices, parameters.reshape(shape), faces)


def _kind(given: Mapping[str, Any], known: Mapping[str, Any], where: str) -> str:
    kind = given.get("type")
    if kind not in known:
        raise _bad(where, f"its type is {kind!r}, not one of {', '.join(known)}")
    return str(kind)


def _typed(given: Mapping[str, Any], key: str, kind: pa.DataType, where: str) -> Any:
    """Return the value of a key, checked and as the column wants it."""
    if key not in given:
        raise _bad(where, f"key {key!r} is missing")
    try:
        return _value(given[key], kind)
    except (TypeError, ValueError) as error:
        raise _bad(where, f"{key} is {error}") from error


def _value(value: Any, kind: pa.DataType) -> Any:
    """Turn what YAML gave into what a column of a type holds.

    Raises
    ------
    TypeError
        Saying what it is instead.
    """
    if kind == VEC3:
        x, y, z = (_value(item, pa.float64()) for item in _list(value))
        return {"x": x, "y": y, "z": z}
    if pa.types.is_list(kind):
        return [_value(item, kind.value_type) for item in _list(value)]
    if pa.types.is_struct(kind):
        return {key: _value(item, kind.field(key).type) for key, item in dict(value).items()}
    wanted: tuple[type, ...] = (str,)
    if pa.types.is_boolean(kind):
        wanted = (bool,)
    elif pa.types.is_integer(kind):
        wanted = (int,)
    elif pa.types.is_floating(kind):
        wanted = (int, float)
    if not isinstance(value, wanted) or (isinstance(value, bool) and bool not in wanted):
        raise TypeError(f"{value!r:.60}, not {kind}")
    return float(value) if isinstance(value, int | float) and float in wanted else value


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise TypeError(f"{value!r:.60}, not a list")
    return value


def _curve(given: Mapping[str, Any], where: str) -> Row:
    """Return type and parameters of a curve."""
    kind = _kind(given, CURVE_KEYS, where)
    if kind == "Other":
        return _other(given, _CURVE_TYPES, where)
    row: Row = {"type": kind}
    aliases = _ALIASES.get(kind, {})
    for key in CURVE_KEYS[kind]:
        name = key if key in given else aliases.get(key, key)
        row[key] = _typed(given, name, _CURVE_TYPES[key], where)
    if kind == "Ellipse":
        row["location"] = _centre(given, row, where)
    if kind == "BSpline":
        row["continuity"] = CONTINUITY_CODES.get(row["continuity"])
        row["periodic"] = len(row["knots"]) != len(row["poles"]) + row["degree"] + 1
        if not row["rational"]:
            row["weights"] = None
    return row


def _centre(given: Mapping[str, Any], row: Row, where: str) -> Row:
    """Return the centre of an ellipse, which the published files leave out."""
    if "location" in given:
        return dict(_typed(given, "location", VEC3, where))
    return {axis: (row["focus1"][axis] + row["focus2"][axis]) / 2 for axis in "xyz"}


def _surface(given: Mapping[str, Any], where: str) -> Row:
    kind = _kind(given, SURFACE_KEYS, where)
    closed = {"u_closed": False, "v_closed": False, "u_periodic": False, "v_periodic": False}
    if kind == "Other":
        row = _other(given, _SURFACE_TYPES, where)
        return closed | _round(row.get("basis_type", "Other"), row) | row
    row = {"type": kind}
    for key in SURFACE_KEYS[kind]:
        if key == "curve":
            nested = given.get(key)
            if not isinstance(nested, Mapping):
                raise _bad(where, "key 'curve' is missing")
            row[key] = _curve(nested, f"{where}, curve")
        else:
            row[key] = _typed(given, key, _SURFACE_TYPES[key], where)
    if kind == "BSpline":
        _finish_spline(row, where)
    return closed | _round(kind, row) | row


def _finish_spline(row: Row, where: str) -> None:
    row["continuity"] = CONTINUITY_CODES.get(row["continuity"])
    if not row["poles"] or len({len(line) for line in row["poles"]}) != 1:
        raise _bad(where, "poles are no rectangular grid")
    for axis, poles in (("u", len(row["poles"])), ("v", len(row["poles"][0]))):
        plain = poles + row[f"{axis}_degree"] + 1
        row[f"{axis}_periodic"] = len(row[f"{axis}_knots"]) != plain
    if not (row["u_rational"] or row["v_rational"]):
        row["weights"] = None


def _round(kind: str, row: Row) -> Row:
    """Return in which parameters a surface is closed and periodic, which its type tells."""
    if kind in _ROUND:
        u, v = _ROUND[kind]
        return {"u_closed": u, "u_periodic": u, "v_closed": v, "v_periodic": v}
    if kind not in ("Revolution", "Extrusion"):
        return {}
    curve = row["curve"]
    conic = curve["type"] in ("Circle", "Ellipse")
    swept = {"closed": conic or bool(curve.get("closed"))}
    swept["periodic"] = conic or bool(curve.get("periodic"))
    along = "v" if kind == "Revolution" else "u"
    found = {f"{along}_{name}": value for name, value in swept.items()}
    return found | ({"u_closed": True, "u_periodic": True} if kind == "Revolution" else {})


def _other(given: Mapping[str, Any], columns: Mapping[str, pa.DataType], where: str) -> Row:
    """Return what is known of a curve or surface that the paper has no type for."""
    other = given.get("other", {})
    if not isinstance(other, Mapping):
        raise _bad(where, "key 'other' holds no mapping")
    if unknown := sorted(other.keys() - columns.keys()):
        raise _bad(where, f"key 'other' holds {unknown[0]!r}, which no column is called")
    row = {key: _typed(other, key, columns[key], where) for key in other}
    return {"type": "Other"} | row
