"""Export in ABC's file formats, read back as its users read them: PyYAML and a plain OBJ reader."""

from __future__ import annotations

import math

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.errors import NameNotFoundError, UsageError
from breplake.queries.abc import export
from breplake.queries.abc.emit import yaml_text
from breplake.schema.abc import CURVE_KEYS, SURFACE_KEYS, file_name, parse_name

ORIGINAL = "00000050_80d90bfdd2e74e709956122a_000"

floats = st.floats(allow_nan=False)
scalars = st.none() | st.booleans() | st.integers() | floats | st.text()
values = st.recursive(
    scalars | st.lists(floats) | st.lists(st.lists(floats, min_size=2, max_size=3)),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


def in_order(data):
    """Return the same with all mappings in order of their keys, so that text tells every bit."""
    if isinstance(data, dict):
        return {key: in_order(data[key]) for key in sorted(data)}
    return [in_order(item) for item in data] if isinstance(data, list) else data


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(st.dictionaries(st.text(), values))
@example({})
@example({"a": [None, []], "b": [[0, [[0.0, 0.0]]], {}], "c": [{}, 1], "d": [[[]]]})
@example({"a": [-0.0, 0, True], "b": [[[1.0, 2.0]], [[3, -4e-07]]]})
def test_yaml_is_read_back_bit_for_bit(data):
    back = yaml.load(yaml_text(data), yaml.CSafeLoader)
    assert repr(back) == repr(in_order(data))


def test_yaml_of_what_is_not_finite():
    text = yaml_text({"a": [math.nan, math.inf, -math.inf], "b": math.nan, "c": [[math.nan]]})
    back = yaml.safe_load(text)
    assert math.isnan(back["a"][0])
    assert back["a"][1:] == [math.inf, -math.inf]
    assert math.isnan(back["b"])
    assert math.isnan(back["c"][0][0])
    with pytest.raises(TypeError, match="cannot write"):
        yaml_text({"a": object()})


def test_small_floats_stay_floats():
    """YAML 1.1 takes 1e-05 for text."""
    back = yaml.safe_load(yaml_text({"a": [1e-05, -2e-20, 1.5e300], "b": 1e-7}))
    assert back == {"a": [1e-05, -2e-20, 1.5e300], "b": 1e-7}


def test_names_of_original_files():
    assert file_name(ORIGINAL, "trimesh") == ORIGINAL.replace("_000", "_trimesh_000.obj")
    found = parse_name("00000050_80d90bfdd2e74e709956122a_features_017.yml")
    assert (found.model, found.kind) == ("00000050_80d90bfdd2e74e709956122a_017", "features")
    for name in ("a.yml", "a_features_000.obj", "a_trimesh_00.obj", "a_step_000.step"):
        assert parse_name(name) is None


@given(st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=40))
def test_names_are_reversible(name):
    for kind in ("trimesh", "features", "stats"):
        found = parse_name(file_name(name, kind))
        assert (found.model, found.kind) == (name, kind)


@pytest.mark.parametrize(
    "name", ["a/b/c", "a%2Fb", ".a", ORIGINAL, ORIGINAL[:-4], "a_features_001"]
)
def test_awkward_names_are_reversible(name):
    stored = file_name(name, "features")
    assert "/" not in stored
    assert parse_name(stored).model == name


def test_too_long_a_name_is_refused():
    with pytest.raises(UsageError, match="255 bytes"):
        file_name("a" * 250, "features")


def read_obj(path):
    """As users of the published files do."""
    rows = {"v": [], "vn": [], "vc": [], "f": []}
    for line in path.read_text().splitlines():
        keyword, *words = line.split()
        if keyword == "f":
            rows["f"].append([[int(i) - 1 for i in word.split("//")] for word in words])
        else:
            rows[keyword].append([float(word) for word in words])
    return {key: np.array(value) for key, value in rows.items()}


@pytest.fixture(scope="module")
def exported(sample_lake, tmp_path_factory):
    folder = tmp_path_factory.mktemp("abc")
    lake = breplake.open(sample_lake)
    done = export(lake, None, folder)
    assert done.written == done.total > 20
    return lake, folder


def names(lake):
    return [row[0] for row in lake.sql("SELECT name FROM models ORDER BY name").fetchall()]


def test_every_key_of_the_paper_is_there(exported):
    lake, folder = exported
    seen = set()
    for name in names(lake):
        features = yaml.load((folder / file_name(name, "features")).read_text(), yaml.CSafeLoader)
        for part, keys in (("curves", CURVE_KEYS), ("surfaces", SURFACE_KEYS)):
            for row in features[part]:
                seen.add((part, row["type"]))
                assert {*keys[row["type"]], "vert_indices", "vert_parameters"} <= row.keys()
                assert "sharp" in row or "face_indices" in row
                if row["type"] == "Ellipse":
                    assert (row["maj_radius"], row["min_radius"]) == (
                        row["x_radius"],
                        row["y_radius"],
                    )
    assert {kind for part, kind in seen if part == "surfaces"} == set(SURFACE_KEYS)
    assert {kind for part, kind in seen if part == "curves"} == set(CURVE_KEYS)


def test_mesh_and_labels_are_the_lakes(exported):
    lake, folder = exported
    name = "screw_countersunk"
    model = lake.model(name)["model_id"]
    mesh = read_obj(folder / file_name(name, "trimesh"))
    features = yaml.load((folder / file_name(name, "features")).read_text(), yaml.CSafeLoader)
    vertices, faces = lake.read("vertices", model), lake.read("faces", model)
    rows = vertices.to_pylist()
    assert len(mesh["vn"]) == len(mesh["vc"]) == len(rows)
    for row in rows[::97]:
        assert mesh["v"][row["vertex_id"]].tolist() == [row["x"], row["y"], row["z"]]
        assert mesh["vn"][row["normal_id"]].tolist() == [row["nx"], row["ny"], row["nz"]]
        assert mesh["vc"][row["normal_id"]][:2].tolist() == [row["k_min"], row["k_max"]]
        assert mesh["vc"][row["normal_id"]][2:5].tolist() == list(row["d_min"].values())
    labels = np.full(faces.num_rows, -1)
    for patch, surface in enumerate(features["surfaces"]):
        labels[surface["face_indices"]] = patch
        on_patch = {int(v) for v in mesh["f"][surface["face_indices"]][:, :, 0].ravel()}
        assert on_patch == set(surface["vert_indices"])
        assert len(surface["vert_indices"]) == len(surface["vert_parameters"])
    assert labels.tolist() == faces.column("patch_id").to_pylist()


def test_stats_are_the_lakes(exported):
    lake, folder = exported
    for name in ("mug", "gear_spur"):
        stats = yaml.safe_load((folder / file_name(name, "stats")).read_text())
        model = lake.model(name)
        assert stats["surface"] == model["area"]
        assert stats["volume"] == model["volume"]
        assert stats["#verts"] == model["n_vertices"]
        assert len(stats["surfs"]) == stats["#surfs"] == model["n_patches"]
        low, high, size = np.reshape(stats["bbox"], (3, 3))
        np.testing.assert_allclose(high - low, size)
        assert stats["diag"] == pytest.approx(np.linalg.norm(size))


def test_finished_models_are_left_alone(tiny_lake, tmp_path):
    lake = breplake.open(tiny_lake)
    first = export(lake, ["big"], tmp_path)
    assert (first.total, first.written) == (1, 1)
    stats = tmp_path / file_name("big", "stats")
    features = tmp_path / file_name("big", "features")
    features.write_text("mine")
    again = export(lake, None, tmp_path)
    assert (again.written, again.skipped) == (again.total - 1, 1)
    assert features.read_text() == "mine"
    stats.unlink()  # as if the export had been interrupted before the last file
    export(lake, ["big"], tmp_path)
    assert features.read_text() != "mine"
    features.write_text("mine")
    export(lake, ["big"], tmp_path, overwrite=True)
    assert features.read_text() != "mine"
    assert not list(tmp_path.glob(".*"))


def test_a_model_without_mesh_has_no_obj(tiny_lake, tmp_path):
    done = export(breplake.open(tiny_lake), ["bare"], tmp_path)
    assert (done.written, done.unmeshed) == (1, 1)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "bare_features_000.yml",
        "bare_stats_000.yml",
    ]


def test_decimals_and_wrong_arguments(tiny_lake, tmp_path):
    lake = breplake.open(tiny_lake)
    export(lake, ["long/flat"], tmp_path, decimals=6)
    text = (tmp_path / "long%2Fflat_trimesh_000.obj").read_text()
    assert "v 9.000000 2.000000 1.000000\n" in text
    with pytest.raises(UsageError, match="3 to 15"):
        export(lake, None, tmp_path, decimals=2)
    with pytest.raises(NameNotFoundError, match="no model"):
        export(lake, ["absent"], tmp_path)
    with pytest.raises(UsageError):
        export(lake, None, tmp_path, where="no_column = 1")


def test_command(tiny_lake, tmp_path):
    arguments = ["export", "abc", "--lake", str(tiny_lake), "-o", str(tmp_path)]
    result = CliRunner().invoke(app, [*arguments, "--where", "area > 100"])
    assert result.exit_code == 0
    assert result.stdout == f"2 models written to {tmp_path}\n"
    assert len(list(tmp_path.iterdir())) == 6
    result = CliRunner().invoke(app, [*arguments, "big", "--where", "true"])
    assert result.exit_code == 2
    assert "not both" in result.stderr
