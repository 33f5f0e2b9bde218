"""The same order as an iterable dataset, for loops that bring a DataLoader of their own."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from torch.utils.data import IterableDataset, get_worker_info

from breplake.loaders.loader import Batched, fetch, settle
from breplake.loaders.order import Order

__all__ = ["BatchStream"]


class BatchStream(IterableDataset[Any]):
    """Batches of one epoch, shared out over the workers of a DataLoader.

    ``DataLoader(BatchStream(dataset, order), batch_size=None, num_workers=8)`` yields them in the
    order of `order`, whatever the number of workers. `Loader` does the same and keeps the state.

    Parameters
    ----------
    dataset : SampleDataset or PackedClouds
        What is read.
    order : Order
        Batch size, seed and rank.
    epoch : int
        The epoch.
    cursor : int
        Place to begin with: the cursor of a loader's state.
    """

    def __init__(self, dataset: Batched, order: Order, epoch: int = 0, cursor: int = 0) -> None:
        self.dataset, self.order = dataset, order
        self.epoch, self.cursor = epoch, cursor

    def __len__(self) -> int:
        return self.order.batches(self.cursor)

    def __iter__(self) -> Iterator[Any]:
        """Yield this worker's batches: each k-th of all of them.

        Raises
        ------
        SampleError
            If a sample cannot be read; the message names its model.
        """
        info = get_worker_info()
        if info:
            settle(info.id)
        worker, workers = (info.id, info.num_workers) if info else (0, 1)
        for number, (indices, _) in enumerate(self.order.walk(self.epoch, self.cursor)):
            if number % workers == worker:  # a DataLoader asks its workers in turn
                yield fetch(self.dataset, indices, self.epoch)
