"""Rebuilt models as CAD files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Literal

from breplake.errors import UsageError
from breplake.ingest.load import load
from breplake.ingest.lossless.compare import differences, measure
from breplake.ingest.lossless.rebuild import ModelTables, rebuild
from breplake.ingest.lossless.step_out import write_step
from breplake.ingest.worker import silence

__all__ = ["SUFFIXES", "write_model"]

SUFFIXES: Final = (".step", ".stp", ".brep", ".bin")
"""STEP; OCCT's own format as text, whose ranges of edges and tolerances have 15 digits; and the
same in binary, which keeps every bit."""

_CARRIED: Final = 1e-6
"""Relative difference of volume and area below which a STEP file counts as the same model."""


def write_model(
    lake: ModelTables, model: str | int, path: Path, unit: Literal["model", "mm"] = "model"
) -> list[str]:
    """Rebuild a model from its tables and write it as a CAD file.

    Parameters
    ----------
    lake : breplake.queries.session.Lake
        The lake.
    model : str or int
        Name or id.
    path : Path
        File to write, of a suffix in `SUFFIXES`; an existing one is replaced.
    unit : {"model", "mm"}
        Length unit of a STEP file: the one that the model's source declared, or millimetres.

    Returns
    -------
    list of str
        In what a STEP file, when it is read again, differs from the model: the format has no
        tolerance of single edges, and OCCT's writer and reader change some geometry. Empty in
        nearly all cases.

    Raises
    ------
    UsageError
        If the suffix is none of `SUFFIXES`.
    NameNotFoundError, LakeFormatError
        As of ``rebuild``.
    OSError
        If the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(f"the file must end with {', '.join(SUFFIXES)}; got {path.name}")
    silence()
    row = lake.model(model)
    compound = rebuild(lake, row["model_id"])
    if suffix in (".step", ".stp"):
        parts, patches = (
            lake.read(table, row["model_id"]).to_pylist() for table in ("parts", "patches")
        )
        scale = row["scale_to_mm"] if unit == "model" else None
        name = Path(row["name"]).name
        write_step(compound, path, name=name, parts=parts, patches=patches, scale_to_mm=scale)
        return _lost(compound, path)
    _write_native(compound, path, binary=suffix == ".bin")
    return []


def _lost(compound: Any, path: Path) -> list[str]:
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    builder, again = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(again)
    for shape in load(path, "step").shapes:
        builder.Add(again, shape)
    return differences(measure(compound), measure(again), _CARRIED)


def _write_native(compound: Any, path: Path, *, binary: bool) -> None:
    from OCP.BinTools import BinTools
    from OCP.BRepTools import BRepTools

    written = BinTools.Write_s if binary else BRepTools.Write_s
    if not written(compound, str(path)):
        raise OSError(f"cannot write {path}; check that its folder exists")
