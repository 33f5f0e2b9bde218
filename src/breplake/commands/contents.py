"""``breplake info`` and ``files``: what is in a lake."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from breplake.commands.options import AtOption, LakeOption, console, shown, sized

if TYPE_CHECKING:
    from rich.table import Table

    from breplake.queries.info import LakeInfo

__all__ = ["files", "info"]


def files(
    table: Annotated[str, typer.Argument(help="Name of a table, or arrays.")],
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Print the paths of a table's files at a snapshot, for other tools to read."""
    import breplake

    for path in breplake.open(lake, at).files(table):
        typer.echo(path)


def info(
    lake: LakeOption = "lake",
    at: AtOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Say what is in a lake: models, failures, types, meshes, sizes, tools."""
    import breplake

    contents = breplake.open(lake, at).info()
    if as_json:
        typer.echo(json.dumps(contents.to_dict(), indent=2))
        return
    console().print(_info_table(contents))


def _info_table(info: LakeInfo) -> Table:
    from rich.table import Table
    from rich.text import Text

    tags = f" ({', '.join(info.tags)})" if info.tags else ""
    lines = {
        "lake": info.root,
        "snapshot": f"{info.snapshot} of {info.snapshots}{tags}, {info.time}: {info.message}",
        "models": f"{info.models:,} ({_listed(info.collections)})",
        "failed inputs": f"{info.failed:,}",
        "failures": _listed(info.failures) or "none",
        "patches": f"{sum(info.patches.values()):,} ({_listed(info.patches)})",
        "curves": f"{sum(info.curves.values()):,} ({_listed(info.curves)})",
        "meshes": f"{info.meshed:,} ({_listed(info.meshes)})",
        "mesh totals": f"{info.vertices:,} vertices, {info.normals:,} (vertex, patch) pairs, "
        f"{info.triangles:,} triangles",
        "on disk": f"{sized(sum(info.bytes.values()))} ("
        + ", ".join(f"{name} {sized(size)}" for name, size in _sorted(info.bytes))
        + ")",
        "source files": sized(info.source_bytes),
        "tools": ", ".join(f"{name} {version}" for name, version in info.tools.items()),
    }
    table = Table.grid(padding=(0, 2))
    for name, line in lines.items():
        table.add_row(Text(name, style="bold"), Text(shown(line)))
    return table


def _listed(counts: dict[str, int]) -> str:
    """Return the counts that are not zero, largest first."""
    return ", ".join(f"{name} {count:,}" for name, count in _sorted(counts) if count)


def _sorted(counts: dict[str, int]) -> list[tuple[str, int]]:
    return sorted(counts.items(), key=lambda item: -item[1])
