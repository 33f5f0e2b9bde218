"""breplake: a columnar data lake and query engine for CAD boundary representations.

>>> import breplake
>>> lake = breplake.open("lake")                                       # doctest: +SKIP
>>> lake.sql("SELECT name FROM models WHERE n_torus > 30").fetchall()  # doctest: +SKIP

Nothing heavy is imported before it is used.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from breplake.queries.session import Lake

    __version__: str

__all__ = ["Lake", "__version__", "open"]


def open(path: str | Path, at: int | str | None = None) -> Lake:
    """Open a lake for reading.

    Parameters
    ----------
    path : str or pathlib.Path
        The lake's folder.
    at : int or str, optional
        Number or tag of a snapshot; the newest if not given.

    Returns
    -------
    breplake.queries.session.Lake
        The lake at that snapshot.

    Raises
    ------
    LakeNotFoundError
        If there is no lake in that folder.
    NameNotFoundError
        If there is no such snapshot.
    LakeFormatError
        If the lake is of a version that this breplake cannot read.
    """
    from breplake.queries.session import Lake

    return Lake(path, at)


def __getattr__(name: str) -> Any:
    """Load `Lake` and `__version__` when they are first asked for."""
    if name == "__version__":
        from importlib.metadata import version

        return version("breplake")
    if name == "Lake":
        from breplake.queries.session import Lake

        return Lake
    raise AttributeError(f"module 'breplake' has no attribute {name!r}")
