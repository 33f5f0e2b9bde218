"""A subset: frozen ids of models, each in one split, as one immutable document of the lake.

``LAKE/subsets/<name>.parquet`` has the columns ``model_id`` (ascending) and ``split``, which any
tool reads; how it came about is in the file's metadata, as JSON under ``breplake.subset``.
Its hash depends on ids and splits alone, so it is the same in every lake.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from breplake.errors import LakeFormatError, NameNotFoundError
from breplake.schema.storage import Storage

__all__ = [
    "FOLDER",
    "WHOLE",
    "Origin",
    "Subset",
    "Together",
    "pinned_snapshots",
    "subset_names",
    "subset_path",
]

FOLDER: Final = "subsets"
"""Folder of a lake that holds its subsets."""

WHOLE: Final = "all"
"""Name of the only split of a subset that was not split."""

Together: TypeAlias = Literal["copies", "form"]
"""Which models share a split: copies, or also scaled copies and mirror images."""

_KEY: Final = b"breplake.subset"


@dataclass(frozen=True, slots=True)
class Origin:
    """Where an imported subset was made.

    Parameters
    ----------
    lake_id : str
        Id of that lake.
    name : str
        The subset's name there.
    snapshot : int
        The snapshot that it was selected from.
    """

    lake_id: str
    name: str
    snapshot: int


@dataclass(frozen=True)
class Subset:
    """Models of a lake at a snapshot, each in one split.

    Parameters
    ----------
    name : str
        Its name in the lake.
    sql : str
        The query that selected the models.
    lake_id : str
        Id of the lake.
    snapshot : int
        Number of the snapshot that was queried.
    fractions : mapping
        Name of each split -> its share, in the order in which they were given.
    seed : int
        Seed of the split and of the limit.
    limit : int or None
        Most models that were to be taken.
    model_ids : numpy.ndarray
        ``(n,)`` int64, ascending, without repeats.
    codes : numpy.ndarray
        ``(n,)`` int16, index of each model's split in `fractions`.
    time : str
        When it was made: UTC, ISO 8601.
    origin : Origin or None
        Where it was made first, if it came from another lake.
    together : {"copies", "form"}
        Which models were to share a split; subsets of before there was a choice say nothing.
    """

    name: str
    sql: str
    lake_id: str
    snapshot: int
    fractions: Mapping[str, float]
    seed: int
    limit: int | None
    model_ids: npt.NDArray[np.int64] = field(repr=False, compare=False)
    codes: npt.NDArray[np.int16] = field(repr=False, compare=False)
    time: str = field(compare=False)
    origin: Origin | None = None
    together: Together = "copies"

    def __len__(self) -> int:
        return len(self.model_ids)

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits; ``("all",)`` where it was not split."""
        return tuple(self.fractions)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the lines ``<model_id> <split>`` in ascending order of ids, hexadecimal.

        The same ids in the same splits have the same hash in every lake.
        """
        names = self.splits
        lines = (
            f"{identity} {names[code]}\n"
            for identity, code in zip(self.model_ids.tolist(), self.codes.tolist(), strict=True)
        )
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    def ids(self, split: str | None = None) -> npt.NDArray[np.int64]:
        """Return the ids of a split, or of all models.

        Parameters
        ----------
        split : str, optional
            One of `splits`.

        Returns
        -------
        numpy.ndarray
            ``(n,)`` int64, ascending.

        Raises
        ------
        NameNotFoundError
            If there is no such split.
        """
        if split is None or split == WHOLE:
            return self.model_ids
        if split not in self.splits:
            known = ", ".join(self.splits)
            raise NameNotFoundError(f"subset {self.name} has no split {split!r}: it has {known}")
        ids: npt.NDArray[np.int64] = self.model_ids[self.codes == self.splits.index(split)]
        return ids

    def counts(self) -> dict[str, int]:
        """Return the number of models of each split."""
        found = np.bincount(self.codes, minlength=len(self.splits))
        return dict(zip(self.splits, found.tolist(), strict=True))

    def to_bytes(self) -> bytes:
        """Return the document; the same for equal subsets, but for their time."""
        origin = self.origin
        facts = {
            "name": self.name,
            "sql": self.sql,
            "lake_id": self.lake_id,
            "snapshot": self.snapshot,
            "fractions": list(self.fractions.items()),
            "seed": self.seed,
            "limit": self.limit,
            "time": self.time,
            "hash": self.hash,
            "origin": origin and [origin.lake_id, origin.name, origin.snapshot],
        }
        if self.together != "copies":  # the default is not written, for readers that know no other
            facts["together"] = self.together
        split = pa.DictionaryArray.from_arrays(pa.array(self.codes), pa.array(self.splits))
        columns = {"model_id": pa.array(self.model_ids), "split": split.cast(pa.string())}
        table = pa.table(columns).replace_schema_metadata({_KEY: json.dumps(facts)})
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        return bytes(sink.getvalue())

    @classmethod
    def from_bytes(cls, data: bytes, source: str) -> Subset:
        """Read a document.

        Parameters
        ----------
        data : bytes
            What `to_bytes` returned.
        source : str
            Where it is from, for messages.

        Raises
        ------
        LakeFormatError
            If it is no subset, or its rows are not those that its hash was taken of.
        """
        try:
            table = pq.read_table(pa.BufferReader(data))
            facts: dict[str, Any] = json.loads(table.schema.metadata[_KEY])
            fractions = {str(name): float(share) for name, share in facts["fractions"]}
            place = {name: code for code, name in enumerate(fractions)}
            split = table.column("split").combine_chunks().dictionary_encode()
            codes = np.array([place[name] for name in split.dictionary.to_pylist()], np.int16)
            said = facts.pop("hash")
            subset = cls(
                **facts
                | {
                    "fractions": fractions,
                    "model_ids": table.column("model_id").to_numpy(),
                    "codes": codes[split.indices.to_numpy()],
                    "origin": Origin(*facts["origin"]) if facts["origin"] else None,
                }
            )
        except (KeyError, TypeError, ValueError, pa.ArrowException) as error:
            raise LakeFormatError(f"{source} is not a subset: {error!r}") from error
        if subset.hash != said:
            raise LakeFormatError(f"{source} is damaged: its hash is {subset.hash}, not {said}")
        return subset


def subset_path(name: str) -> str:
    """Return the relative path of the subset `name` in its lake."""
    return f"{FOLDER}/{name}.parquet"


def subset_names(storage: Storage) -> list[str]:
    """Return the sorted names of the subsets of a lake."""
    names = storage.names(FOLDER)
    return [name.removesuffix(".parquet") for name in names if name.endswith(".parquet")]


def pinned_snapshots(storage: Storage) -> dict[str, int]:
    """Return each subset's snapshot: whoever collects garbage has to keep these.

    Parameters
    ----------
    storage : Storage
        The lake.

    Returns
    -------
    dict
        Name of a subset -> number of its snapshot.

    Raises
    ------
    LakeFormatError
        If a subset is damaged: nothing may be removed then.
    """
    read = ((name, subset_path(name)) for name in subset_names(storage))
    return {name: Subset.from_bytes(storage.read(path), path).snapshot for name, path in read}
