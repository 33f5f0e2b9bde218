"""``breplake samples``: CAD files to try things on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["samples"]


def samples(
    folder: Annotated[Path, typer.Argument(help="Folder to write to.", metavar="DIR")],
) -> None:
    """Model sample parts and write them as STEP files."""
    from breplake.ingest.samples import write_samples

    written = write_samples(folder)
    typer.echo(f"{len(written)} parts in {folder}")
