"""``breplake rebuild``: B-Reps from a lake's tables alone, and the proof that they are the same."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from breplake.commands.options import AtOption, LakeOption, console, shown
from breplake.errors import UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from breplake.ingest.lossless.compare import Comparison
    from breplake.queries.session import Lake

__all__ = ["rebuild"]


def rebuild(
    model: Annotated[
        str | None, typer.Argument(help="Name or id of the model.", metavar="[MODEL]")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="File to write: .step, .brep (OCCT, text) or .bin (OCCT, every bit); "
            "with --compare the report, as JSON.",
        ),
    ] = None,
    unit: Annotated[
        Literal["model", "mm"],
        typer.Option(help="Length unit of a STEP file: the one of the model's source, or mm."),
    ] = "model",
    compare: Annotated[
        bool,
        typer.Option("--compare", help="Compare rebuilt models with their CAD files instead."),
    ] = False,
    step: Annotated[
        bool,
        typer.Option(
            "--step",
            help="With --compare: also write each model as STEP, and compare the tables that "
            "ingest makes of that file.",
        ),
    ] = False,
    where: Annotated[
        str | None,
        typer.Option("--where", help="With --compare: an SQL condition on models; all if none."),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", min=1, help="With --compare: processes; one per core."),
    ] = None,
    timeout: Annotated[
        float, typer.Option(help="With --compare: seconds for a model.", min=1)
    ] = 300.0,
    memory: Annotated[
        float, typer.Option(help="With --compare: memory for a model, in GiB.", min=1)
    ] = 8.0,
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Make the B-Rep of a model again from the lake's tables, without its CAD file.

    With --compare it proves instead that nothing is lost: it rebuilds every model, loads the CAD
    file it came from, and compares volume, area, counts of solids, shells, faces, wires, edges
    and vertices, and validity. It exits with 1 if something differs.
    """
    import breplake

    opened = breplake.open(lake, at)
    if compare:
        models = _chosen(opened, model, where)
        results = _compare(
            opened,
            models,
            jobs=jobs or os.cpu_count() or 1,
            timeout=timeout,
            memory=memory,
            through_step=step,
        )
        if output is not None:
            report = {"lake": opened.place, "snapshot": opened.snapshot.number}
            rows = [result.row() for result in results]
            output.write_text(json.dumps(report | {"models": rows}, indent=1) + "\n")
        if not _report(console(), results):
            raise typer.Exit(1)
        return
    if model is None or output is None:
        raise UsageError("say which MODEL to rebuild and the file with -o, or give --compare")
    if where is not None:
        raise UsageError("--where goes with --compare; without it one MODEL is rebuilt")
    if step:
        raise UsageError("--step goes with --compare; to write a STEP file end -o FILE with .step")
    _write(opened, model, output, unit)


def _write(lake: Lake, model: str, path: Path, unit: Literal["model", "mm"]) -> None:
    from breplake.ingest.lossless.files import write_model

    for loss in write_model(lake, model, path, unit):
        typer.echo(f"read again, {path} differs from the model: {loss}", err=True)
    typer.echo(str(path))


def _chosen(lake: Lake, model: str | None, where: str | None) -> dict[int, str]:
    """Return the names of the models to compare by their ids."""
    if model is not None:
        if where is not None:
            raise UsageError("give either a MODEL or --where, not both")
        row = lake.model(model)
        return {row["model_id"]: row["name"]}
    condition = f"WHERE (\n{where}\n)" if where else ""
    query = f"SELECT model_id, name FROM models {condition} ORDER BY name, model_id"
    found = dict(lake.sql(query).fetchall())
    if not found:
        raise UsageError(f"no model meets {where!r}" if where else "the lake has no models")
    return found


def _compare(
    lake: Lake,
    models: dict[int, str],
    *,
    jobs: int,
    timeout: float,
    memory: float,
    through_step: bool,
) -> list[Comparison]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    from breplake.ingest.lossless.proof import compare_models

    columns = (TextColumn("comparing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    results = compare_models(
        lake, models, jobs=jobs, timeout=timeout, memory=memory, through_step=through_step
    )
    found = []
    with Progress(*columns, console=console(error=True), transient=True) as bar:
        task = bar.add_task("models", total=len(models))
        for result in results:
            found.append(result)
            bar.advance(task)
    place = {model_id: i for i, model_id in enumerate(models)}
    return sorted(found, key=lambda result: place[result.model_id])


def _report(out: Console, results: Sequence[Comparison]) -> bool:
    """Print what was found; return whether everything that was compared is equal."""
    from rich.table import Table

    from breplake.ingest.lossless.compare import VERDICTS

    verdicts = Counter(result.verdict for result in results)
    table = Table(
        "verdict", "models", "meaning", title="rebuilt from the tables alone against CAD files"
    )
    table.title_justify = "left"
    for verdict, meaning in VERDICTS.items():
        if verdicts[verdict]:
            table.add_row(verdict, str(verdicts[verdict]), meaning)
    out.print(table)
    exact = sum(bool(result.is_exact) for result in results)
    out.print(f"{exact} of {len(results)} rebuilt models have the very bits of the tables")
    others = [result for result in results if result.verdict != "equal"]
    if others:
        table = Table("model", "verdict", "why", title="exceptions", title_justify="left")
        for result in others:
            table.add_row(shown(result.name), result.verdict, shown("\n".join(result.reasons)))
        out.print(table)
    unequal = sum(verdicts[verdict] for verdict in ("different", "step-differs", "failed"))
    return bool(verdicts["equal"]) and not unequal
