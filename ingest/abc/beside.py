"""Original ABC files beside the STEP file from which they were made.

The STEP file is the exact source of the B-Rep. Features that are the same curves and patches,
one for one, are checked against it; with an OBJ, its mesh becomes that of the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from breplake.errors import InputError
from breplake.ingest.abc.features import Features
from breplake.ingest.abc.geometry import ExactGeometry
from breplake.ingest.abc.mesh import build_mesh
from breplake.ingest.abc.model import AbcFiles
from breplake.ingest.abc.repair import (
    Listed,
    Repairs,
    changed_parameters,
    is_same,
    listed,
    ranged,
    scaled,
)
from breplake.ingest.abc.truth import refined
from breplake.ingest.failure import advise
from breplake.ingest.mesh import Mesh

__all__ = ["Beside"]

Row = dict[str, Any]
_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

_SAME: Final = 1e-6
"""Share of a model's size by which parameters of the two files may differ."""

_LENGTHS: Final = ("radius", "min_radius", "max_radius", "x_radius", "y_radius")
_POINTS: Final = ("location", "apex", "focus1", "focus2")


class Beside:
    """The ABC files of a STEP file.

    Parameters
    ----------
    paths : mapping of str to Path
        Files by kind: ``features``, ``trimesh``, ``stats``, ``metadata``; any may be missing.

    Raises
    ------
    InputError
        ``bad-features`` or ``bad-mesh``; ``no-features`` for an OBJ without them.
    """

    def __init__(self, paths: Mapping[str, Path]) -> None:
        if "trimesh" in paths and "features" not in paths:
            raise InputError("no-features", advise("no-features", paths["trimesh"].name))
        self.files = AbcFiles.read(paths)
        self.facts: list[tuple[str, str]] = []
        self.geometry: ExactGeometry | None = None

    @property
    def has_mesh(self) -> bool:
        """Whether there is an OBJ whose features were found to be the model's."""
        return self.files.obj is not None and self.geometry is not None

    def verify(self, tables: Mapping[str, pa.Table], model: Row) -> None:
        """Compare the files with the exact rows, and repair what they say of the mesh.

        Parameters
        ----------
        tables : mapping
            ``curves`` and ``patches`` of the STEP file.
        model : dict
            Columns of ``models``.

        Raises
        ------
        InputError
            ``features-mismatch`` if they are not of this model.
        """
        stats, features = self.files.stats, self.files.features
        stats.mass("surface", model["area"])
        if model["volume"] is not None:
            stats.mass("volume", model["volume"])
        corners = [[model[key][axis] for axis in "xyz"] for key in ("bbox_min", "bbox_max")]
        stats.box(np.array(corners), 1e-3 * float(model["diagonal"]))
        stats.compare({"#edges": model["n_curves"], "#surfs": model["n_patches"]})
        if features is None:
            return
        diagonal = float(model["diagonal"])
        for what, given, table in (
            ("curve", features.curves, tables["curves"]),
            ("surface", features.patches, tables["patches"]),
        ):
            _compare(what, given, table.to_pylist(), diagonal)
        geometry = ExactGeometry.of(tables["curves"], tables["patches"])
        if self.files.obj is None:
            _check_parameters(features, geometry, tables, diagonal, self.files.repairs)
        self.geometry = geometry
        text = f"{len(features.patches)} surfaces and {len(features.curves)} curves agree"
        self.facts.append(("features", text))

    def mesh(self, curves: pa.Table) -> Mesh:
        """Return the mesh of the OBJ on the model's own curves, patches and corners.

        Parameters
        ----------
        curves : pyarrow.Table
            Rows of ``curves`` of the STEP file.

        Raises
        ------
        InputError
            ``features-mismatch`` if the OBJ is not of this model.
        """
        features, obj, geometry = self.files.features, self.files.obj, self.geometry
        if features is None or obj is None or geometry is None:
            raise ValueError("there is no mesh: ask has_mesh")
        mesh, _ = build_mesh(features, obj, geometry, self.files.repairs)
        corner = np.full(len(mesh.points), -1, dtype=np.int64)
        for row in curves.select(["curve_id", "start_corner", "end_corner"]).to_pylist():
            nodes = mesh.curves.get(row["curve_id"])
            for end, name in ((0, "start_corner"), (-1, "end_corner")):
                if nodes is not None and row[name] is not None:
                    corner[nodes.vertices[end]] = row[name]
        mesh = replace(mesh, corner=corner)
        kept = 0
        if obj.decimals is not None:
            mesh, kept = refined(mesh, geometry, obj.rounding)
        self.facts.append(("positions", f"mesh of the OBJ; {kept} vertices as printed"))
        return mesh

    def columns(self) -> Row:
        """Return columns of ``models``: what the files state, and repairs."""
        told = self.files.columns()
        return told | {"metadata": [*told["metadata"], *self.facts]}


def _mismatch(detail: str) -> InputError:
    return InputError("features-mismatch", advise("features-mismatch", detail))


def _compare(what: str, given: Sequence[Row], exact: Sequence[Row], diagonal: float) -> None:
    """Compare types, places and lengths of the features with the exact rows, one for one."""
    if len(given) != len(exact):
        raise _mismatch(f"they have {len(given)} {what}s, the STEP file has {len(exact)}")
    for number, (one, two) in enumerate(zip(given, exact, strict=True)):
        kinds = one["type"], two["type"]
        if kinds[0] != kinds[1] and not (kinds[0] == "Other" and "location" not in one):
            raise _mismatch(f"{what} {number} is a {kinds[0]}, in the STEP file a {kinds[1]}")
        for key in (*_POINTS, *_LENGTHS):
            a, b = _numbers(one.get(key)), _numbers(two.get(key))
            if a is None or b is None:
                continue
            slack = _SAME * (diagonal + float(np.abs(b).max()))
            if not (np.abs(a - b) <= slack).all():
                raise _mismatch(f"{key} of {what} {number} is {a}, in the STEP file {b}")


def _numbers(value: Any) -> _Floats | None:
    if value is None:
        return None
    return np.array([value[axis] for axis in "xyz"] if isinstance(value, dict) else [value])


def _check_parameters(
    features: Features,
    geometry: ExactGeometry,
    tables: Mapping[str, pa.Table],
    diagonal: float,
    repairs: Repairs,
) -> None:
    """Check without a mesh that curves and patches put their common vertices at one place.

    Parameters of curves lie in the range of the curve, which tells their scale; the vertices
    that they place tell that of the patches.
    """
    on_curves, on_patches = listed(features.on_curves), listed(features.on_patches)
    low, high = (tables["curves"].column(name).to_numpy() for name in ("t_min", "t_max"))
    t = ranged(on_curves, low, high)
    repairs.update(changed_parameters("curve-parameters", t, on_curves.parameter))
    count = int(max(part.vertex.max(initial=-1) for part in (on_curves, on_patches))) + 1
    points = np.full((count, 3), np.nan)
    placed = on_curves.vertex >= 0
    points[on_curves.vertex[placed]] = geometry.curves.evaluate(
        on_curves.owner[placed], t[placed, 0]
    ).point
    there = (on_patches.vertex >= 0) & np.isfinite(points[on_patches.vertex]).all(axis=1)
    common = np.where(there, on_patches.vertex, -1)

    def evaluate(owner: _Ints, uv: _Floats) -> _Floats:
        return np.asarray(geometry.surfaces.evaluate(owner, uv[:, 0], uv[:, 1]).point)

    uv, _, error = scaled(on_patches, common, points, diagonal, evaluate)
    repairs.update(changed_parameters("patch-parameters", uv, on_patches.parameter))
    known = (common >= 0) & np.asarray(geometry.surfaces.known)[on_patches.owner]
    astray = np.flatnonzero(known & ~is_same(error, diagonal))
    if len(astray):
        first = astray[0]
        raise _mismatch(
            f"vertex {on_patches.vertex[first]} lies {error[first]:.3g} mm off surface "
            f"{on_patches.owner[first]}"
        )
    _count_from_zero(features, on_patches, repairs)


def _count_from_zero(features: Features, on_patches: Listed, repairs: Repairs) -> None:
    """Take up lists that count from 1: the least number is 1, and none is left out."""
    faces = np.concatenate([entry.faces for entry in features.on_patches])
    for code, used in (
        ("one-based-vertices", on_patches.vertex),
        ("one-based-faces", faces),
    ):
        distinct = np.unique(used)
        if len(distinct) and distinct[0] == 1 and distinct[-1] == len(distinct):
            repairs[code] += len(used)
