"""Import of original ABC files: faults found and repaired, or refused with a reason."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("OCP")

import yaml

from breplake.schema.curves import CurveSet
from breplake.schema.surfaces import SurfaceSet

ABC = Path(__file__).parents[3] / "shared" / "abc_groundtruth"
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

originals = pytest.mark.skipif(not ABC.is_dir(), reason="the original ABC models are not here")

MESHED = {
    "00000006_d4fe04f0f5f84b52bd4f10e4_001": {
        "curvature-side": 3216,
        "curvature-unit": 4152,
        "curve-parameters": 638,
        "patch-parameters": 4172,
        "unused-normals": 21,
    },
    "00000008_9b3d6a97e8de4aa193b81000_000": {
        "curvature-side": 4406,
        "curvature-unit": 9061,
        "curve-parameters": 2283,
        "patch-parameters": 9092,
        "unused-normals": 31,
    },
    "00000049_aa208c45e8734584a147f595_000": {
        "curvature-unit": 12338,
        "curve-parameters": 2687,
        "patch-parameters": 12396,
        "shifted-vertices": 8140,
        "unused-normals": 130,
    },
}
"""OBJ and features without a STEP file, with the repairs that they need."""

BESIDE = {
    "one-based": ("00000050_80d90bfdd2e74e709956122a_000", "", 1714, 4489, 24569),
    "zero-based": ("00000050_80d90bfdd2e74e709956122a_000", ".zero_based", 1714, 4489, 0),
    "00000060": ("00000060_767e4372b5f94a88a7a17d90_001", "", 699, 5275, 0),
}
"""Model, variant of its features beside the STEP file, and repairs: parameters of curves, of
patches, numbers of vertices."""


def original(model: str, kind: str, variant: str = "") -> Path:
    stem, part = model.rsplit("_", 1)
    extension = {"trimesh": ".obj", "step": ".step"}.get(kind, ".yml")
    return ABC / f"{stem}_{kind}_{part}{variant}{extension}"


def link(folder: Path, path: Path, name: str | None = None) -> None:
    (folder / (name or path.name)).symlink_to(path)


def repairs(record) -> dict[str, int]:
    found = (entry.rsplit(":", 1) for entry in record.model["import_repairs"])
    return {code: int(times) for code, times in found}


def rows(record, table):
    return record.tables[table].to_pylist()


def positions(path: Path) -> np.ndarray:
    """The vertices of an OBJ, as users of the published files read them."""
    lines = (line.split() for line in path.read_text().splitlines() if line.startswith("v "))
    return np.array([[float(word) for word in words[1:4]] for words in lines])


@originals
@pytest.mark.parametrize("model", MESHED)
def test_evaluated_positions_are_those_of_the_obj_to_its_last_digit(model, ingest_file, tmp_path):
    for kind in ("trimesh", "features"):
        link(tmp_path, original(model, kind))
    record = ingest_file(tmp_path)
    assert record.failures == []
    assert repairs(record) == MESHED[model]

    printed = positions(original(model, "trimesh"))
    error = np.full(len(printed), np.inf)
    surfaces = SurfaceSet.from_patches(record.tables["patches"])
    vertex, patch = record.column("vertices", "vertex_id"), record.column("vertices", "patch_id")
    place = surfaces.evaluate(patch, *record.vectors("vertices", "u", "v").T).point
    np.minimum.at(error, vertex, np.abs(place - printed[vertex]).max(axis=1))
    curves = CurveSet.from_curves(record.tables["curves"])
    for row in rows(record, "curves"):
        # where a curve is off its patches, within the tolerance of the CAD file, it was meshed
        nodes = np.array(row["vert_indices"] or [], dtype=int)
        t = np.array(row["vert_parameters"] or [], dtype=float)
        place = curves.evaluate(row["curve_id"], t).point
        np.minimum.at(error, nodes, np.abs(place - printed[nodes]).max(axis=1))
    assert error.max() <= 0.5e-6 + 1e-12 * np.abs(printed).max()
    # what the lake holds as positions are the exact ones behind the printed digits
    assert np.abs(record.points - printed[vertex]).max() <= 0.5e-6 + 1e-9
    assert (np.abs(record.points - printed[vertex]).max(axis=1) > 1e-9).mean() > 0.5


@originals
def test_parameters_of_the_original_are_wrong_without_repair():
    model = "00000008_9b3d6a97e8de4aa193b81000_000"
    printed = positions(original(model, "trimesh"))
    given = yaml.load(original(model, "features").read_text(), LOADER)
    away = []
    for curve in given["curves"]:
        if curve["type"] == "Circle":
            t = np.array(curve["vert_parameters"])[1:-1, None]
            x, y = (np.array(curve[key]) for key in ("x_axis", "y_axis"))
            place = curve["location"] + curve["radius"] * (np.cos(t) * x + np.sin(t) * y)
            away += np.abs(place - printed[curve["vert_indices"][1:-1]]).max(axis=1).tolist()
    assert np.median(away) > 1.0  # mm


@originals
@pytest.mark.parametrize("case", BESIDE)
def test_features_beside_their_step_file(case, ingest_file, tmp_path):
    model, variant, of_curves, of_patches, of_numbers = BESIDE[case]
    link(tmp_path, original(model, "step"))
    features = original(model, "features", variant)
    link(tmp_path, features, original(model, "features").name)
    record = ingest_file(tmp_path)
    assert record.failures == []
    assert record.model["format"] == "step"
    expected = {"curve-parameters": of_curves, "patch-parameters": of_patches}
    if of_numbers:
        expected["one-based-vertices"] = of_numbers
    assert repairs(record) == expected
    assert "agree" in dict(record.model["metadata"])["features"]

    # put right by hand, curve and patches put a common vertex at one place
    given = yaml.load(features.read_text(), LOADER)
    curves = CurveSet.from_curves(record.tables["curves"])
    points, compared, worst = {}, 0, 0.0
    for number, (row, curve) in enumerate(
        zip(rows(record, "curves"), given["curves"], strict=True)
    ):
        t = np.array(curve["vert_parameters"], dtype=float)
        inner = t[1:-1]
        if len(inner) and not (row["t_min"] <= inner.min() and inner.max() <= row["t_max"]):
            inner *= 1e-3
        places = curves.evaluate(number, np.clip(inner, row["t_min"], row["t_max"])).point
        points |= dict(zip(curve["vert_indices"][1:-1], places, strict=True))
    surfaces = SurfaceSet.from_patches(record.tables["patches"])
    for number, patch in enumerate(given["surfaces"]):
        common = [i for i, v in enumerate(patch["vert_indices"]) if v in points]
        if not common:
            continue
        target = np.array([points[patch["vert_indices"][i]] for i in common])
        uv = np.array(patch["vert_parameters"])[common]
        errors = []
        for scale in ((1, 1), (1e-3, 1), (1, 1e-3), (1e-3, 1e-3)):
            place = surfaces.evaluate(number, *(uv * scale).T).point
            errors.append(np.abs(place - target).max())
        worst, compared = max(worst, min(errors)), compared + len(common)
    assert compared > 500
    assert worst < 1e-4 * record.model["diagonal"]


@originals
def test_features_of_another_model_are_left_aside(ingest_file, tmp_path):
    link(tmp_path, original("00000050_80d90bfdd2e74e709956122a_000", "step"))
    link(
        tmp_path,
        original("00000060_767e4372b5f94a88a7a17d90_001", "features"),
        "00000050_80d90bfdd2e74e709956122a_features_000.yml",
    )
    record = ingest_file(tmp_path)
    assert record.model["n_patches"] == 43  # from the STEP file all the same
    (failure,) = record.failures
    assert (failure.kind, failure.fatal) == ("features-mismatch", False)
    assert "have 219 curves, the STEP file has 106" in failure.message


@pytest.fixture
def bar(ingest_shape, ingest_file, tmp_path):
    """A folder with a round bar as published files, and a function to change one of them."""
    import cadquery as cq

    from breplake.queries.abc.emit import yaml_text
    from breplake.queries.abc.features import features
    from breplake.queries.abc.obj import obj_text
    from breplake.queries.abc.stats import stats

    record = ingest_shape(cq.Workplane().cylinder(10, 4).val(), max_edge=0.2)
    tables = {name: record.tables[name] for name in ("curves", "patches", "vertices")}
    model = {"metadata": None} | record.model
    folder = tmp_path / "bar"
    folder.mkdir()
    content = {
        "features": features(**tables, faces=record.tables["faces"]),
        "stats": stats(model, **tables),
    }
    obj = obj_text(tables["vertices"], record.tables["faces"], None)

    def write(change=None, mesh=None):
        shutil.rmtree(folder)
        folder.mkdir()
        if change is not None:
            change(content)
        for kind, data in content.items():
            (folder / f"a_{kind}_000.yml").write_text(yaml_text(data))
        text = "".join(obj)
        (folder / "a_trimesh_000.obj").write_text(text if mesh is None else mesh(text))
        return ingest_file(folder)

    write.folder = folder
    return write


def test_what_is_right_needs_no_repair(bar):
    record = bar()
    assert record.failures == []
    assert record.model["import_repairs"] == []
    assert record.model["volume"] == pytest.approx(np.pi * 160, rel=1e-9)


def test_mesh_of_an_obj_beside_its_step_file(bar, ingest_file):
    import cadquery as cq

    alone = bar()
    cq.exporters.export(cq.Workplane().cylinder(10, 4), str(bar.folder / "a.step"))
    record = ingest_file(bar.folder)
    assert record.failures == []
    assert record.model["format"] == "step"
    assert record.model["import_repairs"] == []
    assert record.model["mesh_note"] == "the mesh is that of the imported files"
    np.testing.assert_allclose(record.points, alone.points, atol=1e-9)
    np.testing.assert_allclose(record.normals, alone.normals, atol=1e-9)
    assert record.tables["pcurves"].num_rows > 0  # from the STEP file


def shift(content):
    for part in ("curves", "surfaces"):
        for row in content["features"][part]:
            row["vert_indices"] = [i + 1 for i in row["vert_indices"]]


def shift_faces(content):
    for row in content["features"]["surfaces"]:
        row["face_indices"] = [i + 1 for i in row["face_indices"]]


def thousandfold(content):
    for row in content["features"]["curves"]:
        if row["type"] == "Circle":
            t = row["vert_parameters"]
            row["vert_parameters"] = [t[0], *(1000 * value for value in t[1:-1]), t[-1]]


def lose(content):
    (row,) = (s for s in content["features"]["surfaces"] if s["type"] == "Cylinder")
    row["vert_parameters"][5] = [0.1, 400.0]


def forget(content):
    row = content["features"]["curves"][0]
    row["vert_indices"][1] = -1


def point_beyond(content):
    content["features"]["surfaces"][0]["vert_indices"][2] = 10**6


def estimates(content):
    content["stats"] |= {"surface": 1e-11, "volume": 2e-12, "#edges": 7}


@pytest.mark.parametrize(
    ("fault", "codes"),
    [
        (shift, {"one-based-vertices"}),
        (shift_faces, {"one-based-faces"}),
        (thousandfold, {"curve-parameters"}),
        (lose, {"lost-parameters"}),
        (forget, {"missing-vertices"}),
        (point_beyond, {"missing-vertices"}),
        (estimates, {"stats-surface", "stats-volume", "stats-counts"}),
    ],
)
def test_each_fault_is_repaired_and_named(fault, codes, bar):
    sound = bar()
    record = bar(fault)
    assert record.failures == []
    assert codes == {*repairs(record)}
    np.testing.assert_allclose(record.points, sound.points, atol=1e-9)
    np.testing.assert_allclose(record.normals, sound.normals, atol=1e-9)
    for key in ("area", "volume", "n_curves"):
        assert record.model[key] == pytest.approx(sound.model[key], rel=1e-9)


def drop_type(content):
    content["features"]["curves"][1]["type"] = "Spiral"


def drop_face(content):
    content["features"]["surfaces"][0]["face_indices"].pop()


def other_radius(content):
    (row,) = (s for s in content["features"]["surfaces"] if s["type"] == "Cylinder")
    row["radius"] = 5.0


@pytest.mark.parametrize(
    ("fault", "mesh", "kind", "words"),
    [
        (drop_type, None, "bad-features", "curve 1: its type is 'Spiral'"),
        (drop_face, None, "features-mismatch", "each of the"),
        (other_radius, None, "features-mismatch", "is not on surface"),
        (None, lambda text: text.replace("v ", "v x", 1), "bad-mesh", "no number"),
        (None, lambda text: text + "f 1//1 2//1 3//1 4//1\n", "bad-mesh", "no triangles"),
        (None, lambda text: text + "f 1//1 2//1 99999//1\n", "bad-mesh", "is not there"),
    ],
)
def test_what_cannot_be_repaired_is_refused(fault, mesh, kind, words, bar):
    record = bar(fault, mesh)
    (failure,) = record.failures
    assert (failure.kind, failure.fatal) == (kind, True)
    assert words in failure.message
    assert record.model == {}


@pytest.mark.parametrize(
    ("left_out", "kind"), [("trimesh", "no-trimesh"), ("features", "no-features")]
)
def test_half_a_model_is_refused(left_out, kind, bar):
    from breplake.ingest.inputs import find_inputs

    bar()
    for path in bar.folder.glob(f"*_{left_out}_*"):
        path.unlink()
    (item,) = find_inputs([bar.folder])
    assert item.failure is not None
    assert item.failure.kind == kind
    assert "put it beside" in item.failure.message


def test_the_guide_names_every_repair_and_refusal():
    from breplake.ingest.abc.repair import REPAIRS

    guide = (Path(__file__).parents[2] / "docs" / "abc.md").read_text(encoding="utf-8")
    for code, fault in REPAIRS.items():
        assert f"| `{code}` | {fault} |\n" in guide
    for kind in ("no-features", "no-trimesh", "bad-features", "bad-mesh", "features-mismatch"):
        assert f"| `{kind}` |" in guide
