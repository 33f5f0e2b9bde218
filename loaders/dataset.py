"""What all datasets have in common: samples are functions of a number, the seed and the epoch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch.utils.data import Dataset, default_collate

from breplake.errors import UsageError
from breplake.loaders.index import ModelIndex
from breplake.loaders.transforms import Transform

__all__ = ["SampleDataset"]

S = TypeVar("S")


class SampleDataset(Dataset[S], Generic[S]):
    """Samples of the models of an index, as a map-style dataset.

    Parameters
    ----------
    index : ModelIndex
        The models.
    seed : int
        At least 0; another seed draws and transforms otherwise.
    transforms : sequence of Transform
        Applied to each sample in turn, each with a generator keyed by (seed, epoch, model).
    per_model : int
        Samples of each model.

    Raises
    ------
    UsageError
        If `seed` or `per_model` is too small.

    Attributes
    ----------
    index : ModelIndex
        The models.
    seed : int
        The seed.
    """

    def __init__(
        self,
        index: ModelIndex,
        seed: int = 0,
        transforms: Sequence[Transform] = (),
        per_model: int = 1,
    ) -> None:
        if seed < 0 or per_model < 1:
            raise UsageError(
                f"seed must be at least 0 and per_model at least 1, got seed={seed}, "
                f"per_model={per_model}"
            )
        self.index = index
        self.seed = seed
        self.transforms = tuple(transforms)
        self.per_model = per_model
        # shared memory, so that workers that live for several epochs see it change
        self._epoch = torch.zeros((), dtype=torch.int64)
        self._epoch.share_memory_()  # type: ignore[no-untyped-call]  # torch does not annotate it

    @property
    def model_ids(self) -> npt.NDArray[np.int64]:
        """Ids of the models: ``(models,)`` int64, ascending."""
        return self.index.model_ids

    @property
    def snapshot(self) -> int:
        """Number of the snapshot."""
        return self.index.snapshot

    @property
    def epoch(self) -> int:
        """The epoch that samples are drawn for."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Draw other samples in another epoch; call it before iterating.

        `Loader` does so by itself.

        Raises
        ------
        UsageError
            If `epoch` is negative.
        """
        if epoch < 0:
            raise UsageError(f"an epoch is at least 0, got {epoch}")
        self._epoch.fill_(epoch)

    def __len__(self) -> int:
        return len(self.index) * self.per_model

    def __getitem__(self, index: int) -> S:
        """Return a sample.

        Raises
        ------
        IndexError
            If there is no sample of that number.
        """
        return self.sample(self.checked(index), self.epoch)

    def __repr__(self) -> str:
        what = f"{type(self).__name__}({self.index.described})"
        return f"{what}: {len(self)} {self.noun} at {self.snapshot}"

    noun = "samples"
    """What a sample is called."""

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
        return self.index.name(index // self.per_model)

    def label(self, index: int) -> str:
        """Return what a message calls sample `index`: its model's name and id."""
        model, number = divmod(index, self.per_model)
        which = f", piece {number}" if self.per_model > 1 else ""
        return f"model {self.index.name(model)} ({int(self.model_ids[model])}){which}"

    @property
    def fingerprint(self) -> str:
        """Hash of the models' ids: equal for the same models, in every lake."""
        return self.index.fingerprint

    def batch(
        self, indices: npt.NDArray[np.int64], epoch: int, visit: Callable[[int], None]
    ) -> Any:
        """Return samples, collated; `visit` is told each number before its sample is made."""
        samples = []
        for index in indices.tolist():
            visit(index)
            samples.append(self.sample(index, epoch))
        return self.collate(samples)

    def sample(self, index: int, epoch: int) -> S:
        """Return sample `index` as it is in an epoch, whatever `set_epoch` said."""
        model, number = divmod(index, self.per_model)
        made = self.draw(model, number, epoch)
        for place, transform in enumerate(self.transforms):
            made = transform(made, self.generator(model, epoch, number, 1 + place))
        return made

    def draw(self, model: int, number: int, epoch: int) -> S:
        """Return sample `number` of the model number `model`, before the transforms."""
        raise NotImplementedError

    def generator(self, model: int, epoch: int, *more: int) -> np.random.Generator:
        """Return random numbers that depend on seed, epoch, the model's id and `more` alone."""
        return np.random.default_rng((self.seed, epoch, int(self.model_ids[model]), *more))

    def collate(self, samples: Sequence[S]) -> Any:
        """Join samples to a batch; kinds of samples that do not stack have their own way."""
        return default_collate(list(samples))
