"""``breplake publish`` and ``pull``: copy a lake, or some of its models, to and from elsewhere."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from breplake.commands.options import AtOption, LakeOption, console, sized
from breplake.errors import BreplakeError, UsageError

if TYPE_CHECKING:
    from breplake.queries.versions.extract import Extracted, Selection
    from breplake.queries.versions.mirror import Mirrored
    from breplake.schema.lake import LakeStore
    from breplake.schema.snapshot import Snapshot

__all__ = ["publish", "pull"]

_SHOWN: Final = 10
"""Names that a message lists."""

_WhereOption = Annotated[
    str | None,
    typer.Option("--where", help="Copy only models for which this SQL condition holds."),
]
_SubsetOption = Annotated[
    str | None, typer.Option("--subset", help="Copy only the models of this subset, and it.")
]
_ModelsOption = Annotated[
    Path | None,
    typer.Option("--models", help="Copy only models that this file lists.", metavar="FILE"),
]


def publish(
    place: Annotated[
        str, typer.Argument(help="Folder, or URL: file://, s3://, gs:// or az://.", metavar="PLACE")
    ],
    where: _WhereOption = None,
    subset: _SubsetOption = None,
    models: _ModelsOption = None,
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Copy a snapshot to a place from which others pull or read it.

    It is the same snapshot of the same lake there, with the tags and subsets that name it; those
    of other snapshots are left out, and named. A selection of models becomes a lake of its own; in
    a folder that holds a lake, it is added to that. Files that are there already are not copied
    again.
    """
    from breplake.schema.lake import LakeStore
    from breplake.schema.storage import local_folder

    source = LakeStore.open(lake)
    with _reached(place):
        selection = _selection(where, subset, models)
        snapshot = _snapshot(source, at, selection)
        if selection is None:
            done = _mirror(source, place, snapshot, at)
            _say_copied(done, place, snapshot)
            _say_left_out(done, f"breplake publish {place} --lake {lake}")
        elif (folder := local_folder(place)) is not None:
            _say_extracted(_extract(source, folder, snapshot, selection), place)
        else:
            with tempfile.TemporaryDirectory(prefix="breplake-") as here:
                made = _extract(source, Path(here) / "lake", snapshot, selection)
                copied = LakeStore.open(Path(here) / "lake")
                _mirror(copied, place, made.snapshot, None)
                _say_extracted(made, place)


def pull(
    place: Annotated[
        str,
        typer.Argument(
            help="Folder, or URL: file://, s3://, gs://, az://, http:// or https://.",
            metavar="PLACE",
        ),
    ],
    where: _WhereOption = None,
    subset: _SubsetOption = None,
    models: _ModelsOption = None,
    lake: LakeOption = "lake",
    at: AtOption = None,
) -> None:
    """Copy a snapshot from elsewhere to a local folder, checking every file's hash.

    It is the same snapshot of the same lake here, with the tags and subsets that name it; those of
    other snapshots are left out, and named. From http(s), where names cannot be listed, only a tag
    given to --at comes along; --subset copies a subset. A selection of models is added to the lake
    here, which is made if it is not there. Interrupted, the same command goes on where it was.
    """
    from breplake.schema.lake import LakeStore
    from breplake.schema.storage import local_folder

    if local_folder(lake) is None:
        raise UsageError(f"pull copies to a folder of this machine, got --lake {lake}")
    with _reached(place):
        source = LakeStore.open(place)
        selection = _selection(where, subset, models)
        snapshot = _snapshot(source, at, selection)
        if selection is None:
            done = _mirror(source, lake, snapshot, at)
            _say_copied(done, str(lake), snapshot)
            _say_left_out(done, f"breplake pull {place} --lake {lake}")
        else:
            _say_extracted(_extract(source, lake, snapshot, selection), str(lake))


@contextmanager
def _reached(place: str) -> Iterator[None]:
    """Say what is wrong with a network in one line."""
    from obstore.exceptions import BaseError

    try:
        yield
    except BreplakeError:
        raise
    except (BaseError, FileNotFoundError) as error:
        reason = str(error).strip().splitlines()[0]
        raise UsageError(f"cannot copy between here and {place}: {reason}") from error


def _selection(where: str | None, subset: str | None, models: Path | None) -> Selection | None:
    from breplake.queries.versions.extract import Selection

    if where is None and subset is None and models is None:
        return None
    return Selection(where, subset, models)


def _snapshot(source: LakeStore, at: str | None, selection: Selection | None) -> Snapshot:
    """Return the snapshot to copy; a subset's is the one that it was made at."""
    chosen = selection.load_subset(source) if selection and at is None else None
    return source.snapshot(chosen.snapshot if chosen else at)


def _mirror(source: LakeStore, place: str | Path, snapshot: Snapshot, at: str | None) -> Mirrored:
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        Progress,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    from breplake.queries.versions.mirror import mirror

    columns = (BarColumn(), DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn())
    tag = at if at is not None and not at.isdigit() else None
    target = console(error=True)
    with Progress(*columns, console=target, transient=True, disable=not target.is_terminal) as bar:
        task = bar.add_task("bytes", total=snapshot.header.bytes)
        return mirror(
            source, place, snapshot, tag=tag, progress=lambda size: bar.advance(task, size)
        )


def _extract(
    source: LakeStore, place: str | Path, snapshot: Snapshot, selection: Selection
) -> Extracted:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    from breplake.queries.versions.extract import extract

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("shards"), TimeRemainingColumn())
    target = console(error=True)
    with Progress(*columns, console=target, transient=True, disable=not target.is_terminal) as bar:
        task = bar.add_task("shards", total=None)

        def tell(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        return extract(source, place, snapshot, selection, progress=tell)


def _say_copied(done: Mirrored, place: str, snapshot: Snapshot) -> None:
    typer.echo(
        f"{place} has snapshot {snapshot.number}: {done.files:,} files copied "
        f"({sized(done.bytes)}), {done.skipped:,} were there"
    )


def _say_left_out(done: Mirrored, command: str) -> None:
    """Name the tags and subsets that a copy lacks, and the commands that copy them."""
    if not done.is_listed:
        typer.echo(
            "subsets, and tags other than --at, were left out, as names cannot be listed there: "
            f"{command} --subset NAME copies a subset, --at TAG a tag"
        )
    if not done.left_out:
        return
    names = [f"{name} (of snapshot {number})" for name, number in sorted(done.left_out.items())]
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    numbers = sorted(set(done.left_out.values()))
    typer.echo(
        f"left out: {', '.join(names[:_SHOWN])}{more}\n"
        f"{command} --at {numbers[-1]} copies a snapshot with what names it, "
        "--subset NAME a subset with its models alone"
    )


def _say_extracted(done: Extracted, place: str) -> None:
    models = "1 model" if done.models == 1 else f"{done.models:,} models"
    present = f", {done.present:,} were there" if done.present else ""
    typer.echo(f"{place} is at snapshot {done.snapshot.number}: {models} copied{present}")
