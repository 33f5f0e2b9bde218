"""Foot points on surfaces: a batched, damped Newton iteration."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from breplake.errors import UsageError
from breplake.schema.jets import SurfaceJet
from breplake.schema.namespace import Bools, Floats, Ints

__all__ = ["project_points"]

_ROUNDS = 60  # Newton needs about five; damped steps some more
_STEADY = 1e-15  # a step this short, relative to the coordinates, changes nothing
_LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e9
_BATCH = 262_144  # points projected together, some hundred bytes each
_ROUNDING = 4 * np.finfo(np.float64).eps


def project_points(
    evaluate: Callable[[Ints, Floats, Floats], SurfaceJet],
    row: Ints,
    points: ArrayLike,
    u0: Floats,
    v0: Floats,
    bounds: ArrayLike | None,
) -> tuple[Floats, Floats, Floats]:
    """Move (u, v) downhill until p(u, v) is as near to each point as it gets.

    Parameters and results are those of ``SurfaceSet.project``.

    Raises
    ------
    UsageError
        If the shapes do not match.
    """
    count = len(row)
    target = np.asarray(points, dtype=np.float64)
    if target.shape != (count, 3):
        raise UsageError(f"points must be ({count}, 3) like the rows, got {target.shape}")
    box = _box(bounds, count)
    place, distance = np.clip(np.stack([u0, v0]), box[0::2], box[1::2]), np.empty(count)
    for start in range(0, count, _BATCH):
        part = slice(start, start + _BATCH)
        state = _Descent(evaluate, row[part], target[part], place[:, part], box[:, part])
        with np.errstate(over="ignore", invalid="ignore"):  # such a step is taken back
            for _ in range(_ROUNDS):
                if not state.round():
                    break
        place[:, part], distance[part] = state.place, state.distance
    return place[0], place[1], distance


def _box(bounds: ArrayLike | None, count: int) -> Floats:
    """Return bounds as ``(4, n)``."""
    if bounds is None:
        bounds = [-np.inf, np.inf, -np.inf, np.inf]
    box = np.asarray(bounds, dtype=np.float64)
    if box.shape not in {(4,), (count, 4)}:
        raise UsageError(f"bounds must be (4,) or ({count}, 4), got {box.shape}")
    return np.ascontiguousarray(np.broadcast_to(box, (count, 4)).T)


class _Descent:
    """Where the search for foot points stands.

    A round takes a Newton step, or a Gauss-Newton one where the squared distance is not
    convex. A step that does not bring the point nearer is taken back and damped more.
    """

    def __init__(
        self,
        evaluate: Callable[[Ints, Floats, Floats], SurfaceJet],
        row: Ints,
        target: Floats,
        place: Floats,
        box: Floats,
    ) -> None:
        self.evaluate, self.row, self.target, self.box = evaluate, row, target, box
        self.place = place.copy()  # (2, n)
        self.model, self.distance = _model(evaluate(row, *place), target)
        self.damping = np.zeros(len(row))
        self.active = np.flatnonzero(np.isfinite(self.distance))
        self.size = np.abs(target).max(axis=1, initial=0) + self.distance

    def round(self) -> bool:
        """Try one step at every point that still moves; return whether any does."""
        active = self.active
        start, box = self.place[:, active], self.box[:, active]
        model = _held(self.model[:, active], start, box)
        step = _step(model, self.damping[active])
        # A foot point is at most twice as far from the start as the start is from the point.
        reach = 4 * self.distance[active] / np.maximum(_moved(model, step), 1e-300)
        trial = np.clip(start + np.minimum(reach, 1.0) * step, box[0::2], box[1::2])
        moving = _moved(model, trial - start) > _STEADY * self.size[active]
        moving &= self.damping[active] < _MOST_DAMPING
        active, trial, model = active[moving], trial[:, moving], model[:, moving]
        self.active = active
        if not len(active):
            return False
        reached, distance = _model(self.evaluate(self.row[active], *trial), self.target[active])
        flatter = _steepness(_held(reached, trial, self.box[:, active])) < _steepness(model)
        same = distance <= self.distance[active] * (1 + _ROUNDING)
        better = (distance < self.distance[active]) | (same & flatter)
        won, lost = active[better], active[~better]
        self.place[:, won], self.distance[won] = trial[:, better], distance[better]
        self.model[:, won] = reached[:, better]
        eased = self.damping[won] / 16
        self.damping[won] = np.where(eased < _LEAST_DAMPING, 0.0, eased)
        self.damping[lost] = np.maximum(self.damping[lost] * 16, _LEAST_DAMPING)
        return True


def _model(jet: SurfaceJet, target: Floats) -> tuple[Floats, Floats]:
    """Return the quadratic model of half the squared distance, and the distance.

    Returns
    -------
    model : numpy.ndarray
        ``(8, n)``: gradient (2), matrix uu, uv, vv to step with, and metric uu, uv, vv.
    distance : numpy.ndarray
        ``(n,)``.
    """
    away = jet.point - target

    def dots(a: Floats, b: Floats) -> Floats:
        return np.asarray(np.einsum("ij,ij->i", a, b))

    metric = np.stack([dots(jet.du, jet.du), dots(jet.du, jet.dv), dots(jet.dv, jet.dv)])
    bend = np.stack([dots(away, jet.duu), dots(away, jet.duv), dots(away, jet.dvv)])
    newton = metric + bend
    convex = (newton[0] > 0) & (newton[0] * newton[2] > 1.0001 * newton[1] ** 2)
    gradient = np.stack([dots(away, jet.du), dots(away, jet.dv)])
    model = np.concatenate([gradient, np.where(convex, newton, metric), metric])
    return model, np.sqrt(dots(away, away))


def _held(model: Floats, place: Floats, box: Floats) -> Floats:
    """Return the model without the directions in which the bounds stop the descent."""
    stopped: Bools = ((place <= box[0::2]) & (model[:2] > 0)) | (
        (place >= box[1::2]) & (model[:2] < 0)
    )
    model = model.copy()
    model[:2] = np.where(stopped, 0.0, model[:2])
    model[3] = np.where(stopped.any(axis=0), 0.0, model[3])
    return model


def _step(model: Floats, damping: Floats) -> Floats:
    """Solve for the damped step ``(2, n)``; along single axes where the matrix is singular."""
    gradient, (uu, uv, vv), metric = model[:2], model[2:5], model[5:8]
    uu, vv = uu + damping * metric[0], vv + damping * metric[2]
    determinant = uu * vv - uv * uv
    regular = (determinant > 1e-14 * np.abs(uu * vv)) & (uu > 0)
    safe = np.where(regular, determinant, 1.0)
    full = np.stack([uv * gradient[1] - vv * gradient[0], uv * gradient[0] - uu * gradient[1]])
    diagonal = np.stack([uu, vv])
    single = -gradient / np.where(diagonal > 0, diagonal, 1.0)
    return np.where(regular, full / safe, np.where(diagonal > 0, single, 0.0))


def _moved(model: Floats, step: Floats) -> Floats:
    """Return at most how far a step moves the point along the surface, mm, ``(n,)``."""
    paths = np.sqrt(model[5:8:2]) * np.abs(step)
    return np.asarray(paths[0] + paths[1])


def _steepness(model: Floats) -> Floats:
    """Return the squared slope of the distance per mm along u and v, ``(n,)``."""
    diagonal = model[5:8:2]
    slope: Floats = model[:2] ** 2 / np.where(diagonal > 0, diagonal, 1.0)
    return np.asarray(slope[0] + slope[1])
