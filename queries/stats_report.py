"""A report of a lake's statistics: pictures, tables, and one page that needs no network."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import TYPE_CHECKING, Any

from breplake.errors import UsageError
from breplake.queries.picture_scene import COLOURS
from breplake.queries.stats import FEW_CURVES, FEW_PATCHES, Statistics
from breplake.queries.stats_charts import Bars, Histogram
from breplake.queries.stats_page import page
from breplake.queries.stats_plots import draw

if TYPE_CHECKING:
    import pyarrow as pa

    from breplake.queries.session import Lake

__all__ = ["charts", "write_report"]


def write_report(
    lake: Lake, folder: str | Path, *, where: str | None = None, examples: int = 24, seed: int = 0
) -> list[Path]:
    """Write the paper's figures of a lake as PNG, CSV and one HTML page.

    Parameters
    ----------
    lake : Lake
        An open lake.
    folder : str or pathlib.Path
        Where to write; made if need be. Files of the same names are replaced.
    where : str, optional
        SQL condition on a row of ``models``; all models if not given.
    examples : int
        Models on the sheet, drawn at random from those with a mesh.
    seed : int
        Of that draw.

    Returns
    -------
    list of pathlib.Path
        The files, the page ``index.html`` first.

    Raises
    ------
    UsageError
        If the condition is wrong, no model fulfils it, or the folder cannot be written.
    MissingExtraError
        If matplotlib is not installed.
    """
    numbers = Statistics.of(lake, where, examples=examples, seed=seed)
    place = Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
        files = _write(lake, numbers, place)
    except OSError as error:
        raise UsageError(f"cannot write {error.filename or place}: {error.strerror}") from error
    return files


def _write(lake: Lake, numbers: Statistics, place: Path) -> list[Path]:
    import pyarrow.csv

    found = charts(numbers)
    files = [place / "index.html"]
    for name, chart in found.items():
        files.append(place / f"{name}.png")
        draw(chart, files[-1])
    sheet = _draw_sheet(lake, numbers.examples, place / "models.png")
    files += [sheet] if sheet else []
    for name, table in numbers.tables().items():
        files.append(place / f"{name}.csv")
        pyarrow.csv.write_csv(table, files[-1])
    picture = base64.b64encode(sheet.read_bytes()).decode() if sheet else None
    files[0].write_text(page(lake, numbers, found, picture), encoding="utf-8")
    return files


def _draw_sheet(lake: Lake, models: list[int], path: Path) -> Path | None:
    from breplake.queries.picture import draw_sheet

    if not models:
        return None
    draw_sheet(lake, models, path, columns=6, cell=(240, 200))
    return path


def charts(numbers: Statistics) -> dict[str, Bars | Histogram]:
    """Return the four charts of the paper by name."""
    surfaces, curves = numbers.surface_types, numbers.paper_curve_types
    return {
        "surface_types": Bars(
            "Types of patches",
            _list(surfaces, "type"),
            _list(surfaces, "patches"),
            _shares(surfaces),
            [COLOURS[kind] for kind in _list(surfaces, "type")],
        ),
        "curve_types": Bars(
            "Types of curves",
            _list(curves, "type"),
            _list(curves, "curves"),
            _shares(curves),
        ),
        "patches_per_model": _histogram(numbers.patches_per_model, "patches", FEW_PATCHES),
        "curves_per_model": _histogram(numbers.curves_per_model, "curves", FEW_CURVES),
    }


def _histogram(table: pa.Table, unit: str, mark: int) -> Histogram:
    return Histogram(
        f"{unit.capitalize()} per model", unit, _list(table, "low"), _list(table, "models"), mark
    )


def _list(table: pa.Table, name: str) -> list[Any]:
    values: list[Any] = table.column(name).to_pylist()
    return values


def _shares(table: pa.Table) -> list[float]:
    """Return the shares; without any patch or curve they are undefined, and drawn as 0."""
    return [share or 0.0 for share in _list(table, "share")]
