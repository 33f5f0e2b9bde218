"""Charts as data, and as SVG that takes its colours from the page it stands in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

__all__ = ["Bars", "Histogram", "ticks"]

_WIDTH: Final = 520


@dataclass(frozen=True, slots=True)
class Bars:
    """Shares of types, one bar below the other.

    Parameters
    ----------
    title : str
        What is shown.
    labels : sequence of str
        The types.
    counts : sequence of int
        How many of each.
    shares : sequence of float
        Shares of the sum, 0 to 1.
    colours : sequence of str, optional
        Of the bars, ``#rrggbb``; one accent for all if not given.
    """

    title: str
    labels: Sequence[str]
    counts: Sequence[int]
    shares: Sequence[float]
    colours: Sequence[str] | None = None

    def svg(self) -> str:
        """Return the chart as an SVG element."""
        row, left, right = 26, 92, 150
        most = max(max(self.shares), 1e-9)
        parts = []
        for place, label in enumerate(self.labels):
            y = row * place
            width = (_WIDTH - left - right) * self.shares[place] / most
            fill = f' fill="{self.colours[place]}"' if self.colours else ""
            parts.append(
                f'<text x="{left - 10}" y="{y + 17}" text-anchor="end">{escape(label)}</text>'
                f'<rect class="bar" x="{left}" y="{y + 4}" width="{width:.2f}" height="{row - 8}" '
                f'rx="2"{fill}/>'
                f'<text x="{left + width + 8:.2f}" y="{y + 17}">{percent(self.shares[place])}'
                f'<tspan class="faint" dx="8">{self.counts[place]:,}</tspan></text>'
            )
        spoken = ", ".join(
            f"{label} {percent(share)}"
            for label, share in zip(self.labels, self.shares, strict=True)
        )
        return _svg(self.title, f"{self.title}: {spoken}", row * len(self.labels), parts)


@dataclass(frozen=True, slots=True)
class Histogram:
    """Models by a count; the last bin holds all that have more.

    Parameters
    ----------
    title : str
        What is shown.
    unit : str
        What is counted in a model.
    lows : sequence of int
        Least count of each bin.
    models : sequence of int
        Models in each bin.
    mark : int
        Count at which a line is drawn.
    """

    title: str
    unit: str
    lows: Sequence[int]
    models: Sequence[int]
    mark: int

    @property
    def place_of_mark(self) -> float | None:
        """Where the line is, in bins from the left; None if it is not on the chart."""
        if not self.lows[0] <= self.mark <= self.lows[-1]:
            return None
        step = self.lows[1] - self.lows[0]
        return (self.mark - self.lows[0]) / step

    def svg(self) -> str:
        """Return the chart as an SVG element."""
        height, left, bottom, top = 260, 52, 46, 18
        steps = ticks(max(self.models))
        scale = (height - bottom - top) / steps[-1]
        base = height - bottom
        step = (_WIDTH - left - 8) / len(self.lows)
        parts = [
            f'<line class="grid" x1="{left}" x2="{_WIDTH}" y1="{base - value * scale:.2f}" '
            f'y2="{base - value * scale:.2f}"/><text class="faint" x="{left - 8}" '
            f'y="{base - value * scale + 4:.2f}" text-anchor="end">{value:,}</text>'
            for value in steps
        ]
        for place, (low, models) in enumerate(zip(self.lows, self.models, strict=True)):
            x, tall, last = left + step * place, models * scale, place == len(self.lows) - 1
            kind = "bar more" if last else "bar"
            if models:
                parts.append(
                    f'<rect class="{kind}" x="{x + 0.75:.2f}" y="{base - tall:.2f}" '
                    f'width="{step - 1.5:.2f}" height="{tall:.2f}"/>'
                )
            if last or (place % _every(len(self.lows)) == 0 and place < len(self.lows) - 2):
                text = f"{low}+" if last else str(low)
                at = x + step / 2 if last else x
                parts.append(
                    f'<text class="faint" x="{at:.2f}" y="{base + 18}" text-anchor="middle">'
                    f"{text}</text>"
                )
        if self.place_of_mark is not None:
            x = left + step * self.place_of_mark
            parts.append(f'<line class="mark" x1="{x:.2f}" x2="{x:.2f}" y1="{top}" y2="{base}"/>')
        parts.append(
            f'<text x="{(left + _WIDTH) / 2}" y="{height - 8}" text-anchor="middle">'
            f"{escape(self.unit)} per model</text>"
        )
        peak = self.models.index(max(self.models))
        spoken = (
            f"{self.title}: most models, {max(self.models):,}, "
            f"have from {self.lows[peak]:,} {self.unit}"
        )
        return _svg(self.title, spoken, height, parts)


def ticks(most: float) -> list[int]:
    """Return about five round numbers from 0 to `most` or a little more."""
    rough = max(most, 1) / 5
    power = 10 ** math.floor(math.log10(rough)) if rough >= 1 else 1
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough)
    return [int(step * i) for i in range(math.ceil(max(most, 1) / step) + 1)]


def percent(share: float) -> str:
    """Return a share as a percentage that does not call a few nothing."""
    if 0 < share < 0.0005:
        return "< 0.1 %"
    return f"{100 * share:.1f} %"


def _every(bins: int) -> int:
    """Return how many bins there are between two labels."""
    return max(1, round(bins / 10))


def _svg(title: str, spoken: str, height: float, parts: Sequence[str]) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH} {height:g}" role="img" aria-label="{escape(spoken)}">'
        f"<title>{escape(title)}</title>{''.join(parts)}</svg>"
    )
