"""``breplake ingest``: CAD files into a lake."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from breplake.commands.options import LakeOption, console

if TYPE_CHECKING:
    from rich.console import Console

    from breplake.ingest.run import Plan, Summary

__all__ = ["ingest"]

_NAMED = 5  # changed files that are named before "and N more"


def ingest(
    sources: Annotated[
        list[Path], typer.Argument(help="CAD files and folders of them.", metavar="SOURCE...")
    ],
    lake: LakeOption = Path("lake"),
    collection: Annotated[
        str | None,
        typer.Option(help="Collection of the models; the source folder's name if not given."),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Worker processes; one per core.")
    ] = None,
    mesh: Annotated[
        Literal["uniform", "adaptive"],
        typer.Option(help="Edges of one length, or sized by curvature."),
    ] = "uniform",
    max_edge: Annotated[
        float, typer.Option(help="Longest mesh edge, as a share of the model's diagonal.")
    ] = 0.01,
    timeout: Annotated[float, typer.Option(help="Seconds for one attempt at a model.")] = 120.0,
    memory: Annotated[float, typer.Option(help="Memory for one model, in GiB.")] = 8.0,
    message: Annotated[
        str | None, typer.Option("--message", "-m", help="Message of the snapshots.")
    ] = None,
) -> None:
    """Read CAD files, mesh them, derive the ground truth, and commit it all to a lake.

    Files are STEP (.step .stp .p21), IGES (.iges .igs) or BREP (.brep .brp), also with .gz.
    Every file ends as a row of models or of failures; what is in the lake is skipped.
    """
    from breplake.ingest.run import ingest as run
    from breplake.ingest.settings import Settings

    settings = Settings(mesh=mesh, max_edge=max_edge, timeout=timeout, memory=memory)
    errors = console(error=True)
    with _Bar(errors) as bar:
        summary = run(
            sources,
            lake,
            settings=settings,
            collection=collection,
            jobs=jobs,
            message=message,
            progress=bar.update,
        )
    _report(console(), summary, lake)


class _Bar:
    """A progress bar with rate, time left and failures so far."""

    def __init__(self, target: Console) -> None:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self.bar = Progress(
            TextColumn("ingest"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            TextColumn("[red]{task.fields[failed]}"),
            console=target,
            transient=True,
        )
        self.task = self.bar.add_task("models", total=None, rate="", failed="")

    def __enter__(self) -> _Bar:
        self.bar.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self.bar.stop()

    def update(self, plan: Plan, summary: Summary) -> None:
        """Show where the run stands."""
        done = summary.n_models + summary.n_fatal
        elapsed = self.bar.tasks[0].elapsed or 0.0
        rate = f"{60 * done / elapsed:.0f}/min" if done and elapsed else ""
        failed = f"{summary.n_fatal} failed" if summary.n_fatal else ""
        self.bar.update(self.task, total=len(plan.new), completed=done, rate=rate, failed=failed)


def _report(out: Console, summary: Summary, lake: Path) -> None:
    """Print what became of the inputs, and where to look next."""
    from rich.markup import escape

    plan = summary.plan
    if plan.unchanged:
        out.print(f"{_files(len(plan.unchanged))} in the lake already, unchanged")
        if plan.n_failed_before:
            out.print(
                f"{_files(plan.n_failed_before)} of them failed before; to try again with other "
                "limits, ingest into a new lake or another --collection"
            )
    if plan.changed:
        names = escape(", ".join(item.name for item in plan.changed[:_NAMED]))
        more = f" and {len(plan.changed) - _NAMED} more" if len(plan.changed) > _NAMED else ""
        out.print(
            f"[yellow]{_files(len(plan.changed))} not ingested: in the lake with other content "
            f"or settings ({names}{more}); ingest into a new lake or another --collection"
        )
    if not plan.new:
        found = plan.unchanged or plan.changed
        out.print("nothing is new" if found else "no CAD files found in the sources")
        return
    out.print(
        f"{_files(len(plan.new))} ingested in {summary.seconds:.0f} s "
        f"({summary.cpu_seconds:.0f} s of CPU): {summary.n_models} models, "
        f"{summary.n_meshed} of them with mesh and ground truth; {summary.n_fatal} failed"
    )
    if summary.kinds:
        from rich.table import Table

        table = Table("stage", "failure", "times", title="what failed", title_justify="left")
        for (stage, kind), times in summary.kinds.most_common():
            table.add_row(stage, kind, str(times))
        out.print(table)
        query = "SELECT name, stage, kind, message FROM failures"
        out.print(f'why: breplake sql "{query}" --lake {escape(str(lake))}', soft_wrap=True)
    if summary.snapshot is not None:
        out.print(f"{escape(str(lake))} is at snapshot {summary.snapshot.number}")


def _files(count: int) -> str:
    return f"{count} file" if count == 1 else f"{count} files"
