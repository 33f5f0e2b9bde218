"""Print what SQL costs on a lake of a million models, against polars, SQLite and YAML.

Run it as ``python -m breplake.bench.speed.sql LAKE --work DIR``. It makes a lake of 1,000,000
models and 30,000,000 patches with the distributions of LAKE in DIR, consolidates both tables, and
copies what is asked to SQLite (about 8 GB in all, kept and used again). It asks six questions warm
(the median of repeated questions in one session, wall and CPU time) and cold (a fresh process, the
files out of the page cache; opening the lake included). It compares with reading the touched
columns once, with the peers, with the lake before it was consolidated, and with what it would take
to parse the paper's YAML files, one for each model.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from statistics import median
from typing import Annotated, Any, Final

import typer

import breplake
from breplake.bench.speed.machine import machine
from breplake.bench.speed.sql_lake import make_lake
from breplake.bench.speed.sql_peers import QUESTIONS, Question, Rows, make_sqlite, peers, scan
from breplake.queries.consolidated import FOLDER, consolidate

__all__ = ["main"]

Times = dict[str, float]

_PEERS: Final = ("breplake", "polars", "sqlite")
_SLOW: Final = 3.0
"""Seconds from which on a question is asked twice in all."""


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _warm(name: str, run: Callable[[], object], repeat: int) -> Times:
    """Return the medians of `repeat` times after a first one; of the slow, of one.

    That is of wall time, and of the CPU time of all threads: what a busy machine cannot spoil.
    """
    first = _seconds(run)
    walls, cpus = [], []
    for _ in range(repeat if first < _SLOW else 1):
        start = time.process_time()
        walls.append(_seconds(run))
        cpus.append(time.process_time() - start)
    return {name: median(walls), f"{name} CPU": median(cpus)}


def _same(one: Rows, two: Rows) -> bool:
    """Compare answers; sums may differ in their last digits."""

    def near(a: Any, b: Any) -> bool:
        if isinstance(a, float) or isinstance(b, float):
            return math.isclose(a, b, rel_tol=1e-6)
        return bool(a == b)

    return len(one) == len(two) and all(
        len(x) == len(y) and all(map(near, x, y)) for x, y in zip(one, two, strict=True)
    )


def _evict(*places: Path) -> None:
    """Drop files from the page cache."""
    os.sync()
    for place in places:
        for path in [place] if place.is_file() else place.rglob("*"):
            if path.is_file():
                file = os.open(path, os.O_RDONLY)
                os.posix_fadvise(file, 0, 0, os.POSIX_FADV_DONTNEED)
                os.close(file)


def _cold(lake: Path, database: Path, identity: int, peer: str, number: int) -> float:
    """Ask once in a fresh process that finds no file in memory; seconds from opening on."""
    _evict(lake, database)
    command = [sys.executable, "-m", "breplake.bench.speed.sql", str(lake), "--ask"]
    asked = json.dumps([str(lake), str(database), identity, peer, number])
    done = subprocess.run([*command, asked], capture_output=True, text=True, check=True)
    return float(done.stdout)


def _ask(place: str, database: str, identity: int, peer: str, number: int) -> None:
    """Be that process."""
    import duckdb  # noqa: F401  # loading a library is no part of a question
    import polars as pl  # noqa: F401

    lake = None if peer == "breplake" else breplake.open(place)  # only ours has to open it
    start = time.perf_counter()
    peers(lake or breplake.open(place), Path(database), identity)[peer](QUESTIONS[number])
    print(time.perf_counter() - start)


@contextmanager
def _without_copies(lake: Path) -> Iterator[None]:
    """Put the consolidated copies out of the way of a session that is opened meanwhile."""
    away = lake / f"{FOLDER}.away"
    (lake / FOLDER).rename(away)
    try:
        yield
    finally:
        away.rename(lake / FOLDER)


def _measure(
    lake: breplake.Lake, database: Path, identity: int, repeat: int
) -> Iterator[tuple[Question, Times]]:
    """Yield the seconds of each question: ``scan``, ``shards``, and each peer warm and cold."""
    asked = peers(lake, database, identity)
    with _without_copies(lake.root):
        on_shards = peers(breplake.Lake(lake.root), None, identity)["breplake"]
        on_shards(QUESTIONS[0])
    for number, question in enumerate(QUESTIONS):
        answer = asked["breplake"](question)
        for peer in _PEERS[1:]:
            if not _same(answer, asked[peer](question)):
                raise RuntimeError(f"{peer} answers {question.name!r} in another way")
        times = _warm("scan", partial(scan, lake, question), repeat)
        times |= _warm("shards", partial(on_shards, question), repeat)
        for peer in _PEERS:
            times |= _warm(peer, partial(asked[peer], question), repeat)
            times[f"{peer} cold"] = _cold(lake.root, database, identity, peer, number)
        yield question, times


def _yaml(files: list[Path]) -> tuple[float, str]:
    """Return the mean seconds to parse one of the paper's files, and with what."""
    import yaml  # type: ignore[import-untyped]  # there are stubs, but not in this environment

    loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    texts = [path.read_text(encoding="utf-8") for path in files]
    spent = sum(_seconds(partial(yaml.load, text, loader)) for text in texts)
    return spent / len(files), loader.__name__


def _report(lake: breplake.Lake, rows: list[tuple[Question, Times]]) -> Iterator[str]:
    ((models, patches),) = lake.sql("SELECT count(*), sum(n_patches) FROM models").fetchall()
    yield machine("duckdb", "polars", "pyarrow")
    yield f"{models:,} models, {patches:,} patches, {len(lake.files('models')):,} shards"
    yield "milliseconds; x: how many times longer than breplake"
    head = ("", "scan", "on shards", "breplake", "polars", "x", "SQLite", "x")
    yield "{:<38}{:>8}{:>11}{:>10}{:>10}{:>7}{:>10}{:>8}".format(*head)
    for state in ("", " CPU", " cold"):
        for question, times in rows:
            ours = times[f"breplake{state}"]
            cells = "".join(
                f"{1e3 * times[name + state]:{width}.0f}" if name + state in times else " " * width
                for name, width in (("scan", 8), ("shards", 11), ("breplake", 10))
            )
            for peer, width in (("polars", 7), ("sqlite", 8)):
                theirs = times[f"{peer}{state}"]
                cells += f"{1e3 * theirs:10.0f}{theirs / ours:{width}.1f}"
            yield f"{question.name + state:<38}{cells}"
    question, times = rows[0]
    for state in (" CPU", ""):
        ours, read = times[f"breplake{state}"], times[f"scan{state}"]
        yield (
            f"{question.name}, warm{state}: {1e3 * ours:.0f} ms (target 100), "
            f"{ours / read:.2f} times reading the touched columns once (target 3)"
        )


def main(
    source: Annotated[Path, typer.Argument(help="A lake to take distributions from.")],
    work: Annotated[Path, typer.Option(help="Folder for the large lake.")] = Path("sql-bench"),
    models: Annotated[int, typer.Option(help="Models of the large lake.")] = 1_000_000,
    patches: Annotated[int, typer.Option(help="Patches of the large lake.")] = 30_000_000,
    repeat: Annotated[int, typer.Option(help="Times that a question is asked warm.")] = 7,
    yaml: Annotated[Path | None, typer.Option(help="Folder with the paper's YAML files.")] = None,
    ask: Annotated[str | None, typer.Option(hidden=True)] = None,
) -> None:
    """Measure what SQL costs."""
    if ask is not None:
        _ask(*json.loads(ask))
        return
    place, database = work / "lake", work / "lake.sqlite"
    if not place.exists():
        make_lake(breplake.open(source), place, models, patches, tell=_tell)
    consolidate(breplake.open(place), ("models", "patches"))
    lake = breplake.open(place)
    if not database.exists():
        part = database.with_suffix(".part")
        make_sqlite(lake, part)
        part.rename(database)
    ((identity,),) = lake.sql("SELECT max(model_id) FROM models").fetchall()
    rows = list(_measure(lake, database, identity, repeat))
    print("\n".join(_report(lake, rows)))
    if yaml is not None and (files := sorted(yaml.glob("*features*.yml"))):
        each, loader = _yaml(files)
        ((count,),) = lake.sql("SELECT count(*) FROM models").fetchall()
        ratio = each * count / rows[0][1]["breplake"]
        print(
            f"YAML ({loader}, {len(files)} files): {each:.2f} s a model, "
            f"{each * count / 86400:.0f} days for all: {ratio:,.0f} times longer"
        )


def _tell(done: int) -> None:
    print(f"\r{done:,} models", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    typer.run(main)
