"""The wheel, the sdist and the pinned versions."""

from __future__ import annotations

import email
import os
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
FOLDERS = ("ingest", "schema", "queries", "loaders", "bench")


def build(tree: Path, out: Path, kind: str) -> Path:
    """Build by the backend's hook, as pip does, but in this environment and offline."""
    code = f"import sys, hatchling.build as b; print(b.build_{kind}(sys.argv[1]))"
    environment = os.environ | {"PYTHONSAFEPATH": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code, str(out)],
        cwd=tree, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return out / done.stdout.split()[-1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(ROOT, tmp_path_factory.mktemp("wheel"), "wheel")


@pytest.fixture(scope="module")
def unpacked_sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sdist")
    with tarfile.open(build(ROOT, out, "sdist")) as archive:
        links = [m.name for m in archive if not m.isfile()]
        assert links == [], "the sdist holds links or other special files"
        # Python 3.11.2, Debian's, has no filters yet; from 3.12 on leaving it out warns.
        archive.extractall(out, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
    (tree,) = (p for p in out.iterdir() if p.is_dir())
    return tree


def contents(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        assert len(names) == len(set(names))
        return {name: archive.read(name) for name in names}


def expected_files() -> set[str]:
    """Every source and data file of the package, under its name in the wheel."""
    homes = {ROOT / "src/breplake": ROOT / "src"} | {ROOT / folder: ROOT for folder in FOLDERS}
    found = set()
    for home, base in homes.items():
        for path in home.rglob("*"):  # does not follow the links in src/breplake
            if path.is_file() and "__pycache__" not in path.parts:
                inner = path.relative_to(base).as_posix()
                found.add(inner if base != ROOT else f"breplake/{inner}")
    return found


def test_wheel_holds_the_package_and_nothing_else(wheel: Path):
    names = set(contents(wheel))
    info = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    assert names - info == expected_files()
    assert "breplake/py.typed" in names
    assert any(name.startswith("breplake/queries/") and name.endswith(".sql") for name in names)
    for folder in FOLDERS:
        assert f"breplake/{folder}/__init__.py" in names
    assert {name.partition("/")[2] for name in info} == {
        "METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE",
    }  # fmt: skip


def test_metadata(wheel: Path):
    files = contents(wheel)
    (raw,) = (data for name, data in files.items() if name.endswith("METADATA"))
    metadata = email.message_from_bytes(raw)
    assert metadata["License-Expression"] == "MIT"
    assert metadata["Requires-Python"] == ">=3.11"
    extras = set(metadata.get_all("Provides-Extra", []))
    assert {"ingest", "torch", "all"} <= extras
    core = [Requirement(r) for r in metadata.get_all("Requires-Dist", []) if "extra ==" not in r]
    assert not {r.name for r in core} & {"gmsh", "cadquery", "torch", "vtk", "matplotlib"}


def test_sdist_builds_the_same_wheel(wheel: Path, unpacked_sdist: Path, tmp_path: Path):
    assert contents(build(unpacked_sdist, tmp_path, "wheel")) == contents(wheel)


def test_sdist_has_what_a_developer_needs(unpacked_sdist: Path):
    for name in ("Makefile", "constraints.txt", "tools/setup.sh", "tests", "docs", "README.md"):
        assert (unpacked_sdist / name).exists(), name


def test_wheel_imports_without_the_checkout(wheel: Path, tmp_path: Path):
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    code = (
        "import sys; sys.path[:0] = sys.argv[1:]\n"
        "import breplake, breplake.cli, breplake.schema.tables, breplake.queries.session\n"
        "from pathlib import Path\n"
        "assert breplake.__file__.startswith(sys.argv[1]), breplake.__file__\n"
        "assert list(Path(breplake.queries.__path__[0]).rglob('*.sql'))\n"
        "assert callable(breplake.cli.main)\n"
    )
    # -S leaves out the editable install, -I the working folder and PYTHONPATH.
    paths = [str(tmp_path / "site"), sysconfig.get_path("purelib")]
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code, *paths],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    entries = [line for line in lines if line and not line.startswith("#")]
    assert entries == sorted(entries)
    found = {}
    for entry in entries:
        name, separator, version = entry.partition("==")
        assert separator, f"{entry}: only exact versions"
        assert "+" not in version, f"{entry}: a local version exists on no public index"
        found[canonicalize_name(name)] = version
    assert len(found) == len(entries)
    return found


def requirements() -> list[Requirement]:
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lines = list(project["project"]["dependencies"])
    for extra in project["project"]["optional-dependencies"].values():
        lines += extra
    lines += project["dependency-groups"]["dev"] + project["build-system"]["requires"]
    return [r for r in map(Requirement, lines) if r.name != "breplake"]


def test_requirements_are_pinned_within_their_ranges():
    pinned = pins()
    for requirement in requirements():
        version = pinned[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version, prereleases=True), requirement
