"""A DataModule for Lightning: ``trainer.fit(model, LakeDataModule(...))``.

It needs the extra ``lightning``; importing this module without it says so.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from breplake.errors import MissingExtraError
from breplake.loaders.loader import Batched, Loader
from breplake.queries.session import Lake
from breplake.schema.subset import Subset

try:
    _Base: Any = import_module("lightning").LightningDataModule  # not there for type checkers
except ImportError as error:
    raise MissingExtraError("lightning", "breplake.loaders.lightning") from error

__all__ = ["LakeDataModule"]


class LakeDataModule(_Base):  # type: ignore[misc]  # "cannot subclass Any": see above
    """The splits of a subset as Lightning's training, validation and test data.

    Where training stands is part of Lightning's checkpoints: a run that was interrupted goes on
    with the batch that comes next, also on another number of workers or ranks. Lightning must
    leave the samplers alone: ``Trainer(use_distributed_sampler=False)``.

    Parameters
    ----------
    lake : Lake
        The lake.
    subset : Subset or str
        The subset, or its name.
    make : callable
        Makes the dataset of a split: ``lambda lake, subset, split: MeshDataset(lake,
        subset=subset, split=split).points(2048)``.
    batch_size : int
        Samples in a batch of one rank.
    splits : dict, optional
        Which split of the subset is ``train``, ``validation`` and ``test``; by their own names if
        not given. Those that the subset lacks are not there.
    **options
        More options of `Loader`: workers, threads, prefetch, seed, pin_memory.
    """

    def __init__(
        self,
        lake: Lake,
        subset: Subset | str,
        make: Callable[[Lake, Subset, str], Batched],
        batch_size: int,
        splits: dict[str, str] | None = None,
        **options: Any,
    ) -> None:
        super().__init__()
        self.lake = lake
        self.subset = lake.subset(subset) if isinstance(subset, str) else subset
        self.make, self.batch_size, self.options = make, batch_size, options
        self.splits = splits or {name: name for name in self.subset.splits}
        self._loaders: dict[str, Loader] = {}
        self._state: dict[str, Any] | None = None

    def loader(self, stage: str) -> Loader:
        """Return the loader of ``train``, ``validation`` or ``test``, made when first asked for.

        Only training is shuffled and goes from epoch to epoch; and there all ranks have equally
        many batches. The others draw epoch 0 each time: the same points in every pass, also after
        a run was resumed, so that losses can be compared.

        Raises
        ------
        NameNotFoundError
            If the subset has no such split.
        """
        if stage not in self._loaders:
            training = stage == "train"
            dataset = self.make(self.lake, self.subset, self.splits.get(stage, stage))
            self._loaders[stage] = Loader(
                dataset,
                self.batch_size,
                shuffle=training,
                drop_last=training,
                fixed_epoch=None if training else 0,
                **self.options,
            )
            if training and self._state is not None:
                self._loaders[stage].load_state_dict(self._state)
                self._state = None
        return self._loaders[stage]

    def train_dataloader(self) -> Loader:
        """Return the loader of ``train``."""
        return self.loader("train")

    def val_dataloader(self) -> Any:
        """Return the loader of ``validation``; none where the subset has no such split."""
        return self._if_there("validation")

    def test_dataloader(self) -> Any:
        """Return the loader of ``test``; none where the subset has no such split."""
        return self._if_there("test")

    def _if_there(self, stage: str) -> Any:
        return self.loader(stage) if self.splits.get(stage, stage) in self.subset.splits else []

    def state_dict(self) -> dict[str, Any]:
        """Return where training stands, for the checkpoint."""
        return self.loader("train").state_dict()

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on where a checkpoint was taken."""
        self._state = state_dict
        if "train" in self._loaders:
            self._loaders["train"].load_state_dict(state_dict)
