"""What stats and metadata files say of a model, as far as it can be true."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from breplake.ingest.abc.repair import Repairs
from breplake.ingest.sources.abc_names import document_facts
from breplake.schema.types import MESH_KINDS

__all__ = ["Stats", "document_columns"]

_Floats = npt.NDArray[np.float64]

_SAME_MASS: Final = 1e-3
"""Relative difference of a mass from the integral over the patches that may be either's error:
Open CASCADE's integrals over splines are off by up to 1e-4, an error estimate by all of it."""

_COARSE: Final = (0.5, 9.0)
"""By which share of what a coarse mesh shows the truth may be less, or more."""

_GREATEST_TOLERANCE: Final = 1e-3
"""Share of the diagonal that no tolerance of a sound model reaches."""

_SAME_EDGE: Final = 10.0
"""Factor between the edge length that was asked for and the longest edge."""

_METRE: Final = 1000.0


def document_columns(content: Any) -> dict[str, Any]:
    """Return columns of ``models`` from a metadata file, that of the Onshape document.

    ``licence`` where the file states one, ``owner``, ``source_url`` (the page of the document
    and not that of the programming interface) and ``metadata``: name and dates.
    """
    return document_facts(content if isinstance(content, Mapping) else {}).columns()


@dataclass(slots=True)
class Stats:
    """A stats file, judged against the model.

    Parameters
    ----------
    given : mapping
        Its content; empty if there is none.
    repairs : Counter
        Takes up what was wrong.
    """

    given: Mapping[str, Any] = field(default_factory=dict)
    repairs: Repairs = field(default_factory=Repairs)

    def _number(self, key: str) -> float | None:
        value = self.given.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        return float(value) if math.isfinite(value) else None

    @property
    def has_no_volume(self) -> bool:
        """Whether it says that there is no solid."""
        return "volume" in self.given and self.given["volume"] is None

    def mass(self, key: str, exact: float, coarse: float = 0.0) -> float:
        """Return the stated ``surface`` or ``volume`` if it is `exact` but for errors.

        Published files hold an estimate of the error there.

        Parameters
        ----------
        key : {"surface", "volume"}
            Which of both.
        exact : float
            What it is, mm^2 or mm^3.
        coarse : float
            How much of that is of patches that the mesh is too coarse to tell.
        """
        stated = self._number(key)
        if stated is None:
            return exact
        slack = _SAME_MASS * abs(exact)
        less, more = (slack + share * coarse for share in _COARSE)
        if exact - less <= stated <= exact + more:
            return stated
        self.repairs[f"stats-{key}"] += 1
        return exact

    def box(self, points: _Floats, longest: float) -> tuple[_Floats, _Floats]:
        """Return the corners ``(3,)`` mm of the bounding box: the stated ones if they fit.

        Published files hold the box of the first solid, widened by its tolerance.

        Parameters
        ----------
        points : numpy.ndarray
            ``(n, 3)`` mm that lie in it.
        longest : float
            Longest edge of the mesh, mm: no curved side bulges farther out of it.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        stated = self.given.get("bbox")
        if stated is None:
            return low, high
        try:
            corners = np.asarray(stated, dtype=np.float64)[:6].reshape(2, 3)
        except (TypeError, ValueError):
            corners = np.full((2, 3), np.nan)
        out = np.stack([low - corners[0], corners[1] - high])
        if ((out >= -1e-9 * float(np.linalg.norm(high - low))) & (out <= longest)).all():
            return corners[0], corners[1]
        self.repairs["stats-box"] += 1
        return low, high

    def mesh_limit(self, longest: float) -> float | None:
        """Return the edge length that was asked of the mesh, mm, given the longest edge."""
        stated = self._number("max_length")
        if stated is None:
            return None
        for scale in (1.0, _METRE):
            if longest / _SAME_EDGE <= stated * scale <= longest * _SAME_EDGE:
                if scale != 1.0:
                    self.repairs["stats-length"] += 1
                return stated * scale
        return None

    @property
    def mesh_kind(self) -> str:
        """How the mesh was made; the published ones are uniform."""
        stated = self.given.get("mesh_kind")
        return str(stated) if stated in MESH_KINDS else "uniform"

    def tolerance(self, diagonal: float) -> float | None:
        """Return the greatest tolerance that is stated, mm; None if there is none."""
        stated = self._number("tolerance")
        sound = stated is not None and 0 <= stated <= _GREATEST_TOLERANCE * diagonal
        return stated if sound else None

    def compare(self, counts: Mapping[str, int]) -> None:
        """Take up stated counts that are not those of the files."""
        wrong = sum(self.given.get(key, count) != count for key, count in counts.items())
        if wrong:
            self.repairs["stats-counts"] += wrong
