"""``breplake sql``: ask a lake, and print or write the answer."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from breplake.commands.answer import FormatOption, OutputOption, RowsOption, answer
from breplake.commands.options import AtOption, LakeOption
from breplake.errors import UsageError

if TYPE_CHECKING:
    import duckdb

    from breplake.queries.session import Lake

__all__ = ["sql"]


def sql(
    query: Annotated[str, typer.Argument(help="A reading statement, or - to read it from stdin.")],
    lake: LakeOption = "lake",
    at: AtOption = None,
    format_: FormatOption = None,
    output: OutputOption = None,
    rows: RowsOption = 200,
    sandbox: Annotated[
        bool,
        typer.Option(
            "--sandbox", help="For SQL you do not trust: one SELECT, in a process of its own."
        ),
    ] = False,
    timeout: Annotated[
        float | None,
        typer.Option("--timeout", help="With --sandbox: seconds it may run.  [default: 30]"),
    ] = None,
    memory: Annotated[
        float | None,
        typer.Option("--memory", help="With --sandbox: memory it may use, GB.  [default: 1]"),
    ] = None,
) -> None:
    """Run SQL on a lake; try SHOW TABLES and DESCRIBE patches."""
    import breplake

    if not sandbox and (timeout is not None or memory is not None):
        raise UsageError("--timeout and --memory are limits of --sandbox: add it")
    text = sys.stdin.read() if query == "-" else query

    def ask() -> duckdb.DuckDBPyRelation:
        opened = breplake.open(lake, at)
        return _ask_sandbox(opened, text, timeout, memory) if sandbox else opened.sql(text)

    answer(ask, format_, output, rows)


def _ask_sandbox(
    lake: Lake, text: str, timeout: float | None, memory: float | None
) -> duckdb.DuckDBPyRelation:
    import duckdb

    limits: dict[str, Any] = {}
    if timeout is not None:
        limits["timeout"] = timeout
    if memory is not None:
        limits["memory"] = memory
    box = lake.sandbox(**limits)
    return duckdb.from_arrow(box.sql(text), connection=duckdb.connect())
