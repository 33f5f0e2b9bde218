"""tools/setup.sh on machines where something is missing, played with stand-ins on PATH."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "tools/setup.sh"

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="the script installs system libraries on Linux only"
)

# Loaded by every Python of the test: the listed libraries load once apt-get has "installed" them.
SITE = """\
import ctypes, os
real, machine = ctypes.CDLL, os.environ["MACHINE"]
def load(name, *args, **kwargs):
    if os.path.exists(f"{machine}/installed"):
        return object()
    if name in ("libGLU.so.1", "libXft.so.2"):
        raise OSError(name)
    return object()
ctypes.CDLL = load
"""

PACKAGES = "libglu1-mesa libxft2"


class Machine:
    """A folder that is all of PATH."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.bin = folder / "bin"
        self.bin.mkdir()
        (folder / "site").mkdir()
        (folder / "site/sitecustomize.py").write_text(SITE)
        for tool in ("sh", "env", "cat", "touch", "rm"):
            (self.bin / tool).symlink_to(shutil.which(tool))
        self.script("uname", "echo Linux")
        self.python("python3")

    def script(self, name: str, body: str) -> None:
        path = self.bin / name
        path.write_text(f"#!/bin/sh\n{body}\n")
        path.chmod(0o755)

    def python(self, name: str) -> None:
        self.script(name, f'exec "{sys.executable}" "$@"')

    def user(self, number: int) -> None:
        self.script("id", f"echo {number}")

    def apt(self, *, works: bool = True) -> None:
        end = 'case "$*" in *install*) touch "$MACHINE/installed" ;; esac' if works else "exit 100"
        self.script("apt-get", f'echo "apt-get $*" >>"$MACHINE/log"\n{end}')

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {
            "PATH": str(self.bin),
            "MACHINE": str(self.folder),
            "PYTHONPATH": str(self.folder / "site"),
        }
        return subprocess.run(
            [str(SCRIPT), "--libraries", *arguments],
            env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        )  # fmt: skip

    def log(self) -> str:
        path = self.folder / "log"
        return path.read_text() if path.exists() else ""


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_root_installs_just_what_is_missing(machine: Machine):
    machine.user(0)
    machine.apt()
    done = machine.run()
    assert done.returncode == 0, done.stderr
    update, install = machine.log().splitlines()
    assert update.endswith("update")
    assert install.endswith(f"--no-install-recommends {PACKAGES}")
    assert PACKAGES in done.stdout


def test_nothing_missing_asks_nobody(machine: Machine):
    (machine.folder / "installed").touch()
    done = machine.run()
    assert (done.returncode, done.stdout, machine.log()) == (0, "", "")


def test_user_goes_through_sudo_without_a_prompt(machine: Machine):
    machine.user(1000)
    machine.apt()
    machine.script("sudo", 'echo "sudo $*" >>"$MACHINE/log"; shift; exec "$@"')
    done = machine.run()
    assert done.returncode == 0, done.stderr
    assert machine.log().startswith("sudo -n apt-get")


def test_user_without_sudo_is_told_the_packages(machine: Machine):
    machine.user(1000)
    machine.apt()
    done = machine.run()
    assert done.returncode == 1
    assert f"apt-get install --yes {PACKAGES}" in done.stderr
    assert machine.log() == ""


def test_no_apt_is_told_the_packages(machine: Machine):
    machine.user(0)
    done = machine.run()
    assert done.returncode == 1
    assert f"    {PACKAGES}\n" in done.stderr


def test_failing_apt_is_told_the_packages(machine: Machine):
    machine.user(0)
    machine.apt(works=False)
    done = machine.run()
    assert done.returncode == 1
    assert PACKAGES in done.stderr


def test_no_python_says_so(machine: Machine):
    (machine.bin / "python3").unlink()
    done = machine.run()
    assert done.returncode == 1
    assert "needs Python 3.11" in done.stderr


def test_an_old_python_is_passed_over(machine: Machine):
    machine.script("python3", "exit 1")
    machine.python("python3.12")
    (machine.folder / "installed").touch()
    assert machine.run().returncode == 0


def test_a_named_python_that_does_not_start_says_so(machine: Machine):
    done = machine.run("/no/such/python")
    assert done.returncode == 1
    assert "/no/such/python" in done.stderr


def test_missing_venv_module_is_installed_for_that_version(machine: Machine):
    machine.user(0)
    machine.apt()
    body = (
        'case "$*" in\n'
        '*sys.executable*) echo "$0"; exit ;;\n'
        '*ensurepip*) [ -e "$MACHINE/installed" ] || exit 1 ;;\n'
        f'esac\nexec "{sys.executable}" "$@"'
    )
    machine.script("python3.11", body)
    done = machine.run(str(machine.bin / "python3.11"))
    assert done.returncode == 0, done.stderr
    assert "ensurepip" in done.stdout
    assert "-venv" in machine.log()


ROOT = SCRIPT.parents[1]


def make(*arguments: str) -> str:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("MAKE")}
    done = subprocess.run(
        ["make", *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout


def test_bare_make_lists_every_target():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^\.PHONY: ([a-z-]+)$", makefile, re.MULTILINE))
    listed = dict(re.findall(r"^  make ([a-z-]+) +(\S.*)$", make(), re.MULTILINE))
    assert set(listed) == targets
    assert {"setup", "demo", "test", "lint", "format", "docs", "build", "clean"} <= targets


def test_ci_runs_the_same_commands_as_people():
    script = ROOT / ".ci/run"
    assert os.access(script, os.X_OK)
    commands = [line for line in script.read_text().splitlines() if line.startswith("make ")]
    assert commands == ["make setup", "make lint", "make test"]
