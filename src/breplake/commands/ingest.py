"""``breplake ingest``: CAD files into a lake."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from breplake.commands.options import LakeOption, console
from breplake.errors import BreplakeError, InputError, RefusedSourceError, UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from breplake.ingest.plan import Plan
    from breplake.ingest.run import Summary

__all__ = ["ingest"]

_NAMED = 5  # changed files that are named before "and N more"


def ingest(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            help="CAD files, folders, archives, lists (.csv .parquet), onshape: addresses.",
            metavar="SOURCE...",
        ),
    ] = None,
    lake: LakeOption = "lake",
    collection: Annotated[
        str | None,
        typer.Option(help="Collection of the models; the name of the source if not given."),
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
    uv_grid: Annotated[
        int,
        typer.Option(
            help="Also sample each patch N by N, each curve N times; 0 for none.", metavar="N"
        ),
    ] = 0,
    timeout: Annotated[float, typer.Option(help="Seconds for one attempt at a model.")] = 120.0,
    memory: Annotated[float, typer.Option(help="Memory for one model, in GiB.")] = 8.0,
    message: Annotated[
        str | None, typer.Option("--message", "-m", help="Message of the snapshots.")
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Ingest files again whose bytes or settings changed.")
    ] = False,
    retry_failures: Annotated[
        bool, typer.Option("--retry-failures", help="Try again what failed or has no mesh.")
    ] = False,
    kind: Annotated[
        list[str] | None,
        typer.Option(help="Retry only failures of this kind; may be given more than once."),
    ] = None,
    rehash: Annotated[
        bool,
        typer.Option(
            "--rehash", help="Read every file, also those that look as they did when last read."
        ),
    ] = False,
    max_expansion: Annotated[
        float, typer.Option(help="How many times its size an archive may unpack to.")
    ] = 250.0,
    log: Annotated[
        Path | None, typer.Option(help="Append a line of JSON for each event to this file.")
    ] = None,
    engine: Annotated[
        Literal["local", "ray"],
        typer.Option(help="Work on this machine, or on a cluster that Ray runs."),
    ] = "local",
    address: Annotated[
        str | None, typer.Option(help="Address of the Ray cluster; $RAY_ADDRESS if not given.")
    ] = None,
    work: Annotated[
        Path | None,
        typer.Option(
            help="Folder for what is in the making; in the lake, or in the user's cache if that "
            "is elsewhere or Ray is used.",
            metavar="DIR",
        ),
    ] = None,
    status: Annotated[
        bool, typer.Option("--status", help="Say what ingests run on the lake, and end.")
    ] = False,
) -> None:
    """Read CAD files, mesh them, derive the ground truth, and commit it all to a lake.

    Files are STEP (.step .stp .p21), IGES (.iges .igs) or BREP (.brep .brp), also with .gz.
    Archives (.zip .7z .tar .tar.gz ...) are read member by member: see docs/sources.md.
    Every file ends as a row of models or of failures; what is in the lake is skipped. A run
    that was stopped or killed is taken up by the same command.
    """
    if status:
        _report_status(console(), lake, work)
        return
    if not sources:
        raise UsageError("nothing to ingest: give CAD files or folders as SOURCE")
    from breplake.ingest.plan import Redo
    from breplake.ingest.run import ingest as run
    from breplake.ingest.settings import Settings
    from breplake.ingest.sources.limits import Limits

    settings = Settings(
        mesh=mesh, max_edge=max_edge, uv_grid=uv_grid, timeout=timeout, memory=memory
    )
    errors = console(error=True)
    with _Bar(errors) as bar, _stop_signals(errors) as stop, _planning_stopped(bar, stop):
        summary = run(
            sources,
            lake,
            settings=settings,
            collection=collection,
            jobs=jobs,
            message=message,
            redo=Redo(changed=replace, failed=retry_failures, kinds=tuple(kind or ())),
            progress=bar.update,
            stop=stop,
            log=log,
            engine=engine,
            address=address,
            work=work,
            limits=Limits(expansion=max_expansion),
            tell=bar.tell,
            warn=bar.warn,
            rehash=rehash,
        )
    _report(console(), summary, lake)
    if summary.stopped:
        raise typer.Exit(130)
    if summary.refused or summary.unanswered:
        raise _unread(summary)


def _unread(summary: Summary) -> BreplakeError:
    """Return the error that tells of sources of which nothing was read, when all else is done."""
    sources = [*summary.refused, *summary.unanswered]
    reasons = [item.failure.message for item in sources[:_NAMED] if item.failure]
    more = f"; and {len(sources) - _NAMED} more sources" if len(sources) > _NAMED else ""
    text = "; ".join(reasons) + more
    if summary.refused:
        return RefusedSourceError(text)
    return InputError("search-failed", text)


@contextmanager
def _planning_stopped(bar: _Bar, stop: Callable[[], bool]) -> Iterator[None]:
    """Say how things stand when the run ended before it began."""
    try:
        yield
    except KeyboardInterrupt:
        if not (bar.is_planning and stop()):
            raise
        bar.warn(
            "stopped while the sources were looked through: nothing was ingested; "
            "what was found out is remembered, the same command goes on from here"
        )
        raise typer.Exit(130) from None


@contextmanager
def _stop_signals(errors: Console) -> Iterator[Callable[[], bool]]:
    """Make the first Ctrl-C or SIGTERM a request to end well; the second ends at once."""
    asked: list[int] = []

    def ask(number: int, _frame: object) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)
        errors.print("stopping: what is finished is being committed (again to stop at once)")

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, ask) for number in numbers}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _report_status(out: Console, lake: str, work: Path | None) -> None:
    """Print the ingests that run on a lake, and what their workers do."""
    from rich.markup import escape

    from breplake.ingest.workspace import running, work_root
    from breplake.schema.lake import LakeStore

    runs = running(work_root(LakeStore.open(lake).storage, work))
    if not runs:
        out.print(f"no ingest runs on {escape(str(lake))}")
    for run in runs:
        hours, rest = divmod(int(time.time() - run["started"]), 3600)
        out.print(
            f"process {run['pid']} on {escape(run['host'])} for {hours}:{rest // 60:02d} h: "
            f"{run['done']} of {run['todo']} done, {run['failed']} failed "
            f"({escape(run['message'])})"
        )
        for model in run["now"]:
            where = f"{model['stage']} {model['detail']}".strip()
            out.print(f"  {where} for {model['seconds']:.0f} s: {escape(model['name'])}")


class _Bar:
    """A progress bar: how far the sources are looked through, then the run.

    Attributes
    ----------
    is_planning : bool
        Whether the run has not begun yet.
    """

    def __init__(self, target: Console) -> None:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self.is_planning = True
        self.bar = Progress(
            TextColumn("{task.description}"),
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
        self.task = self.bar.add_task("plan", total=None, rate="", failed="")

    def __enter__(self) -> _Bar:
        self.bar.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self.bar.stop()

    def tell(self, text: str, done: int, total: int | None) -> None:
        """Show how far the sources are looked through."""
        from rich.markup import escape

        self.bar.update(self.task, total=total, completed=done, rate=escape(text))

    def warn(self, text: str) -> None:
        """Print a line that stays."""
        from rich.markup import escape

        self.bar.console.print(f"[yellow]{escape(text)}", soft_wrap=True)

    def update(self, plan: Plan, summary: Summary) -> None:
        """Show where the run stands."""
        if self.is_planning:  # its clock starts now
            self.is_planning = False
            self.bar.reset(self.task, total=len(plan.todo), description="ingest")
        done = summary.n_done
        elapsed = self.bar.tasks[0].elapsed or 0.0
        rate = f"{60 * done / elapsed:.0f}/min" if done and elapsed else ""
        failed = f"{summary.n_fatal} failed" if summary.n_fatal else ""
        self.bar.update(self.task, completed=done, rate=rate, failed=failed)


def _report(out: Console, summary: Summary, lake: str) -> None:
    """Print what became of the inputs, and where to look next."""
    from rich.markup import escape

    plan = summary.plan
    if plan.unchanged:
        out.print(f"{_files(len(plan.unchanged))} in the lake already, unchanged")
    given_up = [item for item in plan.failed if item.model_id not in plan.redone]
    if given_up:
        out.print(
            f"{_files(len(given_up))} of them failed before; "
            "to try again, with other limits say, add --retry-failures"
        )
    left = [item for item in plan.changed if item.model_id not in plan.redone]
    if left:
        names = escape(", ".join(item.name for item in left[:_NAMED]))
        more = f" and {len(left) - _NAMED} more" if len(left) > _NAMED else ""
        out.print(
            f"[yellow]{_files(len(left))} not ingested: in the lake with other content "
            f"or settings ({names}{more}); to replace them add --replace"
        )
    if plan.unread:
        names = escape(", ".join(item.name for item in plan.unread[:_NAMED]))
        more = f" and {len(plan.unread) - _NAMED} more" if len(plan.unread) > _NAMED else ""
        out.print(
            f"[yellow]{_files(len(plan.unread))} cannot be read now, so the lake's models are "
            f"kept ({names}{more}): run the command again when they can be read"
        )
    if not plan.todo:
        out.print("nothing is new" if plan.inputs else "no CAD files found in the sources")
        return
    resumed = f" ({summary.n_resumed} of them before)" if summary.n_resumed else ""
    out.print(
        f"{_files(summary.n_done)} ingested{resumed} in {summary.seconds:.0f} s "
        f"({summary.cpu_seconds:.0f} s of CPU): {summary.n_models} models, "
        f"{summary.n_meshed} of them with mesh and ground truth; {summary.n_fatal} failed"
    )
    if summary.n_kept:
        out.print(
            f"[yellow]{_files(summary.n_kept)} could not be read, so the lake's models are kept: "
            "run the command again when they can be read"
        )
    if summary.stopped:
        out.print(
            f"[yellow]stopped with {len(plan.todo) - summary.n_done} left: "
            "the same command goes on from here"
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
