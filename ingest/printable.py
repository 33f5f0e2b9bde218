"""Text that columns can hold: names of files need not be Unicode."""

from __future__ import annotations

from pathlib import PurePath

__all__ = ["printable"]


def printable(text: PurePath | str) -> str:
    r"""Return a path or text as UTF-8 can hold it: what it cannot is spelled out, ``\xff`` say."""
    given = str(text)
    try:
        return given.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # half a character, which no file name has but JSON and YAML may
        return given.encode("utf-8", "backslashreplace").decode("utf-8")
