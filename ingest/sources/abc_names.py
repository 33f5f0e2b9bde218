"""Names and metadata of the original ABC files.

The dataset comes in chunks: ``abc_0000_step_v00.7z`` holds
``00000050/00000050_80d90bfdd2e74e709956122a_step_000.step``, and ``abc_0000_meta_v00.7z`` holds
``00000050/00000050_80d90bfdd2e74e709956122a_metadata_000.yml``, the summary of the Onshape
document that the model is from.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any, Final

from breplake.errors import MissingExtraError
from breplake.ingest.sources.facts import Facts

__all__ = [
    "COLLECTION",
    "ONSHAPE_TERMS",
    "abc_facts",
    "abc_key",
    "chunk_of",
    "document_facts",
    "is_meta_chunk",
    "meta_chunk",
    "metadata_key",
]

COLLECTION: Final = "abc"
"""Collection of all chunks: a model's name holds its ABC number, unique across them."""

ONSHAPE_TERMS: Final = "LicenseRef-Onshape-ToU-1.g.ii"
"""Onshape's Terms of Use, 1(g)(ii): what holds for public documents of before `_TERMS_CHANGED`."""

_TERMS_CHANGED: Final = datetime(2018, 8, 7, tzinfo=UTC)
"""Since then the terms tell between plans and respect a tab named LICENSE, which no summary has."""

_DEEPEST: Final = 30
"""Collections in each other in the summary of a document, with room to spare."""

_CHUNK: Final = re.compile(r"abc_(\d{4})_([a-z0-9]+)_v(\d+)\.7z", re.IGNORECASE)
_STEP: Final = re.compile(r"(\d{8}_[0-9a-f]{24})_step_(\d{3})\.step")
_METADATA: Final = re.compile(r"(\d{8}_[0-9a-f]{24})_metadata_(\d{3})\.yml")

_KEPT: Final = {
    "name": "document",
    "description": "description",
    "tags": "tags",
    "createdAt": "created",
    "modifiedAt": "modified",
}
"""Keys of a summary that are kept if they say something, with their names in the metadata."""


def chunk_of(path: Path) -> tuple[str, str] | None:
    """Return number and kind of an ABC chunk, ``("0000", "step")`` say; None for other files."""
    match = _CHUNK.fullmatch(path.name)
    return (match[1], match[2].lower()) if match else None


def is_meta_chunk(path: Path) -> bool:
    """Whether a file is a chunk of metadata, which holds no models of its own."""
    chunk = chunk_of(path)
    return chunk is not None and chunk[1] == "meta"


def meta_chunk(path: Path) -> Path | None:
    """Return the chunk of metadata that lies beside a chunk of models, if there is one."""
    match = _CHUNK.fullmatch(path.name)
    if match is None:
        return None
    beside = path.with_name(f"abc_{match[1]}_meta_v{match[3]}.7z")
    return beside if beside.is_file() and beside != path else None


def abc_key(name: str) -> str | None:
    """Return ABC id and part of a model's file, ``00000050_80d9…_000``; None for other names."""
    match = _STEP.fullmatch(PurePosixPath(name).name)
    return f"{match[1]}_{match[2]}" if match else None


def metadata_key(name: str) -> str | None:
    """Return the same of a file of metadata."""
    match = _METADATA.fullmatch(PurePosixPath(name).name)
    return f"{match[1]}_{match[2]}" if match else None


def abc_facts(text: bytes) -> Facts:
    """Return what the metadata of an ABC model says.

    Parameters
    ----------
    text : bytes
        A file ``…_metadata_000.yml``: the summary of an Onshape document.

    Raises
    ------
    ValueError
        If it is no such summary.
    MissingExtraError
        If PyYAML is not installed.
    """
    try:
        import yaml  # type: ignore[import-untyped]
    except ImportError as error:
        raise MissingExtraError("ingest", "reading ABC metadata") from error
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        if _depth(yaml.parse(text, Loader=loader)) > _DEEPEST:
            raise ValueError("its YAML is nested too deeply")  # LibYAML would crash on it
        summary = yaml.load(text, Loader=loader)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"its YAML cannot be parsed: {error}") from error
    if not isinstance(summary, dict):
        raise ValueError("it is no summary of a document")
    return document_facts(summary)


def _depth(events: Iterable[Any]) -> int:
    """Return how deeply the collections of a YAML document nest, or one more than is allowed."""
    depth = deepest = 0
    for event in events:
        name = type(event).__name__
        depth += name.endswith("StartEvent") - name.endswith("EndEvent")
        deepest = max(deepest, depth)
        if deepest > _DEEPEST:
            break
    return deepest


def document_facts(summary: Mapping[str, Any]) -> Facts:
    """Return what the summary of an Onshape document says, as its API gives it."""
    owner = summary.get("owner")
    return Facts(
        licence=_licence(summary),
        owner=_text(owner.get("name") if isinstance(owner, Mapping) else owner),
        source_url=_page(summary),
        metadata=tuple(
            (name, text) for key, name in _KEPT.items() if (text := _text(summary.get(key)))
        ),
    )


def _page(summary: Mapping[str, Any]) -> str | None:
    """Return the address of the document's page: the summary has that of the API."""
    address, identity = summary.get("href"), summary.get("id")
    if isinstance(address, str):
        return re.sub(r"/api(/v\d+)?/documents/(d/)?", "/documents/", address)
    return f"https://cad.onshape.com/documents/{identity}" if identity else None


def _licence(summary: Mapping[str, Any]) -> str | None:
    """Return the licence that is stated, or the terms that public documents of then are under."""
    stated = _text(summary.get("license", summary.get("licence")))
    if stated is not None:
        return stated
    if summary.get("public") is not True:
        return None
    try:
        created = datetime.fromisoformat(str(summary.get("createdAt")))
    except ValueError:
        return None
    if created.tzinfo is None:
        created = created.replace(tzinfo=UTC)
    return ONSHAPE_TERMS if created < _TERMS_CHANGED else None


def _text(value: Any) -> str | None:
    """Return a value or a list of values as text; None if it says nothing."""
    if isinstance(value, list):  # of plain values: YAML can nest a gigabyte in a few lines
        value = ", ".join(
            text
            for item in value
            if not isinstance(item, list | dict | set) and (text := _text(item))
        )
    elif isinstance(value, dict | set | tuple):
        return None
    return str(value) if value not in (None, "") else None
