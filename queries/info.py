"""What is in a lake: the numbers behind ``breplake info``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES, count_column

if TYPE_CHECKING:
    from breplake.queries.session import Lake

__all__ = ["LakeInfo", "describe"]


@dataclass(frozen=True, slots=True)
class LakeInfo:
    """Contents of a lake at one snapshot.

    Parameters
    ----------
    root, lake_id : str
        Where it is, and its id.
    snapshot, snapshots : int
        Number of the snapshot, and how many the lake has.
    tags : list of str
        Names of this snapshot.
    time, message : str
        Of the commit.
    tools : dict
        Versions of the tools that made the commit.
    models, failed, meshed : int
        Rows of ``models``, fatal rows of ``failures``, models with a mesh.
    collections : dict
        Models by collection.
    failures : dict
        Rows of ``failures`` by ``stage/kind``; of these, fatal ones are in `failed`.
    patches, curves : dict
        Numbers by type.
    meshes : dict
        Models by mesh kind.
    vertices, normals, triangles : int
        Mesh totals; a normal is a (vertex, patch) pair.
    bytes : dict
        Bytes on disk by table, arrays included.
    source_bytes : int
        Size of the source files of the models.
    """

    root: str
    lake_id: str
    snapshot: int
    snapshots: int
    tags: list[str]
    time: str
    message: str
    tools: dict[str, str]
    models: int
    failed: int
    meshed: int
    collections: dict[str, int]
    failures: dict[str, int]
    patches: dict[str, int]
    curves: dict[str, int]
    meshes: dict[str, int]
    vertices: int
    normals: int
    triangles: int
    bytes: dict[str, int]
    source_bytes: int

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, fit for JSON."""
        return asdict(self)


def describe(lake: Lake) -> LakeInfo:
    """Count what is in `lake`. Reads only columns of ``models`` and ``failures``."""
    patches = {t: count_column(t) for t in SURFACE_TYPES}
    curves = {t: count_column(t, curve=True) for t in CURVE_TYPES}
    totals = _totals(lake, [*patches.values(), *curves.values()])
    sizes: dict[str, int] = {}
    for entry in lake.snapshot.files:
        sizes[entry.table] = sizes.get(entry.table, 0) + entry.bytes
    failures = "SELECT stage || '/' || kind, count(*) FROM failures GROUP BY ALL ORDER BY 2 DESC, 1"
    return LakeInfo(
        root=lake.place,
        lake_id=lake.store.lake_id,
        snapshot=lake.snapshot.number,
        snapshots=len(lake.store.numbers()),
        tags=[tag for tag, number in lake.store.tags().items() if number == lake.snapshot.number],
        time=lake.snapshot.time,
        message=lake.snapshot.message,
        tools=dict(lake.snapshot.tools),
        models=totals["models"],
        failed=_counts(lake, "SELECT 'all', count(*) FROM failures WHERE fatal")["all"],
        meshed=totals["meshed"],
        collections=_counts(lake, "SELECT collection, count(*) FROM models GROUP BY 1 ORDER BY 1"),
        failures=_counts(lake, failures),
        patches={t: totals[column] for t, column in patches.items()},
        curves={t: totals[column] for t, column in curves.items()},
        meshes=_counts(
            lake,
            "SELECT mesh_kind, count(*) FROM models WHERE mesh_kind IS NOT NULL "
            "GROUP BY 1 ORDER BY 1",
        ),
        vertices=totals["n_vertices"],
        normals=totals["n_normals"],
        triangles=totals["n_faces"],
        bytes=sizes,
        source_bytes=totals["bytes"],
    )


def _totals(lake: Lake, columns: list[str]) -> dict[str, int]:
    """Return sums of count columns of ``models``, its rows and its rows with a mesh."""
    summed = [*columns, "n_vertices", "n_normals", "n_faces", "bytes"]
    sums = ", ".join(f"coalesce(sum({name}), 0)::BIGINT AS {name}" for name in summed)
    relation = lake.sql(f"SELECT count(*) AS models, count(n_faces) AS meshed, {sums} FROM models")
    (row,) = relation.fetchall()
    return dict(zip(relation.columns, row, strict=True))


def _counts(lake: Lake, query: str) -> dict[str, int]:
    return {str(name): int(count) for name, count in lake.sql(query).fetchall()}
