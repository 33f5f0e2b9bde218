"""From a z-buffer to a picture: light, curves, outlines, and smooth edges by averaging."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from breplake.queries.picture_raster import Camera, Depths, rasterise
from breplake.queries.picture_scene import COLOURS, Scene
from breplake.schema.types import SURFACE_TYPES

__all__ = ["DEFAULT_VIEW", "render"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Picture = NDArray[np.float32]

DEFAULT_VIEW: Final = (-52.0, 28.0)
"""Azimuth and elevation of the eye, degrees."""

_SAMPLES: Final = 3  # squared, the samples of a pixel
_INK: Final = np.array([0.10, 0.13, 0.18], dtype=np.float32)
_PALETTE: Final = np.array(
    [[int(COLOURS[t][i : i + 2], 16) / 255 for i in (1, 3, 5)] for t in SURFACE_TYPES]
)
# directions to the lights in the axes of the camera: right, up, to the eye
_KEY: Final = np.array([-0.45, 0.60, 0.66])
_FILL: Final = np.array([0.80, 0.15, 0.58])
_DIRECTIONS: Final = 8  # in which hollows are looked for


def render(
    scene: Scene, width: int, height: int, view: tuple[float, float] | None = None
) -> Picture:
    """Draw a scene on white.

    Parameters
    ----------
    scene : Scene
        The model.
    width, height : int
        Pixels.
    view : tuple of float, optional
        Azimuth and elevation of the eye in degrees, by default `DEFAULT_VIEW`.

    Returns
    -------
    numpy.ndarray
        ``(height, width, 3)`` float32, 0 to 1.
    """
    fine = width * _SAMPLES, height * _SAMPLES
    camera = Camera.fit(scene.points, view or DEFAULT_VIEW, *fine)
    points = camera.project(scene.points)
    depths = rasterise(points[scene.triangles], *fine, cull=scene.closed)
    line = max(min(width, height) / 600, 0.6) * _SAMPLES
    weak = _mean(_lines(depths, points[scene.weak], 0.55 * line))
    strong = _mean(_lines(depths, points[scene.strong], line) | _outline(depths, line))
    shade = _shade(scene, camera, depths)  # (height, width, 3)
    seen = _mean(depths.triangle >= 0)
    shade *= (1 - 0.75 * _hollows(depths, seen))[:, :, None]
    picture = shade * seen[:, :, None] + (1 - seen)[:, :, None]
    for ink, strength in ((weak, 0.30), (strong, 0.95)):
        cover = strength * ink[:, :, None]
        picture = picture * (1 - cover) + _INK * cover
    return np.asarray(np.clip(picture, 0, 1), dtype=np.float32)


def _mean(fine: NDArray[np.bool_] | Picture) -> Picture:
    """Average the samples of each pixel."""
    height, width = fine.shape[0] // _SAMPLES, fine.shape[1] // _SAMPLES
    blocks = fine.reshape(height, _SAMPLES, width, _SAMPLES)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))


def _shade(scene: Scene, camera: Camera, depths: Depths) -> Picture:
    """Return the mean colour of the samples of each pixel that show the model."""
    normals = scene.corner_normals @ camera.axes.T  # (f, 3, 3) in the axes of the camera
    height, width = (x // _SAMPLES for x in depths.triangle.shape)
    picture = np.zeros((height * width, 3), dtype=np.float32)
    rows, columns = _samples(scene, depths)
    total = np.bincount((rows // _SAMPLES) * width + columns // _SAMPLES, minlength=height * width)
    for start in range(0, len(rows), 1 << 19):
        some = slice(start, start + (1 << 19))
        row, column = rows[some], columns[some]
        triangle = depths.triangle[row, column]
        weights = depths.weights(row, column)
        normal = np.einsum("nc,nci->ni", weights, normals[triangle])
        colour = _light(normal, _PALETTE[scene.kinds[triangle]])
        pixel = (row // _SAMPLES) * width + column // _SAMPLES
        first, last = pixel.min(), pixel.max() + 1  # a few rows of the picture
        for channel in range(3):
            picture[first:last, channel] += np.bincount(
                pixel - first, colour[:, channel], minlength=last - first
            )
    picture /= np.maximum(total, 1)[:, None]
    return picture.reshape(height, width, 3)


def _samples(scene: Scene, depths: Depths) -> tuple[Ints, Ints]:
    """Return row and column of the samples to shade: one where all of a pixel show one patch."""
    height, width = (x // _SAMPLES for x in depths.triangle.shape)
    patch = np.append(scene.patches, -1)[depths.triangle]  # triangle -1 is nothing
    blocks = patch.reshape(height, _SAMPLES, width, _SAMPLES)
    alike = blocks.min(axis=(1, 3)) == blocks.max(axis=(1, 3))
    chosen = np.repeat(np.repeat(~alike, _SAMPLES, axis=0), _SAMPLES, axis=1)
    middle = slice(_SAMPLES // 2, None, _SAMPLES)
    chosen[middle, middle] |= alike
    rows, columns = np.nonzero(chosen & (patch >= 0))
    return rows, columns


def _light(normal: Floats, colour: Floats) -> Floats:
    """Light surfaces of normals ``(n, 3)``, in the axes of the camera, and colours ``(n, 3)``."""
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    normal = np.where(normal[:, 2:] < 0, -normal, normal)  # the back of an open sheet
    half = _KEY + np.array([0.0, 0.0, 1.0])
    key = np.maximum(normal @ (_KEY / np.linalg.norm(_KEY)), 0)
    fill = np.maximum(normal @ (_FILL / np.linalg.norm(_FILL)), 0)
    front = normal[:, 2]
    gloss = np.maximum(normal @ (half / np.linalg.norm(half)), 0) ** 60
    light = 0.42 + 0.46 * key + 0.20 * fill + 0.14 * front
    return np.asarray(colour * light[:, None] + 0.16 * gloss[:, None])


def _lines(depths: Depths, segments: Floats, width: float) -> NDArray[np.bool_]:
    """Draw the parts of segments ``(k, 2, 3)`` that no triangle hides.

    Whether a place on a curve is seen is decided at its middle, so that lines keep their
    width where they bound the body.
    """
    height, columns = depths.triangle.shape
    ink = np.zeros((height, columns), dtype=bool)
    if not len(segments):
        return ink
    count = np.ceil(np.abs(np.diff(segments[:, :, :2], axis=1)).max(axis=(1, 2))).astype(int) + 1
    which = np.repeat(np.arange(len(segments)), count)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)) / count[which]
    points = segments[which, 0] + share[:, None] * (segments[which, 1] - segments[which, 0])
    x, y = points[:, 0].astype(int), points[:, 1].astype(int)
    inside = (x >= 1) & (x < columns - 1) & (y >= 1) & (y < height - 1)
    x, y, z = x[inside], y[inside], points[inside, 2]
    # the farthest surface around the pixel, so that steep ones do not hide their own rim
    around = np.full(len(z), -np.inf)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            depth = depths.depth[y + dy, x + dx]
            around = np.maximum(around, np.where(np.isfinite(depth), depth, -np.inf))
    seen = (z <= around + 1.5) | np.isneginf(around)
    return _stamp(ink, x[seen], y[seen], width / 2)


def _stamp(
    ink: NDArray[np.bool_], x: NDArray[np.int64], y: NDArray[np.int64], radius: float
) -> NDArray[np.bool_]:
    """Put a disc at each place."""
    reach = int(np.ceil(radius))
    height, width = ink.shape
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            if dx * dx + dy * dy <= radius * radius:
                ink[np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)] = True
    return ink


def _outline(depths: Depths, width: float) -> NDArray[np.bool_]:
    """Find where the body ends or steps back behind itself."""
    step = 0.012 * float(np.hypot(*depths.depth.shape))
    depth = np.minimum(depths.depth, np.float32(1e9))
    ink = np.zeros(depth.shape, dtype=bool)
    ink[:, 1:] |= np.abs(depth[:, 1:] - depth[:, :-1]) > step
    ink[1:] |= np.abs(depth[1:] - depth[:-1]) > step
    y, x = np.nonzero(ink)
    return _stamp(ink, x, y, 0.4 * width)


def _hollows(depths: Depths, seen: Picture) -> Picture:
    """Return how deep each pixel lies in a hollow, 0 to 1: darkened, bores and steps show.

    A pixel is hollow in a direction as far as it lies behind the middle of two places on
    either side of it; a plane, however steep, is hollow nowhere.
    """
    filled = np.where(np.isfinite(depths.depth), depths.depth, 0).astype(np.float32)
    depth = np.where(seen > 0.99, _mean(filled), np.nan).astype(np.float32)
    total = np.zeros_like(seen)
    radii = [max(share * min(seen.shape), 1.0) for share in (0.004, 0.010, 0.022)]
    for radius in radii:
        for angle in np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS:
            x, y = (round(float(radius * f(angle))) for f in (np.cos, np.sin))
            total += _between(depth, x, y, 0.7 * radius * _SAMPLES)
    mean = (total / (len(radii) * _DIRECTIONS)).astype(np.float32)
    return _blur(mean, max(round(radii[0] / 2), 1))


def _between(depth: Picture, x: int, y: int, full: float) -> Picture:
    """Return how far depths lie behind the middle of those at (x, y) and (-x, -y), in `full`."""
    height, width = depth.shape
    hollow = np.zeros_like(depth)
    here = (slice(y, height - y), slice(abs(x), width - abs(x)))
    one = depth[2 * y :, abs(x) + x : width - abs(x) + x]
    two = depth[: height - 2 * y, abs(x) - x : width - abs(x) - x]
    behind = (depth[here] - 0.5 * (one + two)) / np.float32(full)
    hollow[here] = np.clip(np.nan_to_num(behind, nan=0.0), 0, 1)  # NaN: nothing there
    return hollow


def _blur(picture: Picture, reach: int) -> Picture:
    """Average over squares twice."""
    for _ in range(2):
        for axis in (0, 1):
            padding = [(reach + 1, reach) if a == axis else (0, 0) for a in (0, 1)]
            sums = np.cumsum(np.pad(picture, padding, mode="edge"), axis=axis, dtype=np.float64)
            stop = [slice(2 * reach + 1, None) if a == axis else slice(None) for a in (0, 1)]
            start = [slice(None, -2 * reach - 1) if a == axis else slice(None) for a in (0, 1)]
            mean = (sums[tuple(stop)] - sums[tuple(start)]) / (2 * reach + 1)
            picture = mean.astype(np.float32)
    return picture
