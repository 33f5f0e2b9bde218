"""The benchmark of evaluation runs, measures everyone on the same points, and prints ratios."""

import pytest

pytest.importorskip("OCP")

from breplake.bench.speed.evaluate import Faces, Figures, load_faces, measure, report
from breplake.errors import UsageError
from breplake.ingest.samples import write_samples


@pytest.fixture(scope="module")
def faces(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_samples(folder, ["ring_o", "ball_steel"])
    return load_faces([folder], 10)


def test_figures_of_sample_parts(faces):
    figures = measure(faces, 64, 1)
    assert figures.patches == faces.table.num_rows == len(faces.shapes)
    assert figures.nanoseconds["numpy"] > 0
    assert figures.nanoseconds["OCP"] > figures.nanoseconds["numpy"] > 0
    lines = report({"all": figures})
    assert lines[2].startswith("all")
    assert any("million points a second" in line for line in lines)


def test_the_least_of_several_rounds_counts():
    figures = Figures(1)
    for seconds in (2e-3, 1e-3, 3e-3):
        figures.keep("numpy", seconds, 1000)
    figures.keep("abs", 1.0, 0)
    assert figures.nanoseconds == {"numpy": pytest.approx(1000.0)}


def test_a_choice_of_faces(faces):
    one = faces.only([0])
    assert isinstance(one, Faces)
    assert one.table.num_rows == len(one.shapes) == 1


def test_a_folder_without_patches(tmp_path):
    with pytest.raises(UsageError, match="holds a patch"):
        load_faces([tmp_path], 10)
