"""Copies share a fingerprint; parts that differ in one dimension, or by a mirror, do not."""

from pathlib import Path

import numpy as np
import pytest

from breplake.ingest.brep import extract
from breplake.ingest.canonical import canonical
from breplake.ingest.load import load
from breplake.ingest.rows import brep_columns, brep_tables
from breplake.ingest.samples import PARTS, write_samples
from breplake.schema.fingerprint import Fingerprint, fingerprint, mirrored

COPIED = sorted(PARTS)[::4]  # about 30 of the parts
QUICK = 3  # a third of them is enough for every day


def of_file(path):
    document = load(Path(path), "step")
    return of_shape(document.shapes)


def of_shape(shapes):
    brep = extract(canonical(shapes), [])
    tables = brep_tables(0, brep)
    rows = (tables[name] for name in ("patches", "curves", "coedges", "corners"))
    return fingerprint(*rows, brep_columns(brep)["volume"])


def written(shape, path, unit="MM"):
    """Write a shape to STEP in a unit, and return the path."""
    from OCP.Interface import Interface_Static
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    before = Interface_Static.CVal_s("write.step.unit")
    writer = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", unit)
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(path))
    Interface_Static.SetCVal_s("write.step.unit", before)
    return path


def moved(shape, *, mirror=False, scale=1.0):
    """Return a copy that is turned about a skew axis and moved, or mirrored, or scaled."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
    from OCP.gp import gp_Ax1, gp_Ax2, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec

    motion = gp_Trsf()
    if mirror:
        motion.SetMirror(gp_Ax2(gp_Pnt(3, 1, 2), gp_Dir(0.2, 0.7, -0.4)))
    elif scale != 1.0:
        motion.SetScale(gp_Pnt(1, 2, 3), scale)
    else:
        motion.SetRotation(gp_Ax1(gp_Pnt(5, -3, 2), gp_Dir(0.3, -0.5, 0.8)), 1.234)
        motion.SetTranslationPart(gp_Vec(101.3, -57.9, 33.1))
    return BRepBuilderAPI_Transform(shape, motion, True).Shape()


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_samples(folder, names=COPIED)
    return {name: folder / f"{name}.step" for name in COPIED}


def now_and_then(names):
    """Mark all but some of the cases as slow."""
    return [
        name if i % QUICK == 0 else pytest.param(name, marks=pytest.mark.slow)
        for i, name in enumerate(names)
    ]


@pytest.mark.parametrize("name", now_and_then(COPIED))
def test_copies_are_one(name, originals, tmp_path):
    path = originals[name]
    (shape, *more) = load(path, "step").shapes
    if more:
        pytest.skip("the part is of several roots")
    text = path.read_text()
    head, data = text.split("DATA;", 1)
    changed = tmp_path / "header.step"
    changed.write_text(head.replace("FILE_NAME(", "FILE_NAME( /* again */ ") + "DATA;" + data)
    first = of_file(path)
    copies = {
        "re-exported": of_file(written(shape, tmp_path / "again.step")),
        "moved and turned": of_file(written(moved(shape), tmp_path / "moved.step")),
        "header": of_file(changed),
        "inch": of_file(written(shape, tmp_path / "inch.step", "IN")),
    }
    assert {key: str(value) for key, value in copies.items()} == dict.fromkeys(copies, str(first))


@pytest.mark.parametrize("name", COPIED[::QUICK])
def test_mirror_images_and_scaled_copies_are_told_as_such(name, originals):
    (shape, *_) = load(originals[name], "step").shapes
    first = of_shape([shape])
    mirror, large = of_shape([moved(shape, mirror=True)]), of_shape([moved(shape, scale=2.0)])
    assert (mirror.form, mirror.size) == (first.form, first.size)
    assert mirror.hand == mirrored(first.hand)
    assert (large.form, large.hand) == (first.form, first.hand)
    assert large.size != first.size


def plate(width=60.0, depth=40.0, height=8.0, hole=7.0, place=15.0, fillet=3.0):
    """A plate with a hole off its centre and a boss, rounded at its uprights."""
    import cadquery as cq

    body = cq.Workplane("XY").box(width, depth, height).edges("|Z").fillet(fillet)
    body = body.faces(">Z").workplane().center(place, 4.0).hole(hole)
    return body.faces(">Z").workplane().center(-2 * place, -6.0).circle(5.0).extrude(6.0)


def bush(outer=20.0, inner=12.0, length=30.0, chamfer=1.5, flange=34.0, groove=2.0):
    """A flanged bush with a chamfer and a groove."""
    import cadquery as cq

    body = cq.Workplane("XY").circle(outer / 2).extrude(length).faces(">Z").chamfer(chamfer)
    body = body.faces("<Z").workplane().circle(flange / 2).extrude(4.0)
    body = body.cut(cq.Workplane("XY").circle(inner / 2).extrude(2 * length, both=True))
    ring = cq.Workplane("XY").workplane(offset=length / 2).circle(outer).circle(outer / 2 - groove)
    return body.cut(ring.extrude(3.0))


def hook(radius=20.0, wire=3.0, arm=25.0, pitch=6.0, turns=1.5):
    """A coil with a straight arm: chiral, of swept splines."""
    import cadquery as cq

    coil = cq.Wire.makeHelix(pitch, pitch * turns, radius)
    start = cq.Workplane("XZ").center(radius, 0).circle(wire / 2).sweep(coil, isFrenet=True)
    return start.union(cq.Workplane("XY").center(radius, 0).circle(wire).extrude(-arm))


FAMILIES = {"plate": plate, "bush": bush, "hook": hook}


def near_misses():
    """Return a hundred pairs: family, factor on all dimensions, the one that is changed."""
    import inspect

    pairs = [
        (family, round(factor, 3), dimension)
        for factor in np.linspace(0.8, 1.3, 6)
        for family, build in FAMILIES.items()
        for dimension in inspect.signature(build).parameters
    ]
    return pairs[:100]


@pytest.mark.parametrize(
    ("family", "most"), [*((f, 6) for f in FAMILIES), pytest.param("", 100, marks=pytest.mark.slow)]
)
def test_a_thousandth_in_one_dimension_is_another_part(family, most):
    import inspect

    same = []
    pairs = [pair for pair in near_misses() if pair[0] == family or not family][:most]
    assert len(pairs) >= 5
    for name, factor, dimension in pairs:
        build = FAMILIES[name]
        parts = inspect.signature(build).parameters
        sizes = {k: v.default * (factor if k != "turns" else 1.0) for k, v in parts.items()}
        first = of_shape([build(**sizes).val().wrapped])
        other = of_shape([build(**sizes | {dimension: sizes[dimension] * 1.001}).val().wrapped])
        if first == other:
            same.append((name, factor, dimension))
    assert not same


def test_the_text_can_be_read_back():
    text = "0123456789abcdef-+---412"
    assert Fingerprint.parse(text) == Fingerprint("0123456789abcdef", "+-", -412)
    assert str(Fingerprint.parse(text)) == text
    assert str(Fingerprint.parse("0123456789abcdef-00-412")) == "0123456789abcdef-00-412"


def test_without_patches_there_is_none():
    from breplake.schema.tables import COEDGES, CORNERS, CURVES, PATCHES

    rows = (table.empty() for table in (PATCHES, CURVES, COEDGES, CORNERS))
    assert fingerprint(*rows, None) is None
