"""The same point clouds in the formats of other loaders, each with its documented settings.

A peer is a pair of functions: one writes the clouds into a folder, one yields shuffled batches of
torch tensors. Libraries are imported inside, since any of them may be missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

__all__ = ["PEERS", "Clouds", "Peer", "for_ever"]

_CHUNK_BYTES: Final = 64 << 20
"""About the size of a chunk or shard, as the guides of these libraries advise."""


@dataclass(frozen=True, slots=True)
class Clouds:
    """The samples.

    Parameters
    ----------
    points : numpy.ndarray
        ``(m, n, 6)`` float32: position and normal.
    labels : numpy.ndarray
        ``(m, n)`` uint8.
    """

    points: npt.NDArray[np.float32]
    labels: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)

    def item(self, index: int) -> dict[str, npt.NDArray[Any]]:
        """Return one sample as most writers want it."""
        return {"points": self.points[index], "label": self.labels[index]}


@dataclass(frozen=True, slots=True)
class Peer:
    """A way to store and read the clouds.

    Parameters
    ----------
    module : str
        What has to be installed.
    write : callable
        Writes clouds into a folder.
    batches : callable
        Yields ``(points, labels)`` batches, epoch after epoch without end, from a loader that is
        made once: ``batches(folder, batch_size, workers)``.
    workers : tuple of int
        Numbers of worker processes to try; the best one counts.
    note : str
        How it shuffles.
    """

    module: str
    write: Callable[[Clouds, Path], None]
    batches: Callable[[Path, int, int], Iterator[tuple[Any, Any]]]
    workers: tuple[int, ...] = (0, 2)
    note: str = "full shuffle"

    @property
    def is_there(self) -> bool:
        """Whether its library is installed."""
        return find_spec(self.module) is not None


def for_ever(loader: Iterable[Any]) -> Iterator[Any]:
    """Yield the batches of a loader, epoch after epoch."""
    while True:
        yield from loader


def _write_memmap(clouds: Clouds, folder: Path) -> None:
    np.save(folder / "points.npy", clouds.points)
    np.save(folder / "labels.npy", clouds.labels)


def _memmap(folder: Path, batch_size: int, workers: int) -> Iterator[tuple[Any, Any]]:
    import torch

    points = np.load(folder / "points.npy", mmap_mode="r")
    labels = np.load(folder / "labels.npy", mmap_mode="r")
    while True:
        order = np.random.default_rng().permutation(len(points))
        for start in range(0, len(order), batch_size):
            rows = order[start : start + batch_size]
            yield torch.from_numpy(points[rows]), torch.from_numpy(labels[rows])


def _write_litdata(clouds: Clouds, folder: Path) -> None:
    # what litdata.optimize writes with, without its processes
    module = import_module("litdata.streaming.writer")
    writer = module.BinaryWriter(str(folder), chunk_bytes=_CHUNK_BYTES)
    for index in range(len(clouds)):
        writer.add_item(index, clouds.item(index))
    writer.done()
    writer.merge()


def _litdata(folder: Path, batch_size: int, workers: int) -> Iterator[tuple[Any, Any]]:
    module = import_module("litdata")
    dataset = module.StreamingDataset(str(folder), shuffle=True)
    loader = module.StreamingDataLoader(
        dataset, batch_size=batch_size, num_workers=workers, persistent_workers=workers > 0
    )
    for batch in for_ever(loader):
        yield batch["points"], batch["label"]


def _write_mosaic(clouds: Clouds, folder: Path) -> None:
    n = clouds.points.shape[1]
    columns = {"points": f"ndarray:float32:{n},6", "label": f"ndarray:uint8:{n}"}
    writer = import_module("streaming").MDSWriter
    with writer(out=str(folder), columns=columns, size_limit=_CHUNK_BYTES) as out:
        for index in range(len(clouds)):
            out.write(clouds.item(index))


def _mosaic(folder: Path, batch_size: int, workers: int) -> Iterator[tuple[Any, Any]]:
    from torch.utils.data import DataLoader

    streaming = import_module("streaming")
    streaming.base.util.clean_stale_shared_memory()  # of a process that was killed
    dataset = streaming.StreamingDataset(local=str(folder), shuffle=True, batch_size=batch_size)
    loader = DataLoader(
        dataset, batch_size=batch_size, num_workers=workers, persistent_workers=workers > 0
    )
    for batch in for_ever(loader):
        yield batch["points"], batch["label"]


def _write_datasets(clouds: Clouds, folder: Path) -> None:
    datasets = import_module("datasets")
    n = clouds.points.shape[1]
    features = datasets.Features(
        {
            "points": datasets.Array2D((n, 6), "float32"),
            "label": datasets.Sequence(datasets.Value("uint8"), n),
        }
    )
    made = datasets.Dataset.from_generator(
        lambda: (clouds.item(i) for i in range(len(clouds))),
        features=features,
        cache_dir=str(folder / "cache"),
    )
    made.save_to_disk(str(folder / "data"))


def _datasets(folder: Path, batch_size: int, workers: int) -> Iterator[tuple[Any, Any]]:
    from torch.utils.data import DataLoader

    dataset = import_module("datasets").load_from_disk(str(folder / "data")).with_format("torch")
    loader = DataLoader(
        dataset,
        batch_size=batch_size,
        shuffle=True,
        num_workers=workers,
        persistent_workers=workers > 0,
    )
    for batch in for_ever(loader):
        yield batch["points"], batch["label"]


def _write_webdataset(clouds: Clouds, folder: Path) -> None:
    writer = import_module("webdataset").ShardWriter
    with writer(str(folder / "clouds-%05d.tar"), maxsize=_CHUNK_BYTES, verbose=0) as sink:
        for index in range(len(clouds)):
            item = clouds.item(index)
            sink.write({"__key__": f"{index:08d}", "points.npy": item["points"],
                        "label.npy": item["label"]})  # fmt: skip


def _webdataset(folder: Path, batch_size: int, workers: int) -> Iterator[tuple[Any, Any]]:
    import torch

    wds = import_module("webdataset")
    urls = sorted(map(str, folder.glob("*.tar")))
    dataset = wds.WebDataset(urls, shardshuffle=len(urls)).shuffle(1000).decode()
    dataset = dataset.to_tuple("points.npy", "label.npy").batched(batch_size)
    loader = wds.WebLoader(
        dataset, batch_size=None, num_workers=workers, persistent_workers=workers > 0
    )
    for points, label in for_ever(loader):
        yield torch.as_tensor(points), torch.as_tensor(label)


def _write_lance(clouds: Clouds, folder: Path) -> None:
    import pyarrow as pa

    n = clouds.points.shape[1]
    points = pa.FixedSizeListArray.from_arrays(clouds.points.ravel(), n * 6)
    label = pa.FixedSizeListArray.from_arrays(clouds.labels.ravel(), n)
    table = pa.table({"points": points, "label": label})
    import_module("lance").write_dataset(table, str(folder / "clouds.lance"))


class _LanceRows:
    """Map-style access that takes the rows of a whole batch at once, as Lance's guide does."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)
        self._dataset: Any = None

    def __len__(self) -> int:
        return int(self._open().count_rows())

    def _open(self) -> Any:
        if self._dataset is None:  # once in each process
            self._dataset = import_module("lance").dataset(self.path)
        return self._dataset

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "_dataset": None}

    def __getitems__(self, rows: list[int]) -> tuple[Any, Any]:
        import torch

        table = self._open().take(rows)
        flat = [table.column(c).combine_chunks().flatten().to_numpy() for c in ("points", "label")]
        points, label = (torch.from_numpy(a.reshape(len(rows), -1).copy()) for a in flat)
        return points.view(len(rows), -1, 6), label


def _as_is(batch: Any) -> Any:
    return batch


def _lance(folder: Path, batch_size: int, workers: int) -> Iterator[tuple[Any, Any]]:
    from torch.utils.data import DataLoader

    loader: Iterable[Any] = DataLoader(
        _LanceRows(folder / "clouds.lance"),  # type: ignore[arg-type]  # duck-typed Dataset
        batch_size=batch_size,
        shuffle=True,
        num_workers=workers,
        collate_fn=_as_is,
        multiprocessing_context="spawn" if workers else None,  # Lance does not survive a fork
        persistent_workers=workers > 0,
    )
    yield from for_ever(loader)


PEERS: Final[dict[str, Peer]] = {
    "np.memmap": Peer("numpy", _write_memmap, _memmap, workers=(0,)),
    "litdata": Peer("litdata", _write_litdata, _litdata, note="shuffles chunks and inside them"),
    "mosaicml-streaming": Peer("streaming", _write_mosaic, _mosaic, note="shuffles in blocks"),
    "datasets": Peer("datasets", _write_datasets, _datasets),
    "webdataset": Peer(
        "webdataset", _write_webdataset, _webdataset, note="shuffles shards and a buffer of 1,000"
    ),
    "lance": Peer("lance", _write_lance, _lance),
}
"""Peers by the names of their packages."""
