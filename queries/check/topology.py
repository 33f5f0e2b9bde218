"""Rules on how curves bound patches: coedges, loops and sides."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from breplake.queries.check.rules import Measure, model_rule, place
from breplake.queries.check.view import MISSING, Ints, ModelView

__all__ = ["loop_numbers", "next_in_loop"]

_NEEDS = ("ids-dense", "references", "words")


@model_rule(
    "loops",
    "loops of a patch and places in a loop are numbered 0 .. n-1",
    needs=_NEEDS,
    share=0.001,
    source=True,
)
def loops(view: ModelView) -> Iterator[Measure]:
    """Measure each coedge's numbers, and patches.n_loops."""
    patch, loop, number = (view.ints("coedges", c) for c in ("patch_id", "loop", "place"))
    new_patch = np.diff(patch, prepend=-1) != 0
    new_loop = new_patch | (np.diff(loop, prepend=-1) != 0)
    before_loop, before = np.roll(loop, 1), np.roll(number, 1)
    right_loop = np.where(new_patch, loop == 0, (loop == before_loop) | (loop == before_loop + 1))
    right_place = np.where(new_loop, number == 0, number == before + 1)
    yield Measure.of_truth(
        right_loop & right_place,
        place("coedges row {i}: patch {0}, loop {1}, place {2}", patch, loop, number),
    )
    found = np.bincount(patch[new_loop], minlength=view.count("patches"))
    stated = view.ints("patches", "n_loops")
    yield Measure.of_truth(
        found == stated, place("patch {i}: {0} loops, n_loops {1}", found, stated)
    )


@model_rule(
    "sides",
    "left_patch, right_patch and n_patches of a curve are those of its coedges",
    needs=_NEEDS,
)
def sides(view: ModelView) -> Iterator[Measure]:
    """Measure both sides against the coedges that run along and against the curve."""
    curve, patch = view.ints("coedges", "curve_id"), view.ints("coedges", "patch_id")
    against, count = view.flags("coedges", "reversed"), view.count("curves")
    width = max(view.count("patches"), 1)
    pairs = np.unique(curve * width + patch)
    number = np.bincount(pairs // width, minlength=count)
    stated = view.ints("curves", "n_patches")
    yield Measure.of_truth(
        number == stated, lambda i: f"curve {i}: {number[i]} patches, n_patches {stated[i]}"
    )
    for column, chosen in (("left_patch", ~against), ("right_patch", against)):
        side = view.ints("curves", column)
        known = np.unique(curve[chosen] * width + patch[chosen])
        any_there = np.bincount(curve[chosen], minlength=count) > 0
        listed = np.isin(np.arange(count) * width + side, known)
        ok = np.where(side == MISSING, ~any_there, listed)
        yield Measure.of_truth(ok, place("curve {i}: {c} {0}", side, c=column))


@model_rule("curve-kinds", "the kind of a curve fits its coedges", needs=_NEEDS)
def curve_kinds(view: ModelView) -> Iterator[Measure]:
    """Measure kinds against the number of patches and uses.

    ``free`` has no patch, a seam one that uses it twice, a boundary one that uses it once,
    sharp and smooth curves two patches, nonmanifold ones more than two uses.
    """
    kinds = view.words("curves", "kind")
    patches = view.ints("curves", "n_patches")
    uses = np.bincount(view.ints("coedges", "curve_id"), minlength=view.count("curves"))
    rules: dict[str, NDArray[np.bool_]] = {
        "free": patches == 0,
        "seam": (patches == 1) & (uses == 2),
        "boundary": (patches == 1) & (uses == 1),
        "sharp": (patches == 2) & (uses == 2),
        "smooth": (patches == 2) & (uses == 2),
        "nonmanifold": uses > 2,
    }
    for kind, right in rules.items():
        rows = np.flatnonzero(kinds == kind)
        yield Measure.of_truth(
            right[rows],
            place("curve {0}: {k}, {1} patches, {2} uses", rows, patches[rows], uses[rows], k=kind),
        )


@model_rule(
    "loops-close",
    "each coedge of a loop ends at the corner where the next one starts",
    needs=_NEEDS,
    share=0.001,
    source=True,
)
def loops_close(view: ModelView) -> Iterator[Measure]:
    """Measure each loop, walked in either direction; curves without corners are left out."""
    curve = view.ints("coedges", "curve_id")
    against = view.flags("coedges", "reversed")
    first, last = (
        view.ints("curves", "start_corner")[curve],
        view.ints("curves", "end_corner")[curve],
    )
    start, stop = np.where(against, last, first), np.where(against, first, last)
    loop = loop_numbers(view)
    after = next_in_loop(loop)
    whole = (start != MISSING) & (stop != MISSING)
    checked = whole & whole[after] if len(loop) else whole
    forward, backward = (stop == start[after]) | ~checked, (start == stop[after]) | ~checked
    count = int(loop[-1]) + 1 if len(loop) else 0
    broken = np.minimum(
        np.bincount(loop, ~forward, minlength=count), np.bincount(loop, ~backward, minlength=count)
    )
    patch, number = view.ints("coedges", "patch_id"), view.ints("coedges", "loop")
    head = np.searchsorted(loop, np.arange(count))
    yield Measure.of_truth(broken == 0, lambda i: f"patch {patch[head[i]]}, loop {number[head[i]]}")


def loop_numbers(view: ModelView) -> Ints:
    """Return a number for each loop of a model, ``(n_coedges,)``."""
    patch, loop = view.ints("coedges", "patch_id"), view.ints("coedges", "loop")
    new = (np.diff(patch, prepend=-1) != 0) | (np.diff(loop, prepend=-1) != 0)
    return np.asarray(np.cumsum(new) - 1)


def next_in_loop(loop: Ints) -> Ints:
    """Return for each coedge the row of the next one, the last leading back to the first."""
    rows = np.arange(len(loop))
    after = rows + 1
    ends = np.flatnonzero(np.diff(loop, append=-1) != 0)
    after[ends] = np.searchsorted(loop, loop[ends])
    return after
