"""Rows of tables with no more in them than a test cares about."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from breplake.schema.contract import Table


def zero(kind: pa.DataType) -> Any:
    """A value for a column that a test does not care about."""
    if pa.types.is_struct(kind):
        return {field.name: 0.0 for field in kind}
    if pa.types.is_map(kind) or pa.types.is_list(kind):
        return []
    if pa.types.is_boolean(kind):
        return False
    return "" if pa.types.is_string(kind) else 0


def complete(table: Table, row: Mapping[str, Any]) -> dict[str, Any]:
    """Fill the columns that must not be null."""
    return {c.name: zero(c.type) for c in table.columns if not c.nullable} | dict(row)


def vec(point: Any) -> dict[str, float] | None:
    """A point or direction as a row has it; one that is not defined is null."""
    return None if np.isnan(point).any() else dict(zip("xyz", map(float, point), strict=True))
