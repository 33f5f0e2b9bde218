"""Write models of a lake as OBJ, features YAML and stats YAML, one model in memory at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from breplake.errors import UsageError
from breplake.queries.abc.emit import yaml_text
from breplake.queries.abc.features import features
from breplake.queries.abc.obj import obj_text
from breplake.queries.abc.stats import stats
from breplake.schema.abc import file_name

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["Exported", "export"]

_MESH: Final = "trimesh"
_LAST: Final = "stats"
"""Written last: a model that has it is complete."""


@dataclass(slots=True)
class Exported:
    """What an export did.

    Parameters
    ----------
    total : int
        Models that were asked for.
    written : int
        Models whose files were written.
    skipped : int
        Models whose files were there already.
    unmeshed : int
        Models among the written ones that have no mesh, and so no OBJ.
    """

    total: int
    written: int = 0
    skipped: int = 0
    unmeshed: int = 0

    @property
    def done(self) -> int:
        """Models that are finished."""
        return self.written + self.skipped


def export(
    lake: Lake,
    models: Iterable[int | str] | None,
    folder: str | Path,
    *,
    where: str | None = None,
    decimals: int | None = None,
    overwrite: bool = False,
    progress: Callable[[Exported, str], None] | None = None,
) -> Exported:
    """Write models in the original file formats of the ABC dataset.

    Each model becomes ``NAME_trimesh_XXX.obj``, ``NAME_features_XXX.yml`` and
    ``NAME_stats_XXX.yml``; `breplake.schema.abc` says how names become file names. A file
    appears under its name only when it is complete, and a model that has its last one is
    left as it is, so that an export that was interrupted goes on where it stopped.

    Parameters
    ----------
    lake : Lake
        What to read.
    models : iterable of int or str, optional
        Ids or names; None for all.
    folder : path
        Where to write; it is made if it does not exist.
    where : str, optional
        SQL condition on a row of ``models``, which narrows them down.
    decimals : int, optional
        Digits after the point in the OBJ, 6 as in the published files; by default numbers are
        written exactly.
    overwrite : bool
        Whether to write models anew whose files are there.
    progress : callable, optional
        Called with the state and the name of the model after each of them.

    Raises
    ------
    UsageError
        If `where` is wrong, `decimals` is out of range, or two models would get the same
        files.
    NameNotFoundError
        If there is no such model.
    """
    if decimals is not None and not 3 <= decimals <= 15:
        raise UsageError(f"decimals must be from 3 to 15, got {decimals}")
    chosen = _chosen(lake, models, where)
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    state = Exported(len(chosen))
    for model_id, name in chosen.items():
        if not overwrite and (target / file_name(name, _LAST)).exists():
            state.skipped += 1
        else:
            _write_model(lake, model_id, target, decimals, state)
        if progress is not None:
            progress(state, name)
    return state


def _chosen(lake: Lake, models: Iterable[int | str] | None, where: str | None) -> dict[int, str]:
    """Return the names of the models to write by their ids, ascending."""
    condition = f"WHERE (\n{where}\n)" if where else ""
    query = f"SELECT model_id, collection, name FROM models {condition} ORDER BY model_id"
    rows = lake.sql(query).fetchall()
    if models is not None:
        ids = {lake.model(model)["model_id"] for model in models}
        rows = [row for row in rows if row[0] in ids]
    taken: dict[str, str] = {}
    for _, collection, name in rows:
        other = taken.setdefault(file_name(name, _LAST), collection)
        if other != collection:
            raise UsageError(
                f"{other}/{name} and {collection}/{name} would get the same files: export one "
                f"collection at a time, --where \"collection = '{collection}'\""
            )
    return {model_id: name for model_id, _, name in rows}


def _write_model(
    lake: Lake, model_id: int, folder: Path, decimals: int | None, state: Exported
) -> None:
    model = lake.model(model_id)
    tables = {name: lake.read(name, model_id) for name in ("curves", "patches", "vertices")}
    faces = lake.read("faces", model_id)
    name = model["name"]
    # the last file is what tells a complete model: an old one must not, while others are new
    (folder / file_name(name, _LAST)).unlink(missing_ok=True)
    if model["mesh_kind"] is None:
        (folder / file_name(name, _MESH)).unlink(missing_ok=True)
        state.unmeshed += 1
    else:
        _replace(folder / file_name(name, _MESH), obj_text(tables["vertices"], faces, decimals))
    _replace(folder / file_name(name, "features"), yaml_text(features(**tables, faces=faces)))
    _replace(folder / file_name(name, _LAST), yaml_text(stats(model, **tables)))
    state.written += 1


def _replace(path: Path, text: str) -> None:
    """Write a file that appears only when it is complete."""
    part = path.with_name(f".{path.name[:200]}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8", errors="surrogateescape", newline="\n")
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
