"""A pool of processes that breaks is replaced; the models that it had are no worse for it."""

from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool

import pytest

pytest.importorskip("pebble")

from breplake.errors import KernelUnavailableError
from breplake.ingest import pool
from breplake.ingest.inputs import find_inputs
from breplake.ingest.settings import Settings
from breplake.ingest.spool import Spool


class Pool:
    """Does every task at once; one that is broken fails or forgets them."""

    def __init__(self, state):
        self.state = state

    def schedule(self, *_, **__):
        future = Future()
        if self.state == "refuses":
            raise RuntimeError("Unexpected error within the Pool")
        if self.state == "broken":
            self.state = "forgets"
            future.set_exception(BrokenProcessPool("All workers expired"))
        elif self.state == "whole":
            future.set_result([])
        return future

    def stop(self):
        """Nothing runs."""

    def join(self):
        """Nothing runs."""


@pytest.fixture
def run(tmp_path, monkeypatch):
    folder = tmp_path / "in"
    folder.mkdir()
    for name in "abc":
        (folder / f"{name}.step").write_text(name)

    def run_with(states):
        states = iter(states)
        monkeypatch.setattr(pool, "isolated_pool", lambda *_: Pool(next(states)))
        monkeypatch.setattr(pool, "_PAUSE", 0.01)

        def spool(item):
            return Spool(tmp_path / item.name)

        return list(pool.run_models(find_inputs([folder]), Settings(), 1, spool))

    return run_with


@pytest.mark.parametrize("first", ["broken", "refuses"])
def test_models_of_a_broken_pool_get_the_next(run, first):
    results = run([first, "whole"])
    assert sorted(r.input.name for r in results) == ["a", "b", "c"]
    assert all(not r.failures for r in results)


def test_a_model_with_which_all_pools_break_is_to_blame(run, monkeypatch):
    monkeypatch.setattr(Pool, "schedule", lambda *_, **__: broken())
    results = run(["broken"] * 20)
    assert [[f.kind for f in r.failures] for r in results] == [["worker-died"]] * 3
    assert all(r.failures[0].fatal for r in results)


def broken():
    future = Future()
    future.set_exception(BrokenProcessPool("All workers expired"))
    return future


def test_no_kernel_ends_the_run(run, monkeypatch):
    monkeypatch.setattr(pool, "kernels_unavailable", lambda: KernelUnavailableError("no libGL"))
    with pytest.raises(KernelUnavailableError, match="libGL"):
        run(["broken", "whole"])
