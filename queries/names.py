"""Names that are nearly right."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

__all__ = ["did_you_mean"]


def did_you_mean(name: str, known: Sequence[str]) -> str:
    """Return ``: did you mean x or y?`` with the nearest of `known`, or nothing."""
    found = difflib.get_close_matches(name, known, n=3, cutoff=0.6)
    return f": did you mean {' or '.join(found)}?" if found else ""
