"""Why an input failed: stable codes, and the advice that goes with each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

__all__ = ["CHANGED", "KILLED", "KINDS", "STAGES", "Failure", "advise", "detail_of"]

STAGES: Final = ("plan", "fetch", "read", "load", "brep", "import", "mesh", "truth", "write")
"""Stages of a model's way into the lake, in order."""

KINDS: Final[dict[str, str]] = {
    "empty-file": "the file has no bytes; export it again",
    "not-a-file": "a CAD file is expected here; ingest goes into folders only when given as SOURCE",
    "unreadable": "the file cannot be opened; check its permissions and the disk",
    "bad-archive": "the compressed file cannot be unpacked; compress it again",
    "refused": "it is not safe, so nothing of it is read",
    "encrypted": "it needs a password; pack it again without one",
    "too-large": "no CAD file is that large; check what it is",
    "bad-row": "the row of the list cannot be used; correct it",
    "download-failed": "its bytes could not be fetched; try again later with --retry-failures",
    "search-failed": "what it would have found is missing; run the same command again later",
    "translation-failed": "Onshape could not write the part as STEP; open it there to see why",
    "hash-mismatch": "its bytes are not those that were announced; check the source",
    "read-failed": "Open CASCADE cannot parse the file; check that it is complete",
    "translate-failed": "the file was parsed but its shapes could not be built; export it again",
    "no-shape": "the file holds no shape at all; export the part and not only its metadata",
    "no-patches": "the file holds curves or points but no surface, so there is nothing to mesh",
    "no-geometry": "some face has no surface (a tessellated face, say); export exact geometry",
    "unknown-geometry": "no table of the lake describes it; please report it with the file",
    "unbounded": "some face or edge is infinite; trim it in the CAD system",
    "no-features": "an OBJ of the ABC dataset needs its features YAML; put it beside",
    "no-trimesh": "a features YAML needs its trimesh OBJ or its STEP file; put it beside",
    "bad-features": "the features YAML cannot be understood; get the published file again",
    "bad-mesh": "the trimesh OBJ cannot be understood; get the published file again",
    "features-mismatch": "the features are not of this model; check that the files belong together",
    "areas-failed": "exact areas could not be derived; those of Open CASCADE's quadrature are kept",
    "count-mismatch": "Gmsh sees other entities than the B-Rep has; the exact rows are kept",
    "mesh-failed": "the model cannot be meshed this way; check the faulty entity in the CAD system",
    "mesh-incomplete": "its boundary is probably faulty; repair the face in the CAD system",
    "mesh-hang": "Gmsh would not come to an end, so it was stopped; a simpler mesh is tried next",
    "truth-failed": "normals and curvatures could not be derived; the exact rows are kept",
    "timeout": "the model took longer than allowed; more time is given by --timeout",
    "memory": "the model needed more memory than allowed; more is given by --memory",
    "disk-full": "the disk of the lake is full; make room and run the same command again",
    "killed-signal": "the CAD kernel crashed on this model",
    "worker-died": "the worker process ended without an answer",
    "error": "an unexpected error; please report it with the file",
}
"""Stable, append-only codes of failures, each with what it means for the user."""

CHANGED: Final = ("read", "hash-mismatch")
"""Stage and kind of a failure of files that changed between planning and reading."""

KILLED: Final = ("timeout", "mesh-hang", "killed-signal", "worker-died")
"""Kinds in which the worker did not live to count its CPU time."""


@dataclass(frozen=True, slots=True)
class Failure:
    """One failed attempt at a model.

    Parameters
    ----------
    stage : str
        A member of `STAGES`.
    kind : str
        A key of `KINDS`.
    message : str
        What happened, in detail.
    fatal : bool
        Whether the input has no row in ``models``.
    signal : int, optional
        Signal that killed the worker.
    seconds : float
        Wall time until the failure.
    peak_memory : int, optional
        Peak resident memory in bytes.
    """

    stage: str
    kind: str
    message: str
    fatal: bool
    signal: int | None = None
    seconds: float = 0.0
    peak_memory: int | None = None


def advise(kind: str, detail: str) -> str:
    """Join what happened and what helps into one message."""
    return f"{detail.rstrip('. ')}: {KINDS[kind]}" if detail else KINDS[kind]


def detail_of(kind: str, message: str) -> str:
    """Return what happened, of a message that `advise` made."""
    return message.removesuffix(KINDS[kind]).removesuffix(": ")
