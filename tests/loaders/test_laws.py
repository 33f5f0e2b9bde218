"""The laws of a loader: one order, exact resumption, safe processes, flat memory."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import threading
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch.utils.data import DataLoader

import breplake
from breplake.errors import SampleError, UsageError
from breplake.loaders import BatchStream, Loader, MeshDataset, Normalise, PointCloudDataset, Rotate
from breplake.loaders.order import Order

# torch forks its workers although duckdb and polars have threads: that is what is tested
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning"),
    # eight workers must do on two cores as well
    pytest.mark.filterwarnings("ignore:This DataLoader will create:UserWarning"),
]

WORKERS = {"context": "fork", "timeout": 60}


@pytest.fixture(scope="module")
def clouds(tiny_lake):
    """44 samples: 11 of each of 4 models, transformed at random."""
    meshes = MeshDataset(tiny_lake)
    return meshes.points(6, seed=3, transforms=[Normalise(), Rotate()], per_model=11)


def content(batch):
    """What a batch holds, to compare it exactly."""
    return (tuple(batch.name), batch.model_id.tolist(), batch.positions.numpy().tobytes())


def epoch(loader):
    return [content(batch) for batch in loader]


def test_each_sample_comes_exactly_once(clouds):
    loader = Loader(clouds, 5)
    assert len(loader) == 9
    batches = list(loader)
    assert len(batches) == 9
    points = {row.numpy().tobytes() for batch in batches for row in batch.positions}
    assert len(points) == len(clouds) == 44  # no two of them are alike
    ids = torch.cat([batch.model_id for batch in batches]).tolist()
    assert sorted(ids) == np.repeat(clouds.model_ids, 11).tolist()
    assert ids != sorted(ids)


def test_epochs_differ_and_repeat(clouds):
    loader = Loader(clouds, 5)
    first, second = epoch(loader), epoch(loader)
    assert loader.epoch == 2
    assert first != second
    loader.set_epoch(0)
    assert epoch(loader) == first
    assert epoch(Loader(clouds, 5, seed=4)) != first
    still = Loader(clouds, 44, shuffle=False)
    assert next(iter(still)).model_id.tolist() == np.repeat(clouds.model_ids, 11).tolist()


@pytest.mark.parametrize("workers", [1, 2, 8])
def test_workers_do_not_change_the_order(clouds, workers):
    expected = Loader(clouds, 5, threads=0)
    loader = Loader(clouds, 5, workers=workers, **WORKERS)
    for _ in range(2):
        assert epoch(loader) == epoch(expected)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_do_not_change_the_order(clouds, threads):
    assert epoch(Loader(clouds, 5, threads=threads)) == epoch(Loader(clouds, 5, threads=0))


@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_ranks_share_the_order(clouds, ranks):
    whole = [row for batch in Loader(clouds, 44) for row in batch.positions]
    mine = [
        [row for batch in Loader(clouds, 4, rank=rank, ranks=ranks) for row in batch.positions]
        for rank in range(ranks)
    ]
    for place, row in enumerate(whole):
        assert torch.equal(mine[place % ranks][place // ranks], row)
    assert sum(map(len, mine)) == len(whole)


@pytest.mark.parametrize("workers", [1, 3])
def test_a_stream_has_the_same_order(clouds, workers):
    stream = BatchStream(clouds, Order(len(clouds), 5, seed=3), epoch=1, cursor=10)
    expected = Loader(clouds, 5, seed=3)
    expected.set_epoch(1)
    found = DataLoader(
        stream, batch_size=None, num_workers=workers, multiprocessing_context="fork", timeout=60
    )
    assert len(found) == 7
    assert epoch(found) == epoch(expected)[2:]


@settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    stop=st.integers(0, 20),
    threads=st.tuples(st.integers(0, 3), st.integers(0, 3)),
    prefetch=st.integers(1, 6),
)
def test_interrupted_and_resumed_is_uninterrupted(clouds, stop, threads, prefetch):
    whole = Loader(clouds, 5)
    expected = epoch(whole) + epoch(whole) + epoch(whole)
    first = Loader(clouds, 5, threads=threads[0], prefetch=prefetch)
    found = []
    while len(found) < stop:
        for batch in first:
            found.append(content(batch))
            if len(found) == stop:
                state = first.state_dict()
                break
    if not stop:
        state = first.state_dict()
    second = Loader(clouds, 5, threads=threads[1])
    second.load_state_dict(state)
    while len(found) < len(expected):
        found += epoch(second)
    assert found == expected


@pytest.mark.parametrize(("before", "after"), [(0, 2), (2, 0), (2, 1), (1, 8)])
def test_resumed_on_another_number_of_workers(clouds, before, after):
    expected = epoch(Loader(clouds, 5))
    first = Loader(clouds, 5, workers=before, **WORKERS)
    running = iter(first)
    found = [content(next(running)) for _ in range(4)]
    state = first.state_dict()
    second = Loader(clouds, 5, workers=after, **WORKERS)
    second.load_state_dict(state)
    assert found + epoch(second) == expected
    assert second.epoch == 1


def test_resumed_on_another_number_of_ranks(clouds):
    order = [row for batch in Loader(clouds, 44) for row in batch.positions]
    pair = [Loader(clouds, 4, rank=rank, ranks=2) for rank in range(2)]
    running = [iter(loader) for loader in pair]
    done = [[next(r) for r in running] for _ in range(3)]  # 3 steps of 2 ranks: 24 samples
    assert {str(loader.state_dict()) for loader in pair} == {str(pair[0].state_dict())}
    found = [row for step in done for i in range(4) for row in (step[0].positions[i],
             step[1].positions[i])]  # fmt: skip
    three = [Loader(clouds, 3, rank=rank, ranks=3) for rank in range(3)]
    rest = []
    for loader in three:
        loader.load_state_dict(pair[1].state_dict())
        rest.append([row for batch in loader for row in batch.positions])
    found += [rest[i % 3][i // 3] for i in range(20)]
    assert all(torch.equal(a, b) for a, b in zip(found, order, strict=True))


class _Numbers:
    """Samples that are their own numbers."""

    seed, fingerprint = 0, "numbers"

    def __init__(self, n):
        self.n = n

    def __len__(self):
        return self.n

    def label(self, index):
        return str(index)

    def batch(self, indices, epoch, visit):
        return [(epoch, index) for index in indices.tolist()]


def after_steps(loaders, steps):
    """Let all ranks take steps together, epoch after epoch; return what they got."""
    running, found = [iter(loader) for loader in loaders], []
    for _ in range(steps):
        batches = [next(each, None) for each in running]
        if not any(batches):  # of all: the next epoch
            running = [iter(loader) for loader in loaders]
            batches = [next(each, None) for each in running]
        found += [sample for batch in batches for sample in batch or []]
    return found


@settings(deadline=None, max_examples=60)
@given(
    full=st.integers(0, 2),
    rest=st.integers(0, 6),
    sizes=st.tuples(st.integers(1, 4), st.integers(1, 4)),
    ranks=st.tuples(st.integers(1, 4), st.integers(1, 4)),
    drop_last=st.booleans(),
)
def test_all_ranks_agree_where_they_stand(full, rest, sizes, ranks, drop_last):
    """After every step, the uneven ones too; so others can go on from the state of any rank."""
    n = full * sizes[0] * ranks[0] + rest  # with so few left over, some ranks have a batch less

    def loaders(which, drop_last):
        return [
            Loader(_Numbers(n), sizes[which], threads=0, rank=r, ranks=ranks[which],
                   drop_last=drop_last)
            for r in range(ranks[which])
        ]  # fmt: skip

    per_epoch = max(map(len, loaders(0, drop_last)))
    for steps in range(2 * per_epoch + 1):
        first = loaders(0, drop_last)
        found = after_steps(first, steps)
        states = [loader.state_dict() for loader in first]
        assert all(state == states[0] for state in states)
        at = states[0]["epoch"]
        assert at == (steps // per_epoch if per_epoch else 0)
        second = loaders(1, False)
        for loader, state in zip(second, states * 4, strict=False):
            loader.load_state_dict(state)
        found += [sample for loader in second for batch in loader for sample in batch]
        assert len(set(found)) == len(found)
        assert {index for epoch, index in found if epoch == at} == set(range(n))
        assert [loader.epoch for loader in second] == [at + 1] * len(second)


@pytest.mark.parametrize("steps", range(5))
@pytest.mark.parametrize(("workers", "ranks"), [((0, 2), 3), ((2, 0), 1)])
def test_uneven_ranks_resumed_on_other_ranks_and_workers(steps, workers, ranks):
    first = [
        Loader(_Numbers(9), 4, rank=r, ranks=2, workers=workers[0], **WORKERS) for r in range(2)
    ]
    found = after_steps(first, steps)
    states = [loader.state_dict() for loader in first]
    assert states[0] == states[1]
    assert (states[0]["epoch"], states[0]["cursor"]) == (steps // 2, steps % 2 * 8)
    for rank in range(ranks):
        loader = Loader(_Numbers(9), 2, rank=rank, ranks=ranks, workers=workers[1], **WORKERS)
        loader.load_state_dict(states[1])
        found += [sample for _ in range(3 - steps // 2) for batch in loader for sample in batch]
    assert sorted(found) == [(epoch, index) for epoch in range(3) for index in range(9)]


def test_a_rank_that_counts_its_batches_begins_the_next_epoch():
    """It does not ask after its last batch, and has one less than the others."""
    loader = Loader(_Numbers(9), 4, rank=1, ranks=2)
    assert len(loader) == 1
    assert [next(iter(loader))[0][0] for _ in range(3)] == [0, 1, 2]
    loader.set_epoch(0)
    for _ in loader:
        loader.set_epoch(0)  # also while the last batch is there
    assert loader.epoch == 0


def test_the_last_batch_ends_the_epoch(clouds):
    """Lightning takes as many batches as there are, and does not ask for one more."""
    loader = Loader(clouds, 5)
    running = iter(loader)
    for _ in range(len(loader)):
        next(running)
    assert (loader.state_dict()["epoch"], loader.state_dict()["cursor"]) == (1, 0)
    second = Loader(clouds, 5)
    second.set_epoch(1)
    assert epoch(loader) == epoch(second)


def test_leaving_an_epoch_begins_it_anew(clouds):
    loader = Loader(clouds, 5, workers=2, **WORKERS)
    first = content(next(iter(loader)))
    assert epoch(loader)[0] == first


def test_a_state_fits_its_samples_alone(clouds, tiny_lake):
    state = Loader(clouds, 5).state_dict()
    others = [
        Loader(MeshDataset(tiny_lake, where="volume > 2").points(6, 3, per_model=11), 5),
        Loader(clouds, 5, seed=9),
        Loader(clouds, 5, shuffle=False),
        Loader(clouds, 5, block=2),
    ]
    for other in others:
        with pytest.raises(UsageError, match="state is of another loader"):
            other.load_state_dict(state)
    Loader(clouds, 7).load_state_dict(state)


@pytest.mark.parametrize("context", ["fork", "spawn", "forkserver"])
def test_processes_after_everything_was_used_in_the_parent(tiny_lake, context):
    lake = breplake.open(tiny_lake)
    lake.sql("FROM models").fetchall()
    lake.scan("vertices").collect()
    meshes = MeshDataset(lake)
    clouds = meshes.points(6)
    expected = epoch(Loader(clouds, 2, threads=2))
    assert epoch(Loader(clouds, 2, workers=2, context=context, timeout=60)) == expected


class _Broken(PointCloudDataset):
    """Does what `harm` says when it comes to the model called wide."""

    harm = "kill"

    def draw(self, model, number, epoch):
        if self.index.name(model) == "wide":
            if self.harm == "raise":
                raise ZeroDivisionError("no area")
            os.kill(os.getpid(), signal.SIGKILL if self.harm == "kill" else signal.SIGSEGV)
        return super().draw(model, number, epoch)


@pytest.mark.parametrize("harm", ["kill", "crash"])
def test_a_worker_that_dies_names_the_model(tiny_lake, harm):
    broken = _Broken(MeshDataset(tiny_lake), 6)
    broken.harm = harm
    (identity,) = broken.model_ids[[broken.name(i) == "wide" for i in range(4)]]
    loader = Loader(broken, 1, workers=2, **WORKERS)
    with pytest.raises(SampleError, match=rf"died while reading.* model wide \({identity}\)"):
        list(loader)
    broken.harm = "none"


@pytest.mark.parametrize("options", [{"threads": 0}, {"threads": 2}, {"workers": 2, **WORKERS}])
def test_an_error_names_the_model(tiny_lake, options):
    broken = _Broken(MeshDataset(tiny_lake), 6)
    broken.harm = "raise"
    with pytest.raises(SampleError, match=r"model wide \(\d+\): ZeroDivisionError: no area"):
        list(Loader(broken, 1, **options))


@pytest.mark.parametrize("options", [{"threads": 0}, {"workers": 2, **WORKERS}])
def test_an_epoch_can_be_fixed(clouds, options):
    loader = Loader(clouds, 5, fixed_epoch=2, **options)
    other = Loader(clouds, 5)
    other.set_epoch(2)
    expected = epoch(other)
    running = iter(loader)
    for _ in range(len(loader) - 1):
        next(running)
    state = loader.state_dict()
    assert epoch(loader) == epoch(loader) == expected
    assert loader.epoch == 2
    loader.load_state_dict(state)
    assert epoch(loader) == expected[-1:]
    assert epoch(loader) == expected
    for change in (lambda: loader.set_epoch(1), lambda: loader.load_state_dict(other.state_dict())):
        with pytest.raises(UsageError, match="every iteration is epoch 2"):
            change()


def test_threads_live_on_and_a_copy_starts_its_own(clouds):
    loader, expected = Loader(clouds, 5, fixed_epoch=0), epoch(Loader(clouds, 5, threads=0))
    for _ in range(3):
        next(iter(loader))  # who leaves early leaves nothing running
        assert epoch(loader) == expected
    assert epoch(pickle.loads(pickle.dumps(loader))) == expected
    names = [thread.name for thread in threading.enumerate()]
    assert len([name for name in names if name.startswith("breplake-loader")]) <= 4
    fork = get_context("fork")
    answers = fork.SimpleQueue()
    child = fork.Process(target=lambda: answers.put(epoch(loader) == expected))
    child.start()  # threads do not come along
    child.join(60)
    assert child.exitcode == 0
    assert answers.get()


def test_an_iteration_may_end_in_a_thread_that_reads(clouds):
    """The garbage collector ends a forgotten one in whatever thread it happens to run."""

    class Ending(PointCloudDataset):
        drawn = 0

        def draw(self, model, number, epoch):
            self.drawn += 1
            if self.drawn == 6:  # the second batch is read, of an iteration that is let go
                go.wait(60)
                forgotten.pop().close()
                closed.set()
            return super().draw(model, number, epoch)

    go, closed, forgotten = threading.Event(), threading.Event(), []
    loader = Loader(Ending(clouds.meshes, 6, per_model=11), 5, threads=1)
    forgotten.append(iter(loader))
    next(forgotten[0])
    go.set()
    assert closed.wait(20)
    assert len(epoch(loader)) == 9


def test_mistakes(clouds):
    for wrong in ({"workers": -1}, {"threads": -1}, {"prefetch": 0}, {"rank": 0}, {"ranks": 2}):
        with pytest.raises(UsageError):
            Loader(clouds, 2, **wrong)
    with pytest.raises(UsageError, match="epoch"):
        Loader(clouds, 2).set_epoch(-1)
    with pytest.raises(UsageError, match="epoch"):
        Loader(clouds, 2, fixed_epoch=-1)


def resident() -> int:
    """Bytes of this process in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


class _Weighing(PointCloudDataset):
    """Says how large the process is that reads it, in place of the snapshot."""

    def draw(self, model, number, epoch):
        return super().draw(model, number, epoch)._replace(snapshot=resident())


@pytest.mark.parametrize("options", [{"threads": 2}, {"workers": 2, **WORKERS}])
def test_memory_is_flat(tiny_lake, options, record_property):
    """The slope of three epochs, in the reading processes and in this one.

    Keeping the samples would be 11 MiB an epoch.
    """
    clouds = _Weighing(MeshDataset(tiny_lake), 512, per_model=100)
    loader = Loader(clouds, 16, **options)
    heights = []
    for _ in range(5):  # allocators settle in the first two
        readers = max(int(batch.snapshot.max()) for batch in loader)
        gc.collect()
        heights.append((readers, resident()))
    slope = np.polyfit(range(3), np.array(heights[2:]), 1)[0] / 2**20  # MiB an epoch
    record_property("MiB an epoch, readers and parent", slope.round(3).tolist())
    print(f"RSS slope: {slope.round(3).tolist()} MiB an epoch of {len(clouds)} samples")
    assert (slope < 2).all()
