"""Numbers for kernel objects that are shared by reference."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

__all__ = ["Handles"]


class Handles:
    """Numbers kernel objects from 0 in order of first appearance.

    The binding (pybind11) has one Python wrapper for a kernel object at a time, and makes
    another only after that one was collected. So wrappers that are kept here are as good as
    the kernel's pointers. (Its own map of pointers, ``TColStd_IndexedMapOfTransient``, takes
    every key for null.)
    """

    def __init__(self) -> None:
        self._objects: list[Any] = []
        self._numbers: dict[Any, int] = {}

    def __len__(self) -> int:
        """Return how many objects have a number."""
        return len(self._objects)

    def __iter__(self) -> Iterator[Any]:
        """Yield the objects by number, those included that are added meanwhile."""
        return iter(self._objects)

    def add(self, handle: Any) -> int:
        """Return the number of an object, a new one if it has none."""
        number = self._numbers.setdefault(handle, len(self._objects))
        if number == len(self._objects):
            self._objects.append(handle)
        return number

    def optional(self, handle: Any) -> int | None:
        """Return the number of an object as `add` does, None for a null handle."""
        return None if handle is None else self.add(handle)

    def find(self, handle: Any) -> int:
        """Return the number of an object.

        Raises
        ------
        KeyError
            If it has none.
        """
        return self._numbers[handle]
