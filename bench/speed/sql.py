"""Print what SQL costs on a lake of a million models, against polars, SQLite and YAML.

Run it as ``python -m breplake.bench.speed.sql LAKE --work DIR``. It makes a lake of 1,000,000
models and 30,000,000 patches with the distributions of LAKE in DIR (about 2.5 GB, and 4 GB for
SQLite; both are kept and used again), and asks six questions cold (a fresh process, the files out
of the page cache; opening the lake included) and warm (the median of repeated questions in one
session). It compares with reading the touched columns once, with the peers, and with what it would
take to parse the paper's YAML files, a model each.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Annotated, Any, Final

import typer

import breplake
from breplake.bench.speed.machine import machine
from breplake.bench.speed.sql_lake import make_lake
from breplake.bench.speed.sql_peers import QUESTIONS, Question, Rows, make_sqlite, peers, scan

__all__ = ["main"]

_PEERS: Final = ("breplake", "polars", "sqlite")


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _same(one: Rows, two: Rows) -> bool:
    """Compare answers; sums may differ in their last digits."""

    def near(a: object, b: object) -> bool:
        if isinstance(a, float) or isinstance(b, float):
            return math.isclose(float(a), float(b), rel_tol=1e-6)  # type: ignore[arg-type]  # numbers
        return a == b

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
    command = [sys.executable, "-m", __spec__.name if __spec__ else "breplake.bench.speed.sql"]
    asked = ["--ask", json.dumps([str(lake), str(database), identity, peer, number])]
    done = subprocess.run([*command, str(lake), *asked], capture_output=True, text=True, check=True)
    return float(done.stdout)


def _ask(place: str, database: str, identity: int, peer: str, number: int) -> None:
    """Be that process."""
    import duckdb  # noqa: F401  # loading a library is no part of a question
    import polars as pl  # noqa: F401

    start = time.perf_counter()
    peers(breplake.open(place), Path(database), identity)[peer](QUESTIONS[number])
    print(time.perf_counter() - start)


def _warm(run: Callable[[], object], repeat: int) -> float:
    run()
    return median(_seconds(run) for _ in range(repeat))


def _measure(
    lake: breplake.Lake, database: Path, identity: int, repeat: int
) -> Iterator[tuple[Question, dict[str, float]]]:
    """Yield the seconds of each question: ``scan``, and each peer warm and cold."""
    asked = peers(lake, database, identity)
    for number, question in enumerate(QUESTIONS):
        answers = {peer: asked[peer](question) for peer in _PEERS}
        for peer in _PEERS[1:]:
            if not _same(answers["breplake"], answers[peer]):
                raise RuntimeError(f"{peer} answers {question.name!r} in another way")
        # so slow peers are asked once more, not many times
        seconds = {"scan": _warm(lambda question=question: scan(lake, question), min(repeat, 3))}
        for peer in _PEERS:
            first = _seconds(lambda peer=peer, question=question: asked[peer](question))
            times = repeat if first < 2 else 1
            seconds[peer] = _warm(lambda peer=peer, question=question: asked[peer](question), times)
            seconds[f"{peer} cold"] = _cold(lake.root, database, identity, peer, number)
        yield question, seconds


def _yaml(files: list[Path]) -> tuple[float, str]:
    """Return the mean seconds to parse one of the paper's files, and with what."""
    import yaml

    loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    spent = 0.0
    for path in files:
        text = path.read_text(encoding="utf-8")
        spent += _seconds(lambda text=text: yaml.load(text, loader))
    return spent / len(files), loader.__name__


def _report(lake: breplake.Lake, rows: list[tuple[Question, dict[str, float]]]) -> Iterator[str]:
    count = lake.sql("SELECT count(*), sum(n_patches) FROM models").fetchall()[0]
    yield machine("duckdb", "polars", "pyarrow")
    yield f"{count[0]:,} models, {count[1]:,} patches, {len(lake.files('models')):,} shards"
    yield "milliseconds; x: how many times longer than breplake"
    head = ("", "scan", "breplake", "polars", "x", "SQLite", "x")
    yield "{:<34}{:>8}{:>10}{:>10}{:>7}{:>10}{:>8}".format(*head)
    for state in ("", " cold"):
        for question, seconds in rows:
            ours = seconds[f"breplake{state}"]
            cells = f"{1e3 * seconds['scan']:8.0f}" if not state else " " * 8
            cells += f"{1e3 * ours:10.0f}"
            for peer, width in (("polars", 7), ("sqlite", 8)):
                theirs = seconds[f"{peer}{state}"]
                cells += f"{1e3 * theirs:10.0f}{theirs / ours:{width}.1f}"
            yield f"{question.name + state:<34}{cells}"
    question, seconds = rows[0]
    ours, read = seconds["breplake"], seconds["scan"]
    yield (
        f"{question.name}, warm: {1e3 * ours:.0f} ms (target 100), "
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
    lake = breplake.open(place)
    if not database.exists():
        part = database.with_suffix(".part")
        make_sqlite(lake, part)
        part.rename(database)
    middle = lake.sql("SELECT model_id FROM models ORDER BY model_id LIMIT 1").fetchall()[0][0]
    rows = list(_measure(lake, database, middle, repeat))
    for line in _report(lake, rows):
        print(line)
    if yaml is not None and (files := sorted(yaml.glob("*features*.yml"))):
        each, loader = _yaml(files)
        total = each * lake.sql("SELECT count(*) FROM models").fetchall()[0][0]
        print(
            f"YAML ({loader}, {len(files)} files): {each:.1f} s a model, so {total / 86400:.0f} "
            f"days for all; {total / rows[0][1]['breplake']:,.0f} times longer"
        )


def _tell(done: int) -> None:
    print(f"\r{done:,} models", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    typer.run(main)
