"""A rebuilt model against its source: volume, area, counts and validity."""

from __future__ import annotations

import hashlib
import math
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from breplake.errors import BreplakeError
from breplake.ingest.canonical import canonical
from breplake.ingest.heal import add_missing_pcurves
from breplake.ingest.load import load
from breplake.ingest.lossless.carried import CARRIED
from breplake.ingest.lossless.graph import ShapeGraph
from breplake.ingest.lossless.rebuild import ModelTables, rebuilt_shapes
from breplake.ingest.lossless.step_proof import step_differences
from breplake.ingest.unpack import unpacked
from breplake.schema.shape_tables import SHAPE_TABLES

__all__ = [
    "COUNTED",
    "TOLERANCE",
    "VERDICTS",
    "Comparison",
    "Measures",
    "compare_model",
    "differences",
    "measure",
]

TOLERANCE: Final = 1e-12
"""Relative difference of volume and area that counts as none."""

COUNTED: Final = ("solid", "shell", "face", "wire", "edge", "vertex")
"""Types of shapes that are counted, the same shape at the same place once."""

_PLURALS: Final = {"vertex": "vertices"}

VERDICTS: Final = {
    "equal": "volume, area, counts and validity are those of the source",
    "different": "something differs",
    "step-loses": "as equal; a STEP file made of the tables is ingested to others, and so is one "
    "made of the source's own shapes: the kernel's STEP does not carry what differs",
    "step-differs": "as equal, but a STEP file made of the tables is ingested to others than one "
    "made of the source's own shapes",
    "no-source": "the CAD file is not where it was, or is another by now",
    "no-shapes": "the lake has no shapes of the model",
    "failed": "the model could not be rebuilt or its source not be read",
}
"""How a comparison may end."""


@dataclass(frozen=True, slots=True)
class Measures:
    """What is compared of a B-Rep.

    Parameters
    ----------
    volume : float
        Sum over the solids of their volumes without sign, mm^3.
    area : float
        Sum over the faces, mm^2.
    centre : tuple of float
        Centre of mass of the faces ``(3,)``, mm; tells displaced parts.
    counts : dict
        Number of shapes by type, of `COUNTED`.
    is_valid : bool
        Whether OCCT's ``BRepCheck_Analyzer`` finds no fault.
    """

    volume: float
    area: float
    centre: tuple[float, ...]
    counts: dict[str, int]
    is_valid: bool


@dataclass(slots=True)
class Comparison:
    """How one model compares with its source.

    Parameters
    ----------
    model_id : int
        The model.
    name : str
        Its name.
    verdict : str
        A key of `VERDICTS`.
    reasons : list of str
        What differs, or why there is no comparison.
    is_exact : bool, optional
        Whether the tables of the rebuilt shapes are those of the lake, bit for bit.
    source, rebuilt : Measures, optional
        What was measured.
    seconds : float
        CPU time.
    """

    model_id: int
    name: str
    verdict: str = "equal"
    reasons: list[str] = field(default_factory=list)
    is_exact: bool | None = None
    source: Measures | None = None
    rebuilt: Measures | None = None
    seconds: float = 0.0

    def row(self) -> dict[str, Any]:
        """Return the comparison as JSON takes it."""
        return asdict(self)


def measure(shape: Any) -> Measures:
    """Measure a B-Rep, each solid and each face at each place once."""
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopTools import TopTools_IndexedMapOfShape

    maps = {name: TopTools_IndexedMapOfShape() for name in COUNTED}
    for name, found in maps.items():
        TopExp.MapShapes_s(shape, getattr(TopAbs_ShapeEnum, f"TopAbs_{name.upper()}"), found)

    volume, faces = 0.0, GProp_GProps()
    for solid in _shapes(maps["solid"]):
        properties = GProp_GProps()
        BRepGProp.VolumeProperties_s(solid, properties)
        volume += abs(properties.Mass())
    for face in _shapes(maps["face"]):
        properties = GProp_GProps()
        BRepGProp.SurfaceProperties_s(face, properties)
        faces.Add(properties)
    centre = faces.CentreOfMass()
    return Measures(
        volume,
        area=faces.Mass(),
        centre=(centre.X(), centre.Y(), centre.Z()),
        counts={name: int(found.Extent()) for name, found in maps.items()},
        is_valid=bool(BRepCheck_Analyzer(shape).IsValid()),
    )


def _shapes(found: Any) -> Iterator[Any]:
    """Yield the shapes of a map."""
    return (found.FindKey(i + 1) for i in range(found.Extent()))


def compare_model(lake: ModelTables, model_id: int, through_step: bool = False) -> Comparison:
    """Rebuild a model from its tables, load its source, and compare the two.

    The source is measured as it was loaded, after the one repair that ingest makes: the
    pcurves that it lacks are added.

    Parameters
    ----------
    lake : breplake.queries.session.Lake
        The lake.
    model_id : int
        The model.
    through_step : bool
        Whether to write the model as STEP too, and compare the tables that ingest makes of that.
    """
    begun = time.process_time()
    model = lake.model(model_id)
    result = Comparison(model_id, model["name"])
    try:
        _compare(lake, model, result)
        if through_step and result.verdict == "equal":
            _compare_through_step(lake, model, result)
    except (BreplakeError, OSError) as error:
        result.verdict, result.reasons = "failed", [str(error)]
    except Exception as error:  # the kernel raises what it likes; the other models are to go on
        result.verdict, result.reasons = "failed", [f"{type(error).__name__}: {error}"]
    result.seconds = time.process_time() - begun
    return result


def _compare(lake: ModelTables, model: dict[str, Any], result: Comparison) -> None:
    tables = {table.name: lake.read(table.name, model["model_id"]) for table in SHAPE_TABLES}
    if not tables["shapes"].num_rows:
        result.verdict, result.reasons = "no-shapes", ["shapes has no rows of it"]
        return
    path = Path(model["path"])
    if reason := _changed(path, model["sha256"]):
        result.verdict, result.reasons = "no-source", [reason]
        return
    rebuilt = rebuilt_shapes(tables)[0]
    again = ShapeGraph(rebuilt).tables(model["model_id"])
    result.is_exact = all(again[name].equals(table) for name, table in tables.items())
    result.rebuilt = measure(rebuilt)
    with tempfile.TemporaryDirectory() as folder:
        result.source = measure(_source(path, model["format"], Path(folder))[0])
    result.reasons = differences(result.source, result.rebuilt)
    result.verdict = "different" if result.reasons else "equal"


def _compare_through_step(lake: ModelTables, model: dict[str, Any], result: Comparison) -> None:
    names = {*CARRIED, *(table.name for table in SHAPE_TABLES)}
    tables = {name: lake.read(name, model["model_id"]) for name in names}

    def source() -> Any:
        with tempfile.TemporaryDirectory() as folder:
            return _source(Path(model["path"]), model["format"], Path(folder))[1]

    result.reasons, is_own = step_differences(
        tables, model["scale_to_mm"], Path(model["name"]).name, source
    )
    if result.reasons:
        result.verdict = "step-loses" if is_own else "step-differs"


def differences(source: Measures, rebuilt: Measures, tolerance: float = TOLERANCE) -> list[str]:
    """Say in what a rebuilt model differs from its source.

    Parameters
    ----------
    source, rebuilt : Measures
        What to compare.
    tolerance : float
        Relative difference of volume and area, and displacement relative to the size, up to
        which they count as equal.
    """
    found = []
    for name in ("volume", "area"):
        before, after = getattr(source, name), getattr(rebuilt, name)
        if not abs(after - before) <= tolerance * abs(before):
            found.append(f"{name} is {after!r}, not {before!r}")
    apart = math.dist(source.centre, rebuilt.centre)
    if not apart <= tolerance * max(math.hypot(*source.centre), math.sqrt(abs(source.area))):
        found.append(f"the centre of the faces is {apart!r} mm away")
    for name in COUNTED:
        before, after = source.counts[name], rebuilt.counts[name]
        if after != before:
            found.append(f"{after} {_PLURALS.get(name, name + 's')}, not {before}")
    if rebuilt.is_valid != source.is_valid:
        words = {True: "valid", False: "not valid"}
        found.append(f"{words[rebuilt.is_valid]} where the source is {words[source.is_valid]}")
    return found


def _source(path: Path, format: str, folder: Path) -> tuple[Any, Any]:
    """Return the shapes of a CAD file in one compound as they are, and in canonical order."""
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    document = load(unpacked(path, format, folder), format)
    # The repair works on the shapes themselves, which both compounds share.
    ordered = canonical(document.shapes).compound
    add_missing_pcurves(ordered)
    builder, compound = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(compound)
    for shape in document.shapes:
        builder.Add(compound, shape)
    return compound, ordered


def _changed(path: Path, sha256: str) -> str | None:
    """Say why a file cannot be the source with this hash, None if it is."""
    try:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        return f"{path} cannot be read: {error.strerror}"
    return None if found == sha256 else f"{path} has other content than when it was ingested"
