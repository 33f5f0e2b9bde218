"""Points on a model's trimmed patches and along its sharp curves: ``lake.sample(...)``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.errors import UsageError
from breplake.schema import ragged
from breplake.schema.arclength import CurveLengths
from breplake.schema.curves import CurveSet
from breplake.schema.trimming.patches import TrimmedPatches
from breplake.schema.trimming.sampling import UniformSampler

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["CurveSample", "Method", "PointSample", "check_request", "sample"]

Method = Literal["uniform", "poisson"]
"""Independent points, or points that keep their distance from each other."""

_Floats = npt.NDArray[np.float64]
_Ids = npt.NDArray[np.int32]

_TABLES: Final = ("patches", "curves", "coedges", "pcurves")
_CANDIDATES: Final = 5  # uniform points for each one that keeps its distance
_AREA_ERROR: Final = 1e-6  # more than enough to tell distances
_ON_PATCHES, _ON_CURVES = 0, 1  # streams of random numbers of one model


@dataclass(frozen=True, slots=True)
class CurveSample:
    """Points along sharp curves.

    Attributes
    ----------
    position : numpy.ndarray
        ``(m, 3)`` mm.
    tangent : numpy.ndarray
        ``(m, 3)`` unit, towards growing parameters.
    curve : numpy.ndarray
        ``(m,)`` int32 curve_id.
    t : numpy.ndarray
        ``(m,)`` parameter on the curve.
    """

    position: _Floats
    tangent: _Floats
    curve: _Ids
    t: _Floats

    def __len__(self) -> int:
        return len(self.curve)


@dataclass(frozen=True, slots=True)
class PointSample:
    """Points on the patches of a model.

    Attributes
    ----------
    model_id : int
        The model.
    position, normal : numpy.ndarray
        ``(n, 3)`` mm, and outward unit normal.
    k_min, k_max : numpy.ndarray
        ``(n,)`` 1/mm, principal curvatures, positive towards the normal.
    patch : numpy.ndarray
        ``(n,)`` int32 patch_id.
    u, v : numpy.ndarray
        ``(n,)`` parameters on the patch.
    curves : CurveSample or None
        Points along sharp curves, if they were asked for.
    omitted : tuple of int
        Patches without points because their surface or a curve around them cannot be
        evaluated; and sharp curves likewise in `omitted_curves`.
    """

    model_id: int
    position: _Floats
    normal: _Floats
    k_min: _Floats
    k_max: _Floats
    patch: _Ids
    u: _Floats
    v: _Floats
    curves: CurveSample | None = None
    omitted: tuple[int, ...] = ()
    omitted_curves: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.patch)


def check_request(
    n: int, method: str, seed: int, curves: int | None, spacing: float | None
) -> None:
    """Check what is asked of `sample`.

    Raises
    ------
    UsageError
        If a value is out of range, or both `curves` and `spacing` are given.
    """
    rules: tuple[tuple[bool, str, Any], ...] = (
        (n >= 1, "points must be at least 1", n),
        (method in get_args(Method), f"method must be {' or '.join(get_args(Method))}", method),
        (seed >= 0, "seed must not be negative", seed),
        (
            curves is None or curves >= 1,
            "points on curves must be at least 1",
            curves,
        ),
        (spacing is None or spacing > 0, "spacing must be more than 0 mm", spacing),
    )
    for holds, rule, value in rules:
        if not holds:
            raise UsageError(f"{rule}; got {value}")
    if curves is not None and spacing is not None:
        raise UsageError("give the number of points on curves or their spacing, not both")


def sample(
    lake: Lake,
    model: str | int,
    n: int,
    method: Method = "uniform",
    *,
    seed: int = 0,
    curves: int | None = None,
    spacing: float | None = None,
) -> PointSample:
    """Sample a model; see ``Lake.sample``."""
    check_request(n, method, seed, curves, spacing)
    model_id = int(lake.model(model)["model_id"])
    tables = {name: lake.read(name, model_id) for name in _TABLES}
    trimmed = TrimmedPatches.from_tables(**tables)
    random = _random(seed, model_id, _ON_PATCHES)
    row, u, v = _places(trimmed, n, method, random)
    position, normal, k_min, k_max = _evaluated(trimmed, tables["patches"], row, u, v)
    ids = ragged.identifiers(tables["patches"], "patch_id")
    along, unknown = None, np.zeros(0, dtype=np.int64)
    if curves is not None or spacing is not None:
        random = _random(seed, model_id, _ON_CURVES)
        along, unknown = _along(tables["curves"], curves, spacing, random)
    return PointSample(
        model_id,
        position,
        normal,
        k_min,
        k_max,
        ids[row].astype(np.int32),
        u,
        v,
        along,
        tuple(ids[~trimmed.known].tolist()),
        tuple(unknown.tolist()),
    )


def _random(seed: int, model_id: int, stream: int) -> np.random.Generator:
    """Return random numbers that depend on nothing but the arguments."""
    sequence = np.random.SeedSequence([seed, model_id], spawn_key=(stream,))
    return np.random.Generator(np.random.Philox(sequence))


def _places(
    trimmed: TrimmedPatches, n: int, method: Method, random: np.random.Generator
) -> tuple[npt.NDArray[np.int64], _Floats, _Floats]:
    """Draw rows of patches and parameters on them, ``(n,)`` each."""
    sampler = UniformSampler.of(trimmed)
    if method == "uniform":
        return sampler.draw(n, random)
    from breplake.queries.poisson import spread

    row, u, v = sampler.draw(_CANDIDATES * n, random)
    order = np.argsort(row, kind="stable")  # it is fastest where a patch's points follow each other
    row, u, v = row[order], u[order], v[order]
    points = trimmed.surfaces.points(row, u, v)
    area = float(np.nansum(np.abs(trimmed.area(_AREA_ERROR))))
    kept = spread(points.point, points.normal, n, area)
    return row[kept], u[kept], v[kept]


def _evaluated(
    trimmed: TrimmedPatches, patches: pa.Table, row: npt.NDArray[np.int64], u: _Floats, v: _Floats
) -> tuple[_Floats, _Floats, _Floats, _Floats]:
    """Return position, outward normal, k_min and k_max."""
    order = np.argsort(row, kind="stable")
    found = trimmed.surfaces.points(row[order], u[order], v[order])
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    normal, k_min, k_max = (a[back] for a in (found.normal, found.k_min, found.k_max))
    flipped = ragged.flags(patches, "reversed")[row]
    k_min, k_max = np.where(flipped, -k_max, k_min), np.where(flipped, -k_min, k_max)
    normal = np.where(flipped[:, None], -normal, normal)
    return np.ascontiguousarray(found.point[back]), normal, k_min, k_max


def _along(
    table: pa.Table, count: int | None, spacing: float | None, random: np.random.Generator
) -> tuple[CurveSample, npt.NDArray[np.int64]]:
    """Sample sharp curves; return also the ids of those that cannot be evaluated."""
    curves = CurveSet.from_curves(table)
    low, high = ragged.scalars(table, "t_min"), ragged.scalars(table, "t_max")
    known = curves.known & np.isfinite(low + high)
    sharp = ragged.flags(table, "sharp")
    row = np.flatnonzero(sharp & known)
    ids = ragged.identifiers(table, "curve_id")
    lengths = CurveLengths.of(curves, row, low[row], high[row])
    which, t = lengths.at(_distances(lengths, count, spacing, random))
    jet = curves.evaluate(row[which], t)
    with np.errstate(divide="ignore", invalid="ignore"):  # no tangent where a curve stands still
        tangent = jet.d1 / np.linalg.norm(jet.d1, axis=1, keepdims=True)
    found = CurveSample(
        np.ascontiguousarray(jet.point),
        np.ascontiguousarray(tangent),
        ids[row[which]].astype(np.int32),
        t,
    )
    return found, ids[sharp & ~known]


def _distances(
    lengths: CurveLengths, count: int | None, spacing: float | None, random: np.random.Generator
) -> _Floats:
    """Return where along all curves points are wanted, mm from the start of the first."""
    total = float(lengths.offset[-1])
    if not total > 0:
        return np.zeros(0)
    if count is not None:
        return np.sort(random.random(count)) * total
    assert spacing is not None  # one of the two is given
    steps = np.ceil(lengths.length / spacing).astype(np.int64)
    curve = np.repeat(np.arange(len(steps)), steps)
    place = np.arange(len(curve)) - (np.cumsum(steps) - steps)[curve]
    return np.asarray(lengths.offset[curve] + (place + 0.5) / steps[curve] * lengths.length[curve])
