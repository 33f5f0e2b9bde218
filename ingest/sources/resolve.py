"""From what was given as SOURCE to inputs, and from inputs to files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from threading import RLock

from breplake.errors import UsageError
from breplake.ingest.hashing import Hasher
from breplake.ingest.inputs import Input, find_inputs
from breplake.ingest.sources.abc_names import chunk_of, is_meta_chunk, meta_chunk
from breplake.ingest.sources.archives import archive_id, archive_inputs, check_metadata
from breplake.ingest.sources.downloads import Downloads
from breplake.ingest.sources.entry import archive_format
from breplake.ingest.sources.facts import NO_FACTS, Facts
from breplake.ingest.sources.fetch import Fetcher
from breplake.ingest.sources.ledger import Ledger
from breplake.ingest.sources.limits import Limits
from breplake.ingest.sources.listing import LISTS, Row, Taken, list_inputs, read_list
from breplake.ingest.sources.onshape import (
    PREFIX,
    Query,
    documents_in,
    is_onshape,
    onshape_inputs,
)
from breplake.ingest.sources.onshape_api import Keys, OnshapeApi, base_address
from breplake.ingest.sources.onshape_parts import Onshape
from breplake.ingest.sources.origin import MemberOrigin
from breplake.ingest.sources.survey import FACTS, Survey, survey
from breplake.ingest.sources.waiting import Tell, Waiting, silent
from breplake.ingest.sources.web import Web

__all__ = ["Sources"]


class Sources:
    """Finds the inputs of sources and brings their bytes. Make one with :meth:`open`.

    Nothing is opened or made on disk before it is needed.

    Parameters
    ----------
    stack : ExitStack
        Closes what is opened.
    limits : Limits
        How far archives are trusted.
    waiting : Waiting
        Ends what takes long.
    tell : Tell
        Takes the progress now and then.
    warn : callable
        Takes what the user should know though the run goes on.
    rehash : bool
        Read also the files whose hash is remembered.

    Attributes
    ----------
    limits : Limits
        As given.
    whole : set of int
        Ids of the inputs that would stand for the archives, rows of lists and searches that were
        found, could they not be used.
    """

    def __init__(
        self,
        stack: ExitStack,
        limits: Limits,
        waiting: Waiting,
        tell: Tell,
        warn: Callable[[str], None],
        rehash: bool,
    ) -> None:
        self._stack, self.limits, self._waiting = stack, limits, waiting
        self._tell, self._warn, self._rehash = tell, warn, rehash
        self._hasher: Hasher | None = None
        self._lock = RLock()
        self._ledger: Ledger | None = None
        self._downloads: Downloads | None = None
        self._onshape: Onshape | None = None
        self.whole: set[int] = set()

    @classmethod
    @contextmanager
    def open(
        cls,
        limits: Limits | None = None,
        tell: Tell = silent,
        stop: Callable[[], bool] | None = None,
        warn: Callable[[str], None] = lambda _text: None,
        *,
        rehash: bool = False,
    ) -> Iterator[Sources]:
        """Open what finds inputs; it is of use until the block ends.

        Parameters
        ----------
        limits : Limits, optional
            How far archives are trusted.
        tell : Tell, optional
            Takes the progress now and then.
        stop : callable, optional
            Asked often; once it returns True, what is under way ends by KeyboardInterrupt.
        warn : callable, optional
            Takes a line of what the user should know though the run goes on.
        rehash : bool
            Read also the files that look as they did when they were hashed by an earlier run.
        """
        waiting = Waiting(stop or (lambda: False))
        with ExitStack() as stack:
            yield cls(stack, limits or Limits(), waiting, tell, warn, rehash)

    def find(self, sources: Sequence[str | Path], collection: str | None = None) -> list[Input]:
        """List the inputs of `sources`, sorted by collection and name.

        Members of an archive keep the order of the archive. Every input whose bytes can be had
        has its hash.

        Parameters
        ----------
        sources : sequence of str or Path
            CAD files, folders, archives, lists (``.csv``, ``.parquet``) and ``onshape:`` queries.
        collection : str, optional
            Collection of all models; by default each source's own name.

        Raises
        ------
        UsageError
            If a source does not exist or is of no known kind, or two inputs would get the same
            collection and name.
        RefusedSourceError
            If an archive of metadata is not safe. Of others, archive and members are inputs that
            failed, and none of them is read.
        MissingExtraError
            If a source needs a package that is not installed.
        """
        plain: list[Path] = []
        archives: list[Path] = []
        inputs: list[Input] = []
        taken: Taken = {}
        for source in sources:
            path = Path(source)
            if is_onshape(str(source)):
                inputs += self._of_onshape(str(source), collection)
            elif path.is_dir() or not path.exists():
                plain.append(path)
            elif archive_format(path) is not None:
                archives.append(path)
            elif path.suffix.lower() in LISTS:
                inputs += self._of_list(path, collection, taken)
            else:
                plain.append(path)
        inputs += self._of_archives(_once(archives), collection)
        if plain:
            inputs += find_inputs(plain, collection, self._opened_hasher())
        return _merged(inputs)

    @contextmanager
    def fetcher(self, inputs: Iterable[Input], folder: Path) -> Iterator[Fetcher | None]:
        """Give what brings the bytes of `inputs`; None if all are in files of their own.

        Parameters
        ----------
        inputs : iterable of Input
            All that will be asked for.
        folder : Path
            For what is unpacked ahead; must not exist.
        """
        brought = [item for item in inputs if item.origin is not None]
        if not brought:
            yield None
            return
        ledger = self._opened_ledger()
        downloads = self._opened_downloads()
        with closing(Fetcher(brought, folder, ledger, downloads, self.limits)) as fetcher:
            yield fetcher

    def told(self, inputs: Iterable[Input]) -> Iterator[Input]:
        """Yield `inputs` with all facts of them, of use where this machine's ledger is not."""
        for item in inputs:
            known = None
            if isinstance(item.origin, MemberOrigin) and item.origin.facts:
                known = self._opened_ledger().get(FACTS, item.origin.facts)
            yield replace(item, facts=item.facts.over(Facts.of(known))) if known else item

    def _of_archives(self, paths: Sequence[Path], collection: str | None) -> Iterator[Input]:
        if not paths:
            return
        ledger = self._opened_ledger()
        beside = {path: meta_chunk(path) for path in paths if not is_meta_chunk(path)}
        given = {_number(path): path for path in paths if is_meta_chunk(path)}
        metadata = {path: given.get(_number(path)) or meta for path, meta in beside.items()}
        every = list(dict.fromkeys([*paths, *(path for path in metadata.values() if path)]))
        hasher, limits, waiting = self._opened_hasher(), self.limits, self._waiting

        def read(path: Path) -> Survey:
            return survey(path, ledger, limits, waiting, hasher)

        threads = len(os.sched_getaffinity(0))
        surveys = dict(
            zip(every, hasher.over(every, read, "reading archives", threads), strict=True)
        )
        for path, meta in metadata.items():
            if meta is not None:
                check_metadata(meta, surveys[meta])
            if surveys[path].damage is None:
                self.whole.add(archive_id(path, collection))
            yield from archive_inputs(
                path, surveys[path], collection, surveys[meta] if meta else None
            )

    def _of_list(self, path: Path, collection: str | None, taken: Taken) -> Iterator[Input]:
        rows: list[Row] = []
        for row in read_list(path):
            try:
                query = _query(row)
            except UsageError as error:
                rows.append(replace(row, problem=str(error)))
                continue
            if query is not None:
                group = row.values.get("collection") or collection
                yield from self._of_query(query, group, row)
            else:
                rows.append(row)
        yield from list_inputs(
            path,
            rows,
            collection,
            self._opened_downloads,
            self.whole,
            taken,
            self._opened_hasher(),
        )

    def _of_onshape(self, source: str, collection: str | None) -> list[Input]:
        return self._of_query(Query.parse(source), collection, None)

    def _of_query(self, query: Query, collection: str | None, row: Row | None) -> list[Input]:
        facts = row.facts if row else NO_FACTS
        onshape = self._opened_onshape()
        return onshape_inputs(query, onshape, collection, self.whole, facts, self._tell)

    def _opened_ledger(self) -> Ledger:
        with self._lock:
            if self._ledger is None:
                self._ledger = self._stack.enter_context(Ledger.open())
            return self._ledger

    def _opened_hasher(self) -> Hasher:
        if self._hasher is None:
            ledger = None
            try:
                ledger = self._opened_ledger()
            except UsageError as error:  # of the cache, which files that are here can do without
                self._warn(f"hashes of files are not remembered, because {error}")
            self._hasher = Hasher(
                ledger, self._waiting, self._tell, self._warn, rehash=self._rehash
            )
        return self._hasher

    def _opened_downloads(self) -> Downloads:
        def again(uri: str, into: Path) -> None:
            self._opened_onshape().fetch_again(uri, into)

        with self._lock:
            if self._downloads is None:
                more = {PREFIX.rstrip(":"): again}
                self._downloads = Downloads(self._opened_ledger(), self.limits, more, self._waiting)
                self._stack.callback(self._downloads.close)
            return self._downloads

    def _opened_onshape(self) -> Onshape:
        with self._lock:
            if self._onshape is None:
                keys, base = Keys.from_environment(), base_address()
                web = Web(wait=self._waiting.wait, check=self._waiting.check)
                self._stack.callback(web.close)
                self._onshape = Onshape(
                    OnshapeApi(web, keys, base),
                    self._opened_ledger(),
                    self._opened_downloads(),
                    self.limits,
                    self._waiting.wait,
                )
            return self._onshape


def _query(row: Row) -> Query | None:
    """Return what of Onshape a row asks for; None for other rows.

    Raises
    ------
    UsageError
        If the address is one of Onshape and no query.
    """
    base_address()  # should that be wrong, it is not the row's fault
    if row.problem is not None or not documents_in(row.address):
        return None
    return Query.parse(PREFIX + row.address.removeprefix(PREFIX))


def _once(paths: Iterable[Path]) -> list[Path]:
    """Return the files, without those given a second time."""
    return list({path.resolve(): path for path in reversed(list(paths))}.values())[::-1]


def _number(path: Path) -> str | None:
    chunk = chunk_of(path)
    return chunk[0] if chunk else None


def _merged(inputs: Iterable[Input]) -> list[Input]:
    found: dict[tuple[str, str], Input] = {}
    for item in inputs:
        twin = found.setdefault((item.collection, item.name), item)
        if twin is not item and not _same(twin, item):
            raise UsageError(
                f"{item.shown} and {twin.shown} would both be model {item.collection}/{item.name}; "
                "ingest one with another --collection"
            )
    return sorted(found.values(), key=_order)


def _same(a: Input, b: Input) -> bool:
    """Whether two inputs of one name are one file; what is shown of an address has no query."""
    return a.shown == b.shown and (a.origin == b.origin or None in (a.origin, b.origin))


def _order(item: Input) -> tuple[str, str, int, str]:
    """Return what inputs are sorted by: an archive is best read in its own order."""
    if isinstance(item.origin, MemberOrigin):
        return item.collection, str(item.origin.archive), item.origin.place, item.name
    return item.collection, "", 0, item.name
