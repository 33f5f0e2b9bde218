"""Sample parts: valid, varied, and the same bytes every time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("cadquery")

import cadquery as cq
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.GeomAbs import GeomAbs_CurveType, GeomAbs_SurfaceType
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.STEPCAFControl import STEPCAFControl_Reader
from OCP.STEPControl import STEPControl_Reader
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_LabelSequence
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_OUT
from OCP.TopExp import TopExp
from OCP.TopTools import (
    TopTools_IndexedDataMapOfShapeListOfShape,
    TopTools_IndexedMapOfShape,
)

from breplake.ingest.samples import PARTS, part, write_samples

SURFACES = {
    "Plane", "Cylinder", "Cone", "Sphere", "Torus", "SurfaceOfRevolution", "SurfaceOfExtrusion",
    "BSplineSurface", "rational BSplineSurface", "OffsetSurface",
}  # fmt: skip
CURVES = {
    "Line", "Circle", "Ellipse", "Parabola", "Hyperbola", "BSplineCurve", "rational BSplineCurve",
}  # fmt: skip
SEVERAL_SOLIDS = {"bodies_touching", "bearing_spherical_plain"}
"""Parts other than assemblies that are meant to have more than one solid."""


@dataclass
class Body:
    """A sample as read back: its shape and what it is made of."""

    shape: cq.Shape
    surfaces: Counter[str]
    curves: Counter[str]
    n_free: int


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("samples")
    assert [path.stem for path in write_samples(folder)] == list(PARTS)
    return folder


@pytest.fixture(scope="module")
def bodies(folder) -> dict[str, Body]:
    return {name: read(folder / f"{name}.step") for name in PARTS}


def read(path: Path) -> Body:
    reader = STEPControl_Reader()
    assert reader.ReadFile(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone
    reader.TransferRoots()
    shape = cq.Shape.cast(reader.OneShape())
    faces = [face_type(f) for f in shape.Faces()]
    edges = [edge_type(e) for e in shape.Edges() if not BRep_Tool.Degenerated_s(e.wrapped)]
    return Body(shape, Counter(faces), Counter(edges), len(free_edges(shape)))


def face_type(face: cq.Face) -> str:
    surface = BRepAdaptor_Surface(face.wrapped)
    spline = surface.GetType() == GeomAbs_SurfaceType.GeomAbs_BSplineSurface
    is_rational = spline and (surface.BSpline().IsURational() or surface.BSpline().IsVRational())
    return ("rational " if is_rational else "") + surface.GetType().name.removeprefix("GeomAbs_")


def edge_type(edge: cq.Edge) -> str:
    curve = BRepAdaptor_Curve(edge.wrapped)
    spline = curve.GetType() == GeomAbs_CurveType.GeomAbs_BSplineCurve
    is_rational = spline and curve.BSpline().IsRational()
    return ("rational " if is_rational else "") + curve.GetType().name.removeprefix("GeomAbs_")


def free_edges(shape: cq.Shape) -> list[cq.Shape]:
    """Edges that one face uses once: the rim of a surface."""
    owners = TopTools_IndexedDataMapOfShapeListOfShape()
    TopExp.MapShapesAndAncestors_s(shape.wrapped, TopAbs_EDGE, TopAbs_FACE, owners)
    edges = TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(shape.wrapped, TopAbs_EDGE, edges)
    found = []
    for i in range(1, edges.Extent() + 1):
        edge, faces = cq.Edge(edges.FindKey(i)), owners.FindFromKey(edges.FindKey(i))
        is_seam = BRep_Tool.IsClosed_s(edge.wrapped, cq.Face(faces.First()).wrapped)
        if faces.Size() == 1 and not is_seam and not BRep_Tool.Degenerated_s(edge.wrapped):
            found.append(edge)
    return found


def product_names(path: Path) -> list[str]:
    reader = STEPCAFControl_Reader()
    reader.SetNameMode(True)
    reader.ReadFile(str(path))
    document = TDocStd_Document(TCollection_ExtendedString("XCAF"))
    reader.Transfer(document)
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    labels = TDF_LabelSequence()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetShapes(labels)
    names = []
    for i in range(1, labels.Length() + 1):
        name = TDataStd_Name()
        labels.Value(i).FindAttribute(TDataStd_Name.GetID_s(), name)
        names.append(name.Get().ToExtString())
    return names


def test_there_are_at_least_forty_parts():
    assert len(PARTS) >= 40
    for name, sample in PARTS.items():
        assert sample.name == name
        assert sample.description
        assert len(sample.description) < 90


@pytest.mark.parametrize("name", PARTS)
def test_part_is_valid_after_reading_back(bodies, name):
    body = bodies[name]
    assert body.shape.isValid()
    assert 1 <= len(body.shape.Faces()) <= 400
    assert (body.n_free > 0) == PARTS[name].is_open
    assert (not body.shape.Solids()) == PARTS[name].is_open


@pytest.mark.parametrize("name", PARTS)
def test_solids_are_not_inside_out(bodies, name):
    for solid in bodies[name].shape.Solids():
        classifier = BRepClass3d_SolidClassifier(solid.wrapped)
        classifier.PerformInfinitePoint(1e-7)
        assert classifier.State() == TopAbs_OUT
        assert solid.Volume() > 0


def test_only_assemblies_have_several_solids(bodies, folder):
    for name, body in bodies.items():
        is_assembly = "NEXT_ASSEMBLY_USAGE_OCCURRENCE" in (folder / f"{name}.step").read_text()
        if not is_assembly and name not in SEVERAL_SOLIDS:
            assert len(body.shape.Solids()) <= 1, name


def test_every_surface_type_occurs(bodies):
    assert set().union(*(body.surfaces for body in bodies.values())) >= SURFACES


def test_every_curve_type_occurs(bodies):
    assert set().union(*(body.curves for body in bodies.values())) >= CURVES


def test_at_least_two_parts_have_more_than_thirty_torus_faces(bodies):
    assert sum(body.surfaces["Torus"] > 30 for body in bodies.values()) >= 2


def test_inch_and_millimetre_twins_are_the_same_part(bodies, folder):
    metric, imperial = (bodies[f"base_plate_{unit}"].shape for unit in ("mm", "inch"))
    assert imperial.Volume() == pytest.approx(metric.Volume(), rel=1e-12)
    assert "'INCH'" in (folder / "base_plate_inch.step").read_text()
    assert "'INCH'" not in (folder / "base_plate_mm.step").read_text()


def test_assembly_keeps_product_names(folder):
    names = product_names(folder / "piston.step")
    assert names == ["piston", "crown", "gudgeon_pin", "rod", "ring"]


def test_every_product_is_named(folder):
    for path in folder.iterdir():
        assert "Open CASCADE STEP translator" not in path.read_text(), path.stem


@pytest.mark.slow
def test_all_parts_are_the_same_bytes_in_another_process_and_order(folder, tmp_path):
    assert_same_bytes(list(PARTS), folder, tmp_path)


def test_parts_are_the_same_bytes_in_another_process_and_order(folder, tmp_path):
    assemblies = [n for n in PARTS if "NEXT_ASSEMBLY" in (folder / f"{n}.step").read_text()]
    assert_same_bytes(sorted({*assemblies, *list(PARTS)[::7]}), folder, tmp_path)


def assert_same_bytes(names: list[str], folder: Path, other: Path) -> None:
    """Write parts backwards in a fresh interpreter and compare with those in ``folder``."""
    code = "import sys; from pathlib import Path; from breplake.ingest.samples import *; "
    code += "write_samples(Path(sys.argv[1]), sys.argv[2:])"
    command = [sys.executable, "-c", code, str(other), *reversed(names)]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONHASHSEED": "7"}, timeout=240)
    for name in names:
        assert (other / f"{name}.step").read_bytes() == (folder / f"{name}.step").read_bytes(), name


def test_one_part_alone_is_the_same_file(folder, tmp_path):
    (path,) = write_samples(tmp_path / "new", ["ring_o"])
    assert path.name == "ring_o.step"
    assert path.read_bytes() == (folder / path.name).read_bytes()


def test_unknown_name_writes_nothing(tmp_path):
    with pytest.raises(KeyError, match="no_such_part"):
        write_samples(tmp_path / "new", ["ring_o", "no_such_part"])
    assert not (tmp_path / "new").exists()


def test_a_name_is_registered_once():
    with pytest.raises(ValueError, match="ring_o"):
        part("ring_o", "Another ring")(lambda: None)
