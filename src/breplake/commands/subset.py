"""``breplake subset``: freeze the answer to a question, and carry it to other lakes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from breplake.commands.options import AtOption, LakeOption, console, shown
from breplake.errors import UsageError

if TYPE_CHECKING:
    from breplake.loaders.points import Source
    from breplake.queries.session import Lake
    from breplake.schema.subset import Subset, Together

__all__ = ["subset"]

subset = typer.Typer(
    no_args_is_help=True, help="Freeze selections of models, split them, carry them elsewhere."
)

_NameArgument = Annotated[str, typer.Argument(help="Name of the subset.")]


@subset.command()
def create(
    name: Annotated[str, typer.Argument(help="Letters, digits, '.', '_' and '-'.")],
    sql: Annotated[
        str | None, typer.Option("--sql", help="A query with a column model_id.")
    ] = None,
    where: Annotated[
        str | None, typer.Option("--where", help="Instead of --sql: a condition on models.")
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option("--from", help="Instead of both: a file of `subset export`.", metavar="FILE"),
    ] = None,
    split: Annotated[
        str | None,
        typer.Option("--split", help="Shares, as train=0.8,test=0.2; copies stay together."),
    ] = None,
    together: Annotated[
        str,
        typer.Option(
            "--together",
            help="What shares a split: copies, or form (scaled copies and mirror images too).",
        ),
    ] = "copies",
    seed: Annotated[int, typer.Option("--seed", help="Another one splits otherwise.")] = 0,
    limit: Annotated[
        int | None, typer.Option("--limit", min=1, help="Take at most so many models.")
    ] = None,
    partial: Annotated[
        bool, typer.Option("--partial", help="With --from: leave out models that are not here.")
    ] = False,
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Select models, split them by duplicate group, and store the answer for good."""
    import breplake
    from breplake.queries.subset_files import SubsetFile, import_subset, missing_models
    from breplake.queries.subsets import create_subset

    opened = breplake.open(lake, at)
    if source is None:
        if partial:
            raise UsageError("--partial goes with --from")
        made = create_subset(
            opened, name, sql=sql, where=where, split=_fractions(split), seed=seed, limit=limit,
            together=cast("Together", together),
        )  # fmt: skip
        for empty in (split for split, count in made.counts().items() if not count):
            typer.echo(
                f"split {empty} has no model: {len(made)} models are few for these shares, "
                "which are met on average; another --seed splits otherwise",
                err=True,
            )
    else:
        if (sql, where, split, limit, seed, together) != (None, None, None, None, 0, "copies"):
            raise UsageError("--from takes the models and splits of the file, and no other option")
        file = SubsetFile.read(source)
        made = import_subset(opened, name, file, partial=partial)
        for model, why in missing_models(opened, file) if partial else ():
            typer.echo(f"left out {model.label}: {why}", err=True)
    typer.echo(f"{_line(made)}, hash {made.hash}")


@subset.command()
def show(name: _NameArgument, lake: LakeOption = "lake") -> None:
    """Say how a subset came about and how many models its splits have."""
    from rich.table import Table
    from rich.text import Text

    found = _load(lake, name)[1]
    lines: dict[str, Any] = {
        "subset": found.name,
        "hash": found.hash,
        "models": f"{len(found):,}",
        "splits": _splits(found),
        "together": found.together if len(found.splits) > 1 and found.sql else None,
        "seed": found.seed,
        "limit": found.limit,
        "snapshot": found.snapshot,
        "lake": found.lake_id,
        "made": found.time,
        "query": found.sql,
    }
    if found.origin:
        origin = found.origin
        lines["from"] = f"{origin.name} of lake {origin.lake_id} at snapshot {origin.snapshot}"
    table = Table.grid(padding=(0, 2))
    for key, value in lines.items():
        if value is not None:
            table.add_row(Text(key, style="bold"), Text(shown(value)))
    console().print(table)


@subset.command("list")
def list_(lake: LakeOption = "lake") -> None:
    """List the subsets of a lake."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    import breplake
    from breplake.queries.subsets import subsets

    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("subset", "models", "splits", "snapshot", "hash"):
        table.add_column(heading, justify="right" if heading in ("models", "snapshot") else "left")
    for found in subsets(breplake.open(lake)):
        cells = (found.name, f"{len(found):,}", _splits(found), found.snapshot, found.hash[:12])
        table.add_row(*(Text(shown(cell)) for cell in cells))
    console().print(table)


@subset.command()
def diff(
    first: Annotated[str, typer.Argument(help="Name of a subset.")],
    second: Annotated[str, typer.Argument(help="Name of another.")],
    lake: LakeOption = "lake",
) -> None:
    """Print the models that only one of two subsets has, or that are in another split."""
    from breplake.queries.subsets import diff_subsets, load_subset

    opened, a = _load(lake, first)
    b = load_subset(opened, second)
    found = diff_subsets(a, b)
    names = _model_names(opened, a) | _model_names(opened, b)
    for sign, ids in (("-", found.only_first), ("+", found.only_second), ("~", found.moved)):
        for identity in ids.tolist():
            typer.echo(f"{sign} {shown(names[identity])}")
    typer.echo(
        f"{found.common:,} the same, {len(found.only_first):,} only in {first}, "
        f"{len(found.only_second):,} only in {second}, {len(found.moved):,} in another split"
    )


@subset.command()
def export(
    name: _NameArgument,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help=".json or .csv; NAME.json if not given."),
    ] = None,
    lake: LakeOption = "lake",
) -> None:
    """Write a subset as a file from which `subset create --from` makes it in another lake."""
    from breplake.queries.subset_files import export_subset

    opened, found = _load(lake, name)
    path = output or Path(f"{name}.json")
    export_subset(opened, found, path)
    typer.echo(f"{_line(found)}: {path}")


@subset.command()
def pack(
    name: _NameArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to make.")],
    points: Annotated[int, typer.Option("--points", "-n", min=1, help="Points of a cloud.")] = 2048,
    split: Annotated[str | None, typer.Option("--split", help="Take one split.")] = None,
    source: Annotated[
        str, typer.Option("--source", help="vertices, triangles or exact.")
    ] = "vertices",
    seed: Annotated[int, typer.Option("--seed", help="Another one draws other points.")] = 0,
    workers: Annotated[int, typer.Option("--workers", min=0, help="Processes that draw.")] = 0,
    lake: LakeOption = "lake",
) -> None:
    """Draw a point cloud of each model, and store them raw for fast training."""
    from breplake.loaders import MeshDataset, write_pack

    opened, found = _load(lake, name)
    meshes = MeshDataset(opened, subset=found, split=split)
    clouds = meshes.points(points, seed, cast("Source", source))
    made = write_pack(clouds, output, workers=workers)
    left_out = meshes.index.left_out
    note = f"; {left_out} models without a mesh are left out" if left_out else ""
    typer.echo(f"{output}: {len(made):,} clouds of {made.points:,} points{note}")


def _load(lake: str, name: str) -> tuple[Lake, Subset]:
    import breplake
    from breplake.queries.subsets import load_subset

    opened = breplake.open(lake)
    return opened, load_subset(opened, name)


def _fractions(text: str | None) -> dict[str, float] | None:
    """Read ``train=0.8,test=0.2``."""
    if text is None:
        return None
    shares: dict[str, float] = {}
    for item in text.split(","):
        name, _, share = item.strip().partition("=")
        try:
            value = float(share)
        except ValueError:
            raise UsageError(f"a split is written name=share, got {item.strip()!r}") from None
        if name in shares:
            raise UsageError(f"split {name!r} is named twice")
        shares[name] = value
    return shares


def _splits(found: Subset) -> str:
    return ", ".join(f"{name} {count:,}" for name, count in found.counts().items())


def _line(found: Subset) -> str:
    return f"{found.name}: {len(found):,} models ({_splits(found)}) at snapshot {found.snapshot}"


def _model_names(lake: Lake, found: Subset) -> dict[int, str]:
    """Return ``collection/name`` of each model at the subset's snapshot."""
    query = "SELECT model_id, concat(collection, '/', name) FROM models"
    return dict(lake.at(found.snapshot).sql(query).fetchall())
