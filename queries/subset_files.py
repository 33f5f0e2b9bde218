"""Subsets as files: write one in one lake, make the same one in another.

Both forms list every model with its collection, name, split and the hash of its source file.
CSV has what else is known of the subset in a first line ``# {...}``; a list of your own needs no
such line and no column but ``model_id``.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from breplake.errors import UsageError
from breplake.queries.session import Lake
from breplake.queries.subsets import save_subset
from breplake.schema.subset import WHOLE, Origin, Subset

__all__ = [
    "Listed",
    "SubsetFile",
    "check_sources",
    "export_subset",
    "import_subset",
    "missing_models",
]

_FORMAT: Final = "breplake-subset"
_VERSION: Final = 1
_COLUMNS: Final = ("model_id", "split", "collection", "name", "sha256")
_SHOWN: Final = 10


@dataclass(frozen=True, slots=True)
class Listed:
    """A model as a subset's file lists it.

    Parameters
    ----------
    model_id : int
        Its id.
    split : str
        Name of its split.
    label : str
        ``collection/name``, or the id where the file does not say them.
    sha256 : str
        Hash of its source file; empty where the file does not say it.
    """

    model_id: int
    split: str
    label: str
    sha256: str


@dataclass(frozen=True, slots=True)
class SubsetFile:
    """What a subset's file says.

    Parameters
    ----------
    facts : dict
        Name, query, seed, limit, splits, lake and snapshot; empty for a list of one's own.
    models : tuple of Listed
        In ascending order of ids.
    """

    facts: dict[str, Any]
    models: tuple[Listed, ...]

    @classmethod
    def read(cls, path: Path) -> SubsetFile:
        """Read a file that `export_subset` wrote, or a CSV list of one's own.

        Raises
        ------
        UsageError
            If it is neither, or lists a model twice.
        """
        try:
            with path.open(encoding="utf-8", newline="") as stream:
                facts, rows = _read_json(stream) if path.suffix == ".json" else _read_csv(stream)
                listed = sorted((_listed(row) for row in rows), key=lambda m: m.model_id)
        except OSError as error:
            raise UsageError(f"cannot read {path}: {error.strerror}") from error
        except (AttributeError, KeyError, TypeError, ValueError, csv.Error) as error:
            raise UsageError(f"{path} is no list of models ({error!r}): see {_HELP}") from error
        for a, b in pairwise(listed):
            if a.model_id == b.model_id:
                raise UsageError(f"{path} lists model {a.label} twice")
        if not listed:
            raise UsageError(f"{path} lists no model: see {_HELP}")
        return cls(facts, tuple(listed))


_HELP: Final = "docs/subsets.md"


def export_subset(lake: Lake, subset: Subset, path: Path) -> None:
    """Write a subset as ``.json`` or ``.csv``, to be made anew in another lake.

    Raises
    ------
    UsageError
        If the path has another ending.
    """
    if path.suffix not in (".json", ".csv"):
        raise UsageError(f"a subset is written as .json or .csv, not as {path.name}")
    facts = {
        "format": _FORMAT,
        "version": _VERSION,
        "name": subset.name,
        "hash": subset.hash,
        "sql": subset.sql,
        "seed": subset.seed,
        "limit": subset.limit,
        "together": subset.together,
        "splits": dict(subset.fractions),
        "lake_id": subset.lake_id,
        "snapshot": subset.snapshot,
    }
    rows = list(_rows(lake, subset))
    with path.open("w", encoding="utf-8", newline="") as stream:
        if path.suffix == ".csv":
            stream.write(f"# {json.dumps(facts)}\n")
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(_COLUMNS)
            writer.writerows(rows)
            return
        # an id is text: many readers of JSON round whole numbers above 2**53
        lines = (json.dumps(dict(zip(_COLUMNS, (str(r[0]), *r[1:]), strict=True))) for r in rows)
        head = json.dumps(facts, indent=1)[:-2]
        stream.write(head + ',\n "models": [\n  ' + ",\n  ".join(lines) + "\n ]\n}\n")


def import_subset(lake: Lake, name: str, file: SubsetFile, *, partial: bool = False) -> Subset:
    """Store in a lake the subset that a file lists; splits are taken as they are.

    Parameters
    ----------
    lake : Lake
        The lake at the snapshot to pin.
    name : str
        Name of the subset in this lake.
    file : SubsetFile
        What was read.
    partial : bool
        Leave out the models that the lake lacks instead of refusing. The hash is then another.

    Raises
    ------
    UsageError
        If the lake lacks a model, or all of them, or the name is taken.
    """
    absent = missing_models(lake, file)
    if absent and (not partial or len(absent) == len(file.models)):
        raise UsageError(
            f"{len(absent)} of {len(file.models)} models are not in snapshot "
            f"{lake.snapshot.number}: {_named(absent)}; --partial takes the others"
        )
    gone = {model.model_id for model, _ in absent}
    models = [model for model in file.models if model.model_id not in gone]
    facts = file.facts
    fractions: dict[str, float] = facts.get("splits") or _shares(models)
    place = {split: code for code, split in enumerate(fractions)}
    if strange := sorted({m.split for m in models} - place.keys()):
        raise UsageError(f"split {strange[0]!r} is not among {', '.join(place)}")
    subset = Subset(
        name=name,
        sql=facts.get("sql", ""),
        lake_id=lake.store.lake_id,
        snapshot=lake.snapshot.number,
        fractions=fractions,
        seed=facts.get("seed", 0),
        limit=facts.get("limit"),
        model_ids=np.array([m.model_id for m in models], np.int64),
        codes=np.array([place[m.split] for m in models], np.int16),
        time=datetime.now(UTC).isoformat(timespec="seconds"),
        together=facts.get("together", "copies"),
        origin=Origin(facts["lake_id"], facts["name"], facts["snapshot"]) if facts else None,
    )
    if not absent and facts and subset.hash != facts["hash"]:
        raise UsageError(
            f"the file's models have the hash {subset.hash}, and it says {facts['hash']}: "
            "it was edited; remove its facts to import it as a list of your own"
        )
    return save_subset(lake, subset)


def missing_models(lake: Lake, file: SubsetFile) -> list[tuple[Listed, str]]:
    """Return the models of a file that the lake lacks, each with the reason.

    A model of another source file under the same name is another model.
    """
    table: Any = lake.sql("SELECT model_id, sha256 FROM models").to_arrow_table()
    there = dict(zip(*(table.column(i).to_pylist() for i in range(2)), strict=True))
    found = []
    for model in file.models:
        if model.model_id not in there:
            found.append((model, "absent"))
        elif model.sha256 and there[model.model_id] != model.sha256:
            found.append((model, "of another source file"))
    return found


def check_sources(lake: Lake, models: Sequence[Listed], place: str) -> None:
    """Check that no model has another source file in a lake, which `place` names.

    Raises
    ------
    UsageError
        If one has; models that the lake lacks are no matter.
    """
    found = missing_models(lake, SubsetFile({}, tuple(models)))
    if others := [(model, why) for model, why in found if why != "absent"]:
        raise UsageError(
            f"{len(others)} of {len(models)} models are not in snapshot {lake.snapshot.number} of "
            f"{place}: {_named(others)}; choose other models or another lake"
        )


def _named(absent: list[tuple[Listed, str]]) -> str:
    named = [f"{m.label}" + ("" if why == "absent" else f" ({why})") for m, why in absent]
    more = len(named) - _SHOWN
    return ", ".join(named[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _rows(lake: Lake, subset: Subset) -> Iterator[tuple[int, str, str, str, str]]:
    """Yield `_COLUMNS` of every model, as they were at the subset's snapshot."""
    pinned = lake.at(subset.snapshot)
    query = "SELECT model_id, collection, name, sha256 FROM models ORDER BY model_id"
    table: Any = pinned.sql(query).to_arrow_table()
    at = np.searchsorted(table.column("model_id").to_numpy(), subset.model_ids)
    columns = [table.column(name).take(at).to_pylist() for name in ("collection", "name", "sha256")]
    splits = (subset.splits[code] for code in subset.codes.tolist())
    yield from zip(subset.model_ids.tolist(), splits, *columns, strict=True)


def _read_json(stream: Iterable[str]) -> tuple[dict[str, Any], list[dict[str, str]]]:
    facts = json.loads("".join(stream))
    rows = facts.pop("models")
    return _checked_facts(facts), rows


def _read_csv(stream: Iterable[str]) -> tuple[dict[str, Any], list[dict[str, str]]]:
    lines = iter(stream)
    first = next(lines, "")
    facts = _checked_facts(json.loads(first[1:])) if first.startswith("#") else {}
    return facts, list(csv.DictReader(lines if facts else [first, *lines]))


def _checked_facts(facts: dict[str, Any]) -> dict[str, Any]:
    if facts["format"] != _FORMAT or facts["version"] > _VERSION:
        raise ValueError(f"format {facts['format']} {facts['version']}")
    return facts


def _listed(row: dict[str, str]) -> Listed:
    label = "/".join(filter(None, (row.get("collection"), row.get("name"))))
    return Listed(
        int(row["model_id"]),
        row.get("split") or WHOLE,
        label or row["model_id"],
        row.get("sha256") or "",
    )


def _shares(models: list[Listed]) -> dict[str, float]:
    """Return the splits of a list of one's own with the shares that they have."""
    names, counts = np.unique([m.split for m in models], return_counts=True)
    return dict(zip(names.tolist(), (counts / len(models)).tolist(), strict=True))
