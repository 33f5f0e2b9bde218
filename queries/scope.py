"""A query over chosen models: the tables that it reads are narrowed down to them."""

from __future__ import annotations

import re
from collections.abc import Iterable

from breplake.errors import UsageError
from breplake.queries.views import DERIVED, derived_sql
from breplake.schema.tables import TABLES

__all__ = ["over_models"]

_WORD = re.compile(r"\w+")
_COMMENT = re.compile(r"--.*")


def over_models(sql: str, where: str) -> str:
    """Return a query that sees only models, and their rows of other tables, that `where` keeps.

    The tables and views are replaced by common table expressions of the same names, so any query
    can be narrowed down that calls them by their plain names.

    Parameters
    ----------
    sql : str
        A SELECT statement.
    where : str
        Condition on a row of ``models``.

    Returns
    -------
    str
        A SELECT statement.

    Raises
    ------
    UsageError
        If it reads ``failures``, most of which are of inputs that are no models: no condition on
        models can be applied to these.
    """
    if _words(_COMMENT.sub("", sql), ["failures"]):
        raise UsageError(
            "where is a condition on models, and this query reads failures, most of which are of "
            "inputs that are no models: ask without it, or add a condition on failures to the "
            "query's SQL, which breplake query NAME --sql prints"
        )
    tables = [name for name in TABLES if name not in ("models", "failures")]
    narrowed = {
        name: f"SELECT * FROM main.{name} SEMI JOIN models USING (model_id)" for name in tables
    }
    narrowed |= {name: derived_sql(name) for name in DERIVED}
    used = _used(sql, narrowed)
    # line ends close comments
    parts = [f"models AS (SELECT * FROM main.models WHERE (\n{where}\n))"]
    parts += [f"{name} AS (\n{body}\n)" for name, body in narrowed.items() if name in used]
    return f"WITH {', '.join(parts)}\nSELECT * FROM (\n{sql.rstrip().rstrip(';')}\n)"


def _used(sql: str, bodies: dict[str, str]) -> set[str]:
    """Return which of the names occur in `sql`, or in the body of one that does."""
    found: set[str] = set()
    waiting = _words(sql, bodies)
    while waiting:
        name = waiting.pop()
        found.add(name)
        waiting |= _words(bodies[name], bodies) - found
    return found


def _words(text: str, known: Iterable[str]) -> set[str]:
    return set(_WORD.findall(text.lower())) & set(known)
