"""Transforms of samples. Each gets a generator of its own, keyed by (seed, epoch, model).

A transform takes a sample, any named tuple with `positions`, and returns a changed copy; normals
and curvatures follow where the sample has them.
"""

from __future__ import annotations

from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from breplake.errors import UsageError

__all__ = ["Drop", "Jitter", "Normalise", "Rotate", "Transform"]


class Transform(Protocol):
    """A function of a sample and random numbers; it must not use any other randomness."""

    def __call__(self, sample: Any, generator: np.random.Generator) -> Any:
        """Return a changed copy of `sample`."""
        ...


class Normalise:
    """Move a sample's centre to the origin and scale it to radius 1; curvatures scale along.

    Parameters
    ----------
    centre : str
        ``box`` for the middle of the bounding box, ``mean`` for the mean of the points.
    """

    def __init__(self, centre: Literal["box", "mean"] = "box") -> None:
        if centre not in ("box", "mean"):
            raise UsageError(f"centre is box or mean, got {centre!r}")
        self.centre = centre

    def __repr__(self) -> str:
        return f"Normalise(centre={self.centre!r})"

    def __call__(self, sample: Any, generator: np.random.Generator) -> Any:
        """Return the sample about the origin, within the unit ball."""
        points: Tensor = sample.positions  # (n, 3)
        if self.centre == "mean":
            middle = points.mean(dim=0)
        else:
            middle = (points.amin(dim=0) + points.amax(dim=0)) / 2
        moved = points - middle
        # a sample of one point has no size
        radius = moved.norm(dim=1).max().clamp_min(torch.finfo(points.dtype).tiny)
        changed = {"positions": moved / radius}
        if hasattr(sample, "curvatures"):
            changed["curvatures"] = sample.curvatures * radius
        return sample._replace(**changed)


class Rotate:
    """Turn a sample about the origin, evenly over all rotations or about one axis.

    Parameters
    ----------
    axis : str, optional
        ``x``, ``y`` or ``z``; any axis if not given.
    """

    def __init__(self, axis: Literal["x", "y", "z"] | None = None) -> None:
        if axis not in (None, "x", "y", "z"):
            raise UsageError(f"axis is x, y, z or None, got {axis!r}")
        self.axis = axis

    def __repr__(self) -> str:
        return f"Rotate(axis={self.axis!r})"

    def __call__(self, sample: Any, generator: np.random.Generator) -> Any:
        """Return the sample turned, its normals with it."""
        matrix = torch.from_numpy(self.matrix(generator))
        changed = {
            name: getattr(sample, name) @ matrix.T.to(getattr(sample, name).dtype)
            for name in ("positions", "normals")
            if hasattr(sample, name)
        }
        return sample._replace(**changed)

    def matrix(self, generator: np.random.Generator) -> npt.NDArray[np.float64]:
        """Return a random rotation, ``(3, 3)``."""
        if self.axis is None:
            quaternion = generator.normal(size=4)  # evenly spread directions of R^4
            return _rotation(quaternion / np.linalg.norm(quaternion))
        half = generator.uniform(0, np.pi)
        quaternion = np.zeros(4)
        quaternion[0], quaternion[1 + "xyz".index(self.axis)] = np.cos(half), np.sin(half)
        return _rotation(quaternion)


class Jitter:
    """Add normally distributed noise to the positions.

    Parameters
    ----------
    sigma : float
        Standard deviation in the unit of the positions: mm, or radii after `Normalise`.
    """

    def __init__(self, sigma: float) -> None:
        if not sigma >= 0:
            raise UsageError(f"sigma is at least 0, got {sigma}")
        self.sigma = sigma

    def __repr__(self) -> str:
        return f"Jitter({self.sigma})"

    def __call__(self, sample: Any, generator: np.random.Generator) -> Any:
        """Return the sample with noisy positions."""
        shape = tuple(sample.positions.shape)
        noise = torch.from_numpy(generator.standard_normal(shape, np.float32)) * self.sigma
        return sample._replace(positions=sample.positions + noise)


class Drop:
    """Leave out points of a point cloud, each with the same probability; at least one stays.

    Clouds then differ in size: collate them with `collate_padded` or `collate_ragged`.

    Parameters
    ----------
    share : float
        Probability of leaving out a point, at least 0 and below 1.
    """

    def __init__(self, share: float) -> None:
        if not 0 <= share < 1:
            raise UsageError(f"a share to drop is at least 0 and below 1, got {share}")
        self.share = share

    def __repr__(self) -> str:
        return f"Drop({self.share})"

    def __call__(self, sample: Any, generator: np.random.Generator) -> Any:
        """Return the sample with fewer points.

        Raises
        ------
        UsageError
            If it is no point cloud: the triangles of a mesh would lose their corners.
        """
        if hasattr(sample, "triangles"):
            raise UsageError("Drop is for point clouds: the triangles of a mesh need its vertices")
        n = len(sample.positions)
        kept = generator.random(n) >= self.share
        kept[generator.integers(n)] = True
        mask = torch.from_numpy(kept)
        return sample._replace(
            **{k: v[mask] for k, v in sample._asdict().items() if isinstance(v, Tensor)}
        )


def _rotation(q: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the rotation of a unit quaternion ``(w, x, y, z)``, ``(3, 3)``."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
