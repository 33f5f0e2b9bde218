"""Print what ABC's files cost and what a lake of the same models costs, in time and in bytes.

Run it as ``python -m breplake.bench.speed.formats SOURCE``, SOURCE being a lake, whose models are
exported first, or a folder of ABC's OBJ and features files, which are imported first; neither is
measured. Two questions are put to both: the mesh of one model with its patch labels, and the
number of tori among the patches of all models. YAML is read by libyaml (``CSafeLoader``), OBJ by
breplake's own reader, whole columns at a time. Bytes are those that the process read, from the
page cache too, which is where all files are.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

import breplake
from breplake.bench.speed.machine import machine
from breplake.bench.speed.meshes import read_abc, read_lake
from breplake.errors import MissingExtraError, UsageError
from breplake.queries.abc.export import export
from breplake.schema.abc import file_name

__all__ = ["main"]

_IO = Path("/proc/self/io")


def _bytes_read() -> int:
    """Return how many bytes this process has read so far; 0 where no system tells."""
    lines = _IO.read_text(encoding="ascii").splitlines() if _IO.exists() else []
    return next((int(line.split()[1]) for line in lines if line.startswith("rchar")), 0)


def _measured(question: Callable[[], int], rounds: int) -> tuple[int, float, int]:
    """Return the answer, the seconds of the best round and the bytes of the last.

    The first round is not counted: it loads libraries.
    """
    answer, best, read = question(), float("inf"), 0
    for _ in range(rounds):
        before, start = _bytes_read(), time.perf_counter()
        again = question()
        best = min(best, time.perf_counter() - start)
        read = _bytes_read() - before
        if again != answer:
            raise RuntimeError(f"one question was answered with {answer} and {again}")
    return answer, best, read


def _count_tori(folder: Path) -> int:
    try:
        import yaml  # type: ignore[import-untyped]  # there are stubs, but not in this environment
    except ImportError as error:
        raise MissingExtraError("bench", "reading YAML") from error
    loader: Any = yaml.CSafeLoader
    return sum(
        surface["type"] == "Torus"
        for path in sorted(folder.glob("*_features_*.yml"))
        for surface in yaml.load(path.read_bytes(), loader)["surfaces"]
    )


def _imported(source: Path, folder: Path) -> Path:
    """Return a lake of the models of a folder that have both files."""
    from breplake.ingest.run import ingest

    files = folder / "files"
    files.mkdir()
    for mesh in sorted(source.glob("*_trimesh_*.obj")):
        features = mesh.name.replace("_trimesh_", "_features_").removesuffix(".obj") + ".yml"
        if (source / features).exists():
            for name in (mesh.name, features):
                (files / name).symlink_to((source / name).resolve())
    done = ingest([files], folder / "lake", collection="abc", jobs=1)
    if not done.n_models or done.n_fatal:
        raise UsageError(f"{source} must hold OBJ and features files that can be imported")
    return files


def _print(what: str, theirs: tuple[int, float, int], ours: tuple[int, float, int]) -> None:
    if theirs[0] != ours[0]:
        raise RuntimeError(f"{what}: {theirs[0]} in ABC's files, {ours[0]} in the lake")
    print(f"{what}: {theirs[0]:,}")
    for side, (_, seconds, read) in (("ABC's files", theirs), ("breplake", ours)):
        print(f"  {side:<12}{seconds * 1e3:10.1f} ms{read / 1e6:10.2f} MB")
    print(f"  ratio       {theirs[1] / ours[1]:10.0f}   {theirs[2] / max(ours[2], 1):10.0f}")


def main(
    source: Annotated[Path, typer.Argument(help="Lake, or folder of ABC's files.")],
    models: Annotated[int, typer.Option(min=1, help="How many of a lake, at random.")] = 20,
    where: Annotated[str, typer.Option(help="SQL condition on models of a lake.")] = "true",
    rounds: Annotated[int, typer.Option(min=1, help="The best of so many counts.")] = 3,
) -> None:
    """Measure both formats on the same models."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if (source / "breplake.json").exists():
            path, files = source, folder / "files"
        else:
            files, path = _imported(source, folder), folder / "lake"
        lake = breplake.open(path)
        query = f"SELECT model_id, name FROM models WHERE n_faces > 0 AND ({where}\n) "
        rows = lake.sql(query + "ORDER BY hash(model_id) LIMIT ?", [models]).fetchall()
        if path == source:
            export(lake, [identity for identity, _ in rows], files, decimals=6)
        ids, (first, name) = ", ".join(str(row[0]) for row in rows), rows[0]
        one = folder / "one"
        one.mkdir()
        for kind in ("trimesh", "features"):
            (one / file_name(name, kind)).symlink_to(files / file_name(name, kind))
        tori = f"SELECT count(*) FROM patches WHERE type = 'Torus' AND model_id IN ({ids})"

        def count() -> int:
            return int(breplake.open(path).sql(tori).fetchall()[0][0])

        print(machine("breplake", "numpy", "duckdb", "pyyaml"))
        print(f"{len(rows)} models")
        _print(
            f"triangles of {name}, with labels",
            _measured(lambda: sum(read_abc(one)), rounds),
            _measured(lambda: sum(read_lake(breplake.open(path), [first])), rounds),
        )
        _print(
            "tori in all models",
            _measured(lambda: _count_tori(files), rounds),
            _measured(count, rounds),
        )


if __name__ == "__main__":
    typer.run(main)
