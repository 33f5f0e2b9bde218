"""Memory for results that come and go: used again once nobody holds it."""

from __future__ import annotations

import math
import sys
import threading
from typing import Any, Final

import numpy as np
import numpy.typing as npt

__all__ = ["Buffers"]

_KEPT: Final = 8
"""Blocks of one size that are kept: as many batches as are usually on their way."""

_OWN: Final = 3
"""References to memory that nobody holds: the pair's, the loop's and the question's."""

_ALIGNED: Final = 64
"""Bytes: to copy from the start of a page to an address 16 bytes after one, where large blocks of
memory begin, takes AMD's processors several times as long."""


class Buffers:
    """Gives out arrays, and gives their memory out again when all references to it are gone.

    Fresh memory of some megabytes comes from the system page by page, which takes longer than
    to fill it. Views and tensors of an array count as references. Threads may share it; a copy
    in another process starts empty.
    """

    def __init__(self) -> None:
        self._blocks: dict[int, list[tuple[npt.NDArray[np.uint8], int]]] = {}
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[Buffers], tuple[()]]:
        return Buffers, ()

    def empty(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
        """Return an array of any content, as ``numpy.empty`` does."""
        size = math.prod(shape) * dtype.itemsize
        with self._lock:
            block, start = self._free(size)
        return block[start : start + size].view(dtype).reshape(shape)

    def _free(self, size: int) -> tuple[npt.NDArray[np.uint8], int]:
        """Return memory that nobody holds, and where in it to begin.

        Arrays made of it hold the block itself.
        """
        kept = self._blocks.setdefault(size, [])
        for block, start in kept:
            if sys.getrefcount(block) <= _OWN:
                return block, start
        fresh = np.empty(size + _ALIGNED, np.uint8)
        start = -fresh.ctypes.data % _ALIGNED
        if len(kept) < _KEPT:
            kept.append((fresh, start))
        return fresh, start
