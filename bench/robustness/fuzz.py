"""Ingest broken files and prove that every one is accounted for.

Run it as ``python -m breplake.bench.robustness.fuzz FOLDER``. From the STEP files in the folder
it makes mutants with all kinds of faults, adds a model that takes longer than the time limit and
a small file that unpacks to more entities than the memory limit allows, ingests them all, and
prints what became of them. It ends with an error if a file is lost or counted twice, a kill is
not attributed to a stage, or a process or a temporary file is left behind.
"""

from __future__ import annotations

import gzip
import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import typer

import breplake
from breplake.bench.robustness.mutations import FAULTS, mutated

__all__ = ["account", "main", "run_ingest", "write_bomb", "write_mutants"]

KILLS: Final = ("timeout", "mesh-hang", "memory", "killed-signal", "worker-died")
GRACE: Final = 5.0
"""Seconds that helpers of a run may take to notice its end."""
STAGES: Final = ("read", "load", "brep", "mesh", "truth", "write", "import")


def write_mutants(folder: Path, sources: Sequence[Path], count: int) -> None:
    """Write `count` mutants of STEP files, sources and faults in turn."""
    pairs = zip(itertools.cycle(sources), itertools.cycle(FAULTS), range(count), strict=False)
    for source, fault, number in pairs:
        data = mutated(source.read_bytes(), fault, number // len(FAULTS))
        (folder / f"{number:04}_{fault}.step").write_bytes(data)


def write_bomb(path: Path, megabytes: int) -> None:
    """Write a small ``.step.gz`` that unpacks to so much text, every line of it an entity."""
    line = b"#%d=CARTESIAN_POINT('',(0.,1.,2.));\n"
    chunk = 10_000
    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(b"ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n")
        file.write(b"FILE_NAME('','',(''),(''),'','','');\n")
        file.write(b"FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\nDATA;\n")
        for first in range(1, megabytes * 2**20 // 42, chunk):
            file.write(b"".join(line % i for i in range(first, first + chunk)))
        file.write(b"ENDSEC;\nEND-ISO-10303-21;\n")


def run_ingest(folder: Path, lake: Path, scratch: Path, *options: str) -> list[str]:
    """Run ``breplake ingest`` in a session of its own, return what it left behind.

    Parameters
    ----------
    folder, lake : Path
        What to ingest, and where to.
    scratch : Path
        Empty folder for its temporary files.
    options : str
        More options.

    Returns
    -------
    list of str
        Processes, temporary files and folders that should be gone.

    Raises
    ------
    subprocess.CalledProcessError
        If it ends with an exit code other than 0.
    """
    command = [sys.executable, "-m", "breplake", "ingest", str(folder), "--lake", str(lake)]
    environment = {**os.environ, "TMPDIR": str(scratch), "PYTHONSAFEPATH": "1"}
    process = subprocess.Popen([*command, *options], env=environment, start_new_session=True)
    if code := process.wait():
        raise subprocess.CalledProcessError(code, command)
    end = time.monotonic() + GRACE
    while (alive := _session(process.pid)) and time.monotonic() < end:
        time.sleep(0.1)
    left = [f"process {number}" for number in alive]
    left += [str(path) for path in scratch.iterdir()]
    return left + [str(path) for path in [lake / "work"] if path.exists()]


def _session(leader: int) -> list[int]:
    """Return the living processes of a session (Linux)."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(session) == leader and state not in "ZX":
            found.append(int(stat.parent.name))
    return found


def account(lake: breplake.Lake, folder: Path) -> list[str]:
    """Return what is wrong with a lake as an account of a folder, a line each."""
    query = "SELECT path FROM models UNION ALL SELECT path FROM failures WHERE fatal"
    rows = Counter(Path(path).name for (path,) in lake.sql(query).fetchall())
    files = Counter(path.name for path in folder.iterdir())
    wrong = [f"{name} is in no table" for name in files - rows]
    wrong += [f"{name} is in the tables more than once" for name in rows - files]
    failures = lake.sql("SELECT name, kind, stage, seconds, message FROM failures").fetchall()
    for name, kind, stage, seconds, message in failures:
        if not message:
            wrong.append(f"{name}: {kind} without a message")
        if kind in KILLS and not (stage in STAGES and seconds > 0):
            wrong.append(f"{name}: {kind} in stage {stage!r} after {seconds} s")
    return wrong + [f"verify: {fault}" for fault in lake.store.verify(lake.snapshot)]


def _outcomes(lake: breplake.Lake) -> list[str]:
    """Return what became of the files, by fault."""
    query = r"""
        WITH inputs AS (
            SELECT name, coalesce('model, mesh ' || mesh_kind, 'model, no mesh') AS became
            FROM models
            UNION ALL SELECT name, kind FROM failures WHERE fatal
        )
        SELECT regexp_extract(name, '[a-z]+$') AS fault, became, count(*) FROM inputs
        GROUP BY ALL ORDER BY ALL
    """
    table: dict[str, list[str]] = {}
    for fault, became, count in lake.sql(query).fetchall():
        table.setdefault(fault, []).append(f"{count} {became}")
    killed = f"""
        SELECT kind, stage, count(*) FROM failures WHERE kind IN {KILLS} GROUP BY ALL ORDER BY ALL
    """
    kills = lake.sql(killed).fetchall()
    lines = [f"{fault:<12} {', '.join(became)}" for fault, became in table.items()]
    return lines + [f"killed: {count} {kind} in stage {stage}" for kind, stage, count in kills]


def main(
    folder: Annotated[Path, typer.Argument(help="STEP files to break.")],
    files: Annotated[int, typer.Option(help="How many of them to break, the smallest.")] = 50,
    mutants: Annotated[int, typer.Option(help="Broken files to make.")] = 500,
    hang: Annotated[Path | None, typer.Option(help="A file beyond the time limit.")] = None,
    timeout: Annotated[int, typer.Option(help="Seconds for each file.")] = 60,
    bomb: Annotated[int, typer.Option(help="MB that a file unpacks to; 0: none.")] = 400,
) -> None:
    """Ingest broken files and prove that every one is accounted for."""
    found = [path for path in folder.rglob("*") if path.suffix.lower() in (".step", ".stp")]
    found = [path for path in found if path.stat().st_size > 5000]
    sources = sorted(found, key=lambda path: (path.stat().st_size, path))[: 4 * files : 4]
    with tempfile.TemporaryDirectory() as place:
        inputs, scratch, lake = (Path(place) / name for name in ("in", "scratch", "lake"))
        inputs.mkdir()
        scratch.mkdir()
        write_mutants(inputs, sources, mutants)
        if hang is not None:
            (inputs / "hang.step").symlink_to(hang.resolve())
        if bomb:
            write_bomb(inputs / "bomb.step.gz", bomb)
        options = ("--max-edge", "0.05", "--timeout", str(timeout), "--memory", "1")
        wrong = run_ingest(inputs, lake, scratch, *options)
        opened = breplake.open(lake)
        wrong += account(opened, inputs)
        lines: list[Any] = [*_outcomes(opened), f"{len(list(inputs.iterdir()))} files"]
    print("\n".join([*lines, *(wrong or ["all accounted for, nothing left behind"])]))
    raise typer.Exit(code=bool(wrong))


if __name__ == "__main__":
    typer.run(main)
