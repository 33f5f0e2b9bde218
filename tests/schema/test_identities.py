"""Ids of the models in a lake: read fast, and alike in a process that was forked."""

from __future__ import annotations

import os

import numpy as np
import pytest

import breplake.schema.identities as identities
from breplake.errors import LakeFormatError
from breplake.schema.identities import read_ids
from breplake.schema.identity import model_id
from breplake.schema.lake import LakeStore
from breplake.schema.storage import Storage

NAMES = ("small", "long/flat", "big", "wide", "bare", "broken")  # broken is a fatal failure
IDS = sorted(model_id("boxes", name) for name in NAMES)


@pytest.mark.parametrize("is_forked", [False, True])
def test_models_and_fatal_failures(tiny_lake, monkeypatch, is_forked):
    monkeypatch.setattr(identities, "_is_forked", is_forked)
    head = LakeStore.open(tiny_lake).head()
    assert sorted(read_ids(Storage(tiny_lake), head.files)) == IDS
    models = head.table_files("models")
    in_order = np.concatenate([read_ids(Storage(tiny_lake), [entry]) for entry in models])
    assert read_ids(Storage(tiny_lake), models).tolist() == in_order.tolist()
    assert read_ids(Storage(tiny_lake), head.table_files("faces")).tolist() == []


@pytest.mark.parametrize("is_forked", [False, True])
def test_a_file_that_is_gone(own_lake, monkeypatch, is_forked):
    monkeypatch.setattr(identities, "_is_forked", is_forked)
    head = LakeStore.open(own_lake).head()
    (own_lake / "tables/models/s0.parquet").unlink()
    with pytest.raises(LakeFormatError, match="run breplake verify"):
        read_ids(Storage(own_lake), head.files)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning", "ignore:.*fork:RuntimeWarning")
def test_after_a_fork(tiny_lake):
    """The child must not wait for threads of polars that it does not have."""
    head = LakeStore.open(tiny_lake).head()
    read_ids(Storage(tiny_lake), head.files)
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = int(sorted(read_ids(Storage(tiny_lake), head.files)) != IDS)
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
