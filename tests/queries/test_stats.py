"""Statistics: the paper's definitions, the files, and a page that stands on its own."""

from __future__ import annotations

import csv
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import polars as pl
import pytest
from typer.testing import CliRunner

import breplake
from breplake.cli import app
from breplake.errors import MissingExtraError, UsageError
from breplake.queries.session import Lake
from breplake.queries.stats import FEW_CURVES, FEW_PATCHES, Statistics
from breplake.queries.stats_charts import Bars, Histogram, percent, ticks
from breplake.queries.stats_report import charts, write_report

FIGURES = ("surface_types", "curve_types", "patches_per_model", "curves_per_model", "models")
TABLES = ("summary", "surface_types", "curve_types", "paper_curve_types", "patches_per_model",
          "curves_per_model")  # fmt: skip


@pytest.fixture(scope="module")
def lake(sample_lake: Path) -> Lake:
    return breplake.open(sample_lake)


@pytest.fixture(scope="module")
def report(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stats") / "new" / "folder"
    files = write_report(lake, folder, examples=3)
    assert files[0] == folder / "index.html"
    assert sorted(files) == sorted(folder.iterdir())
    return folder


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_types_are_shares_of_all_patches_and_curves(lake: Lake, report: Path):
    """The paper, figure 3: distribution of types over all models."""
    patches = lake.scan("patches").group_by("type").len().collect()
    total = patches["len"].sum()
    expected = {t: n / total for t, n in patches.iter_rows()}
    rows = read_csv(report / "surface_types.csv")
    assert {row["type"]: float(row["share"]) for row in rows} == pytest.approx(expected)
    curves = lake.scan("curves").with_columns(
        type=pl.when(pl.col("type").is_in(["Line", "Circle", "Ellipse", "BSpline"]))
        .then("type")
        .otherwise(pl.lit("Other"))
    )
    expected = dict(curves.group_by("type").len().collect().iter_rows())
    rows = read_csv(report / "paper_curve_types.csv")
    assert [row["type"] for row in rows] == ["Line", "Circle", "Ellipse", "BSpline", "Other"]
    assert {row["type"]: int(row["curves"]) for row in rows} == expected
    assert sum(float(row["share"]) for row in rows) == pytest.approx(1)


@pytest.mark.parametrize("unit", ["patches", "curves"])
def test_histograms_are_of_models(lake: Lake, report: Path, unit: str):
    """The paper, figure 4: models by their number of patches and of curves, truncated right."""
    counts = lake.scan(unit).group_by("model_id").len().collect()["len"].to_list()
    rows = read_csv(report / f"{unit}_per_model.csv")
    assert sum(int(row["models"]) for row in rows) == len(counts)
    for row in rows:
        high = float(row["high"]) if row["high"] else float("inf")
        assert int(row["models"]) == sum(int(row["low"]) <= n <= high for n in counts)


def test_summary(lake: Lake):
    summary = Statistics.of(lake).summary
    info = lake.info()
    assert summary.models == info.models
    assert summary.patches == sum(info.patches.values())
    assert summary.curves == sum(info.curves.values())
    assert summary.triangles == info.triangles
    assert summary.closed == 21
    assert summary.duplicates == 1
    models = lake.scan("models").collect()
    assert summary.few_patches == (models["n_patches"] < FEW_PATCHES).sum()
    assert summary.few_curves == (models["n_curves"] < FEW_CURVES).sum()
    assert summary.median_curves == models["n_curves"].median()


def test_narrowed_down(lake: Lake):
    numbers = Statistics.of(lake, "n_torus > 30 -- many")
    assert numbers.summary.models == 2
    assert sum(numbers.patches_per_model.column("models").to_pylist()) == 2
    ids = {lake.model(name)["model_id"] for name in ("bellows", "spindle_grip")}
    assert set(numbers.examples) == ids
    with pytest.raises(UsageError, match="no model WHERE n_torus > 10000"):
        Statistics.of(lake, "n_torus > 10000")
    with pytest.raises(UsageError, match="n_tori"):
        Statistics.of(lake, "n_tori > 1")


def test_examples_are_drawn_by_seed(lake: Lake):
    draws = [Statistics.of(lake, examples=5, seed=seed).examples for seed in (0, 0, 1)]
    assert draws[0] == draws[1] != draws[2]
    assert all(len(set(draw)) == 5 for draw in draws)
    assert len(Statistics.of(lake, examples=100).examples) == 22


def test_pictures(report: Path):
    from matplotlib.image import imread

    for name in FIGURES:
        picture = imread(report / f"{name}.png")[:, :, :3]
        assert picture.shape[1] >= 600
        assert (picture < 0.9).any(axis=2).mean() > 0.01
    assert {path.stem for path in report.glob("*.csv")} == set(TABLES)


class Page(HTMLParser):
    """What matters of a page: balanced tags, links to elsewhere, tables, texts for the ear."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.tables: list[list[list[str]]] = []
        self.labels: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.links += [value or "" for key, value in attrs if key in ("src", "href")]
        self.labels += [given[key] or "" for key in ("aria-label", "alt") if key in given]
        if tag not in ("meta", "img", "rect", "line"):
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            assert tag == "td" or given["scope"] in ("col", "row")
            self.tables[-1][-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th"):
            self.tables[-1][-1][-1] += data


def test_the_page_stands_on_its_own(report: Path):
    text = (report / "index.html").read_text("utf-8")
    page = Page(text)
    assert [link[:22] for link in page.links] == ["data:image/png;base64,"]
    assert not re.search(r"https?://|@import|url\(|<script", text)
    assert "prefers-color-scheme: dark" in text
    assert "$" not in text
    assert sum(label.startswith("Types of") for label in page.labels) == 2
    assert all(label for label in page.labels)


def test_the_page_has_the_numbers(report: Path):
    tables = Page((report / "index.html").read_text("utf-8")).tables
    for name, table in zip(FIGURES[:4], tables, strict=True):
        rows = read_csv(report / f"{name}.csv")
        assert len(table) == len(rows) + 1
        assert table[0] == [key.replace("_", " ") for key in rows[0]]
        for row, cells in zip(rows, table[1:], strict=True):
            counts = [row[key] for key in ("patches", "curves", "models") if key in row]
            shown = {cell.replace(",", "") for cell in cells}
            assert set(counts) <= shown
    assert tables[2][-1][1] == "and more"


def test_names_and_conditions_are_shown_as_text(tiny_lake: Path, tmp_path: Path):
    folder = tmp_path / "<b>lake & co"
    shutil.copytree(tiny_lake, folder)
    write_report(breplake.open(folder), tmp_path / "out", where="name <> '<i>z'", examples=0)
    text = (tmp_path / "out/index.html").read_text("utf-8")
    assert "Statistics of &lt;b&gt;lake &amp; co" in text
    assert "name &lt;&gt; &#x27;&lt;i&gt;z&#x27;" in text
    assert "<i>z" not in text
    assert "<img" not in text  # no examples, no sheet
    assert not (tmp_path / "out/models.png").exists()


def test_models_without_patches(tiny_lake: Path):
    lake = breplake.open(tiny_lake)
    for name in ("patches", "curves"):
        lake.connection.execute(f"CREATE TABLE no_{name} AS FROM {name} LIMIT 0")
        lake.connection.execute(f"CREATE OR REPLACE VIEW {name} AS FROM no_{name}")
    drawn = charts(Statistics.of(lake))
    assert set(drawn["surface_types"].shares) == {0.0}
    assert "Plane 0.0 %" in drawn["surface_types"].svg()


def test_ticks():
    assert ticks(0) == [0, 1]
    assert ticks(3) == [0, 1, 2, 3]
    assert ticks(77) == [0, 20, 40, 60, 80]
    assert ticks(80) == [0, 20, 40, 60, 80]
    for most in range(1, 3000, 7):
        steps = ticks(most)
        assert steps[0] == 0
        assert steps[-2] < most <= steps[-1]
        assert len(steps) <= 7


def test_percent():
    shown = [percent(share) for share in (0, 0.00001, 0.001, 0.12345, 1)]
    assert shown == ["0.0 %", "< 0.1 %", "0.1 %", "12.3 %", "100.0 %"]


def test_bars_and_bins_are_in_proportion():
    svg = Bars("T", ["a", "b<"], [3, 1], [0.75, 0.25]).svg()
    widths = [float(w) for w in re.findall(r'class="bar"[^>]* width="([\d.]+)"', svg)]
    assert widths[0] == pytest.approx(3 * widths[1], rel=1e-3)
    assert "b&lt;" in svg
    histogram = Histogram("T", "things", [0, 10, 20], [4, 0, 2], 15)
    heights = re.findall(r'class="(bar[ a-z]*)"[^>]* height="([\d.]+)"', histogram.svg())
    assert [kind for kind, _ in heights] == ["bar", "bar more"]  # an empty bin has no bar
    assert float(heights[0][1]) == pytest.approx(2 * float(heights[1][1]), rel=1e-3)
    assert histogram.place_of_mark == 1.5
    assert Histogram("T", "things", [0, 10], [1, 1], 30).place_of_mark is None


def test_without_matplotlib(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"breplake\[plot\]"):
        write_report(lake, tmp_path)


def test_command(tiny_lake: Path, tmp_path: Path):
    def run(*arguments: object):
        given = ["stats", "-l", str(tiny_lake), *map(str, arguments)]
        return CliRunner().invoke(app, given)

    result = run("-o", tmp_path / "out", "--models", 2, "--at", 1)
    assert result.stdout == f"{tmp_path / 'out/index.html'}\n"
    assert "Snapshot 1 of" in (tmp_path / "out/index.html").read_text("utf-8")
    (tmp_path / "file").touch()
    for arguments, message in (
        (("-o", tmp_path / "file"), "cannot write"),
        (("-o", tmp_path, "--where", "n_tori > 1"), "n_tori"),
        (("-o", tmp_path, "--where", "false"), "no model WHERE false"),
    ):
        result = run(*arguments)
        assert result.exit_code == 2
        assert message in result.stderr


@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs the browser chromium")
def test_the_page_in_a_browser(report: Path, tmp_path: Path):
    """Its charts have ink, in light and in dark, and it is no wider than the window."""
    from matplotlib.image import imread

    for scheme, (low, high) in {"1": (0.8, 1.0), "0": (0.0, 0.3)}.items():
        shot = tmp_path / f"{scheme}.png"
        subprocess.run(
            ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
             f"--blink-settings=preferredColorScheme={scheme}", "--window-size=1200,1600",
             f"--screenshot={shot}", f"--user-data-dir={tmp_path / 'profile'}",
             (report / "index.html").as_uri()],
            check=True, capture_output=True, timeout=120,
        )  # fmt: skip
        picture = imread(shot)[:, :, :3]
        assert low <= picture[4, 4].mean() <= high  # the paper
        assert (abs(picture - picture[4, 4]) > 0.3).any(axis=2).mean() > 0.02
        assert (picture[:, -4:] == picture[4, 4]).all()
