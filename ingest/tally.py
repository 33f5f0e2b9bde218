"""Counts of what became of the inputs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from breplake.ingest.pool import Result

__all__ = ["Tally"]


@dataclass(slots=True, kw_only=True)
class Tally:
    """How some inputs ended.

    Parameters
    ----------
    n_models : int
        New rows of ``models``.
    n_meshed : int
        Those of them that have mesh and ground truth.
    n_fatal : int
        Inputs that are rows of ``failures`` only.
    n_kept : int
        Inputs that could not be read, so that the lake keeps the models that it has of them.
    n_resumed : int
        Inputs that an earlier run had finished but not committed.
    kinds : Counter
        Failures by (stage, kind), fatal or not.
    cpu_seconds : float
        CPU time of the models.
    """

    n_models: int = 0
    n_meshed: int = 0
    n_fatal: int = 0
    n_kept: int = 0
    n_resumed: int = 0
    kinds: Counter[tuple[str, str]] = field(default_factory=Counter)
    cpu_seconds: float = 0.0

    @property
    def n_done(self) -> int:
        """Inputs that are finished."""
        return self.n_models + self.n_fatal + self.n_kept

    def add(self, result: Result, *, is_kept: bool = False) -> None:
        """Count one finished input; `is_kept` if it stays as it was in the lake."""
        self.n_resumed += result.is_resumed
        self.kinds.update((failure.stage, failure.kind) for failure in result.failures)
        if is_kept:
            self.n_kept += 1
            return
        if not result.recorded:
            self.n_fatal += 1
            return
        row = result.spool.read_model()
        self.n_models += 1
        self.n_meshed += bool(row.get("mesh_kind"))
        self.cpu_seconds += row["cpu_total"]

    def merge(self, other: Tally) -> None:
        """Count what another tally has counted."""
        self.n_models += other.n_models
        self.n_meshed += other.n_meshed
        self.n_fatal += other.n_fatal
        self.n_kept += other.n_kept
        self.n_resumed += other.n_resumed
        self.kinds.update(other.kinds)
        self.cpu_seconds += other.cpu_seconds
