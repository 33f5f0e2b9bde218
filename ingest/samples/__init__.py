"""Sample parts that come with breplake: mechanical parts modelled in code, written as STEP.

Importing this package loads cadquery and its kernel (the extra ``breplake[ingest]``).

Each part is one small function registered in ``PARTS``; together they cover every type of
surface and curve that the lake distinguishes.  ``write_samples`` writes the same bytes whenever
it is called with the same versions of cadquery and its kernel, for one part as for all.
"""

from collections.abc import Sequence
from pathlib import Path

from . import (  # noqa: F401  (each module registers its parts)
    assemblies,
    bearings,
    conics,
    elementary,
    fasteners,
    freeform,
    gears,
    housings,
    pipes,
    shafts,
    surfaces,
    threads,
)
from .registry import PARTS, Part, part
from .step_file import write_step

__all__ = ["PARTS", "Part", "part", "write_samples"]


def write_samples(folder: Path, names: Sequence[str] | None = None) -> list[Path]:
    """Write sample parts as STEP files.

    Parameters
    ----------
    folder : Path
        Where to write ``<name>.step``; made if it does not exist.
    names : sequence of str, optional
        Parts to write, in this order; all parts by default.

    Returns
    -------
    list of Path
        One file a part.

    Raises
    ------
    KeyError
        If a name is unknown; nothing is written then.
    """
    chosen = list(PARTS) if names is None else list(names)
    unknown = [name for name in chosen if name not in PARTS]
    if unknown:
        raise KeyError(f"unknown sample parts {unknown}; breplake.ingest.samples.PARTS lists all")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return [_write(PARTS[name], folder) for name in chosen]


def _write(sample: Part, folder: Path) -> Path:
    path = folder / f"{sample.name}.step"
    write_step(sample.build(), path, name=sample.name, unit=sample.unit)
    return path
