"""Meshes of a lake as a map-style dataset."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import Dataset

from breplake.errors import UsageError
from breplake.loaders.samples import MeshSample
from breplake.queries.session import Lake
from breplake.schema.array_reader import ArrayShardReader
from breplake.schema.arrays import ARRAYS

if TYPE_CHECKING:
    from breplake.loaders.points import PointCloudDataset

__all__ = ["MeshDataset"]

_COLUMNS = (
    "model_id, name, shard, vertex_offset, normal_offset, face_offset, "
    "n_vertices, n_normals, n_faces"
)


class MeshDataset(Dataset[MeshSample]):
    """The models of a lake that have a mesh, in the order of their ids.

    Samples do not depend on the number of workers. The list of models is taken once, from the
    snapshot of `lake`; a worker, forked or spawned, opens the arrays when it first reads.

    Parameters
    ----------
    lake : Lake, str or pathlib.Path
        A lake at a snapshot, or the folder of one (then its newest snapshot).
    where : str, optional
        SQL condition on columns of ``models``, for instance ``"n_torus > 30"``; it may hold
        subqueries on other tables.

    Raises
    ------
    UsageError
        If `where` is no condition on ``models``.

    Attributes
    ----------
    snapshot : int
        Number of the snapshot.
    model_ids : numpy.ndarray
        ``(len,)`` int64, ascending.
    """

    def __init__(self, lake: Lake | str | Path, where: str | None = None) -> None:
        opened = lake if isinstance(lake, Lake) else Lake(lake)
        self.root = opened.root
        self.snapshot = opened.snapshot.number
        self.where = where
        table = _select(opened, where)
        self.model_ids: npt.NDArray[np.int64] = table.column("model_id").to_numpy()
        # arrays of numbers and one Arrow array of text: Python objects would be copied into
        # every forked worker as their reference counts are touched
        self._names = table.column("name").combine_chunks()
        shards = table.column("shard").combine_chunks().dictionary_encode()
        self._shards: list[str] = shards.dictionary.to_pylist()
        self._shard = shards.indices.to_numpy(zero_copy_only=False)  # (len,)
        self._rows = {
            axis: np.stack(
                [table.column(f"{axis}_offset").to_numpy(), table.column(count).to_numpy()], axis=1
            )  # (len, 2) first row and number of rows
            for axis, count in (
                ("vertex", "n_vertices"),
                ("normal", "n_normals"),
                ("face", "n_faces"),
            )
        }
        self._readers: dict[int, ArrayShardReader] = {}

    def __len__(self) -> int:
        return len(self.model_ids)

    def __getitem__(self, index: int) -> MeshSample:
        """Return a mesh.

        Raises
        ------
        IndexError
            If there is no sample of that number.
        """
        index = self.checked(index)
        return MeshSample(
            positions=self.read("position", index),
            normals=self.read("normal", index),
            curvatures=self.read("curvature", index),
            normal_patch=self.read("patch", index),
            triangles=self.read("triangle", index),
            triangle_normals=self.read("triangle_normal", index),
            triangle_patch=self.read("triangle_patch", index),
            features=self.read("feature", index),
            model_id=int(self.model_ids[index]),
            name=self.name(index),
            snapshot=self.snapshot,
        )

    def __repr__(self) -> str:
        where = f", where={self.where!r}" if self.where else ""
        return f"MeshDataset({str(self.root)!r}{where}): {len(self)} meshes at {self.snapshot}"

    def checked(self, index: int) -> int:
        """Return `index` counted from the start; negative ones count from the end.

        Raises
        ------
        IndexError
            If there is no sample of that number.
        """
        if not -len(self) <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        return int(index) % len(self)

    def name(self, index: int) -> str:
        """Return the name of the model of sample `index`."""
        name: str = self._names[index].as_py()
        return name

    def read(self, array: str, index: int) -> Tensor:
        """Return one array of sample `index`; indices and labels as int64, fit to index with."""
        start, count = self._rows[ARRAYS[array].axis][index].tolist()
        rows = self._reader(int(self._shard[index])).read(array, start, start + count)
        return torch.from_numpy(rows.astype(np.int64) if rows.dtype.kind == "i" else rows)

    def _reader(self, shard: int) -> ArrayShardReader:
        if shard not in self._readers:
            path = self.root / "arrays" / f"{self._shards[shard]}.zarr"
            self._readers[shard] = ArrayShardReader(path)
        return self._readers[shard]

    def points(self, n: int, seed: int = 0) -> PointCloudDataset:
        """Return the same models as clouds of exactly `n` points.

        Parameters
        ----------
        n : int
            Points for each model, at least 1.
        seed : int
            Another seed draws other points.
        """
        from breplake.loaders.points import PointCloudDataset

        return PointCloudDataset(self, n, seed)


def _select(lake: Lake, where: str | None) -> Any:
    """Return the index of the models with a mesh as an Arrow table."""
    import duckdb

    condition = "true" if where is None else where
    # the line break ends a comment in the condition
    query = f"SELECT {_COLUMNS} FROM models WHERE n_faces > 0 AND ({condition}\n) ORDER BY model_id"
    try:
        return lake.sql(query).to_arrow_table()
    except (UsageError, duckdb.Error) as error:
        raise UsageError(f"where={where!r} is no condition on models: {error}") from error
