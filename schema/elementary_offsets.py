"""Offsets of elementary surfaces that are elementary surfaces themselves."""

from __future__ import annotations

from typing import Final

import numpy as np

from breplake.schema.namespace import Bools, Floats, Ints, cross, dot
from breplake.schema.types import SURFACE_TYPES

__all__ = ["moved_elementary"]

_PLANE, _CYLINDER, _CONE, _SPHERE, _TORUS = (
    SURFACE_TYPES.index(name) for name in ("Plane", "Cylinder", "Cone", "Sphere", "Torus")
)
_VANISHED: Final = 1e-7  # mm; a radius that small has no offset of its own in OCCT either


def moved_elementary(kind: Ints, axes: Floats, size: Floats, offset: Floats) -> Bools:
    """Offset elementary surfaces in place, as OCCT's ``Geom_OffsetSurface::Surface`` does.

    That is how OCCT evaluates them, so that it also decides what lies beyond the apex of a
    cone or, where a cylinder or sphere is moved past its axis, how it is parametrised.

    Parameters
    ----------
    kind : numpy.ndarray
        ``(n_rows,)`` place of the type in ``SURFACE_TYPES``.
    axes, size : numpy.ndarray
        ``(12, n_rows)`` and ``(3, n_rows)`` as of ``SurfaceParameters``; they are changed.
    offset : numpy.ndarray
        ``(n_rows,)`` distance along du x dv; zero or NaN where there is none.

    Returns
    -------
    numpy.ndarray
        ``(n_rows,)`` bool: which rows are now the offset.
    """
    x, y, z = axes[3:6], axes[6:9], axes[9:12]
    out = np.where(dot(cross(x, y), z) < 0, -offset, offset)  # away from the axis
    plane, cylinder, cone, sphere, torus = (
        kind == place for place in (_PLANE, _CYLINDER, _CONE, _SPHERE, _TORUS)
    )
    round_ = cylinder | sphere
    growth = np.select([round_, cone], [out, out * size[2]], 0.0)
    radius, tube = size[0] + growth, size[1] + np.where(torus, out, 0.0)
    fits = plane | (round_ & (np.abs(radius) > _VANISHED)) | (cone & (radius >= 0))
    fits = (fits | (torus & (tube > _VANISHED))) & (offset != 0) & np.isfinite(offset)
    size[0, fits], size[1, fits] = np.abs(radius[fits]), tube[fits]
    along = np.select([plane, cone], [out, -out * size[1]], 0.0)
    axes[0:3, fits] += (along * z)[:, fits]
    past = fits & round_ & (radius < 0)
    axes[3:6, past] *= -1
    axes[9:12, past & sphere] *= -1
    return np.asarray(fits)
