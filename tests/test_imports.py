"""Who may import whom: the folders know only what is below them, and importing stays light."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

BELOW = {
    "schema": set(),
    "ingest": {"schema"},
    "queries": {"schema"},
    "loaders": {"schema", "queries"},
    "bench": {"schema", "ingest", "queries", "loaders"},
}
"""Folder -> the other folders it may import."""

HEAVY = {
    "OCP": {"ingest"},
    "cadquery": {"ingest"},
    "gmsh": {"ingest"},
    "torch": {"loaders", "bench"},
}
"""Module that loads slowly or has a licence of its own -> the folders that may import it."""


def imported(source: str, package: str) -> Iterator[tuple[int, str]]:
    """Yield line and full module name of every import in `source`, wherever it stands."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base] if base else above)
            # `from breplake import schema` imports a folder, too
            names = [f"{base}.{a.name}" for a in node.names] if base == "breplake" else [base]
            for name in names:
                yield node.lineno, name


def offences(folder: str, source: str, package: str) -> list[str]:
    """Return what `source`, a module of `folder`, imports against the rules."""
    found = []
    for line, name in imported(source, package):
        parts = name.split(".")
        if parts[0] in BELOW:
            found.append(f"line {line}: import breplake.{name}, not {name}")
        elif parts[0] == "breplake":
            target = parts[1] if len(parts) > 1 else ""
            allowed = {"errors", "__version__", folder, *BELOW[folder]}
            if target not in allowed and folder != "bench":
                found.append(f"line {line}: {folder} may not know {name}")
        elif folder not in HEAVY.get(parts[0], {folder}):
            found.append(f"line {line}: {parts[0]} is not for {folder}")
    return found


def modules() -> list[Path]:
    return sorted(p for folder in BELOW for p in (ROOT / folder).rglob("*.py"))


def test_every_folder_has_modules():
    assert {p.relative_to(ROOT).parts[0] for p in modules()} == set(BELOW)


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_down(path: Path):
    inner = path.relative_to(ROOT)
    package = ".".join(["breplake", *inner.parent.parts])
    assert offences(inner.parts[0], path.read_text(encoding="utf-8"), package) == []


@pytest.mark.parametrize(
    ("folder", "source"),
    [
        ("schema", "from breplake.queries.session import Lake"),
        ("schema", "def f():\n    import breplake.ingest.run"),
        ("queries", "from breplake import ingest"),
        ("queries", "from ..ingest import run"),
        ("ingest", "from breplake.queries import session"),
        ("loaders", "import breplake"),
        ("queries", "import schema.tables"),
        ("queries", "from OCP.TopoDS import TopoDS"),
        ("bench", "import gmsh"),
        ("queries", "import torch.utils.data"),
        ("schema", "import cadquery as cq"),
    ],
)
def test_the_rules_catch(folder: str, source: str):
    assert offences(folder, source, f"breplake.{folder}")


def test_the_rules_let_pass():
    source = "from breplake.errors import UsageError\nfrom breplake.schema.tables import TABLES\n"
    source += "import torch\nfrom . import order\n"
    assert offences("loaders", source, "breplake.loaders") == []


def run_python(code: str) -> None:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd="/")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["breplake", "breplake.cli"])
def test_import_is_light(name: str):
    heavy = {*HEAVY, "vtk", "matplotlib", "scipy"}
    run_python(
        f"import sys, {name}\n"
        f"loaded = sorted({heavy!r} & set(sys.modules))\n"
        "assert not loaded, loaded"
    )


def test_reading_needs_no_extra():
    """All of schema and queries, and the commands, import where no extra is installed."""
    names = [
        ".".join(["breplake", *p.relative_to(ROOT).with_suffix("").parts])
        for p in modules()
        if p.relative_to(ROOT).parts[0] in ("schema", "queries") and p.stem != "__init__"
    ]
    missing = [*HEAVY, "vtk", "vtkmodules", "matplotlib", "scipy", "pebble"]
    run_python(
        "import importlib, sys\n"
        f"for name in {missing!r}: sys.modules[name] = None\n"
        f"for name in {[*names, 'breplake', 'breplake.cli']!r}:\n"
        "    importlib.import_module(name)\n"
    )
