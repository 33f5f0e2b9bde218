"""A lake at one snapshot, as readers see it: ``lake = breplake.open("lake")``."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from breplake.errors import LakeFormatError, NameNotFoundError, UsageError
from breplake.queries.names import did_you_mean
from breplake.queries.rows import RowReader
from breplake.schema.array_reader import ArrayShardReader
from breplake.schema.lake import LakeStore
from breplake.schema.older import TableFile
from breplake.schema.snapshot import ARRAYS_TABLE, FileEntry, Snapshot
from breplake.schema.tables import TABLES

if TYPE_CHECKING:
    import duckdb
    import polars as pl
    import pyarrow as pa

    from breplake.queries.info import LakeInfo
    from breplake.queries.sampling import Method, PointSample
    from breplake.queries.sandbox import Sandbox
    from breplake.schema.subset import Subset

__all__ = ["Lake"]


class Lake:
    """Read a lake at one snapshot.

    It may be pickled and used in worker processes, forked ones too: each process opens its
    own connection when it first needs one.

    Parameters
    ----------
    path : str or pathlib.Path
        The lake's folder, or its URL in object storage (``s3://…``, ``gs://…``, ``az://…``) or on
        a web server. Credentials are those of the environment.
    at : int or str, optional
        Number or tag of a snapshot; the newest if not given. The session stays at that
        snapshot when others commit.

    Raises
    ------
    LakeNotFoundError
        If there is no lake in that folder.
    NameNotFoundError
        If there is no such snapshot.
    LakeFormatError
        If the lake is of a version that this breplake cannot read.

    Attributes
    ----------
    store : LakeStore
        The files and snapshots behind it.
    snapshot : Snapshot
        What it reads.
    """

    def __init__(self, path: str | Path, at: int | str | None = None) -> None:
        self.store = LakeStore.open(path)
        self.snapshot: Snapshot = self.store.snapshot(at)
        self._reset()

    def _reset(self) -> None:
        self._rows = RowReader(self.store.storage, self.snapshot)
        self._shards: dict[str, ArrayShardReader] = {}
        self._connection: duckdb.DuckDBPyConnection | None = None
        self._pid = os.getpid()

    def __getstate__(self) -> dict[str, Any]:
        return {"place": self.place, "number": self.snapshot.number}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.store = LakeStore.open(state["place"])
        self.snapshot = self.store.snapshot(state["number"])
        self._reset()

    def __repr__(self) -> str:
        return f"Lake({self.place!r}, at={self.snapshot.number})"

    @property
    def root(self) -> Path:
        """Absolute path of the lake's folder.

        Raises
        ------
        UsageError
            If the lake is not in a local folder.
        """
        return self.store.root

    @property
    def place(self) -> str:
        """Absolute path of the lake's folder, or its URL."""
        return self.store.storage.name

    def at(self, at: int | str | None = None) -> Lake:
        """Return this lake at another snapshot, by number or tag; None is the newest."""
        return Lake(self.place, at)

    def files(self, table: str) -> list[str]:
        """Return the paths of a table's files (or of ``arrays``) at this snapshot.

        They are absolute, or URLs.

        Raises
        ------
        NameNotFoundError
            If there is no such table.
        """
        _require_table(table, ARRAYS_TABLE)
        return [self.store.storage.locate(entry.path) for entry in self.snapshot.table_files(table)]

    def sources(self, table: str) -> list[str]:
        """Return the files from which a whole table is read fastest, absolute or URLs.

        That is its consolidated copy if there is one in the local folder
        (`breplake.queries.consolidated`), else its files.

        Raises
        ------
        NameNotFoundError
            If there is no such table.
        """
        files = self.files(table)
        copy = self._copy(table)
        return files if copy is None else [copy]

    def _copy(self, table: str) -> str | None:
        """Return the consolidated copy of a table, if there is one."""
        from breplake.queries.consolidated import consolidated_path

        entries = self.snapshot.table_files(table)
        if not entries or not self.store.storage.is_local:
            return None
        path = consolidated_path(self.root, table, entries)
        return str(path) if path.exists() else None

    @property
    def connection(self) -> duckdb.DuckDBPyConnection:
        """The DuckDB session of this process, with a view for each table.

        It is an ordinary session in memory that runs any statement, for instance
        ``lake.connection.execute("CREATE TABLE mine AS FROM 'mine.csv'")`` to join tables of
        your own in `sql`.
        """
        if self._pid != os.getpid():
            # threads do not survive a fork: keep the parent's session alive, but out of use
            self._inherited = self._connection
            self._connection, self._pid = None, os.getpid()
        if self._connection is None:
            self._connection = self._connect()
        return self._connection

    def _connect(self) -> duckdb.DuckDBPyConnection:
        import duckdb
        import pyarrow as pa

        from breplake.queries.views import create_views

        spill = Path(tempfile.gettempdir()) / f"breplake-{os.getuid()}-duckdb"
        connection = duckdb.connect(
            ":memory:",
            config={
                "autoinstall_known_extensions": "false",  # a query must not go to the network
                "python_enable_replacements": "false",  # nor read a Python variable by its name
                "temp_directory": str(spill),  # DuckDB's default is .tmp in the current folder
            },
        )
        try:
            create_views(connection, self._views(connection), self._opened)
        except (duckdb.Error, OSError, pa.ArrowException) as error:
            raise LakeFormatError(f"the lake is damaged ({error}): run breplake check") from error
        return connection

    def _views(self, connection: duckdb.DuckDBPyConnection) -> dict[str, list[TableFile]]:
        """Return what DuckDB reads each table from; let it read over the network if need be."""
        if not self.store.storage.is_local:
            from breplake.queries.remote import LakeFiles

            connection.register_filesystem(LakeFiles(self.store.storage))
        return {table: self._table_files(table) for table in TABLES}

    def _table_files(self, table: str) -> list[TableFile]:
        """Return what DuckDB calls the files of a table, and by which contract each is."""
        entries = self.snapshot.table_files(table)
        copy = self._copy(table)
        if copy is not None:
            return [TableFile(copy, self.snapshot.contract)]
        contract = self.snapshot.contract_of
        return [TableFile(self.sql_path(entry), contract(entry.shard)) for entry in entries]

    def _opened(self, path: str) -> Any:
        """Return what pyarrow reads a file from that `_views` named."""
        if self.store.storage.is_local:
            return path
        from breplake.queries.remote import lake_path

        return self.store.storage.reader(lake_path(path))

    def sql_path(self, entry: FileEntry) -> str:
        """Return what `connection` calls a file of the lake: its path, where it is local."""
        if self.store.storage.is_local:
            return self.store.storage.locate(entry.path)
        from breplake.queries.remote import lake_url

        return lake_url(entry.path)

    def sql(
        self, query: str, params: Sequence[Any] | Mapping[str, Any] | None = None
    ) -> duckdb.DuckDBPyRelation:
        """Run SQL that reads; the tables are views by their names.

        Besides the tables there are the views ``vertex_normals``, ``adjacency``, ``fillets`` and
        ``holes`` (see `breplake.queries.views`).

        Parameters
        ----------
        query : str
            One or more reading statements. This prevents accidents and is no sandbox: run SQL of
            people you do not trust in `sandbox`.
        params : sequence or mapping, optional
            Values of ``?`` or ``$name``.

        Returns
        -------
        duckdb.DuckDBPyRelation
            Of the last statement. It runs when its rows are asked for, and each time anew:
            ``.fetchall()``, ``.to_arrow_table()``, ``.to_arrow_reader()``, ``.pl()``, ``.df()``.

        Raises
        ------
        UsageError
            If the query is wrong, or does anything but read.
        """
        import duckdb

        from breplake.queries.statements import require_reading

        # a cursor of its own lets threads, and results still being read, go side by side
        cursor = self.connection.cursor()
        require_reading(cursor, query)
        try:
            return cursor.sql(query, params=params)
        except duckdb.Error as error:
            raise UsageError(str(error)) from error

    def sandbox(
        self,
        *,
        timeout: float = 30.0,
        memory: float = 1.0,
        max_rows: int = 1_000_000,
        max_bytes: int = 256_000_000,
    ) -> Sandbox:
        """Return where to run SQL of people you do not trust: ``lake.sandbox().sql("SELECT 1")``.

        Parameters
        ----------
        timeout : float
            Seconds for a query, the start of its process included.
        memory : float
            Memory for a query, GB.
        max_rows, max_bytes : int
            Size that an answer may have.

        Raises
        ------
        UsageError
            If a limit is not positive.
        """
        from breplake.queries.sandbox import Sandbox

        return Sandbox(self, timeout, memory, max_rows, max_bytes)

    def query(
        self, name: str, /, *, where: str | None = None, **params: Any
    ) -> duckdb.DuckDBPyRelation:
        """Run a query of the library, for instance ``lake.query("fillets", min_radius=1)``.

        Parameters
        ----------
        name : str
            Its name; `breplake.queries.named.named_queries` lists all.
        where : str, optional
            SQL condition on a row of ``models``: the query then sees only these models.
        **params
            Its parameters.

        Returns
        -------
        duckdb.DuckDBPyRelation
            As of `sql`.

        Raises
        ------
        NameNotFoundError
            If there is no query or parameter of that name.
        UsageError
            If a value is not of its parameter's type, a required one is missing, or `where` is
            wrong.
        """
        from breplake.queries.named import named_query
        from breplake.queries.scope import over_models

        query = named_query(name)
        sql = query.sql if where is None else over_models(query.sql, where)
        return self.sql(sql, query.bind(params))

    def scan(self, table: str) -> pl.LazyFrame:
        """Return a polars frame over the files of `table`, which reads when collected.

        Raises
        ------
        NameNotFoundError
            If there is no such table.
        """
        import polars as pl

        _require_table(table)
        paths = self.sources(table)
        empty = pl.from_arrow(TABLES[table].empty())
        assert isinstance(empty, pl.DataFrame)  # from_arrow of a table is a frame
        if not paths:
            return empty.lazy()
        return pl.scan_parquet(
            paths, glob=False, hive_partitioning=False, schema=empty.schema,
            missing_columns="insert", extra_columns="ignore",
            cast_options=pl.ScanCastOptions(
                missing_struct_fields="insert", extra_struct_fields="ignore"
            ),
        )  # fmt: skip

    def read(self, table: str, model_id: int, columns: Sequence[str] | None = None) -> pa.Table:
        """Return the rows of one model, sorted by the table's key; only its shard is read.

        Raises
        ------
        NameNotFoundError
            If there is no such table, column or model.
        """
        _require_table(table)
        names = TABLES[table].schema.names
        if unknown := sorted(set(columns or ()) - set(names)):
            raise NameNotFoundError(
                f"table {table} has no column {unknown[0]}{did_you_mean(unknown[0], names)}"
            )
        return self._rows.read(table, int(model_id), columns)

    def model(self, name_or_id: str | int) -> dict[str, Any]:
        """Return the row of a model in ``models``.

        Parameters
        ----------
        name_or_id : str or int
            Its ``name``, ``collection/name`` or ``model_id``.

        Raises
        ------
        NameNotFoundError
            If there is none; the message names the nearest.
        UsageError
            If models of several collections have that name.
        """
        from breplake.queries.lookup import failure_message, find_model

        rows = self.read("models", find_model(self, name_or_id))
        if rows.num_rows == 0:
            raise NameNotFoundError(failure_message(self, name_or_id))
        row: dict[str, Any] = rows.to_pylist(maps_as_pydicts="strict")[0]
        return row

    def subset(self, name: str) -> Subset:
        """Return a subset of the lake by its name, whatever snapshot it was made at.

        Raises
        ------
        NameNotFoundError
            If there is none.
        """
        from breplake.queries.subsets import load_subset

        return load_subset(self, name)

    def sample(
        self,
        model: str | int,
        n: int,
        method: Method = "uniform",
        *,
        seed: int = 0,
        curves: int | None = None,
        spacing: float | None = None,
    ) -> PointSample:
        """Sample points on the patches of a model, as trimmed by their loops.

        The same arguments give the same points, whatever else is sampled, and the first
        points of a larger uniform sample are those of a smaller one, to the last bit or two.

        Parameters
        ----------
        model : str or int
            As of `model`.
        n : int
            Number of points.
        method : {"uniform", "poisson"}
            Independent points, uniform by area; or points that keep their distance from each
            other (blue noise), which needs the extra ``sample``.
        seed : int
            Of the random numbers.
        curves : int, optional
            Number of points along sharp curves, uniform by length.
        spacing : float, optional
            Instead: greatest distance of points along each sharp curve, mm.

        Raises
        ------
        NameNotFoundError
            If there is no such model.
        UsageError
            If an argument is out of range, or the model has no patches.
        MissingExtraError
            If `method` needs an extra that is not installed.
        """
        from breplake.queries.sampling import sample

        return sample(self, model, n, method, seed=seed, curves=curves, spacing=spacing)

    def arrays(self, shard: str) -> ArrayShardReader:
        """Return the reader of a shard's arrays.

        Raises
        ------
        NameNotFoundError
            If the snapshot has no arrays of that shard.
        """
        if shard not in self._shards:
            entry = self.snapshot.file(ARRAYS_TABLE, shard)
            if entry is None:
                raise NameNotFoundError(
                    f"snapshot {self.snapshot.number} has no arrays of {shard!r}"
                )
            self._shards[shard] = ArrayShardReader(self.store.storage.folder(entry.path))
        return self._shards[shard]

    def info(self) -> LakeInfo:
        """Return what is in the lake."""
        from breplake.queries.info import describe

        return describe(self)


def _require_table(name: str, *also: str) -> None:
    known = [*TABLES, *also]
    if name not in known:
        raise NameNotFoundError(
            f"there is no table {name!r}{did_you_mean(name, known)}; tables are {', '.join(known)}"
        )
