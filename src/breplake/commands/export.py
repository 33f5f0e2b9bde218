"""``breplake export``: a lake in the formats of others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from breplake.commands.options import AtOption, LakeOption, console
from breplake.errors import UsageError

__all__ = ["export"]

export = typer.Typer(no_args_is_help=True, help="Write what a lake holds in formats of others.")


@export.command()
def delta(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder to write to.", metavar="DIR")
    ],
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Write Delta Lake tables, DIR/TABLE, that link to the lake's own Parquet files.

    Run again later, it adds the newer snapshot as a new version of each table.
    """
    import breplake
    from breplake.queries.export_delta import export_delta

    tables = export_delta(breplake.open(lake, at), output)
    for table in tables:
        typer.echo(f"{table.path}: version {table.version}, {table.files} files")


@export.command()
def croissant(
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="File; croissant.json in the lake's folder if not given."
        ),
    ] = None,
    url: Annotated[
        str | None, typer.Option(help="Where the lake is published, if not beside the file.")
    ] = None,
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Describe a snapshot as a dataset in MLCommons Croissant (JSON-LD)."""
    import breplake
    from breplake.queries.export_croissant import write_croissant

    opened = breplake.open(lake, at)
    typer.echo(str(write_croissant(opened, output or opened.root / "croissant.json", url)))


@export.command()
def abc(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder to write to.", metavar="DIR")
    ],
    models: Annotated[
        list[str] | None,
        typer.Argument(help="Names or ids; all models if none is given.", metavar="[MODEL]..."),
    ] = None,
    where: Annotated[
        str | None, typer.Option("--where", help="Only models for which this SQL holds.")
    ] = None,
    decimals: Annotated[
        int | None,
        typer.Option(
            min=3, max=15, help="Digits after the point in the OBJ: 6 as published; default all."
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Write models anew that are there already.")
    ] = False,
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Write OBJ, features YAML and stats YAML of models, as the ABC dataset has them.

    Models whose files are complete are skipped, so that an interrupted export goes on.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    import breplake
    from breplake.queries.abc import Exported
    from breplake.queries.abc import export as write

    if models and where:
        raise UsageError("give names of models or --where, not both")
    columns = ("export", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console(error=True), transient=True) as bar:
        task = bar.add_task("models")

        def tell(state: Exported, _name: str) -> None:
            bar.update(task, total=state.total, completed=state.done)

        opened = breplake.open(lake, at)
        done = write(
            opened, models, output, where=where, decimals=decimals, overwrite=overwrite,
            progress=tell,
        )  # fmt: skip
    skipped = f", {done.skipped} were there already" if done.skipped else ""
    unmeshed = f", {done.unmeshed} without mesh and so without OBJ" if done.unmeshed else ""
    noun = "model" if done.written == 1 else "models"
    typer.echo(f"{done.written} {noun} written to {output}{skipped}{unmeshed}")
