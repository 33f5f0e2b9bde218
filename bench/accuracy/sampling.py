"""Prove areas and samples of trimmed patches against Open CASCADE.

Run it as ``python -m breplake.bench.accuracy.sampling LAKE`` on a lake whose CAD files are still
where they were. For each model it

- sums the exact areas of the patches, trimmed by the lake's pcurves, and compares the sum with
  the area that ingest integrated;
- draws points uniform by area, and asks Open CASCADE's classifier about each whether it is
  outside its face;
- tests by chi-square whether the patches get points by their areas, and whether the points of a
  patch are spread over it by area.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final

import numpy as np
import typer
from scipy.stats import chi2

import breplake
from breplake.errors import BreplakeError
from breplake.schema.namespace import Floats, Ints
from breplake.schema.trimming.patches import TrimmedPatches
from breplake.schema.trimming.sampling import UniformSampler

__all__ = ["Found", "holds", "judge", "main", "report"]

SAME: Final = 1e-6
"""Relative difference of areas that counts as none."""

_TABLES: Final = ("patches", "curves", "coedges", "pcurves")
_EXPECTED: Final = 20.0  # points in a cell of a test, fewer go to the rest
_CELLS: Final = 4  # by which u and v are divided
_FINE: Final = 50  # places in a cell, each way, by which its area is summed
_UNUSUAL: Final = 1e-3  # chance below which a test counts as unusual
_IMPOSSIBLE: Final = 1e-9  # and below which the sampler is wrong
_STRAYS: Final = 1e-5  # share of points that may be outside
_BROKEN: Final = 0.1  # share of models whose loops may be too faulty for an exact area


@dataclass(frozen=True, slots=True)
class Found:
    """What was found of one model.

    Parameters
    ----------
    name : str
        The model.
    off : float
        Relative difference of the areas; NaN if a patch is unknown.
    points, outside : int
        How many points were judged, and how many of these lie outside.
    chances : list of float
        For each chi-square test the chance that a right sampler does worse.
    excuse : str
        Why nothing was found; empty if something was.
    is_valid : bool
        Whether Open CASCADE finds no fault in the model: what is inside a faulty loop is anyone's
        guess.
    """

    name: str
    off: float = np.nan
    points: int = 0
    outside: int = 0
    chances: list[float] = field(default_factory=list)
    excuse: str = ""
    is_valid: bool = True


def judge(lake: breplake.Lake, model_id: int, points: int) -> Found:
    """Prove one model.

    Parameters
    ----------
    lake : breplake.Lake
        The lake.
    model_id : int
        The model.
    points : int
        How many to draw.
    """
    from breplake.ingest.pointwise import faces_of, outside

    model = lake.model(model_id)
    try:
        tables = {name: lake.read(name, model_id) for name in _TABLES}
        trimmed = TrimmedPatches.from_tables(**tables)
        areas = tables["patches"].column("area").to_numpy()
        off = abs(float(trimmed.area().sum()) / areas.sum() - 1)
        row, u, v = UniformSampler.of(trimmed).draw(points, np.random.default_rng(model_id))
        faces = faces_of(Path(model["path"]), model["format"])
        out = outside(faces, row, u, v)
    except (BreplakeError, OSError) as error:
        return Found(model["name"], excuse=str(error))
    between = np.where(trimmed.known, areas, 0.0)
    chances = [_chance(np.bincount(row, minlength=len(areas)), between / between.sum())]
    for patch in np.flatnonzero(np.bincount(row, minlength=len(areas)) >= _EXPECTED * _CELLS**2):
        mine = row == patch
        chances.append(_spread(trimmed, int(patch), u[mine], v[mine]))
    chances = [chance for chance in chances if chance == chance]
    valid = bool(model["is_valid"])
    return Found(model["name"], off, points, int(out.sum()), chances, is_valid=valid)


def _spread(trimmed: TrimmedPatches, patch: int, u: Floats, v: Floats) -> float:
    """Return the chance of how points are spread over the cells of a patch."""
    low, high = trimmed.window[::2, patch], trimmed.window[1::2, patch]
    ticks = (np.arange(_CELLS * _FINE) + 0.5) / (_CELLS * _FINE)
    grid = np.meshgrid(*(low[i] + ticks * (high[i] - low[i]) for i in (0, 1)), indexing="ij")
    a, b = (part.ravel() for part in grid)
    rows = np.full(len(a), patch)
    mass = trimmed.density.at(rows, a, b) * trimmed.inside(rows, a, b)
    share = mass.reshape(_CELLS, _FINE, _CELLS, _FINE).sum(axis=(1, 3)).ravel()
    place = (np.stack([u, v], axis=1) - low) / (high - low)  # (n, 2) 0 to 1
    number = np.clip((place * _CELLS).astype(int), 0, _CELLS - 1)
    counts = np.bincount(number @ [_CELLS, 1], minlength=_CELLS**2)
    return _chance(counts, share / share.sum())


def _chance(counts: Ints, share: Floats) -> float:
    """Return the chance that a right sampler differs more; NaN if there is nothing to test."""
    total = counts.sum()
    large = share * total >= _EXPECTED
    if large.sum() < 2:
        return np.nan
    found, expected = counts[large].astype(float), share[large] * total
    rest = counts[~large].sum(), share[~large].sum() * total
    if rest[1] >= _EXPECTED:
        found, expected = np.append(found, rest[0]), np.append(expected, rest[1])
    else:
        found[0], expected[0] = found[0] + rest[0], expected[0] + rest[1]
    return float(chi2.sf(((found - expected) ** 2 / expected).sum(), len(found) - 1))


def report(found: list[Found]) -> list[str]:
    """Return what was found of all models, a line each."""
    judged = [one for one in found if not one.excuse]
    known = [one for one in judged if one.off == one.off]
    chances = np.array([chance for one in judged for chance in one.chances])
    lines = [
        f"{len(found)} models, {len(judged)} judged",
        f"{sum(one.off <= SAME for one in known)} of {len(known)} have the area that ingest "
        f"integrated within {SAME:g}; {len(judged) - len(known)} hold a patch that is unknown",
        *(_strays(judged, valid) for valid in (True, False)),
        f"{(chances < _UNUSUAL).sum()} of {len(chances)} chi-square tests have a chance below "
        f"{_UNUSUAL:g}, {_UNUSUAL * len(chances):.1f} are expected",
    ]
    lines += [f"    area off by {one.off:.1e}: {one.name}" for one in known if one.off > SAME]
    lines += [f"    {one.outside} points outside: {one.name}" for one in judged if one.outside]
    return [*lines, *(f"    left out {one.name}: {one.excuse}" for one in found if one.excuse)]


def _strays(judged: list[Found], valid: bool) -> str:
    mine = [one for one in judged if one.is_valid == valid]
    outside, points = sum(one.outside for one in mine), sum(one.points for one in mine)
    kind = "valid" if valid else "invalid"
    return f"{outside} of {points} points are outside by Open CASCADE in {len(mine)} {kind} models"


def holds(found: list[Found]) -> bool:
    """Return whether samples of valid models are on their patches and uniform, and areas right."""
    judged = [one for one in found if not one.excuse and one.is_valid]
    points = sum(one.points for one in judged)
    off = sum(not one.off <= SAME for one in judged)
    return (
        points > 0
        and sum(one.outside for one in judged) <= _STRAYS * points
        and min(chance for one in judged for chance in one.chances) >= _IMPOSSIBLE
        and off <= _BROKEN * len(judged)
    )


def _all(lake: breplake.Lake, models: int, points: int, jobs: int) -> Iterator[Found]:
    from breplake.ingest.processes import Processes

    query = "SELECT model_id, name FROM models WHERE n_patches > 0 ORDER BY sha256 LIMIT ?"
    rows = lake.sql(query, [models]).fetchall()
    tasks = ((name, (lake, model_id, points)) for model_id, name in rows)
    with Processes[str](jobs, 8.0, 900.0, "this proof") as processes:
        for ended in processes.each(judge, tasks):
            yield Found(ended.key, excuse=ended.killed) if ended.killed else ended.value


def main(
    lake: Annotated[Path, typer.Argument(help="The lake.", metavar="LAKE")],
    models: Annotated[int, typer.Option(help="How many models, the first by hash.")] = 1_000_000,
    points: Annotated[int, typer.Option(help="Points on each model.")] = 5000,
    jobs: Annotated[int, typer.Option(help="Models at a time.")] = 1,
) -> None:
    """Prove areas and samples of trimmed patches."""
    found = list(_all(breplake.open(lake), models, points, jobs))
    typer.echo("\n".join(report(sorted(found, key=lambda one: one.name))))
    raise typer.Exit(code=not holds(found))


if __name__ == "__main__":
    # Processes find a task's function by its module, which is not this script.
    from breplake.bench.accuracy import sampling

    typer.run(sampling.main)
