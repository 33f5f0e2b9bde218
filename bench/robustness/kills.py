"""Kill an ingest at random moments and prove that nothing shows of it in the lake.

Run it as ``python -m breplake.bench.robustness.kills FOLDER``. It ingests files of the folder
without disturbance, then again while the whole process group is killed (SIGKILL) at random
moments and started once more, in as many lakes as it takes. It ends with an error if a lake's
tables differ from those of the undisturbed run in anything but timings, if a file of it is
damaged, or if ``breplake gc`` leaves an orphan or removes more than those.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Annotated, Final

import polars as pl
import typer

import breplake
from breplake.schema.gc import collect
from breplake.schema.lake import LakeStore
from breplake.schema.snapshot import ARRAYS_TABLE
from breplake.schema.tables import TABLES

__all__ = ["contents", "differences", "disturbed", "main", "orphans"]

TIMINGS: Final = ("seconds", "peak_memory")
"""Columns that a clock fills, beside those named ``cpu_...``."""


def contents(lake: Path) -> dict[str, pl.DataFrame]:
    """Return a lake's tables without timings, by name."""
    opened = breplake.open(lake)
    found = {}
    for name, table in TABLES.items():
        frame = opened.scan(name).collect()
        timed = [c for c in frame.columns if c in TIMINGS or c.startswith("cpu_")]
        found[name] = frame.drop(timed).sort(table.key)
    return found


def differences(lake: Path, whole: dict[str, pl.DataFrame]) -> list[str]:
    """Return what is wrong with a lake that ought to hold `whole`, a line each."""
    found = contents(lake)
    wrong = [f"{lake.name}: {name} differ" for name in whole if not found[name].equals(whole[name])]
    opened = breplake.open(lake)
    wrong += [f"{lake.name}: {fault}" for fault in opened.store.verify(opened.snapshot)]
    return wrong + [f"{lake.name}: {fault}" for fault in orphans(lake)]


def orphans(lake: Path) -> list[str]:
    """Collect garbage in a lake of which all snapshots are kept; return what went wrong."""
    store = LakeStore.open(lake)
    named = {entry.path for number in store.numbers() for entry in store.snapshot(number).files}
    collect(store, grace=timedelta(0))
    arrays = tuple(path for path in named if path.endswith(".zarr"))  # and their hashes beside
    files = {p.relative_to(lake).as_posix() for p in lake.rglob("*") if p.is_file()}
    files = {p for p in files if p.startswith(("tables/", f"{ARRAYS_TABLE}/"))}
    known = {p for p in files if p in named or p.startswith(arrays)}
    lost = {p for p in named if not (lake / p).exists()}
    return [f"gc left {path}" for path in sorted(files - known)] + [
        f"gc removed {path}" for path in sorted(lost)
    ]


def _start(files: Sequence[Path], lake: Path, options: Sequence[str]) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "breplake", "ingest", *map(str, files), "--lake", str(lake)]
    environment = {**os.environ, "PYTHONSAFEPATH": "1"}
    return subprocess.Popen(
        [*command, "--collection", "killed", *options],
        env=environment,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def disturbed(
    files: Sequence[Path],
    lake: Path,
    *,
    kills: int,
    longest: float,
    rng: random.Random,
    options: Sequence[str] = (),
) -> int:
    """Ingest files into a lake, killed at most so often; return how often it was.

    Parameters
    ----------
    files, lake : sequence of Path, Path
        What to ingest, and where to.
    kills : int
        Most kills; then the run is left alone.
    longest : float
        Seconds after which, at the latest, a run is killed.
    rng : random.Random
        Chooses the moments.
    options : sequence of str
        Of ``breplake ingest``.

    Raises
    ------
    subprocess.CalledProcessError
        If a run that was not killed failed.
    """
    done = 0
    while True:
        process = _start(files, lake, options)
        try:
            code = process.wait(rng.uniform(0, longest) if done < kills else None)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            done += 1
            continue
        if code:
            raise subprocess.CalledProcessError(code, process.args)
        return done


def main(
    folder: Annotated[Path, typer.Argument(help="STEP files to ingest.")],
    models: Annotated[int, typer.Option(help="How many of them.")] = 80,
    kills: Annotated[int, typer.Option(help="How often to kill the run.")] = 50,
    seed: Annotated[int, typer.Option(help="Chooses the moments.")] = 0,
    max_edge: Annotated[float, typer.Option(help="As of ``breplake ingest``.")] = 0.05,
    most_bytes: Annotated[int, typer.Option(help="Leave larger files out.")] = 200_000,
) -> None:
    """Kill an ingest at random moments and prove that nothing shows of it in the lake."""
    found = [path for path in folder.rglob("*") if path.suffix.lower() in (".step", ".stp")]
    small = sorted(path for path in found if path.stat().st_size <= most_bytes)
    files = small[:: max(1, len(small) // models)][:models]
    options = ("--max-edge", str(max_edge))
    rng = random.Random(seed)
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as place:
        began = time.monotonic()
        disturbed(files, Path(place) / "whole", kills=0, longest=0, rng=rng, options=options)
        seconds = time.monotonic() - began
        whole = contents(Path(place) / "whole")
        done = rounds = 0
        while done < kills:
            rounds += 1
            lake = Path(place) / f"lake{rounds}"
            left = kills - done
            done += disturbed(
                files, lake, kills=left, longest=seconds / 5, rng=rng, options=options
            )
            wrong += differences(lake, whole)
    rows = {name: len(frame) for name, frame in whole.items()}
    print(f"{len(files)} files, {rows['models']} models, {rows['failures']} failures")
    print(f"undisturbed run: {seconds:.0f} s; {done} kills in {rounds} lakes")
    print(
        "\n".join(wrong or ["tables equal, files whole, nothing left behind by gc or lost to it"])
    )
    raise typer.Exit(code=bool(wrong))


if __name__ == "__main__":
    typer.run(main)
