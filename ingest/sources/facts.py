"""What a source says of a model beside its geometry: licence, owner, address and more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from breplake.ingest.printable import printable

__all__ = ["NO_FACTS", "Facts"]


@dataclass(frozen=True, slots=True)
class Facts:
    """Facts that a source states; nothing is guessed.

    Parameters
    ----------
    licence, owner, source_url : str, optional
        The columns of ``models`` of these names.
    metadata : tuple of (str, str)
        All else, for the column ``metadata``.
    """

    licence: str | None = None
    owner: str | None = None
    source_url: str | None = None
    metadata: tuple[tuple[str, str], ...] = ()

    def columns(self) -> dict[str, Any]:
        """Return the columns of ``models`` that these facts fill."""
        return {
            "licence": _held(self.licence),
            "owner": _held(self.owner),
            "source_url": _held(self.source_url),
            "metadata": [(printable(key), printable(value)) for key, value in self.metadata],
        }

    def over(self, other: Facts) -> Facts:
        """Return these facts, completed by those of `other` that are missing here."""
        return Facts(
            self.licence or other.licence,
            self.owner or other.owner,
            self.source_url or other.source_url,
            tuple((dict(other.metadata) | dict(self.metadata)).items()),
        )

    @classmethod
    def of(cls, columns: Mapping[str, Any]) -> Facts:
        """Return the facts of which :meth:`columns` made `columns`."""
        pairs = tuple((str(key), str(value)) for key, value in columns["metadata"])
        return cls(columns["licence"], columns["owner"], columns["source_url"], pairs)


def _held(text: str | None) -> str | None:
    return None if text is None else printable(text)


NO_FACTS = Facts()
"""Of a source that states nothing."""
