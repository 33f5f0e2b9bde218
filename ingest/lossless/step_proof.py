"""A rebuilt model through a STEP file and back, and its source the same way."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from breplake.ingest.brep import extract
from breplake.ingest.canonical import canonical
from breplake.ingest.heal import add_missing_pcurves
from breplake.ingest.load import load
from breplake.ingest.lossless.carried import table_differences
from breplake.ingest.lossless.rebuild import rebuilt_shapes
from breplake.ingest.lossless.step_out import write_step
from breplake.ingest.rows import brep_tables

__all__ = ["step_differences"]


def step_differences(
    tables: Mapping[str, pa.Table],
    scale_to_mm: float | None,
    name: str,
    source: Callable[[], Any],
) -> tuple[list[str], bool]:
    """Write a model as STEP from its tables, ingest that, and say which columns differ.

    What differs may be the fault of the tables or the limit of STEP as the kernel writes and
    reads it. The source's own shapes, written by the same writer, tell which.

    Parameters
    ----------
    tables : mapping
        All tables of the model by name, mesh and arrays aside.
    scale_to_mm : float or None
        Millimetres in the unit to write.
    name : str
        Name of the model.
    source : callable
        Returns the shapes that the model was ingested from, a ``TopoDS_Compound`` in canonical
        order; called only if something differs.

    Returns
    -------
    list of str
        As of `table_differences`.
    bool
        Whether it is just so with the source's own shapes: their file has the same bytes, or is
        ingested to the same tables.

    Raises
    ------
    LakeFormatError, InputError, OSError
        If the model cannot be rebuilt, or a file not be written or read.
    """
    parts, patches = (tables[table].to_pylist() for table in ("parts", "patches"))
    write = partial(write_step, name=name, parts=parts, patches=patches, scale_to_mm=scale_to_mm)
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / "rebuilt.step", Path(folder) / "source.step"
        write(rebuilt_shapes(tables)[0], ours)
        again = _ingested(ours)
        reasons = table_differences(tables, again)
        if not reasons:
            return [], True
        write(source(), theirs)
        if ours.read_bytes() == theirs.read_bytes():
            return reasons, True
        return reasons, not table_differences(_ingested(theirs), again)


def _ingested(path: Path) -> dict[str, pa.Table]:
    """Return the exact tables that ingest makes of a STEP file."""
    document = load(path, "step")
    shapes = canonical(document.shapes)
    add_missing_pcurves(shapes.compound)
    return brep_tables(0, extract(shapes, document.labels))
