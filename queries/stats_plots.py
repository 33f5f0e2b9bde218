"""The charts of a report as PNG, by matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from breplake.errors import MissingExtraError
from breplake.queries.stats_charts import Bars, Histogram, percent, ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw"]

_ACCENT: Final = "#3f7cac"
_MORE: Final = "#a9c4d8"
_MARK: Final = "#b5532c"
_GREY: Final = "#66707f"
_DPI: Final = 150


def draw(chart: Bars | Histogram, path: Path) -> None:
    """Write a chart as PNG.

    Parameters
    ----------
    chart : Bars or Histogram
        What is drawn.
    path : pathlib.Path
        The file.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("plot", "drawing statistics") from error
    size = (7.0, 0.36 * len(chart.labels) + 0.9) if isinstance(chart, Bars) else (7.0, 3.8)
    figure = Figure(figsize=size, dpi=_DPI, facecolor="white", layout="constrained")
    axes = figure.add_subplot()
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(colors=_GREY, length=0)
    axes.set_title(chart.title, loc="left", fontsize=11)
    if isinstance(chart, Bars):
        _draw_bars(axes, chart)
    else:
        _draw_histogram(axes, chart)
    figure.savefig(path, format="png")


def _draw_bars(axes: Axes, chart: Bars) -> None:
    places = range(len(chart.labels))
    colours = chart.colours or _ACCENT
    bars = axes.barh(
        places, chart.shares, color=colours, edgecolor=_GREY, linewidth=0.6, height=0.7
    )
    texts = [f"{percent(s)}   {n:,}" for s, n in zip(chart.shares, chart.counts, strict=True)]
    axes.bar_label(bars, texts, padding=5, fontsize=9)
    axes.set_yticks(list(places), chart.labels)
    axes.tick_params(axis="y", colors="black")
    axes.invert_yaxis()
    axes.set_xlim(0, max(chart.shares) * 1.35 or 1)
    axes.xaxis.set_visible(False)
    axes.spines["bottom"].set_visible(False)


def _draw_histogram(axes: Axes, chart: Histogram) -> None:
    count = len(chart.lows)
    colours = [_ACCENT] * (count - 1) + [_MORE]
    axes.bar([i + 0.5 for i in range(count)], chart.models, color=colours, width=0.9)
    every = max(1, round(count / 10))
    shown = list(range(0, count - 2, every))
    places: list[Any] = [*shown, count - 0.5]
    axes.set_xticks(places, [str(chart.lows[i]) for i in shown] + [f"{chart.lows[-1]}+"])
    steps = ticks(max(chart.models))
    axes.set_yticks(steps, [f"{value:,}" for value in steps])
    axes.set_xlim(0, count)
    axes.set_ylim(0, steps[-1])
    axes.grid(axis="y", color="#e1e4e8", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.set_xlabel(f"{chart.unit} per model")
    axes.set_ylabel("models")
    if chart.place_of_mark is not None:
        axes.axvline(chart.place_of_mark, color=_MARK, linewidth=1, linestyle=(0, (4, 3)))
