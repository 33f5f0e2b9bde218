"""Curves and surfaces with other parameters: what a user who optimises geometry changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol, TypeVar

from breplake.errors import UsageError
from breplake.schema.namespace import Array

__all__ = ["with_parameters"]


class _Parametric(Protocol):
    @property
    def splines(self) -> Any: ...

    def parameters(self) -> dict[str, Array]: ...


Part = TypeVar("Part", bound=_Parametric)


def with_parameters(part: Part, changed: Mapping[str, Array]) -> Part:
    """Return a set of curves or surfaces with some of its own parameters changed.

    Raises
    ------
    UsageError
        If a name is no parameter, or the shape of one changes.
    """
    if not changed:
        return part
    present = part.parameters()
    for name, value in changed.items():
        if name not in present:
            raise UsageError(f"there is no parameter {name!r}; there are {sorted(present)}")
        if value.shape != present[name].shape:
            shape = tuple(present[name].shape)
            raise UsageError(f"parameter {name!r} must stay {shape}, got {tuple(value.shape)}")
    fields: dict[str, Any] = {k: v for k, v in changed.items() if k not in ("poles", "weights")}
    if len(fields) < len(changed):
        full = {**present, **changed}
        poles = part.splines.poles.changed(full["poles"], full["weights"])
        fields["splines"] = replace(part.splines, poles=poles)
    return replace(part, **fields)  # type: ignore[type-var]  # every such part is a dataclass
