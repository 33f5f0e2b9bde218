"""Placeholder until the lead's command is here."""

from __future__ import annotations

__all__ = ["ingest"]


def ingest() -> None:
    """Turn CAD files into a lake."""
    raise NotImplementedError
