"""``breplake consolidate``: make SQL on a lake of very many models quick."""

from __future__ import annotations

from typing import Annotated

import typer

from breplake.commands.options import AtOption, LakeOption, console

__all__ = ["consolidate"]


def consolidate(
    tables: Annotated[
        list[str] | None, typer.Argument(help="Names of tables.  [default: models]")
    ] = None,
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Copy tables of a lake of many shards into one file each, which SQL then reads.

    Worth it from some hundred shards on. The copies lie in the lake's folder, serve this snapshot
    alone, and may be deleted when no session reads them. Those of removed snapshots are.
    """
    import breplake
    from breplake.queries.consolidated import consolidate as copy

    opened = breplake.open(lake, at)
    log = console(error=True)
    for path in copy(opened, tables or ("models",), tell=lambda name: log.print(f"copying {name}")):
        typer.echo(str(path))
