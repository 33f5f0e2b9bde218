"""Which model is meant by a name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from breplake.errors import NameNotFoundError, UsageError

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["failure_message", "find_model"]


def find_model(lake: Lake, name_or_id: str | int) -> int:
    """Return the id of a model or failed input.

    Parameters
    ----------
    lake : Lake
        An open lake.
    name_or_id : str or int
        Its ``name``, ``collection/name`` or ``model_id``; an id need not be in the lake.

    Raises
    ------
    NameNotFoundError
        If there is no such name; the message has the nearest.
    UsageError
        If models of several collections have that name.
    """
    if not isinstance(name_or_id, str):
        return int(name_or_id)
    query = (
        "SELECT DISTINCT model_id, collection FROM {} WHERE name = $name OR "
        "(ends_with($name, name) AND concat(collection, '/', name) = $name) ORDER BY ALL"
    )
    for table in ("models", "failures"):
        found = lake.sql(query.format(table), {"name": name_or_id}).fetchall()
        if len(found) > 1:
            names = " or ".join(f"{collection}/{name_or_id}" for _, collection in found)
            raise UsageError(f"several models are called {name_or_id}: say {names}")
        if found:
            return int(found[0][0])
    if name_or_id.isdigit():
        return int(name_or_id)
    raise NameNotFoundError(f"no model {name_or_id!r}{_near_models(lake, name_or_id)}")


def failure_message(lake: Lake, name_or_id: str | int) -> str:
    """Return why an input that was found is no model."""
    failures = lake.read("failures", find_model(lake, name_or_id)).to_pylist()
    said = failures[-1]["message"] if failures else "unknown"
    return f"{name_or_id} was not read into the lake: {said}"


def _near_models(lake: Lake, name: str) -> str:
    query = "SELECT name FROM models ORDER BY jaro_winkler_similarity(name, ?) DESC, name LIMIT 3"
    found = [row[0] for row in lake.sql(query, [name]).fetchall()]
    return f": did you mean {', '.join(found)}?" if found else ""
