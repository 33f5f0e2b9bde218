"""The command ``breplake``: one function per command, in ``breplake.commands``."""

from __future__ import annotations

import os
import re
import sys
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from typer.core import TyperGroup

from breplake.commands.consolidate import consolidate
from breplake.commands.contents import files, info
from breplake.commands.duplicates import duplicates
from breplake.commands.export import export
from breplake.commands.ingest import ingest
from breplake.commands.parts import samples
from breplake.commands.proof import check, show
from breplake.commands.publish import publish, pull
from breplake.commands.query import query
from breplake.commands.rebuild import rebuild
from breplake.commands.sample import sample
from breplake.commands.sql import sql
from breplake.commands.stats import stats
from breplake.commands.subset import subset
from breplake.commands.versions import diff, gc, snapshots, tag, verify
from breplake.errors import BreplakeError

__all__ = ["app", "main"]


_NEEDLESS: Final = re.compile(r"Got unexpected extra arguments?(?:\(s\))? \((.*)\)")
"""What typer says of arguments that a command does not take."""


class _Commands(TyperGroup):
    """Commands whose errors are one clear line and exit code 2."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; with --debug, let its errors through."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise
        except Exception as error:
            _name_lake_option(error)
            if ctx.params.get("debug") or not _is_expected(error):
                raise
            typer.echo(f"breplake: {_one_line(str(error))}", err=True)
            raise typer.Exit(2) from error


def _name_lake_option(error: Exception) -> None:
    """Say in the error of a needless argument that is a lake how a lake is given."""
    needless = _NEEDLESS.fullmatch(getattr(error, "message", None) or "")
    if needless is None:
        return
    from breplake.schema.lake import MARKER

    for word in (needless[1], *needless[1].split()):
        if "://" in word or Path(word, MARKER).is_file():
            error.message = f"{error.message}: name the lake with --lake {word}"  # type: ignore[attr-defined]
            return


def _is_expected(error: Exception) -> bool:
    """Return whether an error says what is wrong with the world, and not with breplake."""
    networks = sys.modules.get("obstore.exceptions")  # loaded by whoever has spoken to one
    unreached = (networks.BaseError,) if networks else ()
    return isinstance(error, (BreplakeError, OSError, *unreached))


def _one_line(message: str) -> str:
    """Return a message without the excerpt of the query that DuckDB adds to it."""
    said = takewhile(lambda line: not line.startswith("LINE "), message.splitlines())
    return " ".join(line.strip() for line in said if line.strip())


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from breplake import __version__

        typer.echo(f"breplake {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Build, query and check a data lake of CAD boundary representations."""


_COMMANDS = (
    *(samples, ingest, info, sql, query, stats, files, show, check, duplicates),
    consolidate,
    *(snapshots, tag, diff, verify, gc, publish, pull, rebuild, sample),
)

for command in _COMMANDS:
    app.command(command.__name__)(command)
app.add_typer(export, name="export")
app.add_typer(subset, name="subset")


def main() -> None:
    """Run the command line; the end of a pipe that closed early is no error."""
    try:
        app()
    except BrokenPipeError:
        # Python flushes stdout once more at exit: give it somewhere to go
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


if __name__ == "__main__":
    main()
