"""Settings of an ingest, and the hash of those that decide what ends up in the lake."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Final, Literal

from breplake.errors import UsageError

__all__ = ["RUNGS", "MeshMode", "Settings"]

MeshMode = Literal["uniform", "adaptive"]

RUNGS: Final[dict[str, tuple[str, ...]]] = {
    "uniform": ("uniform", "tessellation"),
    "adaptive": ("adaptive", "uniform", "tessellation"),
}
"""Ladder of meshing: what is tried, in order, for each mode."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What an ingest does to every model.

    Parameters
    ----------
    mesh : {"uniform", "adaptive"}
        Meshing mode of the paper (section 3.2, step 2).
    max_edge : float
        Longest mesh edge, as a fraction of the bounding box diagonal.
    grading : float
        Adaptive mode: smallest element size, as a fraction of the longest edge.
    per_turn : int
        Adaptive mode: elements per 2 pi of curvature.
    max_triangles : int
        Largest mesh. A model that would need more gets longer edges, and says so.
    uv_grid : int
        Points along a side of the UV-grids of patches and curves; 0 for none.
    timeout : float
        Seconds a model may take in one attempt.
    memory : float
        Address space a worker may take, in GiB.

    Raises
    ------
    UsageError
        If a value is out of range.
    """

    mesh: MeshMode = "uniform"
    max_edge: float = 0.01
    grading: float = 0.05
    per_turn: int = 16
    max_triangles: int = 1_000_000
    uv_grid: int = 0
    timeout: float = 120.0
    memory: float = 8.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        rules = (
            (self.mesh in RUNGS, f"mesh must be one of {', '.join(RUNGS)}", self.mesh),
            (0 < self.max_edge <= 1, "max_edge must be in (0, 1], 0.01 is 1 %", self.max_edge),
            (0 < self.grading <= 1, "grading must be in (0, 1]", self.grading),
            (self.per_turn >= 3, "per_turn must be at least 3", self.per_turn),
            (self.max_triangles >= 1000, "max_triangles must be at least 1000", self.max_triangles),
            (
                self.uv_grid == 0 or 2 <= self.uv_grid <= 256,
                "uv_grid must be 0 or 2 to 256",
                self.uv_grid,
            ),
            (self.timeout > 0, "timeout must be more than 0 seconds", self.timeout),
            (self.memory >= 1, "memory must be at least 1 GiB", self.memory),
        )
        for holds, rule, value in rules:
            if not holds:
                raise UsageError(f"{rule}; got {value}")

    @property
    def config_hash(self) -> str:
        """Hash of the settings that decide content; limits on resources do not."""
        content = {k: v for k, v in asdict(self).items() if k not in ("timeout", "memory")}
        if self.mesh == "uniform":
            del content["grading"], content["per_turn"]
        if not self.uv_grid:
            del content["uv_grid"]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
