"""``breplake duplicates``: which models are copies, and why they count as such."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from breplake.commands.options import AtOption, LakeOption, console

if TYPE_CHECKING:
    from breplake.queries.duplicates import Duplicates

__all__ = ["duplicates"]

_NAMED = 4  # models that are named before "and N more"


def duplicates(
    lake: LakeOption = "lake",
    at: AtOption = None,
    limit: Annotated[int, typer.Option(min=1, help="Groups to show.")] = 20,
    as_json: Annotated[bool, typer.Option("--json", help="Print all groups as JSON.")] = False,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", "-p", help="Draw the first models of the largest groups."),
    ] = None,
) -> None:
    """Group models of the same shape and size, and name mirror images and scaled copies.

    The place and orientation of a part, its unit and the way its file is written make no
    difference; a length that differs by a thousandth does.
    """
    import breplake
    from breplake.queries.duplicates import find_duplicates

    opened = breplake.open(lake, at)
    found = find_duplicates(opened)
    if as_json:
        typer.echo(json.dumps([asdict(group) for group in found.groups], indent=1))
    else:
        _print(found, limit)
    if picture is not None:
        from breplake.queries.picture import draw_sheet

        several = [group for group in found.groups if len(group.models) > 1][:limit]
        draw_sheet(opened, [m for group in several for m, _ in group.models[:_NAMED]], picture)
        typer.echo(f"drawn: {picture}", err=True)


def _print(found: Duplicates, limit: int) -> None:
    from rich.markup import escape
    from rich.table import Table

    out = console()
    names = {group.number: group.models[0][1] for group in found.groups}
    table = Table("models", "what they share", "their names", "related")
    for group in found.groups[:limit]:
        listed = ", ".join(name for _, name in group.models[:_NAMED])
        more = len(group.models) - _NAMED
        related = [f"mirror image of {names[n]}" for n in group.mirrors]
        related += [f"other size of {names[n]}" for n in group.scaled]
        table.add_row(
            str(len(group.models)),
            group.explanation,
            escape(listed + (f" and {more} more" if more > 0 else "")),
            escape("; ".join(related)),
        )
    if found.groups:
        out.print(table)
    if len(found.groups) > limit:
        out.print(f"{len(found.groups) - limit} more groups: give a higher --limit, or --json")
    out.print(f"{found.n_models} models, {found.n_copies} of them copies of others")
