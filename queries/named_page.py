"""The query library as one Markdown page.

``docs/queries.md`` is this page, written by ``make docs``; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from breplake.queries.named import TOPICS, NamedQuery, named_queries
from breplake.queries.views import DERIVED, derived_sql

__all__ = ["library_page", "query_section"]

_HEAD: Final = """\
# Query library

<!-- Written by `make docs` from the headers of queries/library/*.sql: edit those. -->

Questions that people ask of a lake of CAD models, ready to run. Each is a plain SQL file in
[queries/library](../queries/library) to copy from.

```bash
breplake query --list
breplake query fillets --describe
breplake query fillets --param min_radius=1 --where "n_patches < 100"
breplake query surface_types --format csv -o surface_types.csv
```

```python
import breplake

lake = breplake.open("lake")
rounded = lake.query("fillets", min_radius=1, where="n_patches < 100")
print(rounded.fetchall())
print(lake.query("surface_types").pl())
```

`--where` narrows any of them down to models for which a condition on the columns of `models` holds;
those that read `failures` (`failures_by_kind`, `benchmark_rejects`) refuse it, since most failures
are of inputs that are no models.
`lake.query` returns what `lake.sql` does: a DuckDB relation, which converts to Arrow, polars and
pandas.
"""

_SANDBOX: Final = """\
## SQL that you do not trust

`lake.sql` and `breplake sql` run reading statements only, which prevents accidents. They are no
protection against people: a SELECT may read any file that you can. For SQL of others there is the
sandbox. It runs one SELECT on the tables and views, in a process of its own that can reach no file,
network, extension, setting or variable, and stops it when it takes too long or too much memory.

```bash
breplake sql --sandbox "SELECT name FROM models WHERE n_torus > 30" --timeout 60 --memory 1
```

```python
box = lake.sandbox(timeout=60, memory=1.0, max_rows=10_000)
print(box.sql("SELECT type, count(*) AS patches FROM patches GROUP BY type").to_pydict())
```

A refused statement raises `UsageError`, a stopped one `LimitError`. Each query starts a process,
which takes about half a second.
"""

_VIEWS: Final = """\
## Views

Besides the [tables](tables.md), SQL and the queries see these views. They are computed when they
are read.
"""


_LAST: Final = "- [sandbox](#sql-that-you-do-not-trust): SQL that you do not trust"


def library_page() -> str:
    """Return the page of all named queries and views."""
    found = named_queries()
    parts = [_HEAD, _contents(found)]
    for topic, title in TOPICS.items():
        parts.append(f"## {title}\n")
        parts += [query_section(query) for query in found if query.topic == topic]
    parts.append(_VIEWS)
    parts += [_view_section(name) for name in DERIVED]
    parts.append(_SANDBOX)
    return "\n".join(parts)


def query_section(query: NamedQuery) -> str:
    """Return the Markdown of one query: what it answers, its parameters and columns.

    Parameters
    ----------
    query : NamedQuery
        A query of the library.
    """
    text = [
        f"### {query.name}\n",
        f"**[{query.title}](../queries/library/{query.name}.sql).** {query.description}\n",
    ]
    if query.parameters:
        rows = (
            (
                f"`{p.name}`",
                p.type,
                "required" if p.required else f"`{p.default_text}`",
                p.unit,
                p.meaning,
            )
            for p in query.parameters
        )
        text.append(_table(("parameter", "type", "default", "unit", "meaning"), rows))
    columns = ((f"`{c.name}`", c.unit, c.meaning) for c in query.columns)
    text.append(_table(("column", "unit", "meaning"), columns))
    return "\n".join(text)


def _contents(found: Iterable[NamedQuery]) -> str:
    lines = [f"- [{query.name}](#{query.name}): {query.title}" for query in found]
    return "\n".join([*lines, "- [views](#views): what is derived from the tables", _LAST, ""])


def _view_section(name: str) -> str:
    """Return the Markdown of a view: the comment at the head of its file."""
    lines = []
    for line in derived_sql(name).splitlines():
        if not line.startswith("--"):
            break
        lines.append(line[2:].removeprefix(" "))
    text = "\n".join(lines)
    return f"### The view {name}\n\n```text\n{text}\n```\n"


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"
