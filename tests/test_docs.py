"""What README and docs/ tell people to type is typed here; generated pages are up to date."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer

from breplake.cli import app

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
RUNNABLE = {"python", "bash", "console"}

FENCE = re.compile(r"^```(?P<info>[^\n`]*)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
REASON = re.compile(r"<!-- no-run: \S[^\n]*-->\n+\Z")
"""A block that is not run says why in a comment just above it: ``<!-- no-run: reason -->``."""


@dataclass(frozen=True)
class Block:
    """A fenced block of code."""

    language: str
    body: str
    line: int
    no_run: bool
    reason: bool

    def commands(self) -> Iterator[str]:
        """Yield the lines of a shell block that call breplake, or make what it is to read.

        Continuations are joined.
        """
        text = self.body.replace("\\\n", " ")
        for line in text.splitlines():
            line = line.strip()
            if self.language == "console":
                if not line.startswith("$ "):
                    continue  # what the command printed
                line = line[2:]
            if line.startswith(("breplake ", "printf ", "tar ")):
                yield line


def blocks(text: str) -> list[Block]:
    found = []
    for match in FENCE.finditer(text):
        language, *words = match["info"].split() or [""]
        before = text[: match.start()]
        reason = bool(REASON.search(before))
        line = before.count("\n") + 1
        found.append(Block(language, match["body"], line, "no-run" in words, reason))
    return found


def page_blocks(page: Path) -> list[Block]:
    return [b for b in blocks(page.read_text(encoding="utf-8")) if b.language in RUNNABLE]


def run(command: list[str], folder: Path, place: str) -> None:
    environment = os.environ | {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        "BREPLAKE": str(folder / "lake"),
        "BREPLAKE_CACHE": str(folder / "cache"),
        "PYTHONSAFEPATH": "1",
    }
    done = subprocess.run(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL,
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, f"{place}: {command[-1]}\n{done.stdout}\n{done.stderr}"


def run_page(page: Path, folder: Path, lake: Path) -> tuple[int, int]:
    """Run a page in `folder`, which holds a lake; return the numbers of blocks and commands.

    The commands run one by one, then all Python as one script, so that later blocks see the
    names of earlier ones. It has the line numbers of the page.
    """
    shutil.copytree(lake, folder / "lake")
    scripts, commands, python = 0, 0, ""
    for block in page_blocks(page):
        if block.no_run:
            continue
        if block.language == "python":
            scripts += 1
            python += "\n" * (block.line - python.count("\n")) + block.body
        for command in block.commands() if block.language != "python" else ():
            commands += 1
            place = f"{page.name}, block at line {block.line}"
            run(["bash", "-euo", "pipefail", "-c", command], folder, place)
    script = folder / f"{page.stem}.py"
    script.write_text(python, encoding="utf-8")
    run([sys.executable, "-W", "error", str(script)], folder, page.name)
    return scripts, commands


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_blocks_run(page: Path, sample_lake: Path, tmp_path: Path):
    scripts, commands = run_page(page, tmp_path, sample_lake)
    if page == ROOT / "README.md":  # an empty quick start must not pass
        assert scripts >= 2
        assert commands >= 4


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_blocks_that_are_not_run_say_why(page: Path):
    silent = [b.line for b in page_blocks(page) if b.no_run and not b.reason]
    assert silent == [], "write <!-- no-run: the reason --> above these blocks"


def test_blocks_are_found():
    text = (
        "```python\nx = 1\n```\n\n<!-- no-run: needs a GPU -->\n\n```bash no-run\nbreplake a\n```\n"
        "```bash\nmake\nbreplake b \\\n  --c\n```\n"
        "```console\n$ breplake d\nbreplake printed\n$ printf d > e\n```\n"
        "```bash no-run\nbreplake e\n```\n"
    )
    found = blocks(text)
    assert [b.language for b in found] == ["python", "bash", "bash", "console", "bash"]
    assert [(b.no_run, b.reason) for b in found[1::3]] == [(True, True), (True, False)]
    assert list(found[2].commands()) == ["breplake b    --c"]
    assert list(found[3].commands()) == ["breplake d", "printf d > e"]
    assert found[2].line == 10


GENERATE: dict[str, Any] = runpy.run_path(str(ROOT / "docs/generate.py"))


@pytest.mark.parametrize("name", sorted(GENERATE["PAGES"]))
def test_generated_page_is_up_to_date(name: str):
    page = ROOT / "docs" / name
    assert page.read_text(encoding="utf-8") == GENERATE["PAGES"][name](), "run: make docs"


def cli_commands() -> list[tuple[str, Any]]:
    return list(GENERATE["commands"](typer.main.get_command(app), "breplake"))


def test_there_are_commands():
    names = {name for name, _ in cli_commands()}
    wanted = ("samples", "ingest", "sql", "files", "info", "show", "check")
    assert {f"breplake {command}" for command in wanted} <= names


@pytest.mark.parametrize(
    ("name", "command"), [pytest.param(*pair, id=pair[0]) for pair in cli_commands()]
)
def test_every_command_and_parameter_has_help(name: str, command: Any):
    assert (command.help or "").strip(), f"{name} has no help"
    for parameter in command.params:
        assert (parameter.help or "").strip(), f"{name} {parameter.name} has no help"


def test_every_command_is_documented():
    text = (ROOT / "docs/cli.md").read_text(encoding="utf-8")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for name, _ in cli_commands():
        assert f"## {name}\n" in text
    for name in ("breplake ingest", "breplake sql", "breplake show", "breplake check"):
        assert name in readme


def test_what_the_readme_trains_with_has_epochs():
    """Torch's own loader repeats the draws of one epoch, unless someone calls set_epoch."""
    code = "".join(b.body for b in page_blocks(ROOT / "README.md") if b.language == "python")
    assert "Loader(" in code
    assert "torch.utils.data" not in code
    page = (ROOT / "docs/loaders.md").read_text(encoding="utf-8")
    assert "set_epoch(epoch)" in page.split("torch's own `DataLoader`")[1].split("\n\n")[0]


def test_every_page_is_in_the_index():
    index = (ROOT / "docs/README.md").read_text(encoding="utf-8")
    names = {page.name for page in PAGES if page.parent.name == "docs"} - {"README.md"}
    assert {name for name in names if f"]({name})" not in index} == set()


def test_every_link_leads_somewhere():
    for page in [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]:
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name} links to {target}"
