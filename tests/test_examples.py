"""Every example runs on the sample lake."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


def test_there_are_examples():
    assert len(EXAMPLES) >= 10


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda p: p.stem)
def test_example_runs(example: Path, sample_lake: Path, tmp_path: Path):
    done = subprocess.run(
        [sys.executable, str(example), str(sample_lake)],
        cwd=tmp_path, env=os.environ | {"PYTHONSAFEPATH": "1"}, stdin=subprocess.DEVNULL,
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
