"""Moving sets of curves and surfaces between numpy and torch, and between devices."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from breplake.errors import UsageError
from breplake.schema.namespace import Array

__all__ = ["mapped", "transferred"]

Part = TypeVar("Part")


def transferred(part: Part, like: Any = None, *, device: Any = None, dtype: Any = None) -> Part:
    """Return a dataclass with all its arrays as tensors of torch.

    Parameters
    ----------
    part : dataclass
        Holding arrays, or other dataclasses that do.
    like : torch.Tensor, optional
        Its device and, if it is floating, its type count where the others are not given.
    device : torch.device or str, optional
        By default that of the arrays: the CPU if they are numpy's.
    dtype : torch.dtype, optional
        Of the floating numbers; by default theirs. Integers stay int64.

    Raises
    ------
    UsageError
        If torch is not imported yet, or `dtype` is no floating type.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        raise UsageError("to(...) makes tensors of torch: import torch first")
    if like is not None:
        device = like.device if device is None else device
        dtype = like.dtype if dtype is None and like.dtype.is_floating_point else dtype
    if dtype is not None and not dtype.is_floating_point:
        raise UsageError(f"dtype must be a floating type such as torch.float64, got {dtype}")

    def move(array: Array) -> Array:
        tensor = torch.from_numpy(np.array(array)) if isinstance(array, np.ndarray) else array
        return tensor.to(device, dtype if tensor.is_floating_point() else None)

    return mapped(part, move)


def mapped(part: Part, move: Callable[[Array], Array]) -> Part:
    """Return a dataclass with `move` applied to every array in it and in dataclasses in it."""
    changed: dict[str, Any] = {}
    for field in fields(part):  # type: ignore[arg-type]  # Part is bound to dataclasses by use
        value = getattr(part, field.name)
        if is_dataclass(value):
            changed[field.name] = mapped(value, move)
        elif isinstance(value, np.ndarray) or hasattr(value, "requires_grad"):
            changed[field.name] = move(value)
    return replace(part, **changed)  # type: ignore[type-var]  # as above
