"""Print what the element size asked of Gmsh costs, at equal longest edges.

Run it as ``python -m breplake.bench.speed.mesh_size FOLDER``. Gmsh treats the size as a target;
edges beyond the limit are split afterwards. A smaller size leaves less to split, which is
better for the angles, but makes more vertices. All meshes honour the same limit.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import numpy as np
import typer

from breplake.errors import InputError
from breplake.ingest.brep import Brep, extract
from breplake.ingest.canonical import canonical
from breplake.ingest.inputs import find_inputs
from breplake.ingest.kernel import GmshModel, gmsh_session
from breplake.ingest.load import load
from breplake.ingest.meshing import SIZE, gmsh_mesh
from breplake.ingest.quality import measure
from breplake.ingest.refine import refine, surface_periods
from breplake.ingest.settings import Settings

__all__ = ["SIZES", "main"]

SIZES: Final = (1.0, 1 / 1.05, SIZE, 1 / 1.2, 1 / 1.4)
"""Element sizes to compare, in limits."""


@dataclass(frozen=True, slots=True)
class _Cost:
    """What one size costs on one model."""

    vertices: int
    regular: float
    min_angle: float
    seconds: float


def _try(brep: Brep, size: float, limit: float) -> _Cost:
    settings = Settings()
    with gmsh_session() as gmsh, tempfile.TemporaryDirectory() as folder:
        model = GmshModel(gmsh, brep, Path(folder))
        start = time.process_time()
        mesh = gmsh_mesh(model, limit, settings, "uniform", size)
        mesh = refine(mesh, model, surface_periods(brep), limit, settings.max_triangles)
        seconds = time.process_time() - start
    quality = measure(mesh.points, mesh.triangles)
    return _Cost(len(mesh.points), quality.regular_angles, quality.min_angle, seconds)


def main(
    folder: Annotated[Path, typer.Argument(help="CAD files to mesh.", metavar="FOLDER")],
    models: Annotated[int, typer.Option(help="How many of them, evenly spread.")] = 20,
) -> None:
    """Compare element sizes."""
    inputs = find_inputs([folder])
    chosen = inputs[:: max(1, len(inputs) // models)]
    rows: list[list[_Cost]] = []
    for item in chosen:
        try:
            document = load(item.path, item.format)
            brep = extract(canonical(document.shapes), document.labels)
            limit = Settings().max_edge * brep.diagonal
            rows.append([_try(brep, size, limit) for size in SIZES])
        except InputError as error:
            print(f"left out {item.name}: {error}")
    print(f"{len(rows)} models; vertices and CPU relative to the size used, {SIZE:.3f} limits")
    print(f"{'size':>8}{'vertices':>10}{'CPU':>8}{'30-90 deg':>11}{'min angle':>11}")
    used = SIZES.index(SIZE)
    for i, size in enumerate(SIZES):
        vertices = np.median([row[i].vertices / row[used].vertices for row in rows])
        seconds = np.median([row[i].seconds / row[used].seconds for row in rows])
        regular = np.mean([row[i].regular for row in rows])
        angle = np.degrees(np.median([row[i].min_angle for row in rows]))
        print(f"{size:8.3f}{vertices:10.2f}{seconds:8.2f}{regular:11.4f}{angle:10.1f}°")


if __name__ == "__main__":
    typer.run(main)
