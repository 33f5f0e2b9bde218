"""``breplake check`` and ``breplake show``: is the lake right, and what is in it to see."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from breplake.commands.options import AtOption, LakeOption, console

__all__ = ["check", "show"]


def check(
    place: Annotated[
        str | None, typer.Argument(help="The lake's folder, as --lake.", metavar="[LAKE]")
    ] = None,
    lake: LakeOption = "lake",
    at: AtOption = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", help="Write the whole report, every exception, as JSON."),
    ] = None,
) -> None:
    """Prove a lake from its own tables; exit with 1 if a rule is broken."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    import breplake
    from breplake.queries.check import check_lake

    opened = breplake.open(place or lake, at)
    columns = (TextColumn("checking"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console(error=True), transient=True) as bar:
        task = bar.add_task("models")

        def tell(done: int, total: int, name: str) -> None:
            bar.update(task, completed=done, total=total)

        result = check_lake(opened, progress=tell)
    console().print(result.render())
    if report is not None:
        report.write_text(result.to_json() + "\n")
    if not result.ok:
        raise typer.Exit(1)


def show(
    model: Annotated[str, typer.Argument(help="Name or id of the model.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Picture to write; MODEL.png if not given."),
    ] = None,
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Draw a model: patches coloured by type, sharp curves, a legend."""
    import breplake
    from breplake.queries.picture import draw_model

    opened = breplake.open(lake, at)
    path = output or Path(f"{Path(model).name}.png")
    draw_model(opened, model, path)
    typer.echo(str(path))
