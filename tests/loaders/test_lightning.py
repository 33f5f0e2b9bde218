"""The DataModule: splits of a subset, and checkpoints that know where training stands."""

from __future__ import annotations

import shutil

import pytest
import torch

import breplake
from breplake.loaders import MeshDataset, Rotate
from breplake.queries.subsets import create_subset

lightning = pytest.importorskip("lightning")

pytestmark = pytest.mark.filterwarnings("ignore")  # lightning and its dependencies warn a lot


@pytest.fixture(scope="module")
def lake(tiny_lake, tmp_path_factory):
    """A lake with the subset s."""
    root = tmp_path_factory.mktemp("lightning") / "lake"
    shutil.copytree(tiny_lake, root)
    lake = breplake.open(root)
    create_subset(lake, "s", where="n_faces > 0")
    return lake


class Killed(Exception):
    """Ends a training."""


class _Seen(lightning.LightningModule):
    """Notes which clouds it is given; ends in an error at a batch."""

    def __init__(self, end=None):
        super().__init__()
        self.layer = torch.nn.Linear(3, 1)
        self.seen, self.end = [], end

    def training_step(self, batch, number):
        if len(self.seen) == self.end:
            raise Killed
        self.seen.append(batch.positions.sum().item())
        return self.layer(batch.positions).mean()

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), 1e-3)


def module(lake, **options):
    from breplake.loaders.lightning import LakeDataModule

    def clouds(lake, subset, split):
        return MeshDataset(lake, subset=subset, split=split).points(8, per_model=10)

    return LakeDataModule(lake, "s", clouds, 4, splits={"train": "all"}, **options)


def trainer(folder, epochs, callbacks=()):
    return lightning.Trainer(
        max_epochs=epochs, default_root_dir=folder, logger=False, accelerator="cpu",
        enable_progress_bar=False, enable_model_summary=False, use_distributed_sampler=False,
        enable_checkpointing=bool(callbacks), callbacks=list(callbacks),
    )  # fmt: skip


def test_a_checkpoint_knows_where_training_stands(lake, tmp_path):
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


@pytest.mark.parametrize(
    ("end", "options"), [(3, {"workers": 2}), (10, {"threads": 0}), (17, {"threads": 3})]
)
def test_a_run_that_is_killed_goes_on_with_the_next_batch(lake, tmp_path, end, options):
    """In the middle of an epoch, at its end, in the second one; then with other workers."""
    whole = _Seen()
    trainer(tmp_path, 2).fit(whole, module(lake))

    saved = lightning.pytorch.callbacks.ModelCheckpoint(
        dirpath=tmp_path / "saved", filename="{step}", every_n_train_steps=1, save_top_k=-1
    )
    first, second = _Seen(end), _Seen()
    with pytest.raises(Killed):
        trainer(tmp_path, 2, [saved]).fit(first, module(lake))
    trainer(tmp_path, 2).fit(
        second, module(lake, **options), weights_only=False,
        ckpt_path=tmp_path / f"saved/step={end}.ckpt",
    )  # fmt: skip
    assert len(first.seen) == end
    assert first.seen + second.seen == whole.seen


class _Validated(_Seen):
    """Notes the clouds of each validation and test pass, too."""

    def __init__(self):
        super().__init__()
        self.passes = []

    def on_validation_epoch_start(self):
        self.passes.append([])

    on_test_epoch_start = on_validation_epoch_start

    def validation_step(self, batch, number):
        self.passes[-1].append(batch.positions.numpy().tobytes())

    test_step = validation_step


def validated(lake, **options):
    from breplake.loaders.lightning import LakeDataModule

    def clouds(lake, subset, split):
        meshes = MeshDataset(lake, subset=subset, split=split)
        return meshes.points(8, per_model=3, transforms=[Rotate()])

    splits = dict.fromkeys(("train", "validation", "test"), "all")
    return LakeDataModule(lake, "s", clouds, 4, splits=splits, **options)


def test_every_validation_sees_the_same_points(lake, tmp_path):
    whole = _Validated()
    trainer(tmp_path, 3).fit(whole, validated(lake))
    first, *others = whole.passes
    assert len(first) > 0
    full = [run for run in others if len(run) == 3]  # the sanity check may be a part
    assert len(full) == 3
    assert full[0] == full[1] == full[2]
    assert first == full[0][: len(first)]

    resumed = _Validated()
    run = trainer(tmp_path, 1)
    run.fit(_Validated(), validated(lake))
    run.save_checkpoint(tmp_path / "c.ckpt")
    data = validated(lake, threads=0)
    again = trainer(tmp_path, 2)
    again.fit(resumed, data, ckpt_path=tmp_path / "c.ckpt", weights_only=False)
    assert resumed.passes[-1] == full[0]
    for _ in range(2):
        again.test(resumed, data, verbose=False)
        assert resumed.passes[-1] == full[0]


def test_splits_that_are_not_there(lake):
    data = module(lake)
    assert data.val_dataloader() == data.test_dataloader() == []
    assert data.train_dataloader() is data.train_dataloader()
