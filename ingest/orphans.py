"""Processes that end with the one that started them."""

from __future__ import annotations

import ctypes
import os
import signal
from typing import Final

__all__ = ["die_with_parent"]

_DEATH_SIGNAL: Final = 1
"""``PR_SET_PDEATHSIG`` of Linux's ``prctl``: which signal to send when the parent dies."""


def die_with_parent() -> None:
    """Have the system kill this process when its parent ends, whatever ends it.

    Pipes do not do that: a worker that waits for a lock of a killed run keeps them open.
    """
    parent = os.getppid()
    ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:  # it ended in between
        os._exit(1)
