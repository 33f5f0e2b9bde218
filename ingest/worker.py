"""One model, from file to record, in a process of its own."""

from __future__ import annotations

import errno
import os
import time
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa

from breplake.errors import InputError
from breplake.ingest.abc.beside import Beside
from breplake.ingest.abc.model import IMPORTED_MESH, import_model
from breplake.ingest.brep import Brep, extract
from breplake.ingest.canonical import canonical
from breplake.ingest.clock import KERNEL, StageClock, peak_memory
from breplake.ingest.failure import Failure, advise
from breplake.ingest.geometry import Row
from breplake.ingest.heal import add_missing_pcurves
from breplake.ingest.inputs import Input
from breplake.ingest.kernel import ClosedForm, GmshModel, gmsh_session
from breplake.ingest.load import Document, load
from breplake.ingest.measures import duplicate_group
from breplake.ingest.mesh import Mesh
from breplake.ingest.meshing import gmsh_mesh
from breplake.ingest.refine import refine, surface_periods
from breplake.ingest.rows import brep_columns, brep_tables, mesh_columns, mesh_tables
from breplake.ingest.settings import RUNGS, Settings
from breplake.ingest.spool import HANG_EXIT, Spool
from breplake.ingest.swept import swept_areas
from breplake.ingest.tessellation import tessellate
from breplake.ingest.truth import derive, wind
from breplake.ingest.unchanged import unchanged
from breplake.ingest.unpack import unpacked
from breplake.ingest.versions import versions
from breplake.schema.abc import ABC_FORMAT
from breplake.schema.fingerprint import fingerprint
from breplake.schema.uvgrid import uv_grids

__all__ = ["Task", "silence", "work"]

_HONOURED: Final = 1.05
"""A mesh whose longest edge is within this factor of the limit honours it."""

_HOPELESS: Final = 10.0
"""A mesh with edges longer than this many limits does not follow the geometry at all."""


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker is told.

    Parameters
    ----------
    input : Input
        The file.
    settings : Settings
        What to do.
    spool : Spool
        Where to leave the record.
    rung : int
        First rung of the mesh ladder to try; higher after a kill on a lower one. Beyond the
        ladder, the last rung is tried without Gmsh.
    """

    input: Input
    settings: Settings
    spool: Spool
    rung: int = 0


def work(task: Task) -> list[Failure]:
    """Ingest one model and leave its record in the task's spool.

    Returns
    -------
    list of Failure
        Fatal ones leave no record; after others the record holds what was done.
    """
    task.spool.start()  # a pool that broke may have begun it before
    task.spool.begin(task.input.name)
    clock = StageClock(task.spool.mark)
    failures: list[Failure] = []
    try:
        _Model(task, clock, failures).run()
    except Exception as error:  # one model's surprise is a row, never the end of a batch
        failures.append(_failure(clock, error, fatal=not task.spool.has_record))
    return failures


def _failure(clock: StageClock, error: Exception, *, fatal: bool) -> Failure:
    """Turn what went wrong in the current stage into a failure."""
    if isinstance(error, InputError):
        kind, message = error.kind, str(error)
    elif isinstance(error, MemoryError):
        kind, message = "memory", advise("memory", str(error))
    elif isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        kind, message = "disk-full", advise("disk-full", str(error))
    else:
        kind = {"mesh": "mesh-failed", "truth": "truth-failed"}.get(clock.current, "error")
        message = advise(kind, f"{type(error).__name__}: {error}")
    seconds = clock.columns()["seconds"]
    return Failure(clock.current, kind, message, fatal, seconds=seconds, peak_memory=peak_memory())


class _Model:
    """The stages of one model."""

    def __init__(self, task: Task, clock: StageClock, failures: list[Failure]) -> None:
        self.task, self.clock, self.failures = task, clock, failures
        self.input, self.settings, self.spool = task.input, task.settings, task.spool
        self.id = task.input.model_id
        self.row: Row = {}
        self.opposed = 0
        self.tables: dict[str, pa.Table] = {}
        self.beside: Beside | None = None

    def run(self) -> None:
        if self.input.format == ABC_FORMAT:
            self._import_abc()
            return
        with unchanged(self.input, self.clock):
            with self.clock.stage("read"):
                path = unpacked(self.input.path, self.input.format, self.spool.folder)
            with self.clock.stage("load"), KERNEL():
                document = load(path, self.input.format)
            with self.clock.stage("brep"):
                brep = self._brep(document)
                self._read_beside()
        self._write("brep")
        self._add_grids()
        with self.clock.stage("mesh"):
            if not brep.patches:
                raise InputError("no-patches", advise("no-patches", ""))
        with gmsh_session() as gmsh:
            self._add_mesh(gmsh, brep)

    def _brep(self, document: Document) -> Brep:
        from OCP.BRepCheck import BRepCheck_Analyzer

        shapes = canonical(document.shapes)
        added = add_missing_pcurves(shapes.compound)
        brep = extract(shapes, document.labels)
        with KERNEL():
            valid = BRepCheck_Analyzer(shapes.compound).IsValid()
        self.tables = brep_tables(self.id, brep)
        if areas := self._swept_areas():
            brep.set_areas(areas)
            self.tables = brep_tables(self.id, brep)
        self.row = (
            self._source_columns()
            | self.input.facts.columns()
            | brep_columns(brep)
            | {
                "length_unit": document.length_unit,
                "scale_to_mm": document.scale_to_mm,
                "is_valid": valid,
                "n_added_pcurves": added,
            }
        )
        self._identify()
        return brep

    def _swept_areas(self) -> dict[int, float]:
        """Return exact areas by patch; none where they resist, for Open CASCADE's are at hand."""
        try:
            return swept_areas(self.tables)
        except MemoryError as error:
            self._note(error)
        except Exception as error:  # the model is no worse for it
            detail = f"{type(error).__name__}: {error}"
            self._note(InputError("areas-failed", advise("areas-failed", detail)))
        return {}

    def _identify(self) -> None:
        """Add the fingerprint and what follows from it."""
        patches, curves, coedges, corners = (
            self.tables[name] for name in ("patches", "curves", "coedges", "corners")
        )
        found = fingerprint(patches, curves, coedges, corners, self.row["volume"])
        text = None if found is None else str(found)
        group = duplicate_group(text, str(self.input.sha256))
        self.row |= {"fingerprint": text, "duplicate_group": group}

    def _source_columns(self) -> Row:
        """Return what ``models`` says of the input and of what it was read with."""
        source = self.input
        return {
            "model_id": self.id,
            "collection": source.collection,
            "name": source.name,
            "path": source.shown,
            "format": source.format,
            "bytes": source.bytes,
            "sha256": source.sha256,
            "config_hash": self.settings.config_hash,
            **{f"{name}_version": value for name, value in versions().items()},
        }

    def _import_abc(self) -> None:
        """Take over a model from original ABC files, mesh and all."""
        with unchanged(self.input, self.clock):
            found = import_model(self.id, self.input.companions, self.clock)
        self.tables = found.tables
        self.row = self._source_columns() | found.row
        self._identify()
        self._write("mesh")
        self._add_grids()

    def _add_grids(self) -> None:
        """Sample patches and curves if asked to; a model that resists has no grids."""
        if self.settings.uv_grid:
            try:
                with self.clock.stage("brep", "uv-grid"):
                    self.spool.write_grids(uv_grids(self.tables, self.settings.uv_grid))
            except Exception as error:  # the mesh is no worse for it
                self._note(error)

    def _read_beside(self) -> None:
        """Take over what ABC files beside a STEP file say; what is wrong there is noted."""
        if not self.input.companions:
            return
        try:
            self.beside = Beside(self.input.companions)
            self.beside.verify(self.tables, self.row)
        except InputError as error:
            self._note(error)
        if self.beside is not None:
            self.row |= self.beside.columns()

    def _write(self, level: str) -> None:
        start = time.process_time()

        def row() -> Row:
            self.clock.cpu["write"] = self.clock.cpu.get("write", 0.0) + time.process_time() - start
            return self.row | self.clock.columns()

        self.clock.begin("write", level)
        self.spool.write(level, self.tables, row)

    def _add_mesh(self, gmsh: Any, brep: Brep) -> None:
        """Climb down the ladder of meshes until one succeeds."""
        ladder = RUNGS[self.settings.mesh]
        model = self._imported(gmsh, brep)
        if self._add_published_mesh(model):
            return
        rungs = ladder[self.task.rung :] if isinstance(model, GmshModel) else ladder[-1:]
        limit, notes = self._limit(brep)
        for rung in rungs:
            try:
                with self.clock.stage("mesh", rung):
                    mesh = self._mesh(model, rung, limit)
                with self.clock.stage("truth", rung):
                    self._truth(model, mesh, limit)
            except Exception as error:  # whatever fails here, the next rung may not
                self._note(error)
                gmsh.model.mesh.clear()
                continue
            if rung != ladder[0]:
                notes.append(f"{ladder[0]} meshing failed, see failures")
            self.row |= {"mesh_kind": rung, "mesh_limit": limit}
            longest = self.row["max_edge"] / limit
            if not longest <= _HONOURED:
                notes.append(f"longest edge is {longest:.3g} times the limit")
            if self.opposed:
                notes.append(f"{self.opposed} triangles oppose their normals: finer edges may help")
            self.row["mesh_note"] = "; ".join(notes) or None
            self._write("mesh")
            return

    def _add_published_mesh(self, model: GmshModel | ClosedForm) -> bool:
        """Take over the mesh of an OBJ beside the STEP file; False if there is none that fits."""
        if self.beside is None or not self.beside.has_mesh:
            return False
        self.periods = surface_periods(model.brep)
        try:
            with self.clock.stage("mesh", ABC_FORMAT):
                mesh = self.beside.mesh(self.tables["curves"])
            with self.clock.stage("truth", ABC_FORMAT):
                self._truth(model, mesh, np.inf)
        except Exception as error:  # a mesh of our own is still to be had
            self._note(error)
            return False
        kind = self.beside.files.stats.mesh_kind
        self.row |= {"mesh_kind": kind, "mesh_note": IMPORTED_MESH} | self.beside.columns()
        self._write("mesh")
        return True

    def _imported(self, gmsh: Any, brep: Brep) -> GmshModel | ClosedForm:
        """Return the model in Gmsh, or our own closed forms where Gmsh does not take it."""
        if self.task.rung < len(RUNGS[self.settings.mesh]):
            try:
                with self.clock.stage("import"):
                    return GmshModel(gmsh, brep, self.spool.folder)
            except InputError as error:
                self._note(error)
        with self.clock.stage("truth"):
            return ClosedForm(brep, self.tables)

    def _note(self, error: Exception) -> None:
        """Record a failure after which the model goes on."""
        failure = _failure(self.clock, error, fatal=False)
        self.failures.append(failure)
        self.spool.note(asdict(failure))

    def _limit(self, brep: Brep) -> tuple[float, list[str]]:
        """Return the edge length in mm that keeps the mesh within bounds, and what to note."""
        wanted = self.settings.max_edge * float(self.row["diagonal"])
        # An equilateral triangle of side a covers sqrt(3)/4 a^2; real meshes need twice as many.
        # Faces that are wound the wrong way have negative area.
        area = sum(abs(row["area"]) for row in brep.patches)
        least = float(np.sqrt(2 * area / (0.433 * self.settings.max_triangles)))
        if wanted >= least:
            return wanted, []
        return least, [
            f"limit raised from {wanted:.4g} mm to keep to {self.settings.max_triangles} triangles"
        ]

    def _mesh(self, model: GmshModel | ClosedForm, rung: str, limit: float) -> Mesh:
        if isinstance(model, GmshModel) and rung != "tessellation":
            mesh = gmsh_mesh(model, limit, self.settings, rung, hangs=self._hang)
        else:
            mesh = tessellate(model, limit)
        self.periods = surface_periods(model.brep)
        return refine(mesh, model, self.periods, limit, 2 * self.settings.max_triangles)

    def _hang(self, reason: str) -> None:
        """End the process, which is the only way to stop Gmsh; the parent reads why."""
        self.spool.hang(reason)
        os._exit(HANG_EXIT)

    def _truth(self, model: GmshModel | ClosedForm, mesh: Mesh, limit: float) -> None:
        flipped = np.array([row["reversed"] for row in model.brep.patches], dtype=bool)
        mesh, truth = derive(mesh, model, self.periods, flipped, self.row["diagonal"])
        mesh, self.opposed = wind(mesh, truth)
        columns = mesh_columns(mesh)
        if columns["max_edge"] > _HOPELESS * limit:
            detail = f"curves and surfaces lie up to {truth.residual.max():.3g} mm apart"
            raise InputError("mesh-failed", advise("mesh-failed", detail))
        self.tables |= mesh_tables(self.id, self.tables, mesh, truth)
        self.row |= columns


def silence() -> None:
    """Stop OCCT from printing; what matters comes back as failures."""
    from OCP.Message import Message

    messenger = Message.DefaultMessenger_s()
    messenger.ChangePrinters().Clear()
