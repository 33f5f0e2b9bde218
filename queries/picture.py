"""Pictures of models: ``draw_model`` draws one, ``draw_sheet`` many on one page.

The model is drawn in numpy (`breplake.queries.picture_shade`), without a graphics driver or
display; matplotlib sets the words and writes the PNG.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from breplake.errors import MissingExtraError, UsageError
from breplake.queries.picture_scene import COLOURS, Scene
from breplake.queries.picture_shade import Picture, render

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["draw_model", "draw_sheet"]

_DPI = 100
_DARK = "#1a212e"
_GREY = "#66707f"


def draw_model(
    lake: Lake,
    model: str | int,
    path: str | Path,
    *,
    size: tuple[int, int] = (1600, 1200),
    view: tuple[float, float] | None = None,
) -> None:
    """Draw a model: patches coloured by surface type, sharp curves dark, others light.

    Parameters
    ----------
    lake : Lake
        An open lake.
    model : str or int
        Name or id of the model.
    path : str or pathlib.Path
        The PNG file to write.
    size : tuple of int
        Width and height, pixels.
    view : tuple of float, optional
        Azimuth and elevation of the eye, degrees; by default (-52, 28).

    Raises
    ------
    NameNotFoundError
        If the lake has no such model.
    UsageError
        If the model has no mesh, or the picture would be smaller than 200 x 150 pixels.
    MissingExtraError
        If matplotlib is not installed.
    """
    width, height = _checked(size)
    page = _Page(width, height)
    scene = Scene.of(lake, model)
    unit = min(width / 1600, height / 1200)
    head, legend = int(110 * unit), int(250 * unit)
    picture = render(scene, width - legend, height - head - int(30 * unit), view)
    page.paste(picture, 0, head)
    page.words(40 * unit, 34 * unit, scene.title, 30 * unit, _DARK, bold=True)
    page.words(40 * unit, 78 * unit, scene.facts, 17 * unit, _GREY)
    _legend(page, scene.counts, width - legend, head + 40 * unit, unit)
    page.save(path)


def draw_sheet(
    lake: Lake,
    models: Sequence[str | int],
    path: str | Path,
    *,
    columns: int | None = None,
    cell: tuple[int, int] = (320, 260),
    view: tuple[float, float] | None = None,
) -> None:
    """Draw many models on one page, each with its name, and one legend for all.

    Parameters
    ----------
    lake : Lake
        An open lake.
    models : sequence of str or int
        Names or ids, drawn row by row.
    path : str or pathlib.Path
        The PNG file to write.
    columns : int, optional
        Models in a row; by default such that the page is about 4 to 3.
    cell : tuple of int
        Width and height for one model, pixels.
    view : tuple of float, optional
        As in `draw_model`.

    Raises
    ------
    NameNotFoundError, UsageError, MissingExtraError
        As `draw_model`; UsageError also without models.
    """
    if not models:
        raise UsageError("a sheet needs at least one model")
    width, height = _checked(cell)
    columns = columns or max(round((len(models) * 4 / 3 * height / width) ** 0.5), 1)
    columns = min(columns, len(models))
    rows = -(-len(models) // columns)
    foot, unit = 60, width / 320
    page = _Page(columns * width, rows * height + foot)
    counts: dict[str, int] = {}
    for place, model in enumerate(models):
        scene = Scene.of(lake, model)
        left, top = place % columns * width, place // columns * height
        gap, name = int(8 * unit), int(34 * unit)
        page.paste(render(scene, width - 2 * gap, height - gap - name, view), left + gap, top + gap)
        title = _shortened(scene.title, int(width / (7.2 * unit)))
        page.words(left + width / 2, top + height - name / 2, title, 12 * unit, _DARK, centred=True)
        for kind, number in scene.counts.items():
            counts[kind] = counts.get(kind, 0) + number
    ordered = {kind: counts[kind] for kind in COLOURS if kind in counts}
    _legend_row(page, ordered, rows * height + foot / 2, columns * width)
    page.save(path)


def _checked(size: tuple[int, int]) -> tuple[int, int]:
    width, height = size
    if width < 200 or height < 150:
        raise UsageError(f"a picture has at least 200 x 150 pixels, got {width} x {height}")
    return int(width), int(height)


def _shortened(text: str, length: int) -> str:
    """Keep the end of a long name: that is what differs."""
    return text if len(text) <= length else "…" + text[1 - length :]


def _legend(page: _Page, counts: Mapping[str, int], left: float, top: float, unit: float) -> None:
    """List the types with their numbers, one below the other."""
    page.words(left, top, "patches", 17 * unit, _GREY)
    for line, (kind, number) in enumerate(counts.items()):
        y = top + (48 + 38 * line) * unit
        page.patch(left, y - 12 * unit, 24 * unit, 24 * unit, COLOURS[kind])
        page.words(left + 38 * unit, y, kind, 18 * unit, _DARK)
        page.words(left + 210 * unit, y, f"{number:,}", 18 * unit, _DARK, right=True)


def _legend_row(page: _Page, counts: Mapping[str, int], y: float, width: float) -> None:
    """List the types with their numbers, side by side, as large as the page allows."""
    step = min(width / max(len(counts), 1), 170)
    unit = min(step / 170, 1.0)
    left = (width - step * len(counts)) / 2
    for place, (kind, number) in enumerate(counts.items()):
        x = left + step * place
        page.patch(x, y - 9 * unit, 18 * unit, 18 * unit, COLOURS[kind])
        page.words(x + 26 * unit, y, f"{kind} {number:,}", 14 * unit, _DARK)


class _Page:
    """A white page on which pictures and words are put, in pixels from the upper left."""

    def __init__(self, width: int, height: int) -> None:
        try:
            from matplotlib.figure import Figure
        except ImportError as error:
            raise MissingExtraError("plot", "drawing models") from error
        self.width, self.height = width, height
        self.figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
        self.canvas = np.ones((height, width, 3), dtype=np.float32)

    def paste(self, picture: Picture, left: int, top: int) -> None:
        """Put a picture on the page."""
        height, width = picture.shape[:2]
        self.canvas[top : top + height, left : left + width] = picture

    def words(
        self,
        x: float,
        y: float,
        text: str,
        size: float,
        colour: str,
        *,
        bold: bool = False,
        right: bool = False,
        centred: bool = False,
    ) -> None:
        """Write text beside (x, y); `size` is its height in pixels."""
        side = "right" if right else "center" if centred else "left"
        self.figure.text(
            x / self.width,
            1 - y / self.height,
            text,
            fontsize=size * 72 / _DPI,
            color=colour,
            fontweight="bold" if bold else "normal",
            ha=side,
            va="center",
            parse_math=False,
        )

    def patch(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """Draw a filled square with a thin rim."""
        from matplotlib.patches import Rectangle

        low = (x / self.width, 1 - (y + height) / self.height)
        extent = width / self.width, height / self.height
        style: dict[str, Any] = {"facecolor": colour, "edgecolor": _DARK, "linewidth": 0.8}
        self.figure.add_artist(Rectangle(low, *extent, **style))

    def save(self, path: str | Path) -> None:
        """Write the page as PNG."""
        self.figure.figimage(self.canvas, origin="upper")
        self.figure.savefig(path, dpi=_DPI, format="png")
