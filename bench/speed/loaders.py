"""Print how fast breplake's loaders are against others, on the same samples in the same run.

Run it as ``python -m breplake.bench.speed.loaders LAKE``. Point clouds with normals and a label
for each point are drawn from the lake's meshes and stored as a pack and in the format of each
peer that is installed; then each is read shuffled, every time in a fresh process. What counts is
the best of its numbers of workers and of all rounds; files are in the page cache of the system.
Libraries that are missing are skipped and named: the dependency group ``bench-loaders`` has them.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer

from breplake.bench.speed.cloud_peers import PEERS, Clouds, Peer, for_ever
from breplake.bench.speed.machine import machine
from breplake.errors import UsageError

__all__ = ["OURS", "Figure", "main", "measure", "table"]

OURS: Final = "breplake pack"
_DRAWN: Final = "breplake from meshes"
_SECONDS: Final = 5.0
"""Time after which a measurement ends with the batch at hand."""


@dataclass(frozen=True, slots=True)
class Figure:
    """What one process measured.

    Parameters
    ----------
    name : str
        Peer.
    workers : int
        Worker processes, or threads of breplake.
    first : float
        Seconds from the start of the process to the first batch.
    rate : float
        Samples a second after the first batch.
    """

    name: str
    workers: int
    first: float
    rate: float


def _ours() -> dict[str, Peer]:
    """Return breplake's own two ways: reading a pack, and drawing from the lake's meshes."""

    def pack(folder: Path, batch_size: int, workers: int) -> Iterator[tuple[Any, Any]]:
        from breplake.loaders import Loader, PackedClouds

        for batch in for_ever(Loader(PackedClouds(folder), batch_size, threads=workers)):
            yield batch.positions, batch.types

    def drawn(folder: Path, batch_size: int, workers: int) -> Iterator[tuple[Any, Any]]:
        from breplake.loaders import Loader, MeshDataset, PackedClouds

        n = PackedClouds(folder).n
        lake = (folder.parent / "lake.txt").read_text()
        for batch in for_ever(Loader(MeshDataset(lake).points(n), batch_size, workers=workers)):
            yield batch.positions, batch.types

    def written(clouds: Clouds, folder: Path) -> None:
        """Nothing: the pack is what the clouds were read from."""

    return {
        OURS: Peer("breplake", written, pack, note="full shuffle, threads for workers"),
        _DRAWN: Peer("breplake", written, drawn, note="full shuffle, new points in each epoch"),
    }


def measure(
    batches: Callable[[], Iterator[tuple[Any, Any]]], begin: float, seconds: float = _SECONDS
) -> tuple[float, float]:
    """Return seconds from `begin` to the first batch, and samples a second after it.

    Epochs follow each other until `seconds` are over.
    """
    running = batches()
    next(running)
    start = time.time()
    count = 0
    for points, _ in running:
        count += len(points)
        if time.time() - start >= seconds:
            break
    return start - begin, count / (time.time() - start)


def _in_fresh_process(name: str, folder: Path, batch_size: int, workers: int) -> Figure | str:
    """Measure in a process of its own; return what went wrong if something did."""
    command = [sys.executable, "-m", __spec__.name, "--child", name, str(workers)]
    command += ["--batch-size", str(batch_size), str(folder)]
    begin = time.time()
    try:
        done = subprocess.run(
            [*command, "--begin", str(begin)], capture_output=True, text=True, timeout=300
        )
    except subprocess.TimeoutExpired:
        return "took longer than 300 s"
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        return (done.stderr.strip().splitlines() or ["no output"])[-1][:200]
    first, rate = json.loads(lines[-1])
    return Figure(name, workers, first, rate)


def table(figures: list[Figure]) -> list[str]:
    """Return the best figures of each peer, with ratios to breplake's pack, a line each."""
    best: dict[str, Figure] = {}
    for figure in figures:
        kept = best.get(figure.name)
        first = min(figure.first, kept.first) if kept else figure.first
        fast = figure if kept is None or figure.rate > kept.rate else kept
        best[figure.name] = Figure(fast.name, fast.workers, first, fast.rate)
    ours = best[OURS].rate if OURS in best else float("nan")
    lines = [f"{'':<22}{'samples/s':>11}{'pack is':>10}{'first batch':>13}{'workers':>9}"]
    for figure in sorted(best.values(), key=lambda f: -f.rate):
        ratio = f"{ours / figure.rate:.2f} x"
        lines.append(
            f"{figure.name:<22}{figure.rate:>11,.0f}{ratio:>10}{figure.first:>11.2f} s"
            f"{figure.workers:>9}"
        )
    return lines


def _prepare(lake: Path, folder: Path, samples: int, points: int) -> Clouds:
    """Draw the clouds, as the pack in `folder`, and return them."""
    from breplake.loaders import MeshDataset, PackedClouds, write_pack

    meshes = MeshDataset(lake)
    dataset = meshes.points(points, per_model=-(-samples // len(meshes)))
    write_pack(dataset, folder, ("normals", "types"))
    (folder.parent / "lake.txt").write_text(str(lake.resolve()))
    packed = PackedClouds(folder)
    whole = packed.batch(np.arange(len(packed)), 0)
    assert whole.normals is not None and whole.types is not None  # noqa: PT018  # they were asked for
    both = np.concatenate([whole.positions.numpy(), whole.normals.numpy()], axis=2)
    return Clouds(both, whole.types.numpy())


def _compare(
    lake: Path,
    work: Path,
    samples: int,
    points: int,
    batch_size: int,
    rounds: int,
    only: list[str] | None,
) -> None:
    peers = {**_ours(), **PEERS}
    if strange := set(only or ()) - peers.keys():
        raise UsageError(f"there is no peer {min(strange)!r}: there are {', '.join(peers)}")
    clouds = _prepare(lake, work / "pack", samples, points)
    size = (clouds.points.nbytes + clouds.labels.nbytes) / 1e6
    print(f"{len(clouds):,} clouds of {points} points, {size:,.0f} MB; batches of {batch_size}")
    print(machine("breplake", "torch", "numpy"))
    places = {name: work / "pack" for name in _ours() if not only or name in only}
    for name, peer in PEERS.items():
        if only and name not in only:
            continue
        if not peer.is_there:
            print(f"skipped {name}: not installed (pip install {name})")
            continue
        places[name] = work / name
        places[name].mkdir()
        peer.write(clouds, places[name])
    figures: list[Figure] = []
    for _ in range(rounds):  # peers take turns, so that a slow minute hits all of them
        for name, place in places.items():
            for workers in peers[name].workers:
                found = _in_fresh_process(name, place, batch_size, workers)
                if isinstance(found, Figure):
                    figures.append(found)
                    said = f"{name}, {workers} workers: {found.rate:,.0f}/s, {found.first:.2f} s"
                    print(said, file=sys.stderr, flush=True)
                else:
                    print(f"{name} with {workers} workers: {found}")
    print("\n".join(table(figures)))
    for name in places:
        print(f"    {name}: {peers[name].note}")


def main(
    lake: Annotated[Path, typer.Argument(help="Lake with meshes.", metavar="LAKE")],
    samples: Annotated[int, typer.Option(min=1, help="Clouds to store.")] = 8192,
    points: Annotated[int, typer.Option(min=1, help="Points of a cloud.")] = 2048,
    batch_size: Annotated[int, typer.Option(min=1, help="Clouds in a batch.")] = 64,
    rounds: Annotated[int, typer.Option(min=1, help="How often to measure each.")] = 3,
    only: Annotated[list[str] | None, typer.Option(help="Measure this one alone.")] = None,
    folder: Annotated[Path | None, typer.Option(help="Where to write; temporary.")] = None,
    child: Annotated[tuple[str, int] | None, typer.Option(hidden=True)] = None,
    begin: Annotated[float, typer.Option(hidden=True)] = 0.0,
) -> None:
    """Measure the loaders."""
    if child is not None:
        name, workers = child
        peer = {**_ours(), **PEERS}[name]
        print(json.dumps(measure(lambda: peer.batches(lake, batch_size, workers), begin)))
        return
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        _compare(lake, Path(temporary), samples, points, batch_size, rounds, only)


if __name__ == "__main__":
    typer.run(main)
