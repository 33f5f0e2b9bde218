"""Packs: the point clouds of a dataset drawn once and stored raw, to be read at memory speed.

A pack is a Zarr v3 group without compression, so that each of its files is a piece of an array
that can be mapped into memory: reading a sample is one copy per field.  The points of a cloud
are stored in random order; so when a pack has more of them than a sample needs, any run of
neighbours is a random draw, and each epoch takes another run.

::

    PACK/zarr.json              what the pack is, as attributes
    PACK/models.parquet         model_id, name
    PACK/positions/c/0/0/0      (models, points, 3) float32, whole models in each file
    PACK/normals ...            and so for each field
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from torch import Tensor

from breplake.errors import LakeFormatError, UsageError
from breplake.loaders.loader import Loader
from breplake.loaders.points import PointCloudDataset
from breplake.schema.buffers import Buffers
from breplake.schema.raw_arrays import RawArray

__all__ = ["FIELDS", "CloudBatch", "PackedClouds", "write_pack"]

FIELDS: Final = {
    "positions": ("<f4", 3),
    "normals": ("<f4", 3),
    "curvatures": ("<f4", 2),
    "patches": ("<i4", 0),
    "types": ("|u1", 0),
    "features": ("|u1", 0),
}
"""Fields of a cloud that a pack may hold: NumPy type and columns."""

_FORMAT: Final = 1
_FILE_BYTES: Final = 128 << 20
"""About the size of a file of a pack."""

_BATCH: Final = 64


class CloudBatch(NamedTuple):
    """Point clouds of a pack, stacked; fields that the pack lacks are None.

    Parameters
    ----------
    positions : Tensor
        ``(b, n, 3)`` float32, mm.
    normals : Tensor or None
        ``(b, n, 3)`` float32, outward unit normals.
    curvatures : Tensor or None
        ``(b, n, 2)`` float32, k_min and k_max in 1/mm.
    patches : Tensor or None
        ``(b, n)`` int32, patch of each point.
    types : Tensor or None
        ``(b, n)`` uint8, place of the patch's type in `breplake.schema.types.SURFACE_TYPES`.
    features : Tensor or None
        ``(b, n)`` uint8, as in `PointCloudSample`.
    model_id : Tensor
        ``(b,)`` int64.
    name : tuple of str
        Names of the models.
    snapshot : int
        Number of the lake's snapshot.
    """

    positions: Tensor
    normals: Tensor | None
    curvatures: Tensor | None
    patches: Tensor | None
    types: Tensor | None
    features: Tensor | None
    model_id: Tensor
    name: tuple[str, ...]
    snapshot: int


def write_pack(
    clouds: PointCloudDataset,
    path: str | Path,
    fields: Sequence[str] = ("positions", "normals", "types"),
    workers: int = 0,
) -> PackedClouds:
    """Draw the clouds of a dataset, as they are in its current epoch, and store them.

    Parameters
    ----------
    clouds : PointCloudDataset
        What to draw; its transforms are applied.
    path : str or pathlib.Path
        Folder to make. It appears when the pack is whole.
    fields : sequence of str
        Which of `FIELDS`; positions are always stored.
    workers : int
        Processes that draw.

    Returns
    -------
    PackedClouds
        The pack.

    Raises
    ------
    UsageError
        If the folder exists, there is no such field, or a transform changed the number of points.
    SampleError
        If a cloud cannot be drawn.
    """
    import zarr

    target = Path(path)
    part = target.with_name(f".{target.name}.part")
    chosen = [name for name in FIELDS if name in fields or name == "positions"]
    if unknown := sorted(set(fields) - set(FIELDS)):
        raise UsageError(f"a cloud has no field {unknown[0]!r}: it has {', '.join(FIELDS)}")
    if target.exists():
        raise UsageError(f"{target} exists, and packs are written once: name a new folder")
    if not len(clouds):
        raise UsageError("there are no clouds to pack")
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(part, ignore_errors=True)  # of a writer that was killed
    group = zarr.create_group(str(part), zarr_format=3, attributes=_attributes(clouds, chosen))
    arrays = {name: _create(group, name, len(clouds), clouds.n) for name in chosen}
    loader = Loader(clouds, _BATCH, shuffle=False, workers=workers)
    loader.set_epoch(clouds.epoch)
    for name, rows in _gathered(loader, chosen, {k: v.chunks[0] for k, v in arrays.items()}):
        start, values = rows
        if values.shape[1] != clouds.n:
            raise UsageError("a pack holds clouds of one size: leave out the transform Drop")
        arrays[name][start : start + len(values)] = values
    names = [clouds.name(i) for i in range(len(clouds))]
    ids = np.repeat(clouds.model_ids, clouds.per_model)
    table = pa.table({"model_id": ids, "name": names})
    pq.write_table(table, part / "models.parquet", compression="zstd")
    part.rename(target)
    return PackedClouds(target)


class PackedClouds:
    """The clouds of a pack, read in whole batches; give it to a `Loader`.

    Parameters
    ----------
    path : str or pathlib.Path
        The pack's folder.
    n : int, optional
        Points of a sample; all that are stored if not given.
    seed : int
        Another seed takes other runs of points.

    Raises
    ------
    LakeFormatError
        If there is no pack in that folder, or it lacks a field that it was written with.
    UsageError
        If `n` is not between 1 and the number of points stored.

    Attributes
    ----------
    facts : dict
        What was packed: lake id, snapshot, subset, its hash, split, seed, source.
    model_ids : numpy.ndarray
        ``(len,)`` int64, ascending.
    """

    def __init__(self, path: str | Path, n: int | None = None, seed: int = 0) -> None:
        self.path = Path(path)
        try:
            self.facts = RawArray.attributes(self.path)["breplake"]
            models = pq.read_table(self.path / "models.parquet")
            # packs of an earlier version do not say which fields they have
            fields = self.facts.get("fields") or [f for f in FIELDS if (self.path / f).is_dir()]
            self._arrays = {name: RawArray(self.path / name) for name in fields}
            self.snapshot = int(self.facts["snapshot"])
            self.points = self._arrays["positions"].shape[1]
        except (KeyError, OSError, TypeError, ValueError, pa.ArrowException) as error:
            raise LakeFormatError(f"{self.path} is not a pack of clouds: {error!r}") from error
        self.n = self.points if n is None else n
        if not 1 <= self.n <= self.points or seed < 0:
            raise UsageError(
                f"n must be from 1 to the {self.points} points stored and seed at least 0, got "
                f"n={n}, seed={seed}"
            )
        self.seed = seed
        self.model_ids: npt.NDArray[np.int64] = models.column("model_id").to_numpy()
        names = models.column("name").combine_chunks().dictionary_encode()
        self._names: list[str] = names.dictionary.to_pylist()
        self._name_of: npt.NDArray[np.int32] = names.indices.to_numpy()  # (len,)
        self._runs: tuple[int, npt.NDArray[np.int64]] | None = None
        self._buffers = Buffers()

    def __len__(self) -> int:
        return len(self.model_ids)

    def __repr__(self) -> str:
        return f"PackedClouds({str(self.path)!r}): {len(self)} clouds of {self.n} points"

    @property
    def fingerprint(self) -> str:
        """Hash of the models' ids: equal for the same models, in every lake."""
        return str(self.facts["fingerprint"])

    def label(self, index: int) -> str:
        """Return what a message calls sample `index`: its model's name and id."""
        return f"model {self._names[self._name_of[index]]} ({int(self.model_ids[index])})"

    def __getitem__(self, index: int) -> CloudBatch:
        """Return one cloud of epoch 0 as a batch of one."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        return self.batch(np.array([index % len(self)]), 0)

    def batch(
        self,
        indices: npt.NDArray[np.int64],
        epoch: int,
        visit: Callable[[int], None] | None = None,
    ) -> CloudBatch:
        """Return clouds, stacked.

        Parameters
        ----------
        indices : numpy.ndarray
            ``(b,)`` int64, numbers of clouds.
        epoch : int
            Another epoch takes other runs of points.
        visit : callable, optional
            Told the first number: a batch is read in one go.
        """
        if visit is not None and len(indices):
            visit(int(indices[0]))
        starts = None if self.n == self.points else self._starts(epoch)[indices]
        values = {
            name: torch.from_numpy(array.take(indices, starts, self.n, self._buffers))
            for name, array in self._arrays.items()
        }
        return CloudBatch(
            **{name: values.get(name) for name in FIELDS},  # type: ignore[arg-type]  # a pack has positions
            model_id=torch.from_numpy(self.model_ids[indices]),
            name=tuple([self._names[i] for i in self._name_of[indices].tolist()]),
            snapshot=self.snapshot,
        )

    def _starts(self, epoch: int) -> npt.NDArray[np.int64]:
        """Return ``(len,)`` first points of the runs of an epoch."""
        kept = self._runs
        if kept is None or kept[0] != epoch:
            generator = np.random.default_rng((self.seed, epoch, self.points))
            kept = self._runs = (epoch, generator.integers(self.points, size=len(self)))
        return kept[1]


def _attributes(clouds: PointCloudDataset, fields: list[str]) -> dict[str, Any]:
    index = clouds.index
    subset = index.subset
    return {
        "breplake": {
            "pack": _FORMAT,
            "fields": fields,
            "lake_id": index.lake.store.lake_id,
            "snapshot": index.snapshot,
            "subset": subset and subset.name,
            "subset_hash": subset and subset.hash,
            "split": index.split,
            "where": index.where,
            "fingerprint": index.fingerprint,
            "source": clouds.source,
            "seed": clouds.seed,
            "epoch": clouds.epoch,
            "transforms": [repr(t) for t in clouds.transforms],
        }
    }


def _create(group: Any, name: str, models: int, points: int) -> Any:
    """Create an uncompressed array whose files hold whole models."""
    dtype, columns = FIELDS[name]
    shape = (models, points, *([columns] if columns else []))
    size = points * max(columns, 1) * np.dtype(dtype).itemsize
    rows = min(models, max(1, _FILE_BYTES // size))
    return group.create_array(
        name,
        shape=shape,
        dtype=dtype,
        chunks=(rows, *shape[1:]),
        compressors=None,
        filters=None,
        config={"write_empty_chunks": True},  # a file of zeros is mapped as any other
    )


def _gathered(
    loader: Iterable[Any], fields: Sequence[str], rows: dict[str, int]
) -> Iterable[tuple[str, tuple[int, npt.NDArray[Any]]]]:
    """Yield ``(field, (first model, values))``, whole files at a time."""
    waiting: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in fields}
    first = dict.fromkeys(fields, 0)
    for batch in loader:
        for name in fields:
            waiting[name].append(getattr(batch, name).numpy().astype(FIELDS[name][0]))
            if sum(map(len, waiting[name])) >= rows[name]:
                values = np.concatenate(waiting[name])
                yield name, (first[name], values[: rows[name]])
                waiting[name], first[name] = [values[rows[name] :]], first[name] + rows[name]
    for name in fields:
        if sum(map(len, waiting[name])):
            yield name, (first[name], np.concatenate(waiting[name]))
