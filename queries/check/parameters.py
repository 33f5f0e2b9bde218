"""Rules on the parameters of patches and curves: frames, coefficients, apexes, foci."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from breplake.queries.check.rules import Measure, model_rule, place
from breplake.queries.check.view import Floats, ModelView
from breplake.schema.curves import CurveSet

__all__: list[str] = []

_UNIT: Final = 1e-12

_QUADRIC: Final = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
"""Place in ``coefficients`` of each entry of the symmetric matrix of a quadric."""


@model_rule(
    "evaluable",
    "every type but Other has all the parameters of its closed form",
    needs=("words",),
)
def evaluable(view: ModelView) -> Iterator[Measure]:
    """Measure whether each patch and curve can be evaluated."""
    for table, known in (
        ("patches", view.surfaces.known),
        ("curves", CurveSet.from_curves(view.table("curves")).known),
    ):
        types = view.words(table, "type")
        ok = known | (types == "Other")
        yield Measure.of_truth(ok, place("{t} row {i} ({0})", types, t=table))


@model_rule("frames", "axes are unit vectors, at right angles to each other", limit="1e-12")
def frames(view: ModelView) -> Iterator[Measure]:
    """Measure lengths and scalar products of all axes and directions."""
    for table in ("patches", "curves"):
        axes = {name: view.vectors(table, name) for name in ("x_axis", "y_axis", "z_axis")}
        for name, axis in {**axes, "direction": view.vectors(table, "direction")}.items():
            yield _axis_measure(np.linalg.norm(axis, axis=1) - 1, f"{table}.{name}")
        for one, two in (("x_axis", "y_axis"), ("y_axis", "z_axis"), ("z_axis", "x_axis")):
            product = np.einsum("ni,ni->n", axes[one], axes[two])
            yield _axis_measure(product, f"{table}.{one} . {two}")


def _axis_measure(error: Floats, what: str) -> Measure:
    rows = np.flatnonzero(~np.isnan(error))
    return Measure(np.abs(error[rows]), _UNIT, lambda i: f"{what}, row {rows[i]}")


@model_rule(
    "coefficients",
    "coefficients of planes and quadrics vanish on their patch",
    limit="1e-9 x diagonal",
    unit="mm",
    needs=("ids-dense", "references", "words", "evaluable"),
    share=0.001,
    source=True,
)
def coefficients(view: ModelView) -> Iterator[Measure]:
    """Measure the first-order distance of p(u, v) to the plane or quadric at every vertex."""
    offsets, values = view.lists("patches", "coefficients")
    length = np.diff(offsets)
    types = view.words("patches", "type")
    wanted = np.select(
        [types == "Plane", np.isin(types, ("Cylinder", "Cone", "Sphere"))], [4, 10], 0
    )
    yield Measure.of_truth(
        length == wanted, lambda i: f"patch {i} ({types[i]}) has {length[i]} coefficients"
    )
    patch = view.ints("vertices", "patch_id")
    for number in (4, 10):
        rows = np.flatnonzero(((wanted == number) & (length == number))[patch])
        start = offsets[patch[rows]]
        c = values[start[:, None] + np.arange(number)]  # (n, number)
        value, slope = _implicit(c, view.surface.point[rows])
        flat = slope < 1e-6 * view.diagonal * np.abs(c[:, :3]).max(axis=1, initial=0)
        keep = ~flat if number == 10 else np.ones(len(rows), dtype=bool)  # not at an apex
        distance = np.abs(value[keep]) / slope[keep]
        size = view.diagonal + np.abs(view.surface.point[rows[keep]]).max(axis=1, initial=0)
        of = patch[rows[keep]]
        yield Measure(distance, 1e-9 * size, place("patch {0} ({1})", of, types[of]))


def _implicit(c: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Return value and length of the gradient of planes ``(n, 4)`` or quadrics ``(n, 10)``."""
    if c.shape[1] == 4:
        value = np.einsum("ni,ni->n", c[:, :3], p) + c[:, 3]
        return value, np.asarray(np.linalg.norm(c[:, :3], axis=1))
    across = np.einsum("nij,nj->ni", c[:, _QUADRIC], p)
    value = np.einsum("ni,ni->n", across + 2 * c[:, 6:9], p) + c[:, 9]
    return value, np.asarray(2 * np.linalg.norm(across + c[:, 6:9], axis=1))


@model_rule(
    "apex", "the apex of a cone is where its radius is zero", limit="1e-9 x diagonal", unit="mm"
)
def apex(view: ModelView) -> Iterator[Measure]:
    """Measure the distance of apex to location - radius / tan(angle) x z_axis."""
    rows = np.flatnonzero(view.words("patches", "type") == "Cone")
    radius, angle = view.floats("patches", "radius")[rows], view.floats("patches", "angle")[rows]
    along = radius / np.tan(angle)
    base, axis = view.vectors("patches", "location")[rows], view.vectors("patches", "z_axis")[rows]
    distance = np.linalg.norm(
        view.vectors("patches", "apex")[rows] - (base - along[:, None] * axis), axis=1
    )
    size = view.diagonal + np.abs(along) + np.abs(base).max(axis=1, initial=0)
    yield Measure(distance, 1e-9 * size, lambda i: f"patch {rows[i]}")


@model_rule("foci", "foci of conics lie where their radii say", limit="1e-9 x diagonal", unit="mm")
def foci(view: ModelView) -> Iterator[Measure]:
    """Measure the distance of both foci to centre -+ c x_axis (parabola: + focal x_axis)."""
    types = view.words("curves", "type")
    a, b = view.floats("curves", "x_radius"), view.floats("curves", "y_radius")
    with np.errstate(invalid="ignore"):
        away = np.select(
            [types == "Ellipse", types == "Hyperbola"], [np.sqrt(a**2 - b**2), np.hypot(a, b)]
        )
    one, two = view.vectors("curves", "focus1"), view.vectors("curves", "focus2")
    centre, axis = view.vectors("curves", "location"), view.vectors("curves", "x_axis")
    rows = np.flatnonzero(np.isin(types, ("Ellipse", "Hyperbola")))
    reach = away[rows, None] * axis[rows]
    # which of both is the first is a convention; both must be there
    plus, minus = centre[rows] + reach, centre[rows] - reach
    straight = _farther(one[rows] - plus, two[rows] - minus)
    crossed = _farther(one[rows] - minus, two[rows] - plus)
    error = np.minimum(straight, crossed)
    yield Measure(error, 1e-9 * view.diagonal + 1e-12 * away[rows], lambda i: f"curve {rows[i]}")
    bowls = np.flatnonzero(types == "Parabola")
    focal = view.floats("curves", "focal")[bowls]
    error = np.linalg.norm(one[bowls] - centre[bowls] - focal[:, None] * axis[bowls], axis=1)
    yield Measure(error, 1e-9 * view.diagonal + 1e-12 * focal, lambda i: f"curve {bowls[i]}")


def _farther(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)))
