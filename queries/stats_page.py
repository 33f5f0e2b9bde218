"""The page of a report: HTML with its charts inside, light or dark as the reader likes it."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from importlib import resources
from string import Template
from typing import TYPE_CHECKING, Any

from breplake.queries.stats import FEW_CURVES, FEW_PATCHES, Statistics, Summary
from breplake.queries.stats_charts import Bars, Histogram, percent

if TYPE_CHECKING:
    import pyarrow as pa

    from breplake.queries.session import Lake

__all__ = ["page"]


def page(
    lake: Lake,
    numbers: Statistics,
    charts: Mapping[str, Bars | Histogram],
    picture: str | None,
) -> str:
    """Return the page.

    Parameters
    ----------
    lake : Lake
        What it is about.
    numbers : Statistics
        Its numbers.
    charts : mapping
        Its charts by the names of their tables.
    picture : str or None
        PNG of the sheet of models, base64.
    """
    template = resources.files("breplake.queries").joinpath("stats_page.html").read_text("utf-8")
    sums = numbers.summary
    texts = _captions(sums)
    drawn = {name: _figure(chart, texts[name], name, numbers) for name, chart in charts.items()}
    return Template(template).substitute(
        title=escape(f"Statistics of {lake.place.rpartition('/')[2]}"),
        lead=_lead(lake, numbers),
        keys="\n".join(_keys(sums)),
        types=drawn["surface_types"] + drawn["curve_types"],
        complexity=drawn["patches_per_model"] + drawn["curves_per_model"],
        sheet=_sheet(picture, len(numbers.examples)) if picture else "",
        foot=_foot(lake),
    )


def _lead(lake: Lake, numbers: Statistics) -> str:
    snapshot = lake.snapshot
    told = f"Snapshot {snapshot.number} of {escape(snapshot.time[:10])}"
    if numbers.where:
        return f"{told}, models for which <code>{escape(numbers.where)}</code>."
    return f"{told}, all models."


def _foot(lake: Lake) -> str:
    tools = ", ".join(f"{name} {version}" for name, version in lake.snapshot.tools.items())
    return (
        f"Lake <code>{escape(lake.store.lake_id)}</code>, snapshot {lake.snapshot.number}, "
        f"made with {escape(tools)}. The figures are defined as in Koch et al., "
        "<cite>ABC: A Big CAD Model Dataset For Geometric Deep Learning</cite>, CVPR 2019."
    )


def _keys(sums: Summary) -> list[str]:
    """Return the key figures: name, number, remark."""

    def of_models(count: int) -> str:
        return percent(count / sums.models)

    sharp = percent(sums.sharp_curves / sums.curves) if sums.curves else "none"
    rows = [
        ("models", sums.models, f"{sums.parts:,} parts, {sums.duplicates:,} duplicates"),
        ("patches", sums.patches, f"median {sums.median_patches:g} per model"),
        ("curves", sums.curves, f"median {sums.median_curves:g} per model, {sharp} sharp"),
        ("triangles", sums.triangles, f"{of_models(sums.meshed)} of the models have a mesh"),
        ("closed", of_models(sums.closed), "no curve is a boundary"),
        ("valid", of_models(sums.valid), "the CAD kernel finds no fault"),
    ]
    return [
        f"<div><dt>{name}</dt><dd>{value if isinstance(value, str) else f'{value:,}'}"
        f"<small>{remark}</small></dd></div>"
        for name, value, remark in rows
    ]


def _captions(sums: Summary) -> dict[str, str]:
    few_patches = percent(sums.few_patches / sums.models)
    few_curves = percent(sums.few_curves / sums.models)
    return {
        "surface_types": f"Share of all {sums.patches:,} patches.",
        "curve_types": f"Share of all {sums.curves:,} curves, seams and degenerate ones included. "
        "Parabolas and hyperbolas are under Other.",
        "patches_per_model": f"{few_patches} of the models have fewer than {FEW_PATCHES} patches "
        "(dashed line). The last bar holds all models with more.",
        "curves_per_model": f"{few_curves} of the models have fewer than {FEW_CURVES} curves "
        "(dashed line). The last bar holds all models with more.",
    }


def _figure(chart: Bars | Histogram, caption: str, name: str, numbers: Statistics) -> str:
    return (
        f"<figure><figcaption><h3>{escape(chart.title)}</h3>{caption}</figcaption>{chart.svg()}"
        f"<details><summary>The numbers</summary>{_table(numbers.tables()[name])}</details>"
        "</figure>\n"
    )


def _sheet(picture: str, count: int) -> str:
    return (
        '<h2 id="models">What they look like</h2>\n'
        f'<figure class="sheet"><figcaption>{count} models drawn at random, patches coloured by '
        f'type.</figcaption><img alt="Pictures of {count} models" '
        f'src="data:image/png;base64,{picture}"></figure>'
    )


def _table(table: pa.Table) -> str:
    head = "".join(
        f'<th scope="col">{escape(name.replace("_", " "))}</th>' for name in table.column_names
    )
    rows = []
    for row in table.to_pylist():
        cells = [_cell(name, value) for name, value in row.items()]
        rest = "".join(f"<td>{cell}</td>" for cell in cells[1:])
        rows.append(f'<tr><th scope="row">{cells[0]}</th>{rest}</tr>')
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="Table"><table><thead><tr>'
        f"{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _cell(name: str, value: Any) -> str:
    """Return a cell: shares as percentages, a bin without end as such."""
    if value is None:
        return "and more" if name == "high" else ""
    if isinstance(value, float):
        return percent(value) if "share" in name or name == "cumulative" else f"{value:,.4g}"
    return f"{value:,}" if isinstance(value, int) else escape(str(value))
