"""Measure how many points of surfaces are evaluated in a second, against others.

Run it as ``python -m breplake.bench.speed.evaluate [FOLDER ...]``; without a folder it takes
breplake's sample parts. Every patch is evaluated at the same number of random parameters:
position, unit normal and both principal curvatures. One core does it, and CPU seconds count,
so that other processes disturb little. What is compared, in the same run:

- ours by numpy: a call of ``SurfaceSet.points`` for each 262,144 points of all patches. Nobody
  keeps the results of all points here, whose memory the system would have to find first;
- ours by torch on the CPU, and on a CUDA GPU if there is one;
- Open CASCADE point by point from Python: ``BRepLProp_SLProps`` on each face;
- ``abs-hdf5`` if it is installed: one call for each patch, curvatures from its derivatives.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import pyarrow as pa
import typer

from breplake.bench.accuracy.evaluate import random_parameters
from breplake.bench.speed.abs_surfaces import abs_available, abs_points, abs_surface
from breplake.errors import InputError, UsageError
from breplake.schema.namespace import Floats, Ints
from breplake.schema.surfaces import SurfaceSet

__all__ = ["Faces", "main", "measure", "report"]

_OCP_POINTS: Final = 50  # of each patch, as it takes long
_BLOCK: Final = 2**18  # points of one of our calls: 16 MiB of results
_AGREES: Final = 1e-9  # of the model's size: else abs-hdf5 has evaluated something else


@dataclass(slots=True)
class Faces:
    """Patches to evaluate.

    Parameters
    ----------
    table : pyarrow.Table
        Their rows of ``patches``.
    shapes : list
        ``TopoDS_Face`` of each row.
    """

    table: pa.Table
    shapes: list[Any]

    def only(self, rows: Ints) -> Faces:
        """Return some of them."""
        return Faces(self.table.take(pa.array(rows)), [self.shapes[i] for i in rows])


@dataclass(slots=True)
class Figures:
    """Nanoseconds a point, by who evaluated; the least of several rounds.

    Parameters
    ----------
    patches : int
        How many.
    nanoseconds : dict
        By name.
    compared : int
        Of these, how many ``abs-hdf5`` evaluates as we do; only these count for it.
    abs_unknown, abs_failed, abs_elsewhere : int
        How many are of a type that it does not know, raise an error, or lie elsewhere.
    """

    patches: int
    compared: int = 0
    abs_unknown: int = 0
    abs_failed: int = 0
    abs_elsewhere: int = 0
    nanoseconds: dict[str, float] = field(default_factory=dict)

    def keep(self, name: str, seconds: float, points: int) -> None:
        """Record a measurement if it is the quickest."""
        if points:
            best = self.nanoseconds.get(name, np.inf)
            self.nanoseconds[name] = min(best, 1e9 * seconds / points)


def measure(faces: Faces, points: int, rounds: int) -> Figures:
    """Evaluate all of `faces` by every means there is.

    Parameters
    ----------
    faces : Faces
        All of types that can be evaluated.
    points : int
        Parameters on each patch.
    rounds : int
        Each is measured so often, in turns.
    """
    surfaces = SurfaceSet.from_patches(faces.table)
    row, u, v = random_parameters(faces.table, points, 0)
    figures = Figures(len(faces.shapes))
    few = min(points, _OCP_POINTS)
    others = _abs_contestants(faces.table, surfaces, np.stack([u, v], axis=1), figures)
    mine = np.isin(row, [i for i, _, _ in others])
    part = row[mine], u[mine], v[mine]

    def abs_hdf5(curvature: bool) -> None:
        for _, surface, uv in others:
            abs_points(surface, uv, curvature)

    contestants: list[tuple[str, Callable[[], object], int]] = [
        ("numpy", lambda: _in_blocks(surfaces, row, u, v), len(row)),
        ("OCP", lambda: _ocp(faces, u, v, points, few), few * len(faces.shapes)),
        ("numpy on the same", lambda: _in_blocks(surfaces, *part), len(part[0])),
        ("abs", lambda: abs_hdf5(True), len(part[0])),
        ("abs without k", lambda: abs_hdf5(False), len(part[0])),
    ]
    for _ in range(rounds):
        for name, work, count in contestants:
            figures.keep(name, _seconds(work), count)
        for name, seconds in _torch(surfaces, row, u, v):
            figures.keep(name, seconds, len(row))
    return figures


def _in_blocks(surfaces: SurfaceSet, row: Any, u: Any, v: Any) -> None:
    """Evaluate points, with numpy or torch, and drop what comes out."""
    for start in range(0, len(row), _BLOCK):
        some = slice(start, start + _BLOCK)
        surfaces.points(row[some], u[some], v[some])


def _seconds(work: Callable[[], object]) -> float:
    """Return the CPU time of a call."""
    start = time.process_time()
    work()
    return time.process_time() - start


def _ocp(faces: Faces, u: Floats, v: Floats, points: int, few: int) -> None:
    from breplake.ingest.pointwise import adaptor_points

    for i, face in enumerate(faces.shapes):
        some = slice(i * points, i * points + few)
        adaptor_points(face, u[some], v[some])


def _abs_contestants(
    table: pa.Table, surfaces: SurfaceSet, uv: Floats, figures: Figures
) -> list[tuple[int, Any, Floats]]:
    """Return number, surface and parameters of the patches that ``abs-hdf5`` gets right."""
    found = []
    each = len(uv) // max(table.num_rows, 1)
    for i, row in enumerate(table.to_pylist() if abs_available() else []):
        part = uv[i * each : (i + 1) * each]
        try:
            theirs = abs_surface(row)
            if theirs is None:
                figures.abs_unknown += 1
                continue
            with np.errstate(all="ignore"):
                point = abs_points(theirs, part, True)[0]
        except (RuntimeError, ValueError, IndexError, TypeError, NameError):
            figures.abs_failed += 1
            continue
        ours = surfaces.points(i, part[:, 0], part[:, 1]).point
        gap = np.abs(point - ours).max() if point.shape == ours.shape else np.inf
        if gap <= _AGREES * max(1.0, np.abs(ours).max()):
            found.append((i, theirs, part))
        else:
            figures.abs_elsewhere += 1
    figures.compared = len(found)
    return found


def _torch(surfaces: SurfaceSet, row: Ints, u: Floats, v: Floats) -> Iterator[tuple[str, float]]:
    """Measure torch, if it is installed: CPU seconds on the CPU, wall seconds on a GPU."""
    try:
        import torch
    except ImportError:
        return
    torch.set_num_threads(1)
    there = surfaces.to(device="cpu")
    query = torch.as_tensor(row), torch.as_tensor(u), torch.as_tensor(v)
    with torch.no_grad():
        yield "torch", _seconds(lambda: _in_blocks(there, *query))
        if torch.cuda.is_available():
            for dtype in (torch.float64, torch.float32):
                name = f"cuda {str(dtype).rpartition('.')[2]}"
                yield name, _on_gpu(torch, surfaces.to(device="cuda", dtype=dtype), query)


def _on_gpu(torch: Any, surfaces: SurfaceSet, query: tuple[Any, Any, Any]) -> float:
    row, *parameters = (part.to("cuda") for part in query)
    u, v = (part.to(surfaces.axes.dtype) for part in parameters)
    surfaces.points(row, u, v)
    torch.cuda.synchronize()
    start = time.perf_counter()
    surfaces.points(row, u, v)
    torch.cuda.synchronize()
    return time.perf_counter() - start


def _bandwidth() -> float | None:
    """Return the bytes a second that a GPU copies, read and write together."""
    try:
        import torch
    except ImportError:
        return None
    if not torch.cuda.is_available():
        return None
    source = torch.zeros(2**28, dtype=torch.uint8, device="cuda")
    target = torch.empty_like(source)
    best = np.inf
    for _ in range(10):
        torch.cuda.synchronize()
        start = time.perf_counter()
        target.copy_(source)
        torch.cuda.synchronize()
        best = min(best, time.perf_counter() - start)
    return float(2 * source.numel() / best)


def report(figures: dict[str, Figures]) -> list[str]:
    """Return a table, a line for each type of surface and one for all patches together."""
    names = ("numpy", "torch", "OCP", "abs", "abs without k")
    head = [*names, "OCP/numpy", "abs/numpy"]
    lines = [
        "nanoseconds a point: position, normal and both principal curvatures, one core",
        f"{'type':<11}{'patches':>9}{'in abs':>8}" + "".join(f"{n:>15}" for n in head),
    ]
    for kind, one in figures.items():
        ns = one.nanoseconds
        ratios = (
            _ratio(ns.get("OCP"), ns.get("numpy")),
            _ratio(ns.get("abs"), ns.get("numpy on the same")),
        )
        cells = [f"{ns[n]:15.0f}" if n in ns else f"{'-':>15}" for n in names]
        start = f"{kind:<11}{one.patches:>9}{one.compared:>8}"
        lines.append(start + "".join(cells) + "".join(ratios))
    everything = figures["all"]
    speed = 1e3 / everything.nanoseconds["numpy"]
    lines.append(f"numpy evaluates {speed:.1f} million points a second")
    if everything.compared:
        lines.append(
            f"left out for abs-hdf5: {everything.abs_unknown} patches of types that it lacks, "
            f"{everything.abs_failed} where it fails, {everything.abs_elsewhere} where its points "
            "lie elsewhere"
        )
    if bandwidth := _bandwidth():
        for name, width in (("cuda float64", 8), ("cuda float32", 4)):
            each = everything.nanoseconds[name]
            share = (8 + 10 * width) / (each * 1e-9) / bandwidth
            lines.append(
                f"{name}: {1e3 / each:.0f} million points a second; row, u, v and results are "
                f"{100 * share:.1f} % of what the GPU copies in that time"
            )
    return lines


def _ratio(theirs: float | None, ours: float | None) -> str:
    return f"{theirs / ours:14.1f}x" if theirs and ours else f"{'-':>15}"


def load_faces(paths: list[Path], limit: int) -> Faces:
    """Read CAD files; faces that cannot be evaluated, and files that cannot be read, are left out.

    Raises
    ------
    UsageError
        If nothing is left.
    """
    from breplake.ingest.inputs import find_inputs
    from breplake.ingest.pointwise import faces_of, patch_geometry

    tables, shapes = list[pa.Table](), list[Any]()
    inputs = sorted((i for i in find_inputs(paths) if i.sha256), key=lambda i: str(i.sha256))
    for item in inputs:
        if len(tables) == limit:
            break
        try:
            faces = faces_of(item.path, item.format)
        except InputError as error:
            typer.echo(f"left out {item.name}: {error}", err=True)
            continue
        table = patch_geometry(faces)[1]
        known = np.flatnonzero(SurfaceSet.from_patches(table).known)
        if len(known):
            tables.append(table.take(pa.array(known)))
            shapes += [faces[i] for i in known]
    if not tables:
        raise UsageError(f"none of {[str(p) for p in paths]} holds a patch that can be evaluated")
    typer.echo(f"{len(tables)} models, {len(shapes)} patches")
    return Faces(pa.concat_tables(tables), shapes)


def main(
    folders: Annotated[
        list[Path] | None, typer.Argument(help="CAD files; the sample parts by default.")
    ] = None,
    models: Annotated[int, typer.Option(help="At most so many models, by SHA-256.")] = 100,
    points: Annotated[int, typer.Option(help="Parameters on each patch.")] = 1000,
    rounds: Annotated[int, typer.Option(help="Measure so often and keep the best.")] = 3,
) -> None:
    """Measure the evaluation of surfaces."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as temporary:
        paths = list(folders or [])
        if not paths:
            from breplake.ingest.samples import write_samples

            paths = [Path(temporary)]
            write_samples(paths[0])
        faces = load_faces(paths, models)
    kinds = np.array(faces.table["type"].to_pylist())
    figures = {
        kind: measure(faces.only(np.flatnonzero(kinds == kind)), points, rounds)
        for kind in sorted(set(kinds))
    }
    figures["all"] = measure(faces, points, rounds)
    typer.echo("\n".join(report(figures)))


if __name__ == "__main__":
    typer.run(main)
