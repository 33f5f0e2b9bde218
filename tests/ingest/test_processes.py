"""Tasks in processes of their own, and pools that break."""

import os
import time
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool

import pytest

pytest.importorskip("pebble")

from breplake.errors import KernelUnavailableError
from breplake.ingest import processes
from breplake.ingest.processes import Ended, Processes


def run(keys, function=str, *, timeout=60.0, memory=2.0):
    """Begin a task for each key and return how they ended, in order of keys."""
    with Processes(1, memory, timeout, "test") as pool:
        ended = list(pool.each(function, ((key, (key,)) for key in keys)))
    return sorted(ended, key=lambda one: one.key)


class Pool:
    """Does every task at once; one that is broken fails or forgets them."""

    def __init__(self, state):
        self.state = state

    def schedule(self, *_, **__):
        future = Future()
        if self.state == "refuses":
            raise RuntimeError("Unexpected error within the Pool")
        if self.state in ("broken", "always broken"):
            future.set_exception(BrokenProcessPool("All workers expired"))
        if self.state == "broken":
            self.state = "forgets"
        elif self.state == "whole":
            future.set_result("done")
        return future

    def stop(self):
        """Nothing runs."""

    def join(self):
        """Nothing runs."""


@pytest.fixture
def pools(monkeypatch):
    def give(*states):
        states = iter(states)
        monkeypatch.setattr(Processes, "_new_pool", lambda _: Pool(next(states)))
        monkeypatch.setattr(processes, "_PAUSE", 0.01)
        monkeypatch.setattr(processes, "_kernels_unavailable", lambda: None)

    return give


@pytest.mark.parametrize("first", ["broken", "refuses"])
def test_tasks_of_a_broken_pool_get_the_next(pools, first):
    pools(first, "whole")
    assert run("abc") == [Ended(key, "done") for key in "abc"]


def test_a_task_with_which_all_pools_break_is_to_blame(pools):
    pools(*["always broken"] * 20)
    assert run("abc") == [Ended(key, killed="death", exitcode=255) for key in "abc"]


def test_no_kernel_ends_the_run(pools, monkeypatch):
    pools("broken", "whole")
    monkeypatch.setattr(
        processes, "_kernels_unavailable", lambda: KernelUnavailableError("no libGL")
    )
    with pytest.raises(KernelUnavailableError, match="libGL"):
        run("abc")


def test_a_process_that_exits_is_told_from_one_that_returns():
    assert run([3], os._exit) == [Ended(3, killed="death", exitcode=3)]


def test_time_and_memory_are_limited():
    assert run([60], time.sleep, timeout=0.5) == [Ended(60, killed="time")]
    assert run([2**31], bytearray, memory=1.0) == [Ended(2**31, killed="memory")]


def test_tasks_are_taken_as_there_is_room():
    """A million need not be listed first."""
    taken = []

    def tasks():
        for key in range(1000):
            taken.append(key)
            yield key, (key,)

    with Processes(1, 2.0, 60.0, "test") as pool:
        first = next(pool.each(str, tasks()))
    assert first == Ended(0, "0")
    assert len(taken) < 10


def test_a_function_of_the_script_is_refused(monkeypatch):
    monkeypatch.setattr(Pool, "__module__", "__main__")
    with pytest.raises(ValueError, match="Pool is in no module"):
        run("a", Pool)


def test_what_a_task_raises_is_raised():
    with pytest.raises(ValueError, match="invalid literal"):
        run(["x"], int)
