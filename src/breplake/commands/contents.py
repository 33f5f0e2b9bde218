"""``breplake info``, ``files``, ``snapshots`` and ``tag``: what is in a lake."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from breplake.commands.options import AtOption, LakeOption, console, shown

if TYPE_CHECKING:
    from rich.table import Table

    from breplake.queries.info import LakeInfo

__all__ = ["files", "info", "snapshots", "tag"]


def files(
    table: Annotated[str, typer.Argument(help="Name of a table, or arrays.")],
    lake: LakeOption = Path("lake"),
    at: AtOption = None,
) -> None:
    """Print the paths of a table's files at a snapshot, for other tools to read."""
    import breplake

    for path in breplake.open(lake, at).files(table):
        typer.echo(path)


def info(
    lake: LakeOption = Path("lake"),
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
        "on disk": f"{_size(sum(info.bytes.values()))} ("
        + ", ".join(f"{name} {_size(size)}" for name, size in _sorted(info.bytes))
        + ")",
        "source files": _size(info.source_bytes),
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


def _size(size: float) -> str:
    """Return a number of bytes in the unit that suits it."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"


def snapshots(lake: LakeOption = Path("lake")) -> None:
    """List the snapshots of a lake, newest last."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from breplake.schema.lake import LakeStore

    store = LakeStore.open(lake)
    tags: dict[int, list[str]] = {}
    for name, number in store.tags().items():
        tags.setdefault(number, []).append(name)
    table = Table(box=box.SIMPLE_HEAD)
    for name in ("snapshot", "models", "files", "size"):
        table.add_column(name, justify="right")
    for name in ("time", "tags", "message"):
        table.add_column(name)
    for number in store.numbers():
        snapshot = store.snapshot(number)
        models = sum(entry.rows for entry in snapshot.table_files("models"))
        size = sum(entry.bytes for entry in snapshot.files)
        cells = (number, f"{models:,}", len(snapshot.files), _size(size), snapshot.time)
        texts = (*cells, ", ".join(tags.get(number, [])), snapshot.message)
        table.add_row(*(Text(shown(cell)) for cell in texts))
    console().print(table)


def tag(
    name: Annotated[str, typer.Argument(help="Letters, digits, '.', '_' and '-'.")],
    lake: LakeOption = Path("lake"),
    at: AtOption = None,
) -> None:
    """Give a snapshot a name, for good."""
    from breplake.schema.lake import LakeStore

    store = LakeStore.open(lake)
    snapshot = store.snapshot(at)
    store.tag(name, snapshot)
    typer.echo(f"{name} names snapshot {snapshot.number}")
