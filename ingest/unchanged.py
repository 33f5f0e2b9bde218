"""Proof that the files of an input are those that were planned, from first to last byte read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from breplake.errors import InputError
from breplake.ingest.clock import StageClock
from breplake.ingest.failure import CHANGED, advise
from breplake.ingest.hashing import Hasher
from breplake.ingest.inputs import Input

__all__ = ["unchanged"]


@contextmanager
def unchanged(item: Input, clock: StageClock) -> Iterator[None]:
    """Read the files of an input in a block, which fails if they are not those of its hash.

    They are hashed before the block, and looked at after it, also where it fails: half a file
    says nothing about the model. What was brought from elsewhere was hashed on its way.

    Parameters
    ----------
    item : Input
        One that was planned.
    clock : StageClock
        Is told that the stage ``read`` runs.

    Raises
    ------
    InputError
        ``hash-mismatch`` if they changed, ``unreadable`` if they cannot be read any more.
    """
    if item.origin is not None or item.sha256 is None:
        yield
        return
    with clock.stage(CHANGED[0]):
        before = _states(item)
        if Hasher().digest(item.files).sha256 != item.sha256:
            raise _mismatch(item)
    try:
        yield
    finally:
        stage = clock.current
        clock.begin(CHANGED[0])
        if _states(item) != before:
            raise _mismatch(item)
        clock.begin(stage)


def _mismatch(item: Input) -> InputError:
    detail = (
        f"{item.shown} changed after it was planned, so run the same command again, with --rehash "
        "if that says the same"  # times of change that do not show it: the hash is remembered
    )
    return InputError(CHANGED[1], advise(CHANGED[1], detail))


def _states(item: Input) -> list[tuple[int, int, int]]:
    """Return what changes when a file is written or replaced, of each file."""
    try:
        states = [os.stat(path) for path in item.files]
    except OSError as error:
        raise _unreadable(error) from error
    return [(state.st_size, state.st_mtime_ns, state.st_ino) for state in states]


def _unreadable(error: OSError) -> InputError:
    return InputError("unreadable", advise("unreadable", error.strerror or str(error)))
