"""Options that many commands share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["AtOption", "LakeOption", "console", "shown", "sized"]

LakeOption = Annotated[
    str,
    typer.Option(
        "--lake", "-l", envvar="BREPLAKE", help="The lake's folder or URL.", metavar="LAKE"
    ),
]
"""``--lake``, else ``$BREPLAKE``, else ``lake`` in the current folder."""

AtOption = Annotated[
    str | None,
    typer.Option("--at", help="Number or tag of a snapshot; the newest if not given."),
]
"""``--at``: which snapshot is read."""

_PIPE_WIDTH = 100_000


def console(*, error: bool = False) -> Console:
    """Return where to print: as wide as the terminal, and without wrapping into a pipe."""
    from rich.console import Console

    made = Console(stderr=error, highlight=False)
    return made if made.is_terminal else Console(stderr=error, highlight=False, width=_PIPE_WIDTH)


def shown(value: object) -> str:
    """Return a value as a cell of a table: nothing that moves the cursor, no needless digits."""
    if value is None:
        return ""
    text = f"{value:.10g}" if isinstance(value, float) else str(value)
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


def sized(size: float) -> str:
    """Return a number of bytes in the unit that suits it."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"
