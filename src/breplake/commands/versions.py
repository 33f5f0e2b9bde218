"""``breplake snapshots``, ``tag``, ``diff``, ``verify`` and ``gc``: the versions of a lake."""

from __future__ import annotations

import json
import re
from datetime import timedelta
from typing import TYPE_CHECKING, Annotated

import typer

from breplake.commands.options import AtOption, LakeOption, console, shown, sized
from breplake.errors import UsageError

if TYPE_CHECKING:
    from rich.table import Table

    from breplake.queries.versions.diff import Diff
    from breplake.schema.gc import Collection
    from breplake.schema.snapshot import FileEntry

__all__ = ["diff", "gc", "snapshots", "tag", "verify"]

_NAMED = 10  # models or files that are named before "and N more"

_UNITS = {"s": 1, "min": 60, "h": 3600, "d": 86400, "w": 7 * 86400}


def _duration(text: str) -> timedelta:
    """Return a time given as number and unit."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?)\s*(s|min|h|d|w)?", text.strip())
    if match is None or (match[2] is None and float(match[1]) != 0):
        raise UsageError(f"a time is a number with s, min, h, d or w, as 30d; got {text!r}")
    return timedelta(seconds=float(match[1]) * _UNITS[match[2] or "s"])


def snapshots(
    lake: LakeOption = "lake",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the snapshots of a lake, newest last."""
    from dataclasses import asdict

    from breplake.schema.lake import LakeStore

    store = LakeStore.open(lake)
    tags: dict[int, list[str]] = {}
    for name, number in store.tags().items():
        tags.setdefault(number, []).append(name)
    headers = list(store.headers())
    if as_json:
        found = [asdict(header) | {"tags": tags.get(header.number, [])} for header in headers]
        typer.echo(json.dumps(found, indent=2))
        return
    table = _table("snapshot", "models", "files", "size", right=True)
    for name in ("time", "tags", "message"):
        table.add_column(name)
    for header in headers:
        numbers = (header.number, f"{header.models:,}", f"{header.files:,}", sized(header.bytes))
        names = ", ".join(tags.get(header.number, []))
        _add(table, *numbers, header.time, names, header.message)
    console().print(table)


def tag(
    name: Annotated[str, typer.Argument(help="Letters, digits, '.', '_' and '-'.")],
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Give a snapshot a name, for good; a snapshot with a name is kept by gc."""
    from breplake.schema.lake import LakeStore

    store = LakeStore.open(lake)
    snapshot = store.snapshot(at)
    store.tag(name, snapshot)
    typer.echo(f"{name} names snapshot {snapshot.number}")


def diff(
    old: Annotated[str, typer.Argument(help="Number or tag of a snapshot.")],
    new: Annotated[str | None, typer.Argument(help="Another; the newest if not given.")] = None,
    lake: LakeOption = "lake",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print JSON, with the names of all models.")
    ] = False,
) -> None:
    """Say what changed between two snapshots: models, rows and columns of each table."""
    import breplake
    from breplake.queries.versions.diff import diff as compare

    result = compare(breplake.open(lake, old), breplake.open(lake, new))
    if as_json:
        typer.echo(json.dumps(result.to_dict(), indent=2))
    else:
        _print_diff(result)


def _print_diff(result: Diff) -> None:
    out = console()
    out.print(f"snapshot {result.old} to {result.new}")
    for word in ("added", "removed", "changed"):
        models: list[str] = getattr(result, word)
        more = f" and {len(models) - _NAMED:,} more" if len(models) > _NAMED else ""
        named = f": {', '.join(models[:_NAMED])}{more}" if models else ""
        out.print(shown(f"{len(models):,} models {word}{named}"), markup=False)
    if result.rewritten:
        out.print(f"{result.rewritten:,} models written anew, their content as before")
    if result.tables:
        table = _table("table")
        for name in ("added", "removed", "changed"):
            table.add_column(f"rows {name}", justify="right")
        for change in result.tables:
            counts = (change.added, change.removed, change.changed)
            _add(table, change.table, *(f"{count:,}" for count in counts))
        out.print(table)
    if result.columns:
        table = _table("column")
        for name in ("rows changed", "in models"):
            table.add_column(name, justify="right")
        table.add_column("")
        for column in result.columns:
            note = column.note or ("" if column.content else "how it was made")
            name = f"{column.table}.{column.column}"
            _add(table, name, f"{column.rows:,}", f"{column.models:,}", note)
        out.print(table)


def verify(
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Compare size and SHA-256 of every file with the snapshot; exit with 1 if one differs.

    This finds damage by disks and copies. What the files say is proven by breplake check.
    """
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

    from breplake.schema.lake import LakeStore

    store = LakeStore.open(lake)
    snapshot = store.snapshot(at)
    columns = (TextColumn("verifying"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
    target = console(error=True)
    with Progress(*columns, console=target, transient=True, disable=not target.is_terminal) as bar:
        task = bar.add_task("files", total=snapshot.header.bytes)

        def tell(entry: FileEntry) -> None:
            bar.advance(task, entry.bytes)

        problems = store.verify(snapshot, tell)
    for problem in problems:
        console().print(f"{problem.path}: {problem.message}", markup=False)
    if problems:
        console(error=True).print(
            f"{len(problems):,} of {len(snapshot.files):,} files are damaged: copy the lake again, "
            "or ingest their models anew"
        )
        raise typer.Exit(1)
    typer.echo(
        f"snapshot {snapshot.number}: {len(snapshot.files):,} files, "
        f"{sized(snapshot.header.bytes)}, all as written"
    )


def gc(
    lake: LakeOption = "lake",
    keep: Annotated[
        int | None, typer.Option(min=1, help="Keep the newest so many snapshots.")
    ] = None,
    keep_tagged: Annotated[
        bool, typer.Option("--keep-tagged", help="Keep only the newest and the tagged snapshots.")
    ] = False,
    older_than: Annotated[
        str | None,
        typer.Option(help="Keep snapshots that were the newest within this time, as 30d."),
    ] = None,
    grace: Annotated[
        str,
        typer.Option(
            help="Leave alone what changed within this time: others may be at work. 0 if not."
        ),
    ] = "1h",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", "-n", help="Only say what would be removed.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, with all files.")] = False,
) -> None:
    """Remove leftovers of interrupted writers, and snapshots that need not be kept.

    Without --keep, --keep-tagged and --older-than all snapshots are kept. The newest and the
    tagged ones always are; of several rules, each must allow the removal.
    """
    from dataclasses import asdict

    from breplake.schema.gc import Retention, collect
    from breplake.schema.lake import LakeStore

    retention = Retention(keep, keep_tagged, _duration(older_than) if older_than else None)

    def waiting() -> None:
        console(error=True).print("waiting for a writer to finish its shard ...")

    found = collect(
        LakeStore.open(lake), retention, grace=_duration(grace), dry_run=dry_run, waiting=waiting
    )
    if as_json:
        files = [item._asdict() for item in found.garbage]
        typer.echo(json.dumps(asdict(found) | {"garbage": files}, indent=2))
    else:
        _print_collection(found, "would be removed" if dry_run else "removed", grace)


def _print_collection(found: Collection, done: str, grace: str) -> None:
    out = console()
    numbers = ", ".join(map(str, found.snapshots)) or "none"
    out.print(f"snapshots {done}: {numbers}")
    orphans = sum(item.reason == "orphan" for item in found.garbage)
    out.print(
        f"files {done}: {len(found.garbage):,} ({sized(found.bytes)}), {orphans:,} of them left "
        "by interrupted writers"
    )
    for text, items in (
        (f"snapshots kept, for they were the newest within {grace} (--grace)", found.in_grace),
        (f"files kept, for they are new and may be in use (--grace {grace})", found.young),
        ("files that are not a lake's, left", found.foreign),
    ):
        if items:
            more = f" and {len(items) - _NAMED:,} more" if len(items) > _NAMED else ""
            out.print(f"{text}: {', '.join(map(str, items[:_NAMED]))}{more}", markup=False)


def _table(*names: str, right: bool = False) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for name in names:
        table.add_column(name, justify="right" if right else "left")
    return table


def _add(table: Table, *cells: object) -> None:
    from rich.text import Text

    table.add_row(*(Text(shown(cell)) for cell in cells))
