"""What Open CASCADE says at single points of surfaces: slow, and the measure of all else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from breplake.ingest.canonical import canonical, shape_list
from breplake.ingest.geometry import surface_row, untrimmed
from breplake.ingest.load import load
from breplake.schema.jets import SurfacePoints
from breplake.schema.namespace import Bools, Floats, Ints
from breplake.schema.tables import PATCHES

__all__ = ["adaptor_points", "faces_of", "geometry_points", "outside", "patch_geometry"]

_RESOLUTION: Final = 1e-12  # mm; derivatives shorter than this have no direction
_COLUMNS: Final = pa.schema([field.with_nullable(True) for field in PATCHES.schema])


def faces_of(path: Path, format: str) -> list[Any]:
    """Return the faces of a CAD file, in the order of its patches.

    Parameters
    ----------
    path : Path
        The file.
    format : {"step", "iges", "brep"}
        How to read it.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    from OCP.TopoDS import TopoDS

    return shape_list(canonical(load(path, format).shapes).faces, TopoDS.Face_s)


def patch_geometry(faces: list[Any]) -> tuple[list[Any], pa.Table]:
    """Return each face's surface, and its row of ``patches`` as far as geometry goes.

    Returns
    -------
    surfaces : list
        ``Geom_Surface``, location applied.
    table : pyarrow.Table
        Geometry and parameter bounds; all else is null.
    """
    from OCP.BRep import BRep_Tool
    from OCP.BRepTools import BRepTools

    surfaces = [untrimmed(BRep_Tool.Surface_s(face)) for face in faces]
    rows = []
    for face, surface in zip(faces, surfaces, strict=True):
        bounds = zip(("u_min", "u_max", "v_min", "v_max"), BRepTools.UVBounds_s(face), strict=True)
        rows.append(surface_row(surface) | dict(bounds))
    return surfaces, pa.Table.from_pylist(rows, _COLUMNS)


def adaptor_points(face: Any, u: Floats, v: Floats) -> SurfacePoints:
    """Evaluate a face point by point, as scripts on OCP do: ``BRepLProp_SLProps``.

    Parameters
    ----------
    face : TopoDS_Face
    u, v : numpy.ndarray
        ``(n,)`` parameters.

    Returns
    -------
    SurfacePoints
        The normal is that of du x dv, whatever the orientation of the face.
    """
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepLProp import BRepLProp_SLProps

    properties = BRepLProp_SLProps(BRepAdaptor_Surface(face), 2, _RESOLUTION)
    return _evaluated(properties, u, v)


def geometry_points(surface: Any, u: Floats, v: Floats) -> SurfacePoints:
    """Evaluate a ``Geom_Surface`` point by point by ``GeomLProp_SLProps``; NaN if undefined."""
    from OCP.GeomLProp import GeomLProp_SLProps

    return _evaluated(GeomLProp_SLProps(surface, 2, _RESOLUTION), u, v)


def outside(faces: list[Any], patch: Ints, u: Floats, v: Floats, tolerance: float = 1e-9) -> Bools:
    """Tell which points are outside their faces, by ``BRepClass_FaceClassifier``.

    Parameters
    ----------
    faces : list of TopoDS_Face
        As of `faces_of`.
    patch : numpy.ndarray
        ``(n,)`` number of the face of each point.
    u, v : numpy.ndarray
        ``(n,)`` parameters.
    tolerance : float
        Distance in the parameter plane up to which a point is on the border.

    Returns
    -------
    numpy.ndarray
        ``(n,)`` bool.
    """
    from OCP.BRepClass import BRepClass_FaceClassifier
    from OCP.gp import gp_Pnt2d
    from OCP.TopAbs import TopAbs_Orientation, TopAbs_State
    from OCP.TopoDS import TopoDS

    # What is inside does not depend on the orientation, but the classifier believes that it does.
    plain = [TopoDS.Face_s(face.Oriented(TopAbs_Orientation.TopAbs_FORWARD)) for face in faces]
    classifier = BRepClass_FaceClassifier()
    found = np.zeros(len(patch), dtype=bool)
    for i, (row, a, b) in enumerate(zip(patch.tolist(), u.tolist(), v.tolist(), strict=True)):
        classifier.Perform(plain[row], gp_Pnt2d(a, b), tolerance)
        found[i] = classifier.State() == TopAbs_State.TopAbs_OUT
    return found


def _evaluated(properties: Any, u: Floats, v: Floats) -> SurfacePoints:
    """Ask for value, normal and curvatures at every point."""
    out = np.full((len(u), 8), np.nan)
    set_parameters: Callable[[float, float], None] = properties.SetParameters
    for i, (a, b) in enumerate(zip(u.tolist(), v.tolist(), strict=True)):
        set_parameters(a, b)
        point = properties.Value()
        out[i, 0:3] = point.X(), point.Y(), point.Z()
        if not properties.IsNormalDefined():
            continue
        normal = properties.Normal()
        out[i, 3:6] = normal.X(), normal.Y(), normal.Z()
        if properties.IsCurvatureDefined():
            out[i, 6:8] = properties.MinCurvature(), properties.MaxCurvature()
    return SurfacePoints(out[:, 0:3], out[:, 3:6], out[:, 6], out[:, 7])
