"""Write the pages of ``docs/`` that are made from the code: ``make docs``.

``tables.md`` comes from the column contract, ``queries.md`` from the headers of the query library,
``cli.md`` from the commands and their help.
``python docs/generate.py --check`` writes nothing and ends with 1 if a page is out of date.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from breplake.cli import app
from breplake.queries.named_page import library_page
from breplake.schema.dictionary import dictionary

__all__ = ["PAGES", "cli_page", "commands", "main"]

_HEAD = """\
# Commands

<!-- Written by `make docs` from the commands themselves: edit src/breplake/cli.py. -->

`breplake COMMAND --help` shows the same.
"""


def commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield ``(full name, command)`` for every command under a group, groups left out.

    Parameters
    ----------
    command : click-like command of typer
        Where to start.
    name : str
        What is typed to reach it.
    """
    children = getattr(command, "commands", None)
    if children is None:
        yield name, command
        return
    for key, child in children.items():
        if not child.hidden:
            yield from commands(child, f"{name} {key}")


def _parameters(command: Any, context: Any) -> Iterator[str]:
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None and parameter.name != "help":
            names, meaning = (" ".join(text.split()).replace("|", "\\|") for text in record)
            yield f"| `{names}` | {meaning} |"


def command_section(name: str, command: Any) -> str:
    """Return the Markdown of one command: its help, usage, arguments and options.

    Parameters
    ----------
    name : str
        What is typed to call it.
    command : click-like command of typer
        The command.
    """
    context = command.make_context(name, [], resilient_parsing=True)
    usage = " ".join([name, *command.collect_usage_pieces(context)])
    text = [f"## {name}", inspect.cleandoc(command.help or ""), f"Usage: `{usage}`"]
    if parameters := list(_parameters(command, context)):
        text.append("\n".join(["| parameter | meaning |", "|---|---|", *parameters]))
    return "\n\n".join(text) + "\n"


def cli_page() -> str:
    """Return the page of all commands."""
    sections = [command_section(n, c) for n, c in commands(typer.main.get_command(app), "breplake")]
    return "\n".join([_HEAD, *sections])


PAGES = {"tables.md": dictionary, "queries.md": library_page, "cli.md": cli_page}
"""Name of a page in ``docs/`` and the function that makes its text."""


def main(arguments: list[str]) -> int:
    """Write the pages, or with ``--check`` compare them; return the exit code."""
    stale = 0
    for name, make in PAGES.items():
        path = Path(__file__).parent / name
        text = make()
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale = 1
        if "--check" not in arguments:
            path.write_text(text, encoding="utf-8")
        print(f"docs/{name}", "is out of date: make docs" if "--check" in arguments else "written")
    return stale if "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
