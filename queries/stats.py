"""The paper's statistics of a lake: types of patches and curves, histograms of complexity.

`Statistics.of` counts, ``breplake.queries.stats_report`` makes pictures and a page of it. The
definitions are those of the paper's figures: shares of all patches and of all curves (seams and
degenerate ones included) over all models, and models by their number of patches and of curves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from breplake.errors import UsageError

if TYPE_CHECKING:
    import pyarrow as pa

    from breplake.queries.session import Lake

__all__ = ["FEW_CURVES", "FEW_PATCHES", "Statistics", "Summary"]

FEW_PATCHES: Final = 30
"""The paper: many models "consist of less than 30 patches"."""

FEW_CURVES: Final = 100
"""The paper: "... less than 30 patches/100 curves"."""


@dataclass(frozen=True, slots=True)
class Summary:
    """Sums over the models.

    Parameters
    ----------
    models, collections, parts, patches, curves, corners : int
        How many.
    meshed, vertices, triangles : int
        Models with a mesh, and the sizes of all meshes.
    closed, valid, duplicates : int
        Models without boundary curves; without faults; that are copies of earlier ones.
    few_patches, few_curves : int
        Models with fewer than `FEW_PATCHES` patches, and than `FEW_CURVES` curves.
    sharp_curves : int
        Sharp curves.
    median_patches, median_curves : float
        Of a model.
    """

    models: int
    collections: int
    parts: int
    patches: int
    curves: int
    corners: int
    meshed: int
    vertices: int
    triangles: int
    closed: int
    valid: int
    duplicates: int
    few_patches: int
    few_curves: int
    sharp_curves: int
    median_patches: float
    median_curves: float

    @classmethod
    def of(cls, lake: Lake, where: str) -> Summary:
        """Sum up the models for which the SQL condition `where` holds."""
        relation = lake.sql(
            f"""
            SELECT
                count(*) AS models,
                count(DISTINCT collection) AS collections,
                coalesce(sum(n_parts), 0)::BIGINT AS parts,
                coalesce(sum(n_patches), 0)::BIGINT AS patches,
                coalesce(sum(n_curves), 0)::BIGINT AS curves,
                coalesce(sum(n_corners), 0)::BIGINT AS corners,
                count(mesh_kind) AS meshed,
                coalesce(sum(n_vertices), 0)::BIGINT AS vertices,
                coalesce(sum(n_faces), 0)::BIGINT AS triangles,
                count(*) FILTER (is_closed) AS closed,
                count(*) FILTER (is_valid) AS valid,
                count(*) - count(DISTINCT duplicate_group) AS duplicates,
                count(*) FILTER (n_patches < {FEW_PATCHES}) AS few_patches,
                count(*) FILTER (n_curves < {FEW_CURVES}) AS few_curves,
                coalesce(sum(n_sharp_curves), 0)::BIGINT AS sharp_curves,
                coalesce(median(n_patches), 0) AS median_patches,
                coalesce(median(n_curves), 0) AS median_curves
            FROM models
            WHERE (
            {where}
            )
            """
        )
        (row,) = relation.fetchall()
        return cls(**dict(zip(relation.columns, row, strict=True)))


@dataclass(frozen=True, slots=True)
class Statistics:
    """All numbers of a report.

    Parameters
    ----------
    summary : Summary
        Sums over the models.
    surface_types, curve_types, patches_per_model, curves_per_model : pyarrow.Table
        Answers of the queries of these names.
    paper_curve_types : pyarrow.Table
        ``type``, ``curves`` and ``share`` with the paper's types.
    examples : list of int
        Model ids drawn at random from the models with a mesh.
    where : str or None
        Condition that the models fulfil.
    """

    summary: Summary
    surface_types: pa.Table
    curve_types: pa.Table
    paper_curve_types: pa.Table
    patches_per_model: pa.Table
    curves_per_model: pa.Table
    examples: list[int]
    where: str | None

    @classmethod
    def of(
        cls, lake: Lake, where: str | None = None, *, examples: int = 24, seed: int = 0
    ) -> Statistics:
        """Count.

        Parameters
        ----------
        lake : Lake
            An open lake.
        where : str, optional
            SQL condition on a row of ``models``; all models if not given.
        examples : int
            How many models to draw at random.
        seed : int
            Of that draw.

        Raises
        ------
        UsageError
            If the condition is wrong, or no model fulfils it.
        """
        condition = where or "true"
        summary = Summary.of(lake, condition)
        if not summary.models:
            raise UsageError(f"there is no model {f'WHERE {where}' if where else 'in the lake'}")

        def ask(name: str) -> pa.Table:
            return lake.query(name, where=where).to_arrow_table()

        curve_types = ask("curve_types")
        return cls(
            summary=summary,
            surface_types=ask("surface_types"),
            curve_types=curve_types,
            paper_curve_types=_by_paper_type(curve_types),
            patches_per_model=ask("patches_per_model"),
            curves_per_model=ask("curves_per_model"),
            examples=_draw(lake, condition, examples, seed),
            where=where,
        )

    def tables(self) -> dict[str, pa.Table]:
        """Return the tables by name, the summary as one of quantity and value."""
        import pyarrow as pa

        values = {name: float(getattr(self.summary, name)) for name in Summary.__slots__}
        summary: dict[str, Any] = {"quantity": list(values), "value": list(values.values())}
        return {
            "summary": pa.table(summary),
            "surface_types": self.surface_types,
            "curve_types": self.curve_types,
            "paper_curve_types": self.paper_curve_types,
            "patches_per_model": self.patches_per_model,
            "curves_per_model": self.curves_per_model,
        }


def _by_paper_type(curve_types: pa.Table) -> pa.Table:
    """Add up the types that the paper puts under Other, its types in their order."""
    summed = curve_types.group_by("paper_type", use_threads=False).aggregate(
        [("curves", "sum"), ("share", "sum")]
    )
    return summed.select(["paper_type", "curves_sum", "share_sum"]).rename_columns(
        ["type", "curves", "share"]
    )


def _draw(lake: Lake, condition: str, count: int, seed: int) -> list[int]:
    """Return ids of models with a mesh, drawn without repetition, in the order of their names."""
    rows = lake.sql(
        f"SELECT model_id FROM models WHERE n_faces > 0 AND (\n{condition}\n) "
        "ORDER BY collection, name"
    ).fetchall()
    drawn = np.random.default_rng(seed).choice(len(rows), min(count, len(rows)), replace=False)
    return [int(rows[place][0]) for place in np.sort(drawn)]
