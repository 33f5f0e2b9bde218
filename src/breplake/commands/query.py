"""``breplake query``: ask a lake one of the questions of the library."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from breplake.commands.answer import FormatOption, OutputOption, RowsOption, answer
from breplake.commands.options import AtOption, LakeOption, console
from breplake.errors import UsageError

if TYPE_CHECKING:
    from rich.table import Table

    from breplake.queries.named import NamedQuery, OutputColumn, Parameter

__all__ = ["query"]


def query(
    name: Annotated[
        str | None, typer.Argument(help="Name of the query; without it all are listed.")
    ] = None,
    param: Annotated[
        list[str] | None,
        typer.Option("--param", "-p", help="Set a parameter; may be repeated.", metavar="NAME=X"),
    ] = None,
    where: Annotated[
        str | None,
        typer.Option("--where", help="Only models for which this SQL condition on models holds."),
    ] = None,
    lake: LakeOption = "lake",
    at: AtOption = None,
    format_: FormatOption = None,
    output: OutputOption = None,
    rows: RowsOption = 200,
    list_: Annotated[bool, typer.Option("--list", help="List all queries.")] = False,
    describe: Annotated[
        bool, typer.Option("--describe", help="Say what the query answers; do not run it.")
    ] = False,
    show_sql: Annotated[
        bool, typer.Option("--sql", help="Print the query's SQL; do not run it.")
    ] = False,
) -> None:
    """Ask a question of the library: fillets, hole patterns, duplicates ..."""
    import breplake
    from breplake.queries.named import named_query

    if list_ or name is None:
        _list()
        return
    chosen = named_query(name)
    if show_sql:
        typer.echo(chosen.sql, nl=False)
    elif describe:
        _describe(chosen)
    else:
        values = dict(_pair(text) for text in param or ())
        chosen.bind(values)  # a wrong parameter is told before the lake is opened
        opened = breplake.open(lake, at)
        answer(lambda: opened.query(name, where=where, **values), format_, output, rows)


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--param takes NAME=VALUE, got {text!r}")
    return name.strip(), value


def _list() -> None:
    from breplake.queries.named import TOPICS, named_queries

    found = named_queries()
    for topic, title in TOPICS.items():
        table = _grid()
        for entry in found:
            if entry.topic == topic:
                table.add_row(f"  {entry.name}", entry.title)
        console().print(title, style="bold")
        console().print(table)
    console().print("breplake query NAME --describe says more about each.")


def _describe(entry: NamedQuery) -> None:
    out = console()
    out.print(f"{entry.name}: {entry.title}", style="bold", markup=False)
    out.print(f"\n{entry.description}\n", markup=False)
    for title, rows in (("Parameters", entry.parameters), ("Columns", entry.columns)):
        if rows:
            table = _grid()
            for row in rows:
                table.add_row(f"  {row.name}", _kind(row), row.meaning)
            out.print(title, style="bold")
            out.print(table)


def _kind(entry: Parameter | OutputColumn) -> str:
    """Return type, default and unit, as far as there are any."""
    from breplake.queries.named import Parameter

    unit = f"({entry.unit})" if entry.unit else ""
    if not isinstance(entry, Parameter):
        return unit
    default = "required" if entry.required else f"= {entry.default_text}"
    return " ".join(word for word in (entry.type, default, unit) if word)


def _grid() -> Table:
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    return table
