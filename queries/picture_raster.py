"""A z-buffer in numpy: which triangle is seen at each pixel, and how deep.

No graphics library, driver or display is needed, so pictures come out the same on a bare
server as on a desk.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["Camera", "Depths", "rasterise"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_NOTHING: Final = np.uint64(2**64 - 1)
_STEPS: Final = 2.0**31  # depth is kept in so many steps
_HALVES: Final = (0, 1) if sys.byteorder == "little" else (1, 0)
_TILES: Final = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)  # sides of tiles, pixels
_LARGE: Final = _TILES[-1]  # triangles larger than this are drawn one by one
_FRAGMENTS: Final = 1 << 20  # pixels that are tested at once


@dataclass(frozen=True, slots=True)
class Camera:
    """A parallel projection that fits points into a picture.

    Parameters
    ----------
    axes : numpy.ndarray
        ``(3, 3)`` rows: to the right, upwards, and towards the eye.
    centre : numpy.ndarray
        ``(2,)`` the place in the first two axes that is shown in the middle.
    scale : float
        Pixels in a mm.
    width, height : int
        Pixels.
    """

    axes: Floats
    centre: Floats
    scale: float
    width: int
    height: int

    @classmethod
    def fit(cls, points: Floats, view: tuple[float, float], width: int, height: int) -> Camera:
        """Look at points ``(n, 3)`` from azimuth and elevation in degrees, with a margin of 3 %."""
        turn, rise = np.radians(view)
        right = np.array([-np.sin(turn), np.cos(turn), 0.0])
        eye = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        axes = np.stack([right, np.cross(eye, right), eye])
        flat = points @ axes[:2].T
        low, high = flat.min(axis=0), flat.max(axis=0)
        size = np.maximum(high - low, 1e-12 + 1e-9 * float(np.abs(flat).max()))
        scale = 0.94 * float(min(width / size[0], height / size[1]))
        return cls(axes, (low + high) / 2, scale, width, height)

    def project(self, points: Floats) -> Floats:
        """Return x to the right, y downwards, depth away from the eye, all in pixels ``(n, 3)``."""
        seen = points @ self.axes.T
        return np.stack(
            [
                (seen[:, 0] - self.centre[0]) * self.scale + self.width / 2,
                (self.centre[1] - seen[:, 1]) * self.scale + self.height / 2,
                -seen[:, 2] * self.scale,
            ],
            axis=1,
        )


@dataclass(frozen=True, slots=True)
class Depths:
    """What a z-buffer holds in the end.

    Parameters
    ----------
    triangle : numpy.ndarray
        ``(height, width)`` triangle seen at the pixel, -1 for none.
    depth : numpy.ndarray
        ``(height, width)`` float32 depth in pixels, infinite where there is none.
    planes : numpy.ndarray
        ``(f, 3, 3)`` coefficients of x, y and 1 for the weight of each corner.
    """

    triangle: NDArray[np.int32]
    depth: NDArray[np.float32]
    planes: Floats

    def weights(self, rows: Ints, columns: Ints) -> Floats:
        """Return the weight of each corner of the triangles seen at pixels, ``(n, 3)``."""
        planes = self.planes[self.triangle[rows, columns]]  # (n, 3, 3)
        return np.asarray(
            planes[:, :, 0] * (columns + 0.5)[:, None]
            + planes[:, :, 1] * (rows + 0.5)[:, None]
            + planes[:, :, 2]
        )


def rasterise(corners: Floats, width: int, height: int, *, cull: bool) -> Depths:
    """Draw triangles into a z-buffer.

    Parameters
    ----------
    corners : numpy.ndarray
        ``(f, 3, 3)`` corners as `Camera.project` gives them.
    width, height : int
        Pixels.
    cull : bool
        Leave out triangles whose back is seen: of a closed body, they are hidden anyway.
    """
    planes, area = _planes(corners)
    # y points downwards, so a triangle that is counter-clockwise to the eye has area < 0
    drawn = (area < 0) if cull else (area != 0)
    near, far = (corners[:, :, 2].min(initial=np.inf), corners[:, :, 2].max(initial=-np.inf))
    span = max(far - near, 1e-12) if len(corners) else 1.0
    depth = np.einsum("fcj,fc->fj", planes, (corners[:, :, 2] - near) / span)  # (f, 3)
    buffer = np.full(height * width, _NOTHING)
    box = _boxes(corners, width, height)
    drawn &= (box[:, 2] > box[:, 0]) & (box[:, 3] > box[:, 1])
    size = np.maximum(box[:, 2] - box[:, 0], box[:, 3] - box[:, 1])
    for some, side in _batches(np.flatnonzero(drawn & (size <= _LARGE)), size):
        _draw_small(buffer, width, planes, depth, box, some, side)
    for one in np.flatnonzero(drawn & (size > _LARGE)):
        _draw_large(buffer.reshape(height, width), planes[one], depth[one], box[one], int(one))
    codes = buffer.view(np.uint32).reshape(height, width, 2)
    low, high = (codes[:, :, place] for place in _HALVES)
    triangle = low.astype(np.int32)  # all bits set is -1
    z = high * np.float32(span / _STEPS) + np.float32(near)
    z[triangle < 0] = np.inf
    return Depths(triangle, z, planes)


def _planes(corners: Floats) -> tuple[Floats, Floats]:
    """Return corner weights as functions of x, y, 1 ``(f, 3, 3)``, and twice the signed areas."""
    x, y = corners[:, :, 0], corners[:, :, 1]
    x1, y1 = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    x2, y2 = np.roll(x, -2, axis=1), np.roll(y, -2, axis=1)
    planes = np.stack([y1 - y2, x2 - x1, x1 * y2 - x2 * y1], axis=2)
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    return planes / np.where(area == 0, 1.0, area)[:, None, None], area


def _boxes(corners: Floats, width: int, height: int) -> Ints:
    """Return first and last pixel of each triangle, x0 y0 x1 y1 ``(f, 4)``, the last excluded."""
    low = np.floor(corners[:, :, :2].min(axis=1))
    high = np.ceil(corners[:, :, :2].max(axis=1)) + 1
    box = np.concatenate([low, high], axis=1)
    limits = np.array([width, height, width, height])
    return np.asarray(np.clip(box, 0, limits), dtype=np.int64)


def _batches(triangles: Ints, size: Ints) -> Iterator[tuple[Ints, int]]:
    """Yield triangles of like size, as many as can be tested at once, and the side of a tile."""
    least = 0
    for side in _TILES:
        fits = triangles[(size[triangles] > least) & (size[triangles] <= side)]
        step = max(_FRAGMENTS // side**2, 1)
        for start in range(0, len(fits), step):
            yield fits[start : start + step], side
        least = side


def _draw_small(
    buffer: NDArray[np.uint64],
    width: int,
    planes: Floats,
    depth: Floats,
    box: Ints,
    some: Ints,
    side: int,
) -> None:
    """Test a tile of side x side pixels at the corner of each triangle's box."""
    x0, y0, x1, y1 = box[some].T
    step = np.arange(side, dtype=np.float32)
    inside = (step < (y1 - y0)[:, None])[:, :, None] & (step < (x1 - x0)[:, None])[:, None, :]
    for corner in range(3):
        a, b, c = planes[some, corner].T
        # from the tile's own corner the numbers are small, and single precision will do
        first = (a * (x0 + 0.5) + b * (y0 + 0.5) + c).astype(np.float32)
        across = a.astype(np.float32)[:, None] * step  # (k, side)
        down = b.astype(np.float32)[:, None] * step + first[:, None]
        inside &= down[:, :, None] >= -1e-5 - across[:, None, :]
    which, row, column = np.nonzero(inside)
    x, y = x0[which] + column, y0[which] + row
    z = depth[some]
    value = z[which, 0] * (x + 0.5) + z[which, 1] * (y + 0.5) + z[which, 2]
    np.minimum.at(buffer, y * width + x, _codes(value, some[which]))


def _draw_large(
    buffer: NDArray[np.uint64], planes: Floats, depth: Floats, box: Ints, triangle: int
) -> None:
    """Test all pixels of one triangle's box."""
    x0, y0, x1, y1 = box
    x, y = np.arange(x0, x1) + 0.5, (np.arange(y0, y1) + 0.5)[:, None]
    inside = np.ones((y1 - y0, x1 - x0), dtype=bool)
    for a, b, c in planes:
        inside &= (b * y + c) + a * x >= -1e-9
    value = (depth[1] * y + depth[2]) + depth[0] * x
    part = buffer[y0:y1, x0:x1]
    codes = _codes(value, np.int64(triangle))
    np.minimum(part, np.where(inside, codes, _NOTHING), out=part)


def _codes(depth: Floats, triangle: Ints | np.int64) -> NDArray[np.uint64]:
    """Pack depth (0 to 1) and triangle into one number, so that the nearest is the least."""
    steps = np.clip(depth, 0.0, 1.0) * (_STEPS - 1)
    return np.asarray(
        (steps.astype(np.uint64) << np.uint64(32)) | np.uint64(1) * triangle.astype(np.uint64)
    )
