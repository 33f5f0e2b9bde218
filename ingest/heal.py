"""The one repair we make: pcurves that a file lacks.

OCCT's reader computes the curves in parameter space that most files leave out, but gives up
on the whole shape when one surface is faulty. Faces without them cannot be trimmed or meshed.
Nothing that a file states is changed.
"""

from __future__ import annotations

from typing import Any

from breplake.ingest.canonical import explore
from breplake.ingest.clock import KERNEL

__all__ = ["add_missing_pcurves"]


def add_missing_pcurves(compound: Any) -> int:
    """Compute, in place, the pcurves that are missing in `compound`.

    Returns
    -------
    int
        Number of pcurves that were added.
    """
    from OCP.BRep import BRep_Tool
    from OCP.ShapeFix import ShapeFix_Edge
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopoDS import TopoDS

    fixer, added = ShapeFix_Edge(), 0
    with KERNEL():
        for shape in explore(compound, TopAbs_ShapeEnum.TopAbs_FACE):
            face = TopoDS.Face_s(shape)
            if BRep_Tool.Surface_s(face) is None:
                continue
            for found in explore(face, TopAbs_ShapeEnum.TopAbs_EDGE):
                edge = TopoDS.Edge_s(found)
                if BRep_Tool.CurveOnSurface_s(edge, face, 0.0, 0.0) is None:
                    added += bool(fixer.FixAddPCurve(edge, face, False))
    return added
