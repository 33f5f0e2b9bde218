"""``breplake sample``: points on the patches and curves of models."""

from __future__ import annotations

from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Literal

import typer

from breplake.commands.answer import replaced
from breplake.commands.options import AtOption, LakeOption, console
from breplake.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

    from breplake.queries.sampling import PointSample
    from breplake.queries.session import Lake

__all__ = ["sample"]


def sample(
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="File: .npz, .ply, or .parquet for any number of models."
        ),
    ],
    model: Annotated[
        str | None, typer.Argument(help="Name or id of a model.", metavar="[MODEL]")
    ] = None,
    where: Annotated[
        str | None, typer.Option("--where", help="All models for which this SQL holds.")
    ] = None,
    points: Annotated[
        int, typer.Option("--points", "-n", min=1, help="Points on the patches of each model.")
    ] = 10_000,
    method: Annotated[
        Literal["uniform", "poisson"],
        typer.Option(help="Independent points, or points that keep their distance."),
    ] = "uniform",
    seed: Annotated[int, typer.Option(min=0, help="Of the random numbers.")] = 0,
    curves: Annotated[
        int | None, typer.Option(min=1, help="Also so many points along sharp curves.")
    ] = None,
    spacing: Annotated[
        float | None,
        typer.Option(help="Also points along sharp curves, at most so many mm apart."),
    ] = None,
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Sample points, uniform by area on the trimmed patches, with normals and curvatures.

    Points lie on the exact surfaces, not on the mesh: no CAD kernel and no mesh is needed. The
    same model and seed always give the same points.
    """
    import breplake
    from breplake.queries.sampling import check_request

    check_request(points, method, seed, curves, spacing)
    if (model is None) == (where is None):
        raise UsageError("give the name of a model or --where, one of them")
    ending = output.suffix.lower()
    if ending not in (".npz", ".ply", ".parquet"):
        raise UsageError(f"FILE must end in .npz, .ply or .parquet, got {output.name}")
    opened = breplake.open(lake, at)
    found = _chosen(opened, model, where)
    if len(found) != 1 and ending != ".parquet":
        raise UsageError(f"{ending} holds one model and {len(found)} were chosen: take .parquet")

    def draw(model_id: int) -> PointSample:
        return opened.sample(model_id, points, method, seed=seed, curves=curves, spacing=spacing)

    with replaced(output) as stream:
        file = stream.buffer  # type: ignore[attr-defined]  # of a text file
        if len(found) == 1:
            _write_one(file, ending, draw(next(iter(found))))
        else:
            _write_many(file, found, draw)


def _chosen(lake: Lake, model: str | None, where: str | None) -> dict[int, str]:
    """Return the names of the models to sample by their ids, ascending."""
    if model is not None:
        return {int(lake.model(model)["model_id"]): model}
    query = f"SELECT model_id, name FROM models WHERE (\n{where}\n) ORDER BY model_id"
    return {int(row[0]): str(row[1]) for row in lake.sql(query).fetchall()}


def _write_one(file: IO[bytes], ending: str, sample: PointSample) -> None:
    from breplake.queries.point_files import ParquetPoints, write_npz, write_ply

    if ending == ".npz":
        write_npz(file, sample)
    elif ending == ".ply":
        write_ply(file, sample)
    else:
        with ParquetPoints(file) as points:
            points.write(sample)
    _tell(_left_out(sample))


def _write_many(file: IO[bytes], found: dict[int, str], draw: Callable[[int], PointSample]) -> None:
    """Sample model after model, so that one is in memory at a time."""
    from rich.progress import track

    from breplake.queries.point_files import ParquetPoints

    errors = console(error=True)
    skipped = partial = 0
    with ParquetPoints(file) as points:
        for model_id in track(found, "sample", console=errors, transient=True):
            try:
                drawn = draw(model_id)
            except UsageError as error:  # it has no patches: no reason to lose the others
                _tell(f"{found[model_id]} is left out: {error}")
                skipped += 1
                continue
            points.write(drawn)
            partial += bool(_left_out(drawn))
    _tell(f"{len(found) - skipped} models sampled" + (f", {skipped} left out" if skipped else ""))
    if partial:
        _tell(f"{partial} of them have patches or curves that cannot be evaluated, without points")


def _left_out(sample: PointSample) -> str:
    """Say which patches and curves have no points; nothing if all have."""
    parts = {"patches": sample.omitted, "sharp curves": sample.omitted_curves}
    named = [f"{what} {', '.join(map(str, ids))}" for what, ids in parts.items() if ids]
    return f"without points, as they cannot be evaluated: {'; '.join(named)}" if named else ""


def _tell(message: str) -> None:
    if message:
        typer.echo(message, err=True)
