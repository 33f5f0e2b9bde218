"""What a source says of a model beside its geometry: licence, owner, address and more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

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
            "licence": self.licence,
            "owner": self.owner,
            "source_url": self.source_url,
            "metadata": list(self.metadata),
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


NO_FACTS = Facts()
"""Of a source that states nothing."""
