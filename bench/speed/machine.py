"""What a measurement ran on, in one line."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

__all__ = ["machine"]


def machine(*packages: str) -> str:
    """Return processor, cores, load, Python and the versions of `packages`, in one line."""
    info = Path("/proc/cpuinfo")
    text = info.read_text(encoding="utf-8") if info.exists() else ""
    models = [line.partition(":")[2].strip() for line in text.splitlines() if "model name" in line]
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    said = [models[0] if models else platform.machine(), f"{os.cpu_count()} cores", f"load {load}"]
    said += [f"Python {platform.python_version()}", f"Linux {platform.release()}"]
    return "; ".join([*said, *(f"{name} {_version(name)}" for name in packages)])


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"
