"""The order of samples, as laws of pure functions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from breplake.errors import UsageError
from breplake.loaders.order import Order, permutation

numbers = st.integers(0, 300)
seeds = st.integers(0, 2**63)


@given(n=numbers, seed=seeds, epoch=st.integers(0, 9), block=st.none() | st.integers(1, 50))
def test_every_sample_comes_exactly_once(n, seed, epoch, block):
    order = permutation(n, seed, epoch, block)
    assert sorted(order.tolist()) == list(range(n))
    assert order.tolist() == permutation(n, seed, epoch, block).tolist()


def test_seed_and_epoch_change_the_order():
    orders = {tuple(permutation(50, s, e, b)) for s in (0, 1) for e in (0, 1) for b in (None, 5)}
    assert len(orders) == 8


def test_blocks_keep_neighbours_near():
    order = permutation(8_000, 0, 0, block=100)
    jumps = np.abs(np.diff(order))
    assert len(set((order[:800] // 100).tolist())) == 8  # a window is of eight blocks
    assert np.median(jumps) < np.median(np.abs(np.diff(permutation(8_000, 0, 0))))


def walked(order, epoch=0, cursor=0):
    """The batches of every rank, step by step: (steps, ranks) lists."""
    each = []
    for rank in range(order.ranks):
        mine = Order(**{k: getattr(order, k) for k in order.__slots__} | {"rank": rank})
        each.append([(batch.tolist(), after) for batch, after in mine.walk(epoch, cursor)])
        assert len(each[-1]) == mine.batches(cursor)
    return each


def interleaved(order, epoch=0, cursor=0, steps=None):
    """Samples of all ranks in the order of the epoch, and the place after them."""
    each = walked(order, epoch, cursor)
    found = []
    for step in range(max(map(len, each)))[:steps]:
        batches = [rank[step][0] if step < len(rank) else [] for rank in each]
        longest = max(map(len, batches))
        found += [b[i] for i in range(longest) for b in batches if i < len(b)]
        (cursor,) = {rank[step][1] for rank in each if step < len(rank)}
    return found, cursor


@given(
    n=numbers,
    batch_size=st.integers(1, 40),
    ranks=st.integers(1, 4),
    seed=seeds,
    shuffle=st.booleans(),
)
def test_ranks_share_one_order(n, batch_size, ranks, seed, shuffle):
    order = Order(n, batch_size, seed=seed, shuffle=shuffle, ranks=ranks)
    if order.batches():
        assert interleaved(order)[0] == order.samples(0).tolist()
    else:
        assert n == 0


@given(
    n=st.integers(1, 300),
    sizes=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    ranks=st.tuples(st.integers(1, 4), st.integers(1, 4)),
    steps=st.integers(0, 10),
    seed=seeds,
)
def test_another_number_of_ranks_goes_on_where_one_stopped(n, sizes, ranks, steps, seed):
    first = Order(n, sizes[0], seed=seed, ranks=ranks[0])
    before, cursor = interleaved(first, steps=steps) if steps else ([], 0)
    second = Order(n, sizes[1], seed=seed, ranks=ranks[1])
    after = interleaved(second, cursor=cursor)[0] if cursor < n else []
    assert before + after == first.samples(0).tolist()


@given(n=numbers, batch_size=st.integers(1, 40), ranks=st.integers(1, 4))
def test_ranks_can_be_made_equal(n, batch_size, ranks):
    each = walked(Order(n, batch_size, ranks=ranks, drop_last=True))
    assert len({len(rank) for rank in each}) == 1
    assert all(len(batch) == batch_size for rank in each for batch, _ in rank)
    assert sum(len(rank) for rank in each) * batch_size > n - batch_size * ranks
    each = walked(Order(n, batch_size, ranks=ranks))
    lengths = [len(rank) for rank in each]
    assert max(lengths) - min(lengths) <= 1


@given(
    n=numbers,
    batch_size=st.integers(1, 40),
    ranks=st.integers(1, 4),
    drop_last=st.booleans(),
    cursor=numbers,
)
def test_an_epoch_ends_when_no_rank_has_a_batch(n, batch_size, ranks, drop_last, cursor):
    every = [Order(n, batch_size, rank=r, ranks=ranks, drop_last=drop_last) for r in range(ranks)]
    left = [order.batches(cursor) for order in every]
    assert [order.ends(cursor) for order in every] == [not any(left)] * ranks


@pytest.mark.parametrize(
    "wrong",
    [{"batch_size": 0}, {"seed": -1}, {"block": 0}, {"rank": 2, "ranks": 2}, {"rank": -1}],
)
def test_wrong_numbers(wrong):
    with pytest.raises(UsageError, match=r"at least|none of"):
        Order(**{"n": 10, "batch_size": 2} | wrong)
