"""Batches in an order that nothing but the seed decides, with one number as its state."""

from __future__ import annotations

import gc
import os
import re
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, get_worker_info

from breplake.errors import SampleError, UsageError
from breplake.loaders.order import Order

__all__ = ["Batched", "Loader", "fetch", "settle"]

_STATE: Final = 1
"""Version of the state."""

_THREADS: Final = "breplake-loader"
"""What names of threads begin with that read."""


class Batched(Protocol):
    """What a loader reads: a `SampleDataset`, or clouds of a pack."""

    seed: int

    @property
    def fingerprint(self) -> str:
        """Hash of what the samples are: equal where a state of one fits the other."""
        ...

    def __len__(self) -> int: ...

    def label(self, index: int) -> str:
        """Return what a message calls sample `index`."""
        ...

    def batch(
        self, indices: npt.NDArray[np.int64], epoch: int, visit: Callable[[int], None]
    ) -> Any:
        """Return a batch; call `visit` with each number before its sample is read."""
        ...


class Loader:
    """Iterate over a dataset in batches: one epoch for each ``for batch in loader``.

    The order of an epoch is a function of the dataset's models, `seed` and the epoch. It does not
    depend on workers, threads or ranks, and each sample comes exactly once: rank `r` of `w` gets
    the places ``r, r + w, ...``. So where the samples do not fill the last batches, ranks differ
    by up to one batch; `drop_last` makes them equal.

    `state_dict` counts the batches that were handed out, not those read ahead. After
    `load_state_dict`, also in another process with other numbers of workers, threads or ranks,
    the next iteration goes on from there; the one after it begins the next epoch.

    Parameters
    ----------
    dataset : SampleDataset or PackedClouds
        What is read.
    batch_size : int
        Samples in a batch.
    shuffle : bool
        Whether to shuffle; else samples come in ascending order of their model's ids.
    seed : int, optional
        Seed of the order; the dataset's own if not given.
    block : int, optional
        Shuffle blocks of so many neighbours, see `breplake.loaders.order.permutation`.
    workers : int
        Processes that read; 0 reads in this one.
    threads : int
        Threads that read where `workers` is 0, each a batch at a time; 0 reads when a batch is
        asked for.
    prefetch : int
        Batches read ahead, of each worker or of all threads.
    rank, ranks : int, optional
        Which of how many ranks this is; those of ``torch.distributed`` where it is initialised.
    drop_last : bool
        Leave out what does not fill a batch on every rank.
    pin_memory : bool
        Put batches into pinned memory, where there is an accelerator.
    context : str, optional
        How workers are started: ``fork``, ``spawn`` or ``forkserver``. By default as torch does
        it; by ``forkserver`` for a lake that is reached over a network, as no fork reads from one.
    timeout : float
        Seconds to wait for a batch of a worker; 0 waits for ever.
    fixed_epoch : int, optional
        Let every iteration be this epoch: the same order, draws and transforms each time, as
        validation needs.

    Raises
    ------
    UsageError
        If an argument breaks a rule.
    """

    def __init__(
        self,
        dataset: Batched,
        batch_size: int,
        *,
        shuffle: bool = True,
        seed: int | None = None,
        block: int | None = None,
        workers: int = 0,
        threads: int = 2,
        prefetch: int = 4,
        rank: int | None = None,
        ranks: int | None = None,
        drop_last: bool = False,
        pin_memory: bool = False,
        context: str | None = None,
        timeout: float = 0,
        fixed_epoch: int | None = None,
    ) -> None:
        if workers < 0 or threads < 0 or prefetch < 1:
            raise UsageError(
                "workers and threads are at least 0 and prefetch at least 1, got "
                f"workers={workers}, threads={threads}, prefetch={prefetch}"
            )
        if (rank is None) != (ranks is None):
            raise UsageError("rank and ranks go together: give both or neither")
        mine, all_ranks = _ranks() if rank is None or ranks is None else (rank, ranks)
        self.dataset = dataset
        self.order = Order(
            len(dataset),
            batch_size,
            seed=dataset.seed if seed is None else seed,
            shuffle=shuffle,
            block=block,
            rank=mine,
            ranks=all_ranks,
            drop_last=drop_last,
        )
        self.workers, self.threads, self.prefetch = workers, threads, prefetch
        self.pin_memory = pin_memory and torch.accelerator.is_available()
        self.context, self.timeout = context, timeout
        self.fixed_epoch = fixed_epoch
        self.set_epoch(fixed_epoch or 0)
        self._processes: DataLoader[Any] | None = None
        self._readers: tuple[int, ThreadPoolExecutor] | None = None
        # (workers, 2) process and sample that each worker is at
        self._places = torch.full((max(workers, 1), 2), -1)
        self._places.share_memory_()  # type: ignore[no-untyped-call]  # torch does not annotate it

    def __len__(self) -> int:
        """Batches of a whole epoch on this rank."""
        return self.order.batches()

    def __getstate__(self) -> dict[str, Any]:
        """Leave processes and threads behind: a copy starts its own."""
        return {**self.__dict__, "_processes": None, "_readers": None}

    def __repr__(self) -> str:
        return f"Loader({self.dataset!r}, {self.order}, workers={self.workers})"

    @property
    def epoch(self) -> int:
        """The epoch that is under way, or comes next."""
        return self._epoch

    def set_epoch(self, epoch: int) -> None:
        """Let the next iteration be `epoch`, from its beginning.

        Raises
        ------
        UsageError
            If `epoch` is negative, or not the one that is fixed.
        """
        if epoch < 0:
            raise UsageError(f"an epoch is at least 0, got {epoch}")
        if self.fixed_epoch not in (None, epoch):
            raise UsageError(f"every iteration is epoch {self.fixed_epoch} here, got {epoch}")
        self._go_to(epoch)

    def _go_to(self, epoch: int, cursor: int = 0) -> None:
        """Let the next iteration begin at place `cursor` of `epoch`."""
        self._epoch = epoch if self.fixed_epoch is None else self.fixed_epoch
        self._cursor, self._start = cursor, cursor
        self._is_through = False  # this rank had its last batch, another may have one to come

    def state_dict(self) -> dict[str, Any]:
        """Return where the iteration stands: after the same step, the same on every rank.

        A rank that has no batch in an epoch's last step is at that step when its iteration ends.
        """
        order = self.order
        return {
            "version": _STATE,
            "epoch": self._epoch,
            "cursor": self._cursor,
            "seed": order.seed,
            "shuffle": order.shuffle,
            "block": order.block,
            "samples": order.n,
            "fingerprint": self.dataset.fingerprint,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Let the next iteration go on where `state` was taken.

        Raises
        ------
        UsageError
            If the state is of other samples, of another order, or of an epoch that is not the
            fixed one.
        """
        mine = self.state_dict()
        for key in mine.keys() - {"epoch", "cursor"}:
            if state.get(key) != mine[key]:
                raise UsageError(
                    f"the state is of another loader: its {key} is {state.get(key)!r}, here it is "
                    f"{mine[key]!r}"
                )
        self.set_epoch(int(state["epoch"]))
        self._go_to(self._epoch, int(state["cursor"]))

    def __iter__(self) -> Iterator[Any]:
        """Yield the batches of an epoch, from its beginning or from where a state was loaded.

        Raises
        ------
        SampleError
            If a sample cannot be read, or a worker dies; the message names the model.
        """
        if self._is_through:  # whoever counts batches does not come back after the last one
            self._go_to(self._epoch + 1)
        epoch, self._cursor, self._start = self._epoch, self._start, 0
        steps = list(self.order.walk(epoch, self._cursor))
        keys = [(indices, epoch) for indices, _ in steps]
        made = self._by_processes(keys) if self.workers else self._by_threads(keys)
        left = len(steps)
        for batch, (_, after) in zip(made, steps, strict=True):
            left -= 1
            self._cursor, self._is_through = after, not left
            if self.order.ends(after):
                self._go_to(epoch + 1)
            yield batch
        if self._is_through or not steps:
            self._go_to(epoch + 1)

    def _by_threads(self, keys: Sequence[_Key]) -> Iterator[Any]:
        """Yield batches, read ahead by threads of this process."""
        if not self.threads:
            yield from (self._pinned(fetch(self.dataset, *key)) for key in keys)
            return
        waiting: deque[Future[Any]] = deque()
        pool = self._living_threads()
        try:
            for key in keys:
                waiting.append(pool.submit(fetch, self.dataset, *key))
                if len(waiting) > self.prefetch:
                    yield self._pinned(waiting.popleft().result())
            while waiting:
                yield self._pinned(waiting.popleft().result())
        finally:
            running = [batch for batch in waiting if not batch.cancel()]
            # Who leaves early may close the lake or fork, so nothing reads after this; but the
            # garbage collector may end this in a thread that reads: none waits for itself.
            if not threading.current_thread().name.startswith(_THREADS):
                wait(running)

    def _living_threads(self) -> ThreadPoolExecutor:
        """Return the threads that read; they live on, as new ones would bring memory of their own.

        A fork of this process has none of them.
        """
        pid, pool = self._readers or (0, None)
        if pool is None or pid != os.getpid():
            pool = ThreadPoolExecutor(self.threads, _THREADS)
            self._readers = os.getpid(), pool
        return pool

    def _by_processes(self, keys: list[_Key]) -> Iterator[Any]:
        """Yield batches, read by worker processes that live on from epoch to epoch."""
        if self._processes is None:
            self._keys: list[_Key] = []
            self._processes = DataLoader(
                _Reader(self.dataset, self._places),
                batch_size=None,
                sampler=self._keys,
                num_workers=self.workers,
                prefetch_factor=self.prefetch,
                persistent_workers=True,
                pin_memory=self.pin_memory,
                multiprocessing_context=self.context or _fit_context(self.dataset),
                timeout=self.timeout,
                collate_fn=_as_is,
                worker_init_fn=settle,
            )
        self._keys[:] = keys
        try:
            yield from self._processes
        except RuntimeError as error:
            if isinstance(error, SampleError) or "DataLoader worker" not in str(error):
                raise
            self._processes = None
            raise SampleError(self._obituary(str(error))) from error

    def _obituary(self, message: str) -> str:
        """Say which models the dead workers that a message names were at."""
        places = dict(self._places.tolist())
        said = re.findall(r"pid\(?s?\)? ?([\d, ]+)", message)
        dead = [int(number) for text in said for number in re.findall(r"\d+", text)]
        at = [self.dataset.label(places[pid]) for pid in dead if places.get(pid, -1) >= 0]
        reading = f" while reading {' and '.join(at)}" if at else ""
        return f"a worker died{reading}: {message.splitlines()[0]}"

    def _pinned(self, batch: Any) -> Any:
        return _pin(batch) if self.pin_memory else batch


_Key = tuple[npt.NDArray[np.int64], int]
"""Numbers of a batch's samples, and the epoch."""


def _fit_context(dataset: Batched) -> str | None:
    """Return how workers are started that read a lake over a network; None is torch's way."""
    index = getattr(dataset, "index", None)
    return None if index is None or index.lake.store.storage.is_local else "forkserver"


class _Reader(Dataset[Any]):
    """Reads whole batches in a worker, and notes which sample it is at."""

    def __init__(self, dataset: Batched, places: Tensor) -> None:
        self.dataset = dataset
        self.places = places

    def __getitem__(self, key: _Key) -> Any:
        info = get_worker_info()
        place = self.places[info.id if info else 0]
        place[0] = os.getpid()

        def visit(index: int) -> None:
            place[1] = index

        return fetch(self.dataset, *key, visit)


def fetch(
    dataset: Batched,
    indices: npt.NDArray[np.int64],
    epoch: int,
    visit: Callable[[int], None] = lambda index: None,
) -> Any:
    """Return a batch.

    Raises
    ------
    SampleError
        If a sample cannot be read; the message names its model.
    """
    at = -1

    def visited(index: int) -> None:
        nonlocal at
        at = index
        visit(index)

    try:
        return dataset.batch(indices, epoch, visited)
    except Exception as error:
        where = dataset.label(at) if at >= 0 else "a batch"
        raise SampleError(f"{where}: {type(error).__name__}: {error}") from error


def settle(worker: int) -> None:
    """Keep the collector's hands off what a worker inherited by a fork.

    It could destroy a database session of the parent, whose threads are not here: a crash. And
    what it does not visit stays shared with the parent's memory.
    """
    gc.freeze()


def _as_is(batch: Any) -> Any:
    return batch


def _pin(value: Any) -> Any:
    """Return a copy of a batch with its tensors in pinned memory."""
    if isinstance(value, Tensor):
        return value.pin_memory()
    if isinstance(value, dict):
        return {key: _pin(item) for key, item in value.items()}
    if isinstance(value, tuple):
        items = [_pin(item) for item in value]
        return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
    # graphs of torch_geometric know how
    return value.pin_memory() if hasattr(value, "pin_memory") else value


def _ranks() -> tuple[int, int]:
    """Return rank and number of ranks of ``torch.distributed``; 0 of 1 without it."""
    distributed = torch.distributed
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_rank(), distributed.get_world_size()
    return 0, 1
