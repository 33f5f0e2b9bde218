"""The DataModule: splits of a subset, and checkpoints that know where training stands."""

from __future__ import annotations

import pytest
import torch

import breplake
from breplake.loaders import MeshDataset
from breplake.queries.subsets import create_subset

lightning = pytest.importorskip("lightning")

pytestmark = pytest.mark.filterwarnings("ignore")  # lightning and its dependencies warn a lot


class _Seen(lightning.LightningModule):
    """Notes which clouds it is given; ends in an error at a batch."""

    def __init__(self, end=None):
        super().__init__()
        self.layer = torch.nn.Linear(3, 1)
        self.seen, self.end = [], end

    def training_step(self, batch, number):
        if self.end is not None and len(self.seen) == self.end:
            raise KeyboardInterrupt
        self.seen.append(batch.positions.sum().item())
        return self.layer(batch.positions).mean()

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), 1e-3)


def module(lake):
    from breplake.loaders.lightning import LakeDataModule

    def clouds(lake, subset, split):
        return MeshDataset(lake, subset=subset, split=split).points(8, per_model=10)

    return LakeDataModule(lake, "s", clouds, 4, splits={"train": "all"}, threads=1)


def trainer(folder, epochs):
    return lightning.Trainer(
        max_epochs=epochs, default_root_dir=folder, logger=False, accelerator="cpu",
        enable_progress_bar=False, enable_model_summary=False, use_distributed_sampler=False,
        enable_checkpointing=False,
    )  # fmt: skip


def test_a_checkpoint_knows_where_training_stands(own_lake, tmp_path):
    lake = breplake.open(own_lake)
    create_subset(lake, "s", where="n_faces > 0")
    whole = _Seen()
    trainer(tmp_path, 2).fit(whole, module(lake))
    assert len(whole.seen) == 20
    assert len(set(whole.seen)) == 20

    first = _Seen()
    run = trainer(tmp_path, 1)
    run.fit(first, module(lake))
    run.save_checkpoint(tmp_path / "c.ckpt")
    second = _Seen()
    trainer(tmp_path, 2).fit(
        second, module(lake), ckpt_path=tmp_path / "c.ckpt", weights_only=False
    )
    assert first.seen + second.seen == whole.seen


def test_splits_that_are_not_there(own_lake):
    lake = breplake.open(own_lake)
    create_subset(lake, "s", where="n_faces > 0")
    data = module(lake)
    assert data.val_dataloader() == data.test_dataloader() == []
    assert data.train_dataloader() is data.train_dataloader()
