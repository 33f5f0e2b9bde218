"""``breplake stats``: the paper's figures of a lake."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from breplake.commands.options import AtOption, LakeOption

__all__ = ["stats"]


def stats(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder to write to.", metavar="DIR")
    ],
    lake: LakeOption = "lake",
    at: AtOption = None,
    where: Annotated[
        str | None,
        typer.Option("--where", help="Only models for which this SQL condition on models holds."),
    ] = None,
    models: Annotated[
        int, typer.Option("--models", min=0, help="Models on the sheet of examples.")
    ] = 24,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the draw of examples.")] = 0,
) -> None:
    """Write the paper's figures: types, histograms, examples; as PNG, CSV and one HTML page."""
    import breplake
    from breplake.queries.stats_report import write_report

    opened = breplake.open(lake, at)
    files = write_report(opened, output, where=where, examples=models, seed=seed)
    typer.echo(str(files[0]))
