"""Buffers are used again when, and only when, nobody holds them."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from breplake.schema.buffers import Buffers

SHAPE, KIND = (3, 4), np.dtype(np.float32)


def place(array):
    return array.__array_interface__["data"][0]


def test_what_is_held_is_not_given_again():
    buffers = Buffers()
    held = [buffers.empty(SHAPE, KIND) for _ in range(20)]
    assert len({place(array) for array in held}) == 20


@pytest.mark.parametrize(
    "hold", [lambda a: a, lambda a: a[1:], memoryview], ids=["all", "rows", "view"]
)
def test_views_count(hold):
    buffers = Buffers()
    held = hold(buffers.empty(SHAPE, KIND))
    first = place(np.asarray(held)) if not isinstance(held, memoryview) else None
    other = buffers.empty(SHAPE, KIND)
    assert not np.shares_memory(np.asarray(held), other)
    del held
    again = buffers.empty(SHAPE, KIND)
    assert not np.shares_memory(again, other)
    assert first is None or first - place(again) in (0, SHAPE[1] * KIND.itemsize)


def test_tensors_count():
    torch = pytest.importorskip("torch")
    buffers = Buffers()
    tensor = torch.from_numpy(buffers.empty(SHAPE, KIND))
    part = tensor[1:].permute(1, 0)
    del tensor
    part.fill_(7)
    buffers.empty(SHAPE, KIND).fill(0)
    assert bool((part == 7).all())


def test_what_is_let_go_is_given_again():
    buffers = Buffers()
    first = place(buffers.empty(SHAPE, KIND))
    assert place(buffers.empty(SHAPE, KIND)) == first
    assert first % 64 == 0
    assert buffers.empty((4, 3), KIND).shape == (4, 3)
    assert buffers.empty(SHAPE, np.dtype(np.int8)).dtype == np.int8


def test_a_copy_starts_empty():
    buffers = Buffers()
    held = buffers.empty(SHAPE, KIND)
    copy = pickle.loads(pickle.dumps(buffers))
    assert not np.shares_memory(copy.empty(SHAPE, KIND), held)
