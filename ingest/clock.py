"""CPU time of a model's stages, and the part of it spent inside OCCT and Gmsh."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["KERNEL", "KernelClock", "StageClock", "peak_memory"]


class KernelClock:
    """Adds up the CPU time of calls into the CAD and meshing kernels, through their bindings.

    A worker handles one model in one thread, so one clock per process is enough.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._depth = 0
        self._start = 0.0

    def __call__(self) -> KernelClock:
        """Return what counts a block; nested blocks count once."""
        return self

    def __enter__(self) -> None:
        """Begin a block."""
        if not self._depth:
            self._start = time.process_time()
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        """End a block."""
        self._depth -= 1
        if not self._depth:
            self.seconds += time.process_time() - self._start


KERNEL = KernelClock()
"""The process's kernel clock; count a call with ``with KERNEL():``."""


class StageClock:
    """Attributes CPU time to named stages, and tells an observer which one runs.

    Parameters
    ----------
    observer : callable
        Called with the stage's name when it begins, so that a kill can be attributed.
    """

    def __init__(self, observer: Callable[[str], None]) -> None:
        self.observer = observer
        self.started = time.monotonic()
        self.cpu_started = time.process_time()
        self.kernel_started = KERNEL.seconds
        self.cpu: dict[str, float] = {}
        self.current = "read"

    def begin(self, name: str, detail: str = "") -> None:
        """Tell the observer that a stage begins."""
        self.current = name
        self.observer(f"{name}:{detail}")

    @contextmanager
    def stage(self, name: str, detail: str = "") -> Iterator[None]:
        """Run a block as the stage `name`, which may be entered again."""
        self.begin(name, detail)
        start = time.process_time()
        try:
            yield
        finally:
            self.cpu[name] = self.cpu.get(name, 0.0) + time.process_time() - start

    def columns(self) -> dict[str, float | int]:
        """Return the timing columns of ``models``."""
        return {
            "seconds": time.monotonic() - self.started,
            "cpu_load": self.cpu.get("read", 0.0) + self.cpu.get("load", 0.0),
            "cpu_brep": self.cpu.get("brep", 0.0),
            "cpu_mesh": self.cpu.get("import", 0.0) + self.cpu.get("mesh", 0.0),
            "cpu_truth": self.cpu.get("truth", 0.0),
            "cpu_write": self.cpu.get("write", 0.0),
            "cpu_kernel": KERNEL.seconds - self.kernel_started,
            "cpu_total": time.process_time() - self.cpu_started,
            "peak_memory": peak_memory(),
        }


def peak_memory() -> int:
    """Return the peak resident memory of this process in bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
