"""Rules on sums: patches make up parts, parts make up the model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from breplake.queries.check.rules import Measure, model_rule
from breplake.queries.check.view import ModelView

__all__: list[str] = []


@model_rule(
    "model-sums",
    "area of a model is the sum of its patches', its volume that of its parts'",
    limit="1e-9 x sum of sizes",
    unit="mm^2, mm^3",
)
def model_sums(view: ModelView) -> Iterator[Measure]:
    """Measure models.area and models.volume."""
    areas = view.floats("patches", "area")
    error = abs(view.row["area"] - areas.sum())
    yield Measure(np.array([error]), 1e-9 * np.abs(areas).sum(), lambda _: "area")
    volumes = view.floats("parts", "volume")
    volumes = volumes[~np.isnan(volumes)]
    stated = view.row["volume"]
    yield Measure.of_truth([(stated is None) == (not len(volumes))], lambda _: f"volume {stated}")
    if stated is not None:
        error = abs(stated - volumes.sum())
        yield Measure(np.array([error]), 1e-9 * np.abs(volumes).sum(), lambda _: "volume")


@model_rule(
    "part-sums",
    "area of a part is the sum of its patches' (not less, where parts share patches)",
    limit="1e-9 x area of the model",
    unit="mm^2",
    needs=("ids-dense", "references", "words"),
    share=0.001,
    source=True,
)
def part_sums(view: ModelView) -> Iterator[Measure]:
    """Measure parts.area; a shared patch counts for its first part only."""
    part = view.ints("patches", "part_id")
    own = np.bincount(part, view.floats("patches", "area"), minlength=view.count("parts"))
    error = view.floats("parts", "area") - own
    if np.any(view.words("curves", "kind") == "nonmanifold"):
        error = np.minimum(error, 0.0)
    limit = 1e-9 * float(np.abs(view.floats("patches", "area")).sum())
    yield Measure(np.abs(error), limit, lambda i: f"part {i}")


@model_rule("solid-volume", "solids have a volume, shells and faces none", needs=("words",))
def solid_volume(view: ModelView) -> Iterator[Measure]:
    """Measure whether volume is null exactly for parts that are no solids."""
    has = ~np.isnan(view.floats("parts", "volume"))
    solid = view.words("parts", "kind") == "solid"
    yield Measure.of_truth(has == solid, lambda i: f"part {i}")
