"""Print what ingest costs, model by model and stage by stage.

Run it as ``python -m breplake.bench.speed.ingest FOLDER``. It ingests the folder at the
paper's setting (edges of 1 % of the bounding box diagonal) into a temporary lake, and prints
CPU seconds per model, the ratio to the paper's 63, and the share spent inside Open CASCADE
and Gmsh. ``--lake LAKE`` keeps the lake; a lake that holds the folder already is only read.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import numpy.typing as npt
import typer

import breplake

__all__ = ["PAPER_SECONDS", "main", "report"]

PAPER_SECONDS: Final = 63.0
"""CPU seconds per model of the paper: 2 CPU years for a million models (section 3.2)."""

_STAGES: Final = ("load", "brep", "mesh", "truth", "write")


def report(lake: breplake.Lake) -> list[str]:
    """Return the measured figures of a lake's ingest, a line each.

    Killed attempts count with their wall time, and inputs that failed for good count too.
    """
    models: Any = lake.sql("SELECT * FROM models ORDER BY model_id").to_arrow_table()
    killed, fatal, n_fatal = lake.sql(
        """
        SELECT coalesce(sum(seconds) FILTER (
                   kind IN ('timeout', 'mesh-hang', 'killed-signal', 'worker-died')), 0),
               coalesce(sum(seconds) FILTER (fatal), 0),
               count(*) FILTER (fatal)
        FROM failures
        """
    ).fetchall()[0]

    def column(name: str) -> npt.NDArray[np.float64]:
        values: npt.NDArray[np.float64] = models.column(name).to_numpy().astype(np.float64)
        return values

    total = column("cpu_total")
    if not len(total):
        return [f"{n_fatal} inputs, and no model among them"]
    n_inputs = len(total) + n_fatal
    mean = (total.sum() + fatal) / n_inputs
    lost = lake.sql(
        """
        SELECT coalesce(sum(f.seconds), 0) FROM failures f JOIN models m USING (model_id)
        WHERE f.kind IN ('timeout', 'mesh-hang', 'killed-signal', 'worker-died')
        """
    ).fetchall()[0][0]
    share = column("cpu_kernel").sum() / (total.sum() - lost)
    meshed = [kind is not None for kind in models.column("mesh_kind").to_pylist()]
    lines = [
        f"{n_inputs} inputs: {len(total)} models, {sum(meshed)} with mesh, {n_fatal} failed",
        f"{'CPU seconds':<12}{'median':>10}{'mean':>10}{'p95':>10}{'max':>10}",
    ]
    for name, values in [(s, column(f"cpu_{s}")) for s in _STAGES] + [("total", total)]:
        figures = (np.median(values), values.mean(), np.quantile(values, 0.95), values.max())
        lines.append(f"{name:<12}" + "".join(f"{figure:10.3f}" for figure in figures))
    return [
        *lines,
        f"mean of all inputs, failed and killed attempts included: {mean:.2f} s",
        f"killed attempts took {killed:.0f} s in all",
        f"ratio to the paper's {PAPER_SECONDS:g} s a model: {PAPER_SECONDS / mean:.1f} times less",
        f"share inside Open CASCADE and Gmsh: {100 * share:.1f} %",
        f"peak memory of a worker: median {np.median(column('peak_memory')) / 2**20:.0f} MiB, "
        f"max {column('peak_memory').max() / 2**20:.0f} MiB",
    ]


def _slowest(lake: breplake.Lake) -> list[str]:
    rows = lake.sql(
        """
        SELECT name, n_patches, coalesce(n_vertices, 0) AS n_vertices, cpu_total,
               cpu_load, cpu_brep, cpu_mesh
        FROM models ORDER BY cpu_total DESC, name LIMIT 5
        """
    ).fetchall()
    return ["slowest models:"] + [
        f"    {total:6.1f} s ({load:.1f} load, {brep:.1f} brep, {mesh:.1f} mesh), "
        f"{patches} patches, {vertices} vertices: {name}"
        for name, patches, vertices, total, load, brep, mesh in rows
    ]


def main(
    folder: Annotated[Path, typer.Argument(help="CAD files to ingest.", metavar="FOLDER")],
    lake: Annotated[Path | None, typer.Option(help="Keep the lake here.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Worker processes; one per core.")] = None,
    timeout: Annotated[float, typer.Option(help="Seconds for one attempt.")] = 120.0,
) -> None:
    """Measure what ingest costs."""
    from breplake.ingest.run import ingest
    from breplake.ingest.settings import Settings

    with tempfile.TemporaryDirectory() as temporary:
        place = lake or Path(temporary) / "lake"
        ingest([folder], place, settings=Settings(timeout=timeout), jobs=jobs)
        opened = breplake.open(place)
        print("\n".join([*report(opened), *_slowest(opened)]))


if __name__ == "__main__":
    typer.run(main)
