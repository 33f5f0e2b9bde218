"""Memory for results that come and go: used again once nobody holds it."""

from __future__ import annotations

import sys
import threading
from typing import Any, Final

import numpy as np
import numpy.typing as npt

__all__ = ["Buffers"]

_KEPT: Final = 8
"""Arrays of one shape that are kept: as many batches as are usually on their way."""

_OWN: Final = 3
"""References to an array that nobody holds: the list's, the loop's and the question's."""


class Buffers:
    """Gives out arrays, and gives them out again when all references to them are gone.

    Fresh memory of some megabytes comes from the system page by page, which takes longer than
    to fill it. Views and tensors of an array count as references to it. Threads may share it;
    a copy in another process starts empty.
    """

    def __init__(self) -> None:
        self._arrays: dict[tuple[Any, ...], list[npt.NDArray[Any]]] = {}
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[Buffers], tuple[()]]:
        return Buffers, ()

    def empty(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
        """Return an array of any content, as ``numpy.empty`` does."""
        with self._lock:
            kept = self._arrays.setdefault((shape, dtype), [])
            for array in kept:
                if sys.getrefcount(array) <= _OWN:
                    return array
            fresh = np.empty(shape, dtype)
            if len(kept) < _KEPT:
                kept.append(fresh)
            return fresh
