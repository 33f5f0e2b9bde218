"""Subsets of a lake: select models by SQL, split them by duplicate group, freeze the answer.

Which split a model is in is a pure function of the seed and its duplicate group, whatever the
other models are.  So copies and near-copies stay together, and a model keeps its split when the
lake grows.  The price is that shares are met on average and not exactly.

Scaled copies and mirror images are other duplicate groups.  Splitting by form keeps them together
too.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, get_args

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.errors import NameNotFoundError, UsageError
from breplake.queries.names import did_you_mean
from breplake.queries.session import Lake
from breplake.schema.fingerprint import Fingerprint
from breplake.schema.subset import WHOLE, Subset, Together, subset_names, subset_path

__all__ = [
    "Subset",
    "SubsetDiff",
    "create_subset",
    "diff_subsets",
    "form_groups",
    "load_subset",
    "save_subset",
    "split_codes",
    "subsets",
]

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_SHOWN: Final = 5
_SHARED: Final = " or ".join(get_args(Together))


@dataclass(frozen=True, slots=True)
class SubsetDiff:
    """How two subsets differ.

    Parameters
    ----------
    only_first, only_second : numpy.ndarray
        ``(n,)`` int64, ids that only one of them has.
    moved : numpy.ndarray
        ``(m,)`` int64, ids that both have in splits of different names.
    common : int
        Number of ids that both have in the same split.
    """

    only_first: npt.NDArray[np.int64]
    only_second: npt.NDArray[np.int64]
    moved: npt.NDArray[np.int64]
    common: int


def create_subset(
    lake: Lake,
    name: str,
    *,
    sql: str | None = None,
    where: str | None = None,
    split: Mapping[str, float] | None = None,
    seed: int = 0,
    limit: int | None = None,
    together: Together = "copies",
) -> Subset:
    """Select models and store them in the lake under a name, for good.

    Parameters
    ----------
    lake : Lake
        The lake at the snapshot to select from.
    name : str
        Letters, digits, '.', '_' and '-'.
    sql : str, optional
        A query with a column ``model_id``; rows that repeat an id count once.
    where : str, optional
        Instead of `sql`: a condition on ``models``.
    split : mapping, optional
        Name of each split -> its share; the shares sum to 1. See `split_codes`.
    seed : int
        Another seed splits and limits otherwise.
    limit : int, optional
        Take at most so many: those whose hash with the seed is least, so that nearly the same
        ones are taken when models are added.
    together : {"copies", "form"}
        Which models share a split: those of a duplicate group, or those of a form, that is scaled
        copies and mirror images too. See `form_groups`.

    Returns
    -------
    Subset
        What was stored.

    Raises
    ------
    UsageError
        If an argument breaks these rules, nothing is selected, or the name is taken by another
        subset.
    """
    if (sql is None) == (where is None):
        raise UsageError("say which models: either sql or where, and not both")
    if limit is not None and limit < 1:
        raise UsageError(f"a limit is at least 1, got {limit}")
    if together not in get_args(Together):
        raise UsageError(f"models stay together by {_SHARED}, got {together!r}")
    # the line break ends a comment in the condition
    query = sql if sql is not None else f"SELECT model_id FROM models WHERE ({where}\n)"
    ids, groups, prints = _select(lake, query)
    if together == "form":
        groups = form_groups(groups, prints)
    if limit is not None and limit < len(ids):
        kept = np.sort(np.argsort(_uniform(ids, seed), kind="stable")[:limit])
        ids, groups = ids[kept], groups[kept]
    fractions = _checked_fractions(split)
    subset = Subset(
        name=name,
        sql=query,
        lake_id=lake.store.lake_id,
        snapshot=lake.snapshot.number,
        fractions=fractions,
        seed=seed,
        limit=limit,
        model_ids=ids,
        codes=split_codes(groups, fractions, seed),
        time=datetime.now(UTC).isoformat(timespec="seconds"),
        together=together,
    )
    return save_subset(lake, subset)


def save_subset(lake: Lake, subset: Subset) -> Subset:
    """Store a subset, for good; storing an equal one again changes nothing.

    Returns
    -------
    Subset
        What the lake now has under that name.

    Raises
    ------
    UsageError
        If its name is unfit or names another subset.
    NameNotFoundError
        If its snapshot was removed meanwhile: then nothing is stored.
    """
    if not _NAME.fullmatch(subset.name):
        raise UsageError(
            "a subset is named by letters, digits, '.', '_' and '-', at most 100, "
            f"got {subset.name!r}"
        )
    storage, path = lake.store.storage, subset_path(subset.name)
    if storage.create(path, subset.to_bytes()):
        try:
            lake.store.log.confirm(subset.snapshot)
        except NameNotFoundError:
            storage.remove(path)
            raise
        return subset
    there = load_subset(lake, subset.name)
    if there != subset or there.hash != subset.hash:
        raise UsageError(
            f"subset {subset.name} is there already, made at snapshot {there.snapshot} and "
            "immutable: use a new name"
        )
    return there


def load_subset(lake: Lake, name: str) -> Subset:
    """Return a subset by its name.

    Raises
    ------
    NameNotFoundError
        If there is none.
    LakeFormatError
        If its file is damaged.
    """
    storage = lake.store.storage
    path = subset_path(name)
    try:
        if not _NAME.fullmatch(name):
            raise FileNotFoundError(path)
        return Subset.from_bytes(storage.read(path), path)
    except FileNotFoundError:
        known = subset_names(storage)
        hint = did_you_mean(name, known) or f": there are {', '.join(known[:_SHOWN]) or 'none'}"
        raise NameNotFoundError(f"the lake {lake.place} has no subset {name!r}{hint}") from None


def subsets(lake: Lake) -> list[Subset]:
    """Return all subsets of a lake, sorted by name."""
    return [load_subset(lake, name) for name in subset_names(lake.store.storage)]


def diff_subsets(first: Subset, second: Subset) -> SubsetDiff:
    """Compare two subsets, of one lake or of two."""
    _, a, b = np.intersect1d(
        first.model_ids, second.model_ids, assume_unique=True, return_indices=True
    )
    names_a, names_b = np.array(first.splits), np.array(second.splits)
    moved = names_a[first.codes[a]] != names_b[second.codes[b]]  # (common,)
    return SubsetDiff(
        only_first=np.setdiff1d(first.model_ids, second.model_ids, assume_unique=True),
        only_second=np.setdiff1d(second.model_ids, first.model_ids, assume_unique=True),
        moved=first.model_ids[a][moved],
        common=int((~moved).sum()),
    )


def split_codes(
    groups: npt.NDArray[np.int64], fractions: Mapping[str, float], seed: int
) -> npt.NDArray[np.int16]:
    """Assign every duplicate group to a split.

    The first 64 bits of SHA-256 of ``<seed> <group>``, as a number in [0, 1), fall into one of
    the intervals whose lengths are the shares, in their order.

    Parameters
    ----------
    groups : numpy.ndarray
        ``(n,)`` int64, duplicate group of each model.
    fractions : mapping
        Name of each split -> its share; they sum to 1.
    seed : int
        Another seed assigns otherwise.

    Returns
    -------
    numpy.ndarray
        ``(n,)`` int16, index of the split; equal for equal groups.
    """
    unique, inverse = np.unique(groups, return_inverse=True)
    borders = np.cumsum(list(fractions.values()))[:-1]  # (splits - 1,)
    codes = np.searchsorted(borders, _uniform(unique, seed), side="right")
    return codes.astype(np.int16)[inverse]


def form_groups(
    groups: npt.NDArray[np.int64], fingerprints: Sequence[str | None]
) -> npt.NDArray[np.int64]:
    """Return a number for each form: the same for copies, scaled copies and mirror images.

    Parameters
    ----------
    groups : numpy.ndarray
        ``(n,)`` int64, duplicate group of each model.
    fingerprints : sequence of str or None
        Of each model; one without is of a form of its own, numbered as its group.

    Returns
    -------
    numpy.ndarray
        ``(n,)`` int64, the form's 64 bits.
    """
    forms = [
        group if text is None else int(Fingerprint.parse(text).form, 16)
        for group, text in zip(groups.tolist(), fingerprints, strict=True)
    ]
    return np.array([form % 2**64 for form in forms], np.uint64).view(np.int64)


def _uniform(numbers: npt.NDArray[np.int64], seed: int) -> npt.NDArray[np.float64]:
    """Return ``(n,)`` numbers in [0, 1), each a hash of the seed and one of `numbers`."""
    digests = (hashlib.sha256(f"{seed} {n}".encode()).digest()[:8] for n in numbers.tolist())
    bits = np.frombuffer(b"".join(digests), dtype=">u8")
    # the bits that float64 holds exactly
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53


def _checked_fractions(split: Mapping[str, float] | None) -> dict[str, float]:
    if split is None:
        return {WHOLE: 1.0}
    for name, share in split.items():
        if not _NAME.fullmatch(name) or name == WHOLE:
            raise UsageError(
                f"a split is named by letters, digits, '.', '_' and '-', and not {WHOLE!r}, "
                f"got {name!r}"
            )
        if not 0 < share <= 1:
            raise UsageError(f"the share of a split is above 0 and at most 1, got {name}={share}")
    if abs(sum(split.values()) - 1) > 1e-9:
        raise UsageError(f"the shares of all splits sum to 1, got {sum(split.values()):g}")
    return dict(split)


def _select(
    lake: Lake, query: str
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], list[str | None]]:
    """Return ascending ids, their duplicate groups and their fingerprints."""
    import duckdb

    try:
        relation = lake.sql(query)
        if "model_id" not in relation.columns:
            raise UsageError(f"the query must have a column model_id, not {relation.columns}")
        chosen: Any = relation.select("model_id").to_arrow_table().column("model_id")
    except duckdb.Error as error:
        raise UsageError(str(error)) from error
    if not pa.types.is_integer(chosen.type) or chosen.null_count:
        raise UsageError("the column model_id of the query must be whole numbers without nulls")
    ids = np.unique(chosen.to_numpy().astype(np.int64))
    if not len(ids):
        raise UsageError(f"the query selects no model: {query.strip()}")
    table: Any = lake.sql(
        "SELECT model_id, duplicate_group, fingerprint FROM models ORDER BY model_id"
    )
    models = table.to_arrow_table()
    known = models.column("model_id").to_numpy()
    if len(strange := np.setdiff1d(ids, known)):
        raise UsageError(
            f"{len(strange)} of the {len(ids)} selected ids are no models of snapshot "
            f"{lake.snapshot.number}: {', '.join(map(str, strange[:_SHOWN]))}"
        )
    at = np.searchsorted(known, ids)
    groups, prints = models.column("duplicate_group"), models.column("fingerprint")
    return ids, groups.to_numpy()[at], prints.take(at).to_pylist()
