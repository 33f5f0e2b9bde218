"""Patches of real and sample parts against Open CASCADE, within the tolerances that we promise."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

pytest.importorskip("OCP")

from breplake.bench.accuracy.evaluate import (
    TOLERANCES,
    Errors,
    compare,
    models_of,
    report,
    total,
)

CORPUS = Path(__file__).parents[3] / "shared/corpus"


def compared(path, per_patch):
    from breplake.ingest.pointwise import faces_of, patch_geometry

    return compare(*patch_geometry(faces_of(path, "step")), per_patch)


def test_sample_parts(tmp_path):
    """A few points on every patch of parts that have every type between them."""
    from breplake.ingest.samples import PARTS as ALL
    from breplake.ingest.samples import write_samples

    names = list(ALL)[::9]
    errors = total(compared(path, 20) for path in write_samples(tmp_path, names))
    assert {"Plane", "Cylinder", "Cone", "Torus", "BSpline"} <= set(errors)
    for kind, one in errors.items():
        assert one.patches
        assert not one.unknown, kind
        assert one.flagged <= one.points // 1000, kind
        assert one.failed == [], "\n".join(report(errors))


def test_a_wrong_evaluation_is_found(tmp_path):
    """The comparison itself can fail: a radius that is off by 1e-9 of itself is too much."""
    from breplake.ingest.pointwise import faces_of, patch_geometry
    from breplake.ingest.samples import write_samples

    (path,) = write_samples(tmp_path, ["ring_o"])
    surfaces, table = patch_geometry(faces_of(path, "step"))
    assert total([compare(surfaces, table, 20)])["Torus"].failed == []
    place = table.column_names.index("min_radius")
    wrong = pa.array(table["min_radius"].to_numpy() * (1 + 1e-9))
    errors = compare(surfaces, table.set_column(place, table.schema.field(place), wrong), 20)
    assert "position" in errors["Torus"].failed
    assert errors["Torus"].worst["position"] > TOLERANCES["position"]


def test_what_is_not_evaluated_is_found(tmp_path, monkeypatch):
    """A set of surfaces that evaluates nothing does not pass for want of differences."""
    from breplake.schema.surfaces import SurfaceSet

    points = SurfaceSet.points

    def nothing(self, row, u, v):
        found = points(self, row, u, v)
        for part in (found.normal, found.k_min, found.k_max):
            part[:] = np.nan
        return found

    monkeypatch.setattr(SurfaceSet, "points", nothing)
    from breplake.ingest.samples import write_samples

    (path,) = write_samples(tmp_path, ["ring_o"])
    assert compared(path, 20)["Torus"].failed == ["flagged"]


def test_the_report():
    one, two = Errors(patches=2, points=40), Errors(patches=1, points=20, flagged=3)
    one.worst["normal"] = 1e-9
    lines = report(total([{"Plane": one}, {"Plane": two, "Cone": two}]))
    assert lines[1].split()[:5] == ["Cone", "1", "20", "0", "3"]
    assert lines[2].split()[:5] == ["Plane", "3", "60", "0", "3"]
    assert lines[3].split()[:3] == ["all", "4", "80"]
    assert np.isclose(float(lines[2].split()[-2]), 1e-9)


@pytest.mark.slow
@pytest.mark.skipif(not CORPUS.is_dir(), reason="the corpus of CAD files is not here")
def test_a_hundred_models_of_the_corpus():
    """At 1,000 random parameters on every patch."""
    found = [errors for _, errors in models_of(CORPUS, 100, 1000, 2)]
    errors = total(found)
    assert len(found) == 100
    for one in errors.values():
        assert one.failed == [], "\n".join(report(errors))
