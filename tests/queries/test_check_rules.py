"""Every rule on models must catch the fault it is for, and no other rule may cry with it.

Each case spoils a faultless solid in one way. Where two rules are named, the fault breaks
both by its nature.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from breplake.queries.check.curves import _arc_lengths, _quadrature
from breplake.queries.check.ids import REFERENCES
from breplake.queries.check.rules import MODEL_RULES, Tally
from breplake.queries.check.run import ORDERED_RULES, check_model
from breplake.queries.check.view import ModelView
from breplake.schema.arrays import MESH_ARRAYS
from breplake.schema.curves import CurveSet
from breplake.schema.shape_tables import SHAPE_TABLES
from breplake.schema.tables import TABLES

Rows = dict[str, list[dict[str, Any]]]
# Solids made by hand have no shape graph: test_check_shapes spoils that of a real part.
_STORED = {table.name for table in SHAPE_TABLES}
ELSEWHERE = {"shape-graph", "placements", "shape-rows", "edge-curves", "coedge-pcurves"}
ELSEWHERE |= {"pcurve-on-curve", "pcurve-loops", "trimmed-areas", "uv-grids"}
HAND_MADE = [r for r in REFERENCES if r[0] not in _STORED]
SOLIDS = ("box", "cylinder", "cone", "torus", "saddle", "wires")
NULL_DIRECTIONS = {"d_min": None, "d_max": None}


def broken_rules(solid: Any, arrays: Any = None) -> set[str]:
    tallies = {name: Tally(rule) for name, rule in ORDERED_RULES.items()}
    check_model(view_of(solid, solid.arrays() if arrays is None else arrays), tallies)
    return {name for name, tally in tallies.items() if not tally.result().passed}


def view_of(solid: Any, arrays: Any = None) -> ModelView:
    tables = {name: solid.table(name) for name in TABLES}
    return ModelView(tables["models"].to_pylist()[0], tables, arrays)


def inner(rows: Rows, patch: int) -> dict[str, Any]:
    """A row of vertices inside a patch."""
    free = (r for r in rows["vertices"] if not {"curve_id", "corner_id"} & r.keys())
    return next(r for r in free if r["patch_id"] == patch)


def turned(row: dict[str, Any], angle: float) -> dict[str, float]:
    """The row's normal, turned by an angle."""
    n = np.array([row["nx"], row["ny"], row["nz"]])
    side = np.cross(n, [0.3, 0.5, 0.8])
    n = math.cos(angle) * n + math.sin(angle) * side / np.linalg.norm(side)
    return dict(zip(("nx", "ny", "nz"), map(float, n / np.linalg.norm(n)), strict=True))


def flip(face: dict[str, Any]) -> None:
    face.update(v1=face["v2"], v2=face["v1"], n1=face["n2"], n2=face["n1"])


def duplicate_row(rows: Rows) -> None:
    rows["vertices"].append(
        rows["vertices"][-1] | {"normal_id": len(rows["vertices"]), "is_primary": False}
    )
    rows["models"][0]["n_normals"] += 1


def other_row_of_vertex(rows: Rows) -> None:
    for face in rows["faces"]:
        for row in rows["vertices"]:
            if row["vertex_id"] == face["v0"] and row["patch_id"] != face["patch_id"]:
                face["n0"] = row["normal_id"]
                return


def second_row(rows: Rows) -> dict[str, Any]:
    return next(r for r in rows["vertices"] if not r["is_primary"])


def move_vertex(rows: Rows) -> None:
    row = inner(rows, 0)
    row.update(x=row["x"] + 1e-5, residual=1e-5)


def turn_normal(rows: Rows, angle: float) -> None:
    row = inner(rows, 0)
    row.update(turned(row, angle) | NULL_DIRECTIONS)


def forget_entry(rows: Rows) -> None:
    curve = rows["curves"][0]
    vertex = curve["vert_indices"].pop(1)
    curve["vert_parameters"].pop(1)
    for row in rows["vertices"]:
        if row["vertex_id"] == vertex:
            row["curve_id"] = None


def swap_entries(rows: Rows) -> None:
    for column in ("vert_indices", "vert_parameters"):
        values = rows["curves"][0][column]
        values[1], values[2] = values[2], values[1]


def swap(row: dict[str, Any], a: str, b: str) -> None:
    row[a], row[b] = row[b], row[a]


def open_mesh(rows: Rows) -> None:
    """Take a triangle away, and state the counts of what is left."""
    rows["faces"].pop()
    rows["models"][0].update(n_faces=len(rows["faces"]), n_boundary_edges=3, is_watertight=False)
    rows["models"][0].update(regular_angles=None, max_edge=None, min_angle=None)


def scale_area(rows: Rows) -> None:
    rows["patches"][0]["area"] *= 1.2
    total = sum(p["area"] for p in rows["patches"])
    rows["models"][0]["area"] = rows["parts"][0]["area"] = total


def shell_with_volume(rows: Rows) -> None:
    rows["parts"][0]["kind"] = "shell"
    rows["models"][0]["n_solids"] = 0


def shrink_box(rows: Rows) -> None:
    model = rows["models"][0]
    model["bbox_min"] = model["bbox_min"] | {"x": model["bbox_min"]["x"] + 0.1}
    size = [model["bbox_max"][a] - model["bbox_min"][a] for a in "xyz"]
    model["diagonal"] = math.hypot(*size)


def swap_coedges(rows: Rows) -> None:
    one, two = rows["coedges"][1], rows["coedges"][2]
    for column in ("curve_id", "reversed"):
        one[column], two[column] = two[column], one[column]


def turn_curve(rows: Rows) -> None:
    swap(rows["curves"][0], "start_corner", "end_corner")


def unlabel(rows: Rows) -> None:
    next(row for row in rows["vertices"] if "curve_id" in row)["curve_id"] = None


def stretch_normal(rows: Rows) -> None:
    inner(rows, 0)["nx"] *= 1 + 1e-10


def forget_normal(rows: Rows) -> None:
    nothing = dict.fromkeys(("nx", "ny", "nz", "k_min", "k_max"))
    inner(rows, 0).update(nothing | NULL_DIRECTIONS)


def fill(rows: Rows) -> None:
    for table in ("models", "parts"):
        rows[table][0]["volume"] = 50.0


def coefficient(patch: int, place: int, value: float) -> Callable[[Rows], None]:
    return lambda rows: rows["patches"][patch]["coefficients"].__setitem__(place, value)


def on(table: str, index: int, **values: Any) -> Callable[[Rows], None]:
    """Set columns of one row."""
    return lambda rows: rows[table][index].update(values)


def times(table: str, index: int, column: str, factor: float) -> Callable[[Rows], None]:
    return lambda rows: rows[table][index].update({column: rows[table][index][column] * factor})


def plus(table: str, index: int, column: str, step: Any) -> Callable[[Rows], None]:
    return lambda rows: rows[table][index].update({column: rows[table][index][column] + step})


def inside(patch: int, **values: Any) -> Callable[[Rows], None]:
    """Set columns of a vertex row inside a patch."""
    return lambda rows: inner(rows, patch).update(values)


def longer(row: dict[str, Any], column: str, factor: float) -> None:
    row[column] = {axis: value * factor for axis, value in row[column].items()}


CASES: list[tuple[str, str, Callable[[Rows], Any], str]] = [
    ("ids-dense", "box", on("parts", 0, part_id=1), ""),
    ("ids-dense", "box", on("faces", 3, face_id=7), ""),
    ("ids-dense", "box", on("vertices", 3, vertex_id=-1), "mesh-counts"),
    ("references", "box", lambda r: r["curves"][2]["vert_indices"].__setitem__(1, -1), ""),
    ("words", "box", on("curves", 0, kind="Sharp"), ""),
    ("words", "box", on("patches", 0, type="plane"), "counts"),
    ("words", "box", on("models", 0, mesh_kind="regular"), ""),
    ("face-rows", "box", other_row_of_vertex, ""),
    ("face-rows", "box", on("faces", 0, patch_id=3), ""),
    ("primary", "box", lambda r: second_row(r).update(is_primary=True), ""),
    ("vertex-patch", "torus", duplicate_row, ""),
    ("one-position", "box", lambda r: second_row(r).update(x=second_row(r)["x"] + 1e-10), ""),
    ("mesh-edges", "box", on("models", 0, n_boundary_edges=1), ""),
    ("mesh-edges", "box", on("models", 0, n_nonmanifold_edges=1), ""),
    ("mesh-edges", "saddle", on("models", 0, is_watertight=True), ""),
    ("mesh-counts", "box", plus("models", 0, "n_normals", 1), ""),
    ("mesh-counts", "box", plus("models", 0, "n_faces", 1), ""),
    ("mesh-counts", "wires", on("models", 0, n_faces=0), ""),
    ("mesh-measures", "box", times("models", 0, "min_angle", 1.001), ""),
    ("mesh-measures", "torus", times("models", 0, "regular_angles", 0.99), ""),
    ("mesh-measures", "box", times("models", 0, "max_edge", 0.999), ""),
    ("edge-limit", "box", times("models", 0, "mesh_limit", 0.9), ""),
    ("bounding-box", "box", shrink_box, ""),
    ("bounding-box", "box", times("models", 0, "diagonal", 1.001), ""),
    ("watertight", "torus", open_mesh, "mesh-measures"),
    ("curve-lists", "box", lambda r: r["curves"][0]["vert_parameters"].pop(), ""),
    ("curve-position", "box", lambda r: r["curves"][0]["vert_parameters"].__setitem__(1, 0.9), ""),
    ("curve-parameters", "box", on("curves", 0, t_min=-0.1), ""),
    ("curve-parameters", "box", swap_entries, "curve-edges"),
    ("curve-ends", "box", turn_curve, "loops-close"),
    ("curve-edges", "cylinder", forget_entry, ""),
    ("on-curve", "cylinder", inside(0, curve_id=0), ""),
    ("on-curve", "cylinder", inside(0, corner_id=0), ""),
    ("on-curve", "box", unlabel, ""),
    ("corner-position", "box", on("corners", 0, point={"x": 1e-3, "y": 0.0, "z": 0.0}), ""),
    ("curve-length", "cylinder", times("curves", 0, "length", 1.001), ""),
    ("evaluable", "cylinder", on("patches", 0, radius=None), ""),
    ("frames", "cylinder", lambda r: longer(r["patches"][0], "x_axis", 1 + 1e-10), ""),
    ("frames", "cylinder", lambda r: longer(r["curves"][0], "y_axis", 1 + 1e-10), ""),
    ("coefficients", "cylinder", coefficient(0, 9, -4.1), ""),
    ("coefficients", "cone", coefficient(0, 8, 0.7), ""),
    ("coefficients", "box", coefficient(1, 3, 9.0), ""),
    ("coefficients", "torus", on("patches", 0, coefficients=[0.0] * 10), ""),
    ("apex", "cone", on("patches", 0, apex={"x": 0.0, "y": 0.0, "z": 3.001}), ""),
    ("foci", "wires", on("curves", 0, focus2={"x": -2.1, "y": 2.0, "z": 3.0}), ""),
    ("foci", "wires", on("curves", 1, focus1={"x": 6.1, "y": 2.0, "z": 3.0}), ""),
    ("foci", "wires", on("curves", 2, focus1={"x": 3.1, "y": 2.0, "z": 3.0}), ""),
    ("model-sums", "box", times("models", 0, "area", 1 + 1e-6), ""),
    ("model-sums", "box", times("models", 0, "volume", 1 + 1e-6), ""),
    ("part-sums", "box", times("parts", 0, "area", 1 + 1e-6), ""),
    ("solid-volume", "box", shell_with_volume, ""),
    ("position", "cylinder", move_vertex, ""),
    ("residual", "cylinder", inside(0, residual=1e-3), ""),
    ("range", "saddle", on("patches", 0, u_max=0.9), ""),
    ("range", "cylinder", on("patches", 0, v_min=0.5), ""),
    ("unit-normal", "cylinder", stretch_normal, ""),
    ("normal", "cylinder", lambda r: turn_normal(r, 3e-9), ""),
    ("normal", "torus", lambda r: turn_normal(r, math.pi), ""),
    ("normal-freeform", "saddle", lambda r: turn_normal(r, 3e-6), ""),
    ("normal-defined", "cone", on("vertices", 24 * 6, nx=1.0, ny=0.0, nz=0.0), ""),
    ("normal-defined", "torus", forget_normal, "curvature-defined"),
    ("normal-defined", "torus", inside(0, nx=None, **NULL_DIRECTIONS), "curvature-order"),
    ("curvature-order", "box", inside(0, k_max=-1e-12), ""),
    ("curvature", "cylinder", inside(0, k_min=0.0, k_max=0.5), ""),
    ("curvature", "torus", inside(0, k_max=1 + 2e-6), ""),
    ("curvature-defined", "torus", inside(0, k_min=None, k_max=None), ""),
    ("curvature-defined", "cone", on("vertices", 24 * 6, k_min=0.0, k_max=0.0), "curvature-order"),
    ("directions", "torus", lambda r: longer(inner(r, 0), "d_max", 1 + 1e-6), ""),
    ("directions", "torus", inside(0, d_min=None), ""),
    ("direction-truth", "torus", lambda r: swap(inner(r, 0), "d_min", "d_max"), ""),
    ("loops", "box", plus("patches", 0, "n_loops", 1), ""),
    ("loops", "box", on("coedges", 3, place=4), ""),
    ("loops", "box", on("coedges", 0, loop=1), "loops-close"),
    ("sides", "box", lambda r: swap(r["curves"][0], "left_patch", "right_patch"), ""),
    ("sides", "box", plus("curves", 0, "n_patches", 1), "curve-kinds"),
    ("sides", "saddle", on("curves", 0, left_patch=None), ""),
    ("curve-kinds", "box", on("curves", 0, kind="nonmanifold"), ""),
    ("curve-kinds", "cylinder", on("curves", 1, kind="smooth"), ""),
    ("loops-close", "box", swap_coedges, ""),
    ("winding", "saddle", lambda r: flip(r["faces"][5]), ""),
    ("winding", "cylinder", lambda r: flip(r["faces"][5]), "neighbours"),
    ("neighbours", "torus", lambda r: flip(r["faces"][5]), ""),
    ("patch-area", "cylinder", scale_area, ""),
    ("patch-area", "box", scale_area, ""),
    ("mesh-volume", "cylinder", fill, ""),
]  # fmt: skip


@pytest.mark.parametrize("name", SOLIDS)
def test_faultless(solid: Any, name: str) -> None:
    assert broken_rules(solid(name)) == set()


@pytest.mark.parametrize(
    ("rule", "name", "spoil", "also"),
    CASES,
    ids=[f"{case[0]}-{case[1]}-{i}" for i, case in enumerate(CASES)],
)
def test_rule_catches(
    solid: Any, rule: str, name: str, spoil: Callable[[Rows], Any], also: str
) -> None:
    spoilt = solid(name)
    spoil(spoilt.tables)
    assert broken_rules(spoilt) == {rule} | ({also} if also else set())


@pytest.mark.parametrize(
    ("rule", "name", "spoil", "also"),
    CASES,
    ids=[f"{case[0]}-{case[1]}-{i}" for i, case in enumerate(CASES)],
)
def test_faults_of_an_invalid_file_are_listed_but_excused(
    solid: Any, rule: str, name: str, spoil: Callable[[Rows], Any], also: str
) -> None:
    spoilt = solid(name)
    spoil(spoilt.tables)
    spoilt.tables["models"][0]["is_valid"] = False
    caught = {r for r in (rule, also) if r}
    assert broken_rules(spoilt) == {r for r in caught if not MODEL_RULES[r].source}


@pytest.mark.parametrize(("table", "column", "target", "nullable"), HAND_MADE)
@pytest.mark.parametrize("wrong", [-1, 10_000])
def test_references(
    solid: Any, table: str, column: str, target: str, nullable: bool, wrong: int
) -> None:
    spoilt = solid("cylinder")
    arrays = spoilt.arrays()
    spoilt.rows(table)[0][column] = wrong
    assert broken_rules(spoilt, arrays) == {"references"}


@pytest.mark.parametrize(
    "column",
    ["n_parts", "n_solids", "n_patches", "n_curves", "n_corners", "n_sharp_curves", "n_torus",
     "n_other", "n_circle", "n_bspline_curve"],
)  # fmt: skip
def test_counts(solid: Any, column: str) -> None:
    spoilt = solid("cylinder")
    spoilt.rows("models")[0][column] += 1
    assert broken_rules(spoilt) == {"counts"}


@pytest.mark.parametrize("name", ["box", "saddle"])
def test_closed_flag(solid: Any, name: str) -> None:
    spoilt = solid(name)
    model = spoilt.rows("models")[0]
    model["is_closed"] = not model["is_closed"]
    assert "counts" in broken_rules(spoilt)


@pytest.mark.parametrize("array", MESH_ARRAYS)
def test_arrays(solid: Any, array: str) -> None:
    spoilt = solid("cone")
    arrays = spoilt.arrays()
    arrays[array].flat[7] += 1
    assert broken_rules(spoilt, arrays) == {"arrays"}


def test_arrays_of_wrong_length(solid: Any) -> None:
    spoilt = solid("cone")
    arrays = spoilt.arrays()
    arrays["normal"] = arrays["normal"][:-1]
    assert broken_rules(spoilt, arrays) == {"arrays"}


def test_edge_limit_with_a_reason(solid: Any) -> None:
    model = solid("box")
    model.rows("models")[0].update(mesh_limit=0.1, mesh_note="the limit of vertices was reached")
    assert broken_rules(model) == set()


def test_every_rule_has_a_case() -> None:
    covered = {case[0] for case in CASES} | {"references", "counts", "arrays"} | ELSEWHERE
    assert covered == set(ORDERED_RULES)


def test_rules_come_after_what_they_need() -> None:
    seen: set[str] = set()
    for name, rule in ORDERED_RULES.items():
        assert seen.issuperset(rule.needs), name
        seen.add(name)


def test_models_are_skipped_where_a_needed_rule_is_broken(solid: Any) -> None:
    spoilt = solid("box")
    spoilt.rows("faces")[0]["v0"] = 999
    tallies = {name: Tally(rule) for name, rule in ORDERED_RULES.items()}
    check_model(view_of(spoilt), tallies)
    assert tallies["winding"].result().skipped == 1
    assert tallies["winding"].result().checked == 0
    assert tallies["counts"].result().checked > 0


def test_the_share_of_exceptions(solid: Any) -> None:
    """One bad row of 800 breaks the rule of 99.9 %, one of 2,000 does not; both are listed."""
    spoilt = solid("torus")
    inner(spoilt.tables, 0).update(x=9.0)
    tally = Tally(ORDERED_RULES["position"])
    for measure in tally.rule.measure(view_of(spoilt)):
        tally.add(measure, "a")
    assert not tally.result().passed
    for name in ("b", "c"):
        for measure in tally.rule.measure(view_of(solid("torus"))):
            tally.add(measure, name)
    result = tally.result()
    assert result.passed
    assert (result.checked, result.failed) == (2400, 1)
    assert [o.subject for o in result.offenders] == ["a"]
    assert result.exceptions.places[0].startswith("row ")


@pytest.mark.parametrize("lean", [-1, 1])
def test_both_sides_of_a_knot_are_right(lean: int) -> None:
    """A roof of degree 1 has two normals along its ridge, and no third one."""
    poles = [
        [dict(zip("xyz", (float(u), float(v), -abs(float(u))), strict=True)) for v in (0, 1)]
        for u in (-1, 0, 1)
    ]
    flags = dict.fromkeys(("reversed", "u_closed", "v_closed", "u_periodic", "v_periodic"), False)
    patch = flags | {
        "model_id": 1, "patch_id": 0, "part_id": 0, "type": "BSpline", "u_degree": 1, "v_degree": 1,
        "poles": poles, "u_knots": [-1.0, -1, 0, 1, 1], "v_knots": [0.0, 0, 1, 1], "u_min": -1.0,
        "u_max": 1.0, "v_min": 0.0, "v_max": 1.0, "area": 1.0, "n_loops": 1, "tolerance": 1e-7,
    }  # fmt: skip
    row = {"model_id": 1, "normal_id": 0, "vertex_id": 0, "patch_id": 0, "is_primary": True,
           "u": 0.0, "v": 0.5, "x": 0.0, "y": 0.5, "z": 0.0, "residual": 0.0}  # fmt: skip

    def angle(normal: tuple[float, float, float]) -> float:
        vertex = row | dict(zip(("nx", "ny", "nz"), normal, strict=True))
        tables = {"patches": TABLES["patches"].from_rows([patch]),
                  "vertices": TABLES["vertices"].from_rows([vertex])}  # fmt: skip
        model = ModelView({"diagonal": 2.0, "collection": "", "name": ""}, tables)
        (measure,) = ORDERED_RULES["normal-freeform"].measure(model)
        return float(measure.values[0])

    half = math.sqrt(0.5)
    assert angle((lean * half, 0.0, half)) < 1e-9
    assert angle((0.0, 0.0, 1.0)) == pytest.approx(math.pi / 4)


def test_length_of_an_uneven_curve() -> None:
    """A parabola far along its arm: one quadrature is not enough, halving is."""
    focal, far = 0.01, 2.0
    x, y = np.eye(3)[:2]
    row: dict[str, Any] = {"type": "Parabola", "focal": focal}
    for name, value in (("location", 0 * x), ("x_axis", x), ("y_axis", y)):
        row[name] = dict(zip("xyz", value.tolist(), strict=True))
    curves = CurveSet.from_curves(pa.Table.from_pylist([row]))
    owner, start, stop = np.array([0]), np.array([0.0]), np.array([far])
    found = _arc_lengths(curves, owner, start, stop)
    s = far / (2 * focal)
    assert found == pytest.approx([focal * (s * math.hypot(1, s) + math.asinh(s))], rel=1e-8)
    once = _quadrature(curves, owner, start, stop, np.polynomial.legendre.leggauss(8))
    assert once != pytest.approx(found, rel=1e-6)


def test_strips_that_touch_are_watertight(solid: Any) -> None:
    """Four triangles at an edge close a body as two do; three do not."""
    spoilt = solid("box")
    faces, model = spoilt.rows("faces"), spoilt.rows("models")[0]
    for turned_over in (False, True):
        faces.append(faces[0] | {"face_id": len(faces)})
        if turned_over:
            flip(faces[-1])
        model.update(n_faces=len(faces), n_nonmanifold_edges=3, is_watertight=False)
        assert ("watertight" in broken_rules(spoilt)) is not turned_over
