"""A model from original ABC files alone: OBJ and features, with stats and metadata."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from breplake.ingest.abc.facts import Stats, document_columns
from breplake.ingest.abc.features import Features, read_features
from breplake.ingest.abc.mesh import build_mesh
from breplake.ingest.abc.obj import Obj, read_obj
from breplake.ingest.abc.repair import Repairs
from breplake.ingest.abc.shape import Shape, shape
from breplake.ingest.abc.text import read_yaml
from breplake.ingest.abc.truth import Printed, orientation, refined, truth
from breplake.ingest.clock import StageClock
from breplake.ingest.mesh import Mesh
from breplake.ingest.rows import mesh_columns, mesh_tables, shape_columns
from breplake.ingest.truth import Truth
from breplake.schema.tables import COEDGES, CORNERS, CURVES, PARTS, PATCHES

__all__ = ["IMPORTED_MESH", "AbcFiles", "Imported", "import_model"]

IMPORTED_MESH: Final = "the mesh is that of the imported files"
"""``models.mesh_note`` of meshes that were not made here."""


@dataclass(slots=True)
class AbcFiles:
    """The files of one model, read.

    Parameters
    ----------
    features : Features
        Curves and patches.
    obj : Obj, optional
        The mesh; None where the STEP file stands in.
    stats : Stats
        Judged later; empty if there is no such file.
    document : dict
        Columns of ``models`` from the metadata.
    repairs : Counter
        What was wrong so far.
    """

    features: Features | None
    obj: Obj | None
    stats: Stats
    document: dict[str, Any]
    repairs: Repairs = field(default_factory=Repairs)

    @classmethod
    def read(cls, paths: Mapping[str, Path]) -> AbcFiles:
        """Read files by kind, as `breplake.schema.abc` calls them.

        Raises
        ------
        InputError
            ``bad-features`` or ``bad-mesh``.
        """
        repairs = Repairs()
        given = read_yaml(paths["stats"]) if "stats" in paths else {}
        return cls(
            features=read_features(read_yaml(paths["features"])) if "features" in paths else None,
            obj=read_obj(paths["trimesh"]) if "trimesh" in paths else None,
            stats=Stats(given if isinstance(given, Mapping) else {}, repairs),
            document=document_columns(read_yaml(paths["metadata"]) if "metadata" in paths else {}),
            repairs=repairs,
        )

    def columns(self) -> dict[str, Any]:
        """Return what they say of the model beyond its geometry, repairs included."""
        facts = list(self.document["metadata"])
        if "model" in self.stats.given:
            facts.append(("model", str(self.stats.given["model"])))
        done = [f"{code}:{times}" for code, times in sorted(self.repairs.items())]
        return self.document | {"metadata": facts, "import_repairs": done}


@dataclass(frozen=True, slots=True)
class Imported:
    """What becomes of the files of one model.

    Parameters
    ----------
    tables : dict
        All tables, by name.
    row : dict
        Columns of ``models`` that depend on the content.
    """

    tables: dict[str, pa.Table]
    row: dict[str, Any]


def import_model(model_id: int, paths: Mapping[str, Path], clock: StageClock) -> Imported:
    """Import a model.

    Parameters
    ----------
    model_id : int
        Its id.
    paths : mapping of str to Path
        Its files by kind: ``features`` and ``trimesh``, perhaps ``stats`` and ``metadata``.
    clock : StageClock
        Takes the time.

    Raises
    ------
    InputError
        ``bad-features``, ``bad-mesh`` or ``features-mismatch``.
    """
    with clock.stage("load"):
        files = AbcFiles.read(paths)
    features, obj = files.features, files.obj
    if features is None or obj is None:
        raise ValueError("features and trimesh are needed")  # inputs see to it
    geometry = features.geometry()
    with clock.stage("mesh"):
        mesh, normals = build_mesh(features, obj, geometry, files.repairs)
        mesh, positions = _positions(mesh, obj, features)
    with clock.stage("truth"):
        flipped = orientation(mesh, geometry, len(features.patches))
        printed = Printed.of(obj, normals)
        mesh, exact = truth(mesh, printed, geometry, flipped, files.repairs)
    with clock.stage("brep"):
        is_exact = obj.decimals is None
        rows = shape(features, mesh, geometry, exact, flipped, files.stats, is_exact=is_exact)
    return _imported(model_id, files, rows, mesh, exact, positions)


def _positions(mesh: Mesh, obj: Obj, features: Features) -> tuple[Mesh, str]:
    """Return the mesh with positions as exact as can be, and where they come from."""
    if obj.decimals is None:
        return mesh, "as in the OBJ"
    mesh, kept = refined(mesh, features.geometry(), obj.rounding)
    return mesh, (
        f"on the exact geometry where the {obj.decimals} decimals of the OBJ allow; "
        f"{kept} of {len(mesh.points)} as in the OBJ"
    )


def _imported(
    model_id: int, files: AbcFiles, rows: Shape, mesh: Mesh, exact: Truth, positions: str
) -> Imported:
    """Return tables and columns; what the stats state is taken where it can be true."""
    identity = {"model_id": model_id}
    tables = {
        table.name: table.from_rows(identity | row for row in found)
        for table, found in (
            (PARTS, rows.parts),
            (PATCHES, rows.patches),
            (CURVES, rows.curves),
            (COEDGES, rows.coedges),
            (CORNERS, rows.corners),
        )
    }
    tables |= mesh_tables(model_id, tables, mesh, exact)
    stats, of_mesh = files.stats, mesh_columns(mesh)
    bounds = stats.box(mesh.points, of_mesh["max_edge"])
    columns = shape_columns(rows.parts, rows.patches, rows.curves, len(rows.corners), bounds)
    columns |= {"area": rows.area, "volume": rows.volume}
    stats.compare(
        {
            "#verts": of_mesh["n_vertices"],
            "#faces": of_mesh["n_faces"],
            "#edges": columns["n_curves"],
            "#surfs": columns["n_patches"],
        }
    )
    of_mesh |= {
        "mesh_kind": stats.mesh_kind,
        "mesh_limit": stats.mesh_limit(of_mesh["max_edge"]),
        "mesh_note": IMPORTED_MESH,
    }
    told = files.columns()
    told["metadata"] = [*told["metadata"], ("positions", positions)]
    unknown = {
        "n_shells": sum(part["kind"] != "face" for part in rows.parts),
        "is_valid": False,  # Open CASCADE has no shapes to judge
        "n_added_pcurves": 0,
        "scale_to_mm": 1.0,
    }
    return Imported(tables, columns | unknown | of_mesh | told)
