"""Versions of what decides a lake's content, without loading any of it."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Final

from breplake.errors import MissingExtraError

__all__ = ["versions"]

_PACKAGES: Final = {"occt": "cadquery-ocp", "gmsh": "gmsh", "breplake": "breplake"}
"""Packages by the name under which their version is recorded. That of OCP begins with OCCT's."""


def versions() -> dict[str, str]:
    """Return the versions of Open CASCADE, Gmsh and breplake.

    Raises
    ------
    MissingExtraError
        If a package is not installed.
    """
    try:
        return {name: version(package) for name, package in _PACKAGES.items()}
    except PackageNotFoundError as error:
        raise MissingExtraError("ingest", "breplake ingest") from error
