"""The order of samples: pure functions of the number of samples, the seed and the epoch.

The order of an epoch is one permutation.  Rank `r` of `w` takes its places ``r, r + w, ...``, and
a step of all ranks together is the next ``w * batch_size`` places; so one number, the places that
are done, says where training stands, and another number of workers or ranks can go on from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from breplake.errors import UsageError

__all__ = ["Order", "permutation"]


def permutation(n: int, seed: int, epoch: int, block: int | None = None) -> npt.NDArray[np.int64]:
    """Return an order of `n` samples.

    Parameters
    ----------
    n : int
        Number of samples.
    seed, epoch : int
        At least 0; the order depends on nothing else.
    block : int, optional
        Shuffle blocks of so many neighbours, and then inside windows of eight blocks: reads stay
        near each other, which spares a disk that seeks or a cache that is small. Each sample still
        comes exactly once.

    Returns
    -------
    numpy.ndarray
        ``(n,)`` int64, every number below `n` once.
    """
    generator = np.random.default_rng((seed, epoch))
    if block is None:
        return generator.permutation(n)
    starts = generator.permutation(-(-n // block)) * block
    order = (starts[:, None] + np.arange(block)).ravel()  # a short last block overruns
    order = order[order < n]
    window = 8 * block
    for start in range(0, n, window):
        generator.shuffle(order[start : start + window])
    return order


@dataclass(frozen=True, slots=True)
class Order:
    """Which samples each batch of an epoch holds.

    Parameters
    ----------
    n : int
        Number of samples.
    batch_size : int
        Samples in a batch of one rank.
    seed : int
        Seed of the order.
    shuffle : bool
        Whether to shuffle; else samples come in ascending order of their model's ids.
    block : int or None
        As in `permutation`.
    rank, ranks : int
        Which of how many ranks this is.
    drop_last : bool
        Leave out the samples at an epoch's end that do not fill a batch on every rank.

    Raises
    ------
    UsageError
        If a number is too small, or the rank is none of the ranks.
    """

    n: int
    batch_size: int
    seed: int = 0
    shuffle: bool = True
    block: int | None = None
    rank: int = 0
    ranks: int = 1
    drop_last: bool = False

    def __post_init__(self) -> None:
        if self.batch_size < 1 or self.seed < 0 or (self.block is not None and self.block < 1):
            raise UsageError(
                "batch_size and block are at least 1 and seed at least 0, got "
                f"batch_size={self.batch_size}, block={self.block}, seed={self.seed}"
            )
        if not 0 <= self.rank < self.ranks:
            raise UsageError(f"rank {self.rank} is none of {self.ranks} ranks, counted from 0")

    def samples(self, epoch: int) -> npt.NDArray[np.int64]:
        """Return the order of all ranks together: ``(n,)`` int64."""
        if not self.shuffle:
            return np.arange(self.n)
        return permutation(self.n, self.seed, epoch, self.block)

    @property
    def step(self) -> int:
        """Samples of all ranks in one step."""
        return self.batch_size * self.ranks

    def batches(self, cursor: int = 0) -> int:
        """Return the number of this rank's batches from place `cursor` to the epoch's end."""
        left = max(0, self.n - cursor)
        whole, rest = divmod(left, self.step)
        return whole + (not self.drop_last and rest > self.rank)

    def ends(self, cursor: int) -> bool:
        """Return whether no rank has a batch from place `cursor` on."""
        left = self.n - cursor
        return left < self.step if self.drop_last else left <= 0

    def walk(self, epoch: int, cursor: int = 0) -> Iterator[tuple[npt.NDArray[np.int64], int]]:
        """Yield this rank's batches from place `cursor` on.

        Yields
        ------
        numpy.ndarray
            ``(batch_size,)`` int64, numbers of samples; fewer at the end.
        int
            The place after this step of all ranks.
        """
        order = self.samples(epoch)
        for _ in range(self.batches(cursor)):
            after = min(cursor + self.step, self.n)
            yield order[cursor + self.rank : after : self.ranks], after
            cursor = after
