"""The model inside Gmsh: import, proof that its entities are ours, and evaluation.

Gmsh bundles its own OCCT, so shapes cross over as BREP text, never as pointers. All calls
are batched by entity: one Python call evaluates a whole patch.
"""

from __future__ import annotations

import io
import math
import re
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.errors import InputError
from breplake.ingest.brep import Brep
from breplake.ingest.clock import KERNEL
from breplake.ingest.failure import advise
from breplake.schema.curves import CurveSet
from breplake.schema.jets import SurfaceJet
from breplake.schema.surfaces import SurfaceSet

__all__ = ["ClosedForm", "GmshModel", "gmsh_session", "groups"]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

_VANISHING: Final = 1e-9
"""A derivative this much shorter than usual on its patch is zero but for rounding."""

_LONG: Final = re.compile(rb"-?\d+\.\d{12,}(?:e[+-]?\d+)?")
"""A number of more digits than `_rounded` keeps."""

_OPTIONS: Final = {
    "General.Terminal": 0,
    "General.NumThreads": 1,
    "General.Verbosity": 2,
    "Geometry.OCCAutoFix": 0,
    "Geometry.OCCFixDegenerated": 0,
    "Geometry.OCCFixSmallEdges": 0,
    "Geometry.OCCFixSmallFaces": 0,
    "Geometry.OCCSewFaces": 0,
    "Geometry.OCCMakeSolids": 0,
    "Geometry.OCCParallel": 0,
    "Geometry.OCCScaling": 1,
    "Mesh.RandomSeed": 1,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.Algorithm": 6,
    "Mesh.Smoothing": 0,
}
"""All healing off: an entity that Gmsh repaired would no longer be the B-Rep's."""


@contextmanager
def gmsh_session() -> Iterator[Any]:
    """Initialise Gmsh with our options for the duration of a block, and yield the module."""
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    if threading.current_thread() is threading.main_thread():
        # Gmsh lets a closed pipe or connection end the process, which Python does not.
        signal.signal(signal.SIGPIPE, signal.getsignal(signal.SIGPIPE))
    try:
        for name, value in _OPTIONS.items():
            gmsh.option.setNumber(name, value)
        # Sticky across models in one process, so it is set for each.
        gmsh.option.setString("Geometry.OCCTargetUnit", "")
        yield gmsh
    finally:
        gmsh.finalize()


class GmshModel:
    """A B-Rep imported into Gmsh, addressed by our ids.

    Parameters
    ----------
    gmsh : module
        As yielded by `gmsh_session`.
    brep : Brep
        The exact model.
    folder : Path
        Temporary folder for the BREP file.

    Raises
    ------
    InputError
        ``count-mismatch`` if Gmsh's entities are not ours, one for one.
    OSError
        If the BREP file cannot be written, which is no fault of the model.
    """

    def __init__(self, gmsh: Any, brep: Brep, folder: Path) -> None:
        self.gmsh = gmsh
        self.brep = brep
        path = folder / "model.brep"
        complaint = ""
        try:
            path.write_bytes(_rounded(brep))
            with KERNEL():
                gmsh.model.occ.importShapes(str(path), highestDimOnly=False, format="brep")
                gmsh.model.occ.synchronize()
        except OSError:  # of the disk
            raise
        except Exception as error:  # gmsh raises plain Exception for everything
            # It complains of faulty wires too and imports them all the same.
            complaint = f" ({error})"
        finally:
            path.unlink(missing_ok=True)
        self.complaint = complaint
        self._set_undefined(brep.patch_table)
        # Gmsh embeds curves that lie inside a patch, but leaves some of them out.
        whole = len(gmsh.model.getEntities(1)) == len(brep.edges)
        internal = set() if whole else brep.internal_curves
        self.curve_ids = [i for i in range(len(brep.edges)) if i not in internal]
        self.curve_tag = {curve_id: i + 1 for i, curve_id in enumerate(self.curve_ids)}
        self._prove()

    def _set_undefined(self, patches: Any) -> None:
        """Take over from the closed forms where a normal or curvature is not defined.

        Both sides then call the same points singular. Spheres are regular at their poles,
        which derivatives alone cannot tell.
        """
        self.surfaces = SurfaceSet.from_patches(patches)
        self.spheres = np.array([row["type"] == "Sphere" for row in self.brep.patches], dtype=bool)
        size = np.sqrt([max(row["area"], 0.0) for row in self.brep.patches])  # (p,) mm
        self.least = np.empty((len(size), 2))  # (p, 2) lengths of du and dv that count as zero
        for axis, name in enumerate("uv"):
            span = np.array([row[f"{name}_max"] - row[f"{name}_min"] for row in self.brep.patches])
            usual = _VANISHING * size / np.where(span > 0, span, 1.0)
            self.least[:, axis] = np.where(self.surfaces.known, self.surfaces.least[axis], usual)

    def _prove(self) -> None:
        """Check tags, ends and sample points of every entity against the B-Rep.

        Raises
        ------
        InputError
            ``count-mismatch``, naming the first entity that differs.
        """
        counts = (len(self.brep.vertices), len(self.curve_ids), len(self.brep.faces))
        for dim, (name, ours) in enumerate(
            zip(("corners", "curves", "patches"), counts, strict=True)
        ):
            tags = sorted(tag for _, tag in self.gmsh.model.getEntities(dim))
            if tags != list(range(1, ours + 1)):
                raise self._mismatch(f"{name}: {ours} in the B-Rep, {len(tags)} in Gmsh")
        for corner_id, corner in enumerate(self.brep.corners):
            point = tuple(corner["point"][axis] for axis in "xyz")
            with KERNEL():
                theirs = self.gmsh.model.getValue(0, corner_id + 1, [])
            self._same("corner", corner_id, theirs, point)
        for curve_id in self.curve_ids:
            self._prove_curve(curve_id)
        for patch_id in range(len(self.brep.faces)):
            self._prove_patch(patch_id)

    def _prove_curve(self, curve_id: int) -> None:
        from OCP.BRepAdaptor import BRepAdaptor_Curve

        row = self.brep.curves[curve_id]
        if row["kind"] == "degenerate":
            return
        t = row["t_min"] + 0.37 * (row["t_max"] - row["t_min"])
        point = BRepAdaptor_Curve(self.brep.edges[curve_id]).Value(t)
        ours = point.X(), point.Y(), point.Z()
        self._same("curve", curve_id, self.curve_points(curve_id, np.array([t]))[0], ours)
        ends = {row["start_corner"], row["end_corner"]} - {None}
        with KERNEL():
            boundary = self.gmsh.model.getAdjacencies(1, self.curve_tag[curve_id])[1]
        if {tag - 1 for tag in boundary} != ends:
            raise self._mismatch(f"curve {curve_id} ends at other corners")

    def _prove_patch(self, patch_id: int) -> None:
        row = self.brep.patches[patch_id]
        u = row["u_min"] + 0.37 * (row["u_max"] - row["u_min"])
        v = row["v_min"] + 0.41 * (row["v_max"] - row["v_min"])
        point = self.brep.surfaces[patch_id].Value(u, v)
        ours = point.X(), point.Y(), point.Z()
        with KERNEL():
            theirs = self.gmsh.model.getValue(2, patch_id + 1, [u, v])
        self._same("patch", patch_id, theirs, ours)

    def _same(self, what: str, index: int, theirs: Any, ours: tuple[float, ...]) -> None:
        distance = math.dist(theirs, ours)
        if not distance <= 1e-9 * max(1.0, *map(abs, ours)):
            raise self._mismatch(f"{what} {index} lies {distance:.3g} mm off")

    def _mismatch(self, detail: str) -> InputError:
        return InputError("count-mismatch", advise("count-mismatch", detail + self.complaint))

    def curve_points(self, curve_id: int, t: _Floats) -> _Floats:
        """Return points ``(n, 3)`` mm of a curve at parameters ``(n,)``."""
        with KERNEL():
            points = self.gmsh.model.getValue(1, self.curve_tag[curve_id], np.ascontiguousarray(t))
        return np.asarray(points, dtype=np.float64).reshape(-1, 3)

    def jet(self, patch_ids: _Ints, u: _Floats, v: _Floats) -> SurfaceJet:
        """Evaluate surfaces with first and second derivatives.

        Parameters
        ----------
        patch_ids : numpy.ndarray
            ``(n,)`` patches.
        u, v : numpy.ndarray
            ``(n,)`` parameters.

        Returns
        -------
        SurfaceJet
            In input order. The surfaces' own direction; patch orientation is not applied.
        """
        n = len(patch_ids)
        point, first, second = np.empty((n, 3)), np.empty((n, 2, 3)), np.empty((n, 3, 3))
        model = self.gmsh.model
        for patch_id, rows in groups(patch_ids):
            uv = np.column_stack([u[rows], v[rows]]).ravel()
            with KERNEL():
                p = model.getValue(2, patch_id + 1, uv)
                d1 = model.getDerivative(2, patch_id + 1, uv)
                d2 = model.getSecondDerivative(2, patch_id + 1, uv)
            point[rows] = np.reshape(p, (-1, 3))
            first[rows], second[rows] = np.reshape(d1, (-1, 2, 3)), np.reshape(d2, (-1, 3, 3))
        radial = umbilic = None
        sphere = self.spheres[patch_ids]
        if sphere.any():
            closed = self.surfaces.evaluate(patch_ids[sphere], u[sphere], v[sphere])
            radial, umbilic = np.full((n, 3), np.nan), np.full(n, np.nan)
            radial[sphere], umbilic[sphere] = closed.radial, closed.umbilic
        return SurfaceJet(
            point,
            du=first[:, 0],
            dv=first[:, 1],
            duu=second[:, 0],  # Gmsh's order is uu, vv, uv
            duv=second[:, 2],
            dvv=second[:, 1],
            least=self.least[patch_ids],
            radial=radial,
            umbilic=umbilic,
        )

    def points(self, patch_ids: _Ints, u: _Floats, v: _Floats) -> _Floats:
        """Return points ``(n, 3)`` mm of surfaces at parameters ``(n,)``."""
        point = np.empty((len(patch_ids), 3))
        for patch_id, rows in groups(patch_ids):
            uv = np.column_stack([u[rows], v[rows]]).ravel()
            with KERNEL():
                values = self.gmsh.model.getValue(2, patch_id + 1, uv)
            point[rows] = np.reshape(values, (-1, 3))
        return point


def _rounded(brep: Brep) -> bytes:
    """Return a B-Rep as a BREP file whose numbers are rounded to 14 digits.

    It is made in memory: of a file, Open CASCADE does not say why it cannot be written. The
    mesher decides ties by the last bit, which differs between a part in inches and the same part
    in millimetres. Geometry moves by less than 1e-13 of its size.
    """
    from OCP.BRepTools import BRepTools

    stream = io.BytesIO()
    with KERNEL():
        BRepTools.Write_s(brep.canonical.compound, stream)
    return _LONG.sub(lambda found: b"%.14g" % float(found[0]), stream.getvalue())


class ClosedForm:
    """A B-Rep evaluated by our own closed forms, where Gmsh refuses the model.

    Parameters
    ----------
    brep : Brep
        The exact model.
    tables : mapping
        Its tables ``patches`` and ``curves``.

    Raises
    ------
    InputError
        ``truth-failed`` if a patch or curve has no closed form.
    """

    def __init__(self, brep: Brep, tables: Mapping[str, pa.Table]) -> None:
        self.brep = brep
        self.surfaces = SurfaceSet.from_patches(tables["patches"])
        self.curves = CurveSet.from_curves(tables["curves"])
        bounding = np.array([row["kind"] not in ("degenerate", "free") for row in brep.curves])
        if not (self.surfaces.known.all() and self.curves.known[bounding].all()):
            raise InputError(
                "truth-failed", advise("truth-failed", "not all geometry has a closed form")
            )

    def jet(self, patch_ids: _Ints, u: _Floats, v: _Floats) -> SurfaceJet:
        """Evaluate surfaces, as `GmshModel.jet` does."""
        return self.surfaces.evaluate(patch_ids, u, v)

    def points(self, patch_ids: _Ints, u: _Floats, v: _Floats) -> _Floats:
        """Return points ``(n, 3)`` mm of surfaces at parameters ``(n,)``."""
        return np.ascontiguousarray(self.surfaces.evaluate(patch_ids, u, v).point)

    def curve_points(self, curve_id: int, t: _Floats) -> _Floats:
        """Return points ``(n, 3)`` mm of a curve at parameters ``(n,)``."""
        return np.ascontiguousarray(self.curves.evaluate(np.full(len(t), curve_id), t).point)


def groups(keys: _Ints) -> Iterator[tuple[int, _Ints | slice]]:
    """Yield each distinct key with the rows that have it, keys ascending, rows in order.

    Where keys ascend already the rows are a slice, which copies in a third of the time.
    """
    if not len(keys):
        return
    if (keys[1:] >= keys[:-1]).all():
        starts = np.flatnonzero(np.diff(keys, prepend=keys[0] - 1)).tolist()
        for start, stop in zip(starts, [*starts[1:], len(keys)], strict=True):
            yield int(keys[start]), slice(start, stop)
        return
    order = np.argsort(keys, kind="stable")
    for key, rows in groups(keys[order]):
        yield key, order[rows]
