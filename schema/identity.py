"""Identity of models: a pure function of the name, so that subsets hold in every lake."""

from __future__ import annotations

import hashlib

from breplake.errors import UsageError

__all__ = ["model_id"]


def model_id(collection: str, name: str) -> int:
    """Return the id of the model `name` of `collection`.

    Parameters
    ----------
    collection : str
        Group of models in which names are unique. It must hold no ``/``.
    name : str
        Name of the model, a relative POSIX path without extension.

    Returns
    -------
    int
        The first 63 bits of SHA-256 of ``collection/name``: 0 <= id < 2**63.

    Raises
    ------
    UsageError
        If either is empty, or if `collection` holds a ``/``: ``a/b`` + ``c`` and ``a`` +
        ``b/c`` would otherwise be one model.
    """
    if not collection or not name:
        raise UsageError(f"collection and name must not be empty, got {collection!r} and {name!r}")
    if "/" in collection:
        raise UsageError(f"a collection must not hold '/', got {collection!r}")
    # surrogateescape keeps file names that are not UTF-8 distinct instead of refusing them
    text = f"{collection}/{name}".encode("utf-8", "surrogateescape")
    return int.from_bytes(hashlib.sha256(text).digest()[:8], "big") >> 1
