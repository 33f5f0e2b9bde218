"""Print how fast full meshes with labels are read, against the files of the ABC dataset.

Run it as ``python -m breplake.bench.speed.meshes LAKE``. Models are exported as ABC's OBJ and YAML
files; then both sides read vertices, normals, curvatures, triangles, patch labels and types. OBJ
files are parsed by breplake's own reader, whole columns at a time, and YAML files by libyaml
(``CSafeLoader``), the fastest there is; both in this one process, without workers.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import breplake
from breplake.bench.speed.machine import machine
from breplake.errors import MissingExtraError
from breplake.ingest.abc.obj import read_obj
from breplake.queries.abc.export import export

__all__ = ["main", "read_abc", "read_lake"]


def read_abc(folder: Path) -> Iterator[int]:
    """Read every model of a folder; yield its triangles."""
    try:
        import yaml  # type: ignore[import-untyped]  # there are stubs, but not in this environment
    except ImportError as error:
        raise MissingExtraError("bench", "reading YAML") from error
    loader: Any = yaml.CSafeLoader
    for path in sorted(folder.glob("*_trimesh_*.obj")):
        mesh = read_obj(path)
        features = path.with_name(path.name.replace("_trimesh_", "_features_")).with_suffix(".yml")
        labels = yaml.load(features.read_bytes(), loader)
        patch = np.empty(len(mesh.triangles), np.int64)
        for number, surface in enumerate(labels["surfaces"]):
            patch[surface["face_indices"]] = number
        yield len(mesh.triangles)


def read_lake(lake: breplake.Lake, ids: list[int]) -> Iterator[int]:
    """Read the same models with their labels from the lake; yield their triangles."""
    from breplake.loaders import LabelledMeshDataset, MeshDataset

    chosen = ", ".join(map(str, ids))
    meshes = MeshDataset(lake, where=f"model_id IN ({chosen})")
    labelled = LabelledMeshDataset(meshes)
    for index in range(len(meshes)):
        sample = labelled[index]
        meshes.read("curvature", index)
        yield len(sample.triangles)


def _timed(read: Callable[[], Iterator[int]]) -> tuple[float, list[int]]:
    start = time.perf_counter()
    triangles = list(read())
    return time.perf_counter() - start, triangles


def main(
    lake: Annotated[Path, typer.Argument(help="Lake with meshes.", metavar="LAKE")],
    models: Annotated[int, typer.Option(min=1, help="How many models, at random.")] = 20,
    where: Annotated[str, typer.Option(help="SQL condition on models.")] = "true",
    rounds: Annotated[int, typer.Option(min=1, help="The best of so many counts.")] = 3,
) -> None:
    """Measure reading of full meshes."""
    opened = breplake.open(lake)
    chosen = f"n_faces > 0 AND ({where}\n)"
    query = f"SELECT model_id FROM models WHERE {chosen} ORDER BY hash(model_id) LIMIT ?"
    ids = [identity for (identity,) in opened.sql(query, [models]).fetchall()]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        export(opened, ids, folder, decimals=6)
        size = sum(path.stat().st_size for path in folder.iterdir())
        theirs = [_timed(lambda: read_abc(folder)) for _ in range(rounds)]
    ours = [_timed(lambda: read_lake(opened, ids)) for _ in range(rounds)]
    assert sorted(ours[0][1]) == sorted(theirs[0][1]), "both sides read the same triangles"
    abc, mine = min(seconds for seconds, _ in theirs), min(seconds for seconds, _ in ours)
    print(machine("breplake", "numpy", "torch", "pyyaml"))
    total = sum(ours[0][1])
    print(f"{len(ids)} models, {total:,} triangles, {size / 1e6:,.0f} MB of OBJ and YAML")
    print(f"ABC's OBJ and YAML   {len(ids) / abc:10.2f} models/s")
    print(f"breplake             {len(ids) / mine:10.2f} models/s, {abc / mine:.0f} times as many")


if __name__ == "__main__":
    typer.run(main)
