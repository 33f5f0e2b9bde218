"""Six questions, asked of breplake, polars and SQLite: what `breplake.bench.speed.sql` measures.

Every peer is opened once and then asked; SQLite holds only the columns that the questions touch,
with the indices that help them.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    import polars as pl

    from breplake.queries.session import Lake

__all__ = ["QUESTIONS", "Question", "make_sqlite", "peers", "scan"]

Rows = list[tuple[Any, ...]]


@dataclass(frozen=True, slots=True)
class Question:
    """A question in SQL that DuckDB and SQLite both understand, and for polars.

    Parameters
    ----------
    name : str
        What is asked.
    sql : str
        The statement; ``{id}`` stands for a model's id.
    frame : callable
        The same for polars: takes the frames of models and patches and an id.
    touched : dict
        Columns that must be read, by table.
    """

    name: str
    sql: str
    frame: Callable[[pl.LazyFrame, pl.LazyFrame, int], pl.LazyFrame]
    touched: dict[str, tuple[str, ...]]


def _torus_rich(models: pl.LazyFrame, patches: pl.LazyFrame, identity: int) -> pl.LazyFrame:
    import polars as pl

    return models.filter(pl.col("n_torus") > 30).select("name").sort("name")


def _types(models: pl.LazyFrame, patches: pl.LazyFrame, identity: int) -> pl.LazyFrame:
    import polars as pl

    return patches.group_by("type").agg(pl.len(), pl.col("area").sum()).sort("type")


def _radii(models: pl.LazyFrame, patches: pl.LazyFrame, identity: int) -> pl.LazyFrame:
    import polars as pl

    bins = (pl.col("min_radius") * 10).floor().alias("bin")
    tori = patches.filter(pl.col("type") == "Torus", pl.col("min_radius") < 10)
    return tori.group_by(bins).agg(pl.len()).sort("bin")


def _freeform(models: pl.LazyFrame, patches: pl.LazyFrame, identity: int) -> pl.LazyFrame:
    import polars as pl

    free = pl.when(pl.col("type") == "BSpline").then("area").otherwise(0.0).sum()
    shares = patches.group_by("model_id").agg(free.alias("free"), pl.col("area").sum())
    return shares.filter(pl.col("free") > 0.5 * pl.col("area")).select(pl.len())


def _bores(models: pl.LazyFrame, patches: pl.LazyFrame, identity: int) -> pl.LazyFrame:
    import polars as pl

    bores = patches.filter(
        pl.col("type") == "Cylinder", pl.col("reversed"), pl.col("radius").is_between(5, 6)
    )
    small = models.filter(pl.col("n_patches") < 20)
    return bores.join(small, on="model_id").group_by("format").agg(pl.len()).sort("format")


def _one_model(models: pl.LazyFrame, patches: pl.LazyFrame, identity: int) -> pl.LazyFrame:
    import polars as pl

    rows = patches.filter(pl.col("model_id") == identity)
    return rows.select("patch_id", "type", "area").sort("patch_id")


QUESTIONS: Final = (
    Question(
        "torus-rich models",
        "SELECT name FROM models WHERE n_torus > 30 ORDER BY name",
        _torus_rich,
        {"models": ("name", "n_torus")},
    ),
    Question(
        "types of all patches, with areas",
        "SELECT type, count(*), sum(area) FROM patches GROUP BY type ORDER BY type",
        _types,
        {"patches": ("type", "area")},
    ),
    Question(
        "radii of tori",
        "SELECT floor(min_radius * 10) AS bin, count(*) FROM patches "
        "WHERE type = 'Torus' AND min_radius < 10 GROUP BY bin ORDER BY bin",
        _radii,
        {"patches": ("type", "min_radius")},
    ),
    Question(
        "models that are mostly freeform",
        "SELECT count(*) FROM (SELECT sum(CASE WHEN type = 'BSpline' THEN area ELSE 0.0 END) AS f, "
        "sum(area) AS a FROM patches GROUP BY model_id) AS s WHERE f > 0.5 * a",
        _freeform,
        {"patches": ("model_id", "type", "area")},
    ),
    Question(
        "bores of small models, a join",
        "SELECT format, count(*) FROM patches JOIN models ON models.model_id = patches.model_id "
        "WHERE type = 'Cylinder' AND reversed AND radius BETWEEN 5 AND 6 AND n_patches < 20 "
        "GROUP BY format ORDER BY format",
        _bores,
        {"patches": ("model_id", "type", "reversed", "radius"),
         "models": ("model_id", "n_patches", "format")},
    ),
    Question(
        "patches of one model",
        "SELECT patch_id, type, area FROM patches WHERE model_id = {id} ORDER BY patch_id",
        _one_model,
        {"patches": ("model_id", "patch_id", "type", "area")},
    ),
)  # fmt: skip
"""The torus query first."""


def peers(
    lake: Lake, database: Path | None, identity: int
) -> dict[str, Callable[[Question], Rows]]:
    """Return what answers a question, by the name of the peer.

    Parameters
    ----------
    lake : Lake
        What breplake and polars read.
    database : pathlib.Path or None
        What `make_sqlite` made of it; None leaves SQLite out.
    identity : int
        The model that one of the questions is about.
    """

    def breplake(question: Question) -> Rows:
        return lake.sql(question.sql.format(id=identity)).fetchall()

    def polars(question: Question) -> Rows:
        frame = question.frame(lake.scan("models"), lake.scan("patches"), identity)
        return frame.collect().rows()

    found: dict[str, Callable[[Question], Rows]] = {"breplake": breplake, "polars": polars}
    if database is not None:
        connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True)

        def sqlite(question: Question) -> Rows:
            return connection.execute(question.sql.format(id=identity)).fetchall()

        found["sqlite"] = sqlite
    return found


def scan(lake: Lake, question: Question) -> int:
    """Read the columns that a question touches, once and whole; return their number of values.

    Parquet's own reader in Arrow does it, with all cores and large buffers, into memory.
    """
    import pyarrow.dataset

    values = 0
    for table, columns in question.touched.items():
        files = pyarrow.dataset.dataset(lake.sources(table), format="parquet")
        for batch in files.to_batches(columns=list(columns), batch_size=1 << 17):
            values += batch.num_rows * batch.num_columns
    return values


def make_sqlite(lake: Lake, path: Path) -> None:
    """Write the touched columns of a lake as an SQLite database, with indices.

    Parameters
    ----------
    lake : Lake
        What to copy.
    path : pathlib.Path
        The file; replaced if it exists.
    """
    columns: dict[str, list[str]] = {}
    for question in QUESTIONS:
        for table, touched in question.touched.items():
            known = columns.setdefault(table, [])
            known += [name for name in touched if name not in known]
    path.unlink(missing_ok=True)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = off")
        connection.execute("PRAGMA synchronous = off")
        for table, names in columns.items():
            connection.execute(f"CREATE TABLE {table} ({', '.join(names)})")
            marks = ", ".join("?" * len(names))
            reader = lake.sql(f"SELECT {', '.join(names)} FROM {table}").to_arrow_reader(100_000)
            for batch in reader:
                rows = zip(*(column.to_pylist() for column in batch.columns), strict=True)
                connection.executemany(f"INSERT INTO {table} VALUES ({marks})", rows)
        connection.execute("CREATE INDEX tori ON models (n_torus, name)")
        connection.execute("CREATE INDEX ids ON models (model_id, n_patches, format)")
        connection.execute("CREATE INDEX of_model ON patches (model_id)")
        connection.execute("CREATE INDEX of_type ON patches (type, min_radius)")
        connection.commit()
        connection.execute("ANALYZE")
