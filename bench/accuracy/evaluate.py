"""Compare points, normals and curvatures of every patch of CAD files with Open CASCADE's.

Run it as ``python -m breplake.bench.accuracy.evaluate FOLDER``: it takes models of the folder
in the order of their SHA-256, evaluates every patch at random parameters, and prints the worst
differences by type of surface. Where these exceed the tolerances, our own kernels in extended
precision (64 bits of mantissa against 53) decide who is off by how much.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import pyarrow as pa
import typer

from breplake.errors import InputError
from breplake.schema.forms import bent
from breplake.schema.jets import SurfacePoints
from breplake.schema.namespace import Bools, Floats, Ints
from breplake.schema.surfaces import SurfaceSet
from breplake.schema.transfer import mapped

__all__ = ["TOLERANCES", "Errors", "compare", "main", "models_of", "report", "total"]

TOLERANCES: Final = {"position": 1e-12, "normal": 1e-10, "curvature": 1e-7}
"""Largest differences: of the model's size; of unit vectors; relative to the larger curvature."""

_ROUNDING: Final = {"position": 1e-12, "normal": 1e-6, "curvature": 1e-3}
"""Differences up to which rounding may be to blame, so that extended precision decides. It has
our formulas and parameters: of position, and of more than this, Open CASCADE is the judge."""

_SELDOM: Final = 1e-2
"""Share of points that may be disputed: a wrong formula would be wrong at most of them."""

_SINGULAR: Final = 1e-3
"""Share of points that may be flagged: patches are singular at single points."""

_FLAT: Final = 1e-6
"""Curvatures below this over the model's size are compared with it: such a patch departs from a
plane by about 1e-7 of the model, and what is left of its curvature are rounding errors."""


@dataclass(slots=True)
class Errors:
    """Worst differences over points of some patches.

    Attributes
    ----------
    patches, points : int
        How many were compared.
    unknown : int
        Patches that cannot be evaluated.
    flagged : int
        Points where we or Open CASCADE say that normal or curvature is undefined.
    worst : dict
        Against Open CASCADE, by name of the tolerance, `flagged` points left out.
    disputed : int
        Points that differ by more than a tolerance.
    ours, theirs : dict
        Worst error of either at these points, against extended precision.
    """

    patches: int = 0
    points: int = 0
    unknown: int = 0
    flagged: int = 0
    disputed: int = 0
    worst: dict[str, float] = field(default_factory=lambda: dict.fromkeys(TOLERANCES, 0.0))
    ours: dict[str, float] = field(default_factory=lambda: dict.fromkeys(TOLERANCES, 0.0))
    theirs: dict[str, float] = field(default_factory=lambda: dict.fromkeys(TOLERANCES, 0.0))

    def add(self, other: Errors) -> None:
        """Take in the figures of other patches."""
        for name in ("patches", "points", "unknown", "flagged", "disputed"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in ("worst", "ours", "theirs"):
            _raise(getattr(self, name), getattr(other, name))

    @property
    def failed(self) -> list[str]:
        """Names of the tolerances that we exceed, and of what is not evaluated too often."""
        found = [name for name, limit in TOLERANCES.items() if not self._within(name, limit)]
        found += ["unknown"] if self.unknown else []
        return found + (["flagged"] if self.flagged > max(_SINGULAR * self.points, 1) else [])

    def _within(self, name: str, limit: float) -> bool:
        if self.worst[name] <= limit:
            return True
        seldom = self.disputed <= max(_SELDOM * self.points, 1)
        return seldom and self.worst[name] <= _ROUNDING[name] and self.ours[name] <= limit


def _raise(worst: dict[str, float], new: dict[str, float]) -> None:
    for name, value in new.items():
        worst[name] = max(worst[name], value)


def compare(
    surfaces: list[Any], table: pa.Table, per_patch: int, seed: int = 0
) -> dict[str, Errors]:
    """Compare every patch of a model with Open CASCADE, by type of surface.

    Parameters
    ----------
    surfaces : list
        ``Geom_Surface`` of each row, as of ``ingest.pointwise.patch_geometry``.
    table : pyarrow.Table
        Rows of ``patches``.
    per_patch : int
        Random parameters on each patch, uniform within its bounds.
    seed : int
        Of the parameters.
    """
    from breplake.ingest.pointwise import geometry_points

    ours = SurfaceSet.from_patches(table)
    row, u, v = random_parameters(table, per_patch, seed)
    found = ours.points(row, u, v)
    size = _diagonal(found.point)
    errors: dict[str, Errors] = {}
    for i, (kind, surface) in enumerate(zip(table["type"].to_pylist(), surfaces, strict=True)):
        mine = slice(i * per_patch, (i + 1) * per_patch)
        patch = Errors(patches=1)
        if ours.known[i]:
            truth = geometry_points(surface, u[mine], v[mine])
            patch = _patch_errors(ours, row[mine], u[mine], v[mine], _cut(found, mine), truth, size)
        else:
            patch.unknown = 1
        errors.setdefault(kind, Errors()).add(patch)
    return errors


def random_parameters(table: pa.Table, per_patch: int, seed: int) -> tuple[Ints, Floats, Floats]:
    """Return rows, u and v of points within the bounds of every patch, patch by patch."""
    rng = np.random.default_rng(seed)
    row = np.repeat(np.arange(table.num_rows), per_patch)
    bounds = [table[name].to_numpy()[row] for name in ("u_min", "u_max", "v_min", "v_max")]
    return row, rng.uniform(*bounds[:2]), rng.uniform(*bounds[2:])


def _diagonal(points: Floats) -> float:
    known = points[np.isfinite(points).all(axis=1)]
    return float(np.linalg.norm(np.ptp(known, axis=0))) if len(known) else 1.0


def _cut(points: SurfacePoints, part: slice) -> SurfacePoints:
    return SurfacePoints(
        points.point[part], points.normal[part], points.k_min[part], points.k_max[part]
    )


def _patch_errors(
    surfaces: SurfaceSet,
    row: Ints,
    u: Floats,
    v: Floats,
    found: SurfacePoints,
    truth: SurfacePoints,
    size: float,
) -> Errors:
    """Compare the points of one patch."""
    differences = _differences(found, truth, size)
    bad = np.isnan(differences["normal"]) | np.isnan(differences["curvature"])
    errors = Errors(patches=1, points=len(u), flagged=int(bad.sum()))
    errors.worst = {name: _largest(values) for name, values in differences.items()}
    beyond: Bools = np.any([differences[n] > limit for n, limit in TOLERANCES.items()], axis=0)
    if beyond.any():
        exact = _extended(surfaces, row[beyond], u[beyond], v[beyond])
        for one, against in (("ours", found), ("theirs", truth)):
            some = SurfacePoints(*(getattr(against, n)[beyond] for n in _PARTS))
            gap = _differences(some, exact, size)
            setattr(errors, one, {name: _largest(values) for name, values in gap.items()})
        errors.disputed = int(beyond.sum())
    return errors


_PARTS: Final = ("point", "normal", "k_min", "k_max")


def _differences(one: SurfacePoints, two: SurfacePoints, size: float) -> dict[str, Floats]:
    """Return the differences ``(n,)`` by name of the tolerance; NaN where flagged."""
    bend = np.maximum(np.maximum(np.abs(two.k_min), np.abs(two.k_max)), _FLAT / size)
    gap = np.maximum(np.abs(one.k_min - two.k_min), np.abs(one.k_max - two.k_max))
    position = np.linalg.norm(one.point - two.point, axis=1) / size
    return {
        "position": np.where(np.isnan(position), np.inf, position),  # it is defined everywhere
        "normal": np.linalg.norm(one.normal - two.normal, axis=1),
        "curvature": gap / bend,
    }


def _largest(values: Floats) -> float:
    known = values[~np.isnan(values)]
    return float(known.max(initial=0.0))


def _extended(surfaces: SurfaceSet, row: Ints, u: Floats, v: Floats) -> SurfacePoints:
    """Evaluate points of one patch with 64 bits of mantissa, from derivatives."""
    if np.finfo(np.longdouble).eps > 1e-18:
        nothing = np.full((len(u), 3), np.nan)
        return SurfacePoints(nothing, nothing, nothing[:, 0], nothing[:, 0])

    def widened(array: Any) -> Any:
        return array.astype(np.longdouble) if array.dtype == np.float64 else array

    wide, parameters = mapped(surfaces, widened), (widened(u), widened(v))
    point, du, dv, *seconds = wide.jet(int(surfaces.group[row[0]]), row, *parameters)
    least = np.zeros((2, len(u)))
    normal, *bends = bent(du, dv, (seconds[0], seconds[1], seconds[2]), least)
    return SurfacePoints(np.broadcast_to(point, (3, len(u))).T, normal.T, *bends)


def total(errors: Iterable[dict[str, Errors]]) -> dict[str, Errors]:
    """Add up the figures of many models."""
    found: dict[str, Errors] = {}
    for model in errors:
        for kind, patch in model.items():
            found.setdefault(kind, Errors()).add(patch)
    return found


def report(errors: dict[str, Errors]) -> list[str]:
    """Return a table, a line for each type of surface, and what disputed points came to."""
    everything = Errors()
    for one in errors.values():
        everything.add(one)
    names = tuple(TOLERANCES)
    head = ("patches", "points", "unknown", "flagged", "disputed")
    lines = [f"{'type':<11}" + "".join(f"{n:>10}" for n in (*head, *names))]
    for kind, one in [*sorted(errors.items()), ("all", everything)]:
        lines.append(
            f"{kind:<11}"
            + "".join(f"{getattr(one, n):>10}" for n in head)
            + "".join(f"{one.worst[n]:>10.1e}" for n in names)
        )
    if everything.disputed:
        lines.append("worst error at the disputed points, against extended precision:")
        for name, part in (("ours", everything.ours), ("OCCT's", everything.theirs)):
            lines.append(f"{name:<61}" + "".join(f"{part[n]:>10.1e}" for n in names))
    limits = ", ".join(f"{name} {limit:.0e}" for name, limit in TOLERANCES.items())
    return [*lines, f"tolerances: {limits}; exceeded: {', '.join(everything.failed) or 'none'}"]


def models_of(
    folder: Path, models: int, per_patch: int, jobs: int
) -> Iterator[tuple[str, dict[str, Errors]]]:
    """Compare `models` models that hold patches, the first by hash, each in its own process."""
    from breplake.ingest.inputs import find_inputs
    from breplake.ingest.processes import Processes

    inputs = sorted((i for i in find_inputs([folder]) if i.sha256), key=lambda i: str(i.sha256))
    tasks = ((i, (inputs[i].path, inputs[i].format, per_patch)) for i in range(len(inputs)))
    found: dict[int, dict[str, Errors]] = {}
    next_one = done = 0
    with Processes[int](jobs, 8.0, 1800.0, "this comparison") as processes:
        for ended in processes.each(_model, tasks):
            found[ended.key] = {} if ended.killed else ended.value
            if not found[ended.key]:
                why = ended.killed or "no patches can be read"
                typer.echo(f"left out {inputs[ended.key].name}: {why}", err=True)
            while next_one in found:  # in order, however many are compared at a time
                errors = found.pop(next_one)
                if errors:
                    yield inputs[next_one].name, errors
                    done += 1
                    if done == models:
                        return
                next_one += 1


def _model(path: Path, format: str, per_patch: int) -> dict[str, Errors]:
    """Compare one model; nothing if it cannot be read."""
    from breplake.ingest.pointwise import faces_of, patch_geometry

    try:
        return compare(*patch_geometry(faces_of(path, format)), per_patch)
    except InputError:
        return {}


def main(
    folder: Annotated[Path, typer.Argument(help="CAD files.", metavar="FOLDER")],
    models: Annotated[int, typer.Option(help="How many models.")] = 100,
    points: Annotated[int, typer.Option(help="Random parameters on each patch.")] = 1000,
    jobs: Annotated[int, typer.Option(help="Models at a time.")] = 1,
) -> None:
    """Compare evaluated patches with Open CASCADE's."""
    found: list[dict[str, Errors]] = []
    for name, errors in models_of(folder, models, points, jobs):
        found.append(errors)
        disputed = sum(one.disputed for one in errors.values())
        typer.echo(f"{sum(e.patches for e in errors.values()):6} {disputed:6} {name}", err=True)
    typer.echo("\n".join([f"{len(found)} models", *report(total(found))]))
    if any(one.failed for one in total(found).values()):
        raise typer.Exit(1)


if __name__ == "__main__":
    # Processes find a task's function by its module, which is not this script.
    from breplake.bench.accuracy import evaluate

    typer.run(evaluate.main)
