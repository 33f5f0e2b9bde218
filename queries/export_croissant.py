"""A snapshot as a dataset in MLCommons Croissant 1.0: files with hashes, tables with columns.

See https://docs.mlcommons.org/croissant/docs/croissant-spec.html.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa

from breplake.errors import UsageError
from breplake.schema.contract import Table
from breplake.schema.snapshot import ARRAYS_TABLE
from breplake.schema.tables import TABLES

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["croissant", "write_croissant"]

_PARQUET: Final = "application/x-parquet"

_OWN_TERMS: Final = (
    *("citeAs", "column", "extract", "field", "fileProperty", "fileObject", "fileSet", "format"),
    *("includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet"),
    *("references", "regex", "repeated", "replace", "samplingRate", "separator", "source"),
    *("subField", "transform"),
)

_CONTEXT: Final[dict[str, Any]] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "equivalentProperty": "cr:equivalentProperty",
    **{term: f"cr:{term}" for term in _OWN_TERMS},
}


def write_croissant(lake: Lake, path: str | Path, url: str | None = None) -> Path:
    """Write the description of a snapshot to a file.

    Parameters
    ----------
    lake : Lake
        A lake at a snapshot.
    path : path
        The file, replaced if it is there. Without `url` it must be in the lake's folder or in one
        above it, and names the lake's files relative to its own folder.
    url : str, optional
        Where the lake is published.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    UsageError
        If the lake's files cannot be named relative to the file.
    """
    path = Path(path)
    folder = path.resolve().parent
    if url is None and not lake.root.is_relative_to(folder):
        raise UsageError(
            f"Croissant names files below its own folder, and {path} is not above {lake.root}: "
            f"write to {lake.root / 'croissant.json'}, or say where the lake is published (--url)"
        )
    base = url or lake.root.relative_to(folder).as_posix()
    path.write_text(json.dumps(croissant(lake, base), indent=1, ensure_ascii=False) + "\n")
    return path


def croissant(lake: Lake, base: str) -> dict[str, Any]:
    """Return the description of a snapshot.

    Parameters
    ----------
    lake : Lake
        A lake at a snapshot.
    base : str
        Place of the lake, a URL or relative to where the description will be.
    """
    info = lake.info()
    tables = [table for table in TABLES.values() if lake.snapshot.table_files(table.name)]
    licences = lake.sql("SELECT DISTINCT licence FROM models WHERE licence IS NOT NULL ORDER BY 1")
    patches, curves = sum(info.patches.values()), sum(info.curves.values())
    document = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": f"breplake-{info.lake_id[:8]}",
        "description": (
            f"{info.models:,} CAD models ({', '.join(info.collections)}) as boundary "
            f"representations: {patches:,} surface patches and {curves:,} curves with their exact "
            f"geometry; {info.meshed:,} meshes with {info.vertices:,} vertices and "
            f"{info.triangles:,} triangles. Lengths are millimetres, angles radians. Snapshot "
            f"{info.snapshot} of lake {info.lake_id}, made by breplake."
        ),
        "version": f"{info.snapshot}.0.0",
        "datePublished": info.time,
        "keywords": ["CAD", "B-Rep", "boundary representation", "geometric deep learning"],
        "distribution": _files(lake, tables, base),
        "recordSet": [_record_set(table) for table in tables],
    }
    if found := [row[0] for row in licences.fetchall()]:
        document["license"] = found
    if "://" in base:
        document["url"] = base
    return document


def _files(lake: Lake, tables: list[Table], base: str) -> list[dict[str, Any]]:
    """Return every Parquet file with its hash, the set of each table, and the arrays' folders."""
    found: list[dict[str, Any]] = []
    for table in tables:
        entries = lake.snapshot.table_files(table.name)
        found += [
            {
                "@type": "cr:FileObject",
                "@id": entry.path,
                "name": entry.path,
                "contentUrl": _joined(base, entry.path),
                "contentSize": f"{entry.bytes} B",
                "encodingFormat": _PARQUET,
                "sha256": entry.sha256,
            }
            for entry in entries
        ]
        members: dict[str, Any] = {"includes": [_joined(base, entry.path) for entry in entries]}
        if "://" in base:  # globs are for folders; elsewhere a set is made of its files
            contained = [{"@id": entry.path} for entry in entries]
            members = {"includes": "*.parquet", "containedIn": contained}
        found.append(
            {
                "@type": "cr:FileSet",
                "@id": _set_id(table),
                "name": _set_id(table),
                "description": f"files of the table {table.name}",
                "encodingFormat": _PARQUET,
            }
            | members
        )
    if folders := lake.snapshot.table_files(ARRAYS_TABLE):
        found.append(
            {
                "@type": "cr:FileSet",
                "@id": "arrays",
                "name": "arrays",
                "description": (
                    "Zarr v3 groups with the meshes of each shard; rows of a model start at the "
                    "offsets in models. The files of a group and their SHA-256 are listed beside "
                    "it, in <shard>.zarr.sha256."
                ),
                "encodingFormat": "application/vnd.zarr",
                "includes": [_joined(base, f"{entry.path}/**") for entry in folders],
            }
        )
    return found


def _joined(base: str, path: str) -> str:
    return path if base in ("", ".") else f"{base.rstrip('/')}/{path}"


def _set_id(table: Table) -> str:
    return f"{table.name}-files"


def _record_set(table: Table) -> dict[str, Any]:
    fields = []
    nested = []
    for column in table.columns:
        if not _is_expressible(column.type):
            nested.append(column.name)
            continue
        text = f"{column.description} [{column.unit}]" if column.unit else column.description
        fields.append(_field(table, column.name, [], column.type) | {"description": text})
    left_out = f"; only in the files, for they are nested: {', '.join(nested)}" if nested else ""
    return {
        "@type": "cr:RecordSet",
        "@id": table.name,
        "name": table.name,
        "description": f"a row is {table.row}{left_out}",
        "key": [{"@id": f"{table.name}/{name}"} for name in table.key],
        "field": fields,
    }


def _is_expressible(kind: pa.DataType, *, in_list: bool = False) -> bool:
    """Return whether Croissant has words for a type: no list within a list or a structure."""
    if pa.types.is_struct(kind):
        return all(_is_expressible(field.type, in_list=True) for field in kind)
    if pa.types.is_list(kind):
        return not in_list and _is_expressible(kind.value_type, in_list=True)
    return True


def _field(table: Table, column: str, inner: list[str], kind: pa.DataType) -> dict[str, Any]:
    """Describe a column, or the member of a structure that the path `inner` leads to."""
    names = [column, *inner]
    field: dict[str, Any] = {
        "@type": "cr:Field",
        "@id": "/".join([table.name, *names]),
        "name": "/".join(names),
    }
    if pa.types.is_list(kind):
        field["repeated"] = True
        kind = kind.value_type
    if pa.types.is_struct(kind):
        field["subField"] = [_field(table, column, [*inner, f.name], f.type) for f in kind]
        return field
    source: dict[str, Any] = {"fileSet": {"@id": _set_id(table)}, "extract": {"column": column}}
    if inner:
        source["transform"] = {"jsonPath": ".".join(["$", *inner])}
    return field | {"dataType": _data_type(kind), "source": source}


def _data_type(kind: pa.DataType) -> str:
    if pa.types.is_integer(kind):
        return "sc:Integer"
    if pa.types.is_floating(kind):
        return "sc:Float"
    return "sc:Boolean" if pa.types.is_boolean(kind) else "sc:Text"
