"""Pictures: the z-buffer on shapes whose image is known, and whole pages."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from breplake.errors import MissingExtraError, NameNotFoundError, UsageError
from breplake.queries.picture import draw_model, draw_sheet
from breplake.queries.picture_raster import Camera, rasterise
from breplake.queries.picture_scene import COLOURS, Scene
from breplake.queries.picture_shade import render
from breplake.queries.session import Lake
from breplake.schema.types import SURFACE_TYPES


@pytest.fixture
def lake(hand_lake: Path) -> Lake:
    return Lake(hand_lake)


def read_png(path: Path) -> np.ndarray:
    from matplotlib.image import imread

    return np.asarray(imread(path))[:, :, :3]


def triangle(*corners: tuple[float, float, float]) -> np.ndarray:
    return np.array([corners], dtype=float)


def test_covered_area() -> None:
    depths = rasterise(triangle((10, 10, 0), (10, 90, 0), (90, 10, 0)), 100, 100, cull=False)
    assert np.count_nonzero(depths.triangle == 0) == pytest.approx(3200, rel=0.02)
    assert depths.triangle[20, 20] == 0
    assert depths.triangle[80, 80] == -1
    assert np.isinf(depths.depth[80, 80])


@pytest.mark.parametrize("size", [60.0, 600.0])
def test_the_nearer_triangle_is_seen(size: float) -> None:
    """Small triangles are drawn in batches, large ones one by one: both keep to the depth."""
    near = triangle((0, 0, 5), (0, size, 5), (size, 0, 5))
    far = triangle((0, 0, 9), (0, size, 9), (size, 0, 9))
    for corners, front in ((np.concatenate([near, far]), 0), (np.concatenate([far, near]), 1)):
        depths = rasterise(corners, 50, 50, cull=False)
        assert depths.triangle[10, 10] == front
        assert depths.depth[10, 10] == pytest.approx(5, abs=1e-6)


def test_crossing_triangles_share_the_picture() -> None:
    one = triangle((0, 0, 0), (0, 100, 0), (100, 0, 10))
    two = triangle((0, 0, 10), (0, 100, 10), (100, 0, 0))
    depths = rasterise(np.concatenate([one, two]), 100, 100, cull=False)
    assert depths.triangle[10, 30] == 0
    assert depths.triangle[10, 70] == 1


def test_backs_are_left_out() -> None:
    front = triangle((0, 0, 0), (0, 50, 0), (50, 0, 0))  # y points downwards
    back = front[:, ::-1]
    assert rasterise(front, 50, 50, cull=True).triangle[5, 5] == 0
    assert rasterise(back, 50, 50, cull=True).triangle[5, 5] == -1
    assert rasterise(back, 50, 50, cull=False).triangle[5, 5] == 0


def test_weights_interpolate() -> None:
    corners = triangle((0, 0, 0), (0, 100, 0), (100, 0, 0))
    depths = rasterise(corners, 100, 100, cull=False)
    weights = depths.weights(np.array([20]), np.array([30]))
    assert weights.sum() == pytest.approx(1)
    assert weights @ corners[0] == pytest.approx(np.array([[30.5, 20.5, 0]]))


def test_no_triangle_and_triangles_outside() -> None:
    assert (rasterise(np.empty((0, 3, 3)), 10, 10, cull=False).triangle == -1).all()
    away = triangle((100, 100, 0), (100, 190, 0), (190, 100, 0))
    assert (rasterise(away, 10, 10, cull=False).triangle == -1).all()


@pytest.mark.parametrize("view", [(-52.0, 28.0), (0.0, 0.0), (200.0, -90.0)])
def test_camera_fits(view: tuple[float, float]) -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)) + 1e3
    camera = Camera.fit(points, view, 300, 200)
    assert camera.axes @ camera.axes.T == pytest.approx(np.eye(3), abs=1e-12)
    seen = camera.project(points)
    assert seen[:, 0].min() >= 0
    assert seen[:, 0].max() <= 300
    assert seen[:, 1].min() >= 0
    assert seen[:, 1].max() <= 200


def test_camera_from_the_front() -> None:
    """Azimuth -90 looks along +y: x runs to the right, z upwards, small y is near."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    seen = Camera.fit(points, (-90.0, 0.0), 100, 100).project(points)
    assert seen[1, 0] > seen[0, 0]
    assert seen[3, 1] < seen[0, 1]
    assert seen[2, 2] > seen[0, 2]


def test_scene(lake: Lake) -> None:
    scene = Scene.of(lake, "cylinder")
    assert scene.counts == {"Plane": 2, "Cylinder": 1}
    assert scene.closed
    assert set(scene.kinds) == {SURFACE_TYPES.index("Plane"), SURFACE_TYPES.index("Cylinder")}
    assert len(scene.strong) == 2 * 24  # both circles
    assert len(scene.weak) == 4  # the seam
    assert "3 patches" in scene.facts
    assert "3 curves, 2 sharp" in scene.facts
    assert not Scene.of(lake, "saddle").closed
    assert not np.isnan(Scene.of(lake, "cone").corner_normals).any()  # the apex has none


def test_colours_are_those_of_the_types() -> None:
    assert tuple(COLOURS) == SURFACE_TYPES
    assert len(set(COLOURS.values())) == len(COLOURS)


def test_a_box_from_above(lake: Lake) -> None:
    """Looked at from straight above, a box is a grey rectangle 3 : 2 with a dark rim."""
    picture = render(Scene.of(lake, "box"), 300, 200, (-90.0, 90.0))
    ink = (picture < 0.99).any(axis=2)
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    width, height = np.ptp(columns) + 1, np.ptp(rows) + 1
    assert width / height == pytest.approx(1.5, rel=0.02)
    middle = picture[100, 150]
    assert np.ptp(middle) < 0.05  # grey: a plane
    assert picture[rows[0] : rows[0] + 3, 150].min() < 0.7  # the sharp edge
    assert (picture[0, 0] == 1).all()


def test_light_falls_on_exact_normals(lake: Lake) -> None:
    """A coarse cylinder has no facets: its brightness changes smoothly around it."""
    picture = render(Scene.of(lake, "cylinder"), 400, 400, (-90.0, 0.0))
    row = picture[200, :, 2]
    inside = np.flatnonzero(row < 0.99)[12:-12]
    steps = np.abs(np.diff(row[inside]))
    assert steps.max() < 0.03
    assert np.ptp(row[inside]) > 0.2


def test_hidden_curves_are_not_drawn(lake: Lake) -> None:
    """From above, the lower circle of a cone is its rim; from below, nothing lies on its disc."""
    picture = render(Scene.of(lake, "cone"), 300, 300, (-90.0, -90.0))
    middle = picture[80:220, 80:220]
    assert np.ptp(middle, axis=(0, 1)).max() < 0.02


@pytest.mark.parametrize("name", ["box", "cylinder", "cone", "torus", "saddle"])
def test_draw_model(lake: Lake, tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{name}.png"
    draw_model(lake, name, path, size=(400, 300))
    picture = read_png(path)
    assert picture.shape == (300, 400, 3)
    assert (picture < 0.9).any(axis=2).mean() > 0.05


def test_pictures_are_the_same_every_time(lake: Lake, tmp_path: Path) -> None:
    for place in ("a", "b"):
        draw_model(lake, "torus", tmp_path / place, size=(320, 240))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_legend_shows_the_types(lake: Lake, tmp_path: Path) -> None:
    draw_model(lake, "torus", tmp_path / "t.png", size=(800, 600))
    legend = read_png(tmp_path / "t.png")[:, 670:]
    colour = [int(COLOURS["Torus"][i : i + 2], 16) / 255 for i in (1, 3, 5)]
    assert (np.abs(legend - colour).max(axis=2) < 0.01).sum() > 50


def test_draw_sheet(lake: Lake, tmp_path: Path) -> None:
    names = ["box", "cylinder", "cone", "torus", "saddle"]
    draw_sheet(lake, names, tmp_path / "s.png", columns=3, cell=(200, 160))
    picture = read_png(tmp_path / "s.png")
    assert picture.shape == (2 * 160 + 60, 600, 3)
    for place in range(5):
        left, top = place % 3 * 200, place // 3 * 160
        assert (picture[top : top + 160, left : left + 200] < 0.9).any(axis=2).mean() > 0.03


def test_what_cannot_be_drawn(lake: Lake, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no mesh"):
        draw_model(lake, "wires", tmp_path / "w.png")
    with pytest.raises(NameNotFoundError):
        draw_model(lake, "nothing of that name", tmp_path / "w.png")
    with pytest.raises(UsageError, match="at least one"):
        draw_sheet(lake, [], tmp_path / "w.png")
    with pytest.raises(UsageError, match="200 x 150"):
        draw_model(lake, "box", tmp_path / "w.png", size=(100, 100))
    assert not (tmp_path / "w.png").exists()


def test_without_matplotlib(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"breplake\[plot\]"):
        draw_model(lake, "box", tmp_path / "b.png")
