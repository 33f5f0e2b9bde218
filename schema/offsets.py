"""Curves and surfaces at a distance from others.

Every derivative of an offset needs one more of its basis. The rules are those of OCCT's
``Geom2d_OffsetCurve``, ``Geom_OffsetCurve`` and ``Geom_OffsetSurface``. Where the basis has
no normal, an offset is not defined, and NaN.
"""

from __future__ import annotations

from breplake.schema.namespace import Array, cross, namespace
from breplake.schema.series import Series, indices, multiply, unit

__all__ = ["offset_curve", "offset_surface"]


def offset_curve(jet: list[Array], distance: Array, direction: Array | None) -> list[Array]:
    """Move curves sideways: along p' x direction in space, to the right of p' in a plane.

    Parameters
    ----------
    jet : list of array
        Point and derivatives of the basis, each ``(dim, n)``.
    distance : array
        ``(n,)`` how far.
    direction : array or None
        ``(3, n)`` reference direction; None in a plane.

    Returns
    -------
    list of array
        Point and all derivatives but the last.
    """
    xp = namespace(distance)
    sideways: Series = {}
    for k, part in enumerate(jet[1:]):
        right = xp.stack((part[1], -part[0])) if direction is None else cross(part, direction)
        sideways[(k,)] = right
    normal = unit(sideways, len(jet) - 2).values()
    return [part + distance * n for part, n in zip(jet[:-1], normal, strict=True)]


def offset_surface(jet: list[Array], distance: Array, order: int) -> list[Array]:
    """Move surfaces along their unit normals du x dv.

    Parameters
    ----------
    jet : list of array
        The basis as ``indices(2, order + 1)``, each ``(3, n)``.
    distance : array
        ``(n,)`` how far.
    order : int
        Derivatives wanted.
    """
    basis = dict(zip(indices(2, order + 1), jet, strict=True))
    du: Series = {(i - 1, j): part for (i, j), part in basis.items() if i}
    dv: Series = {(i, j - 1): part for (i, j), part in basis.items() if j}
    normal = unit(multiply(du, dv, cross, order), order)
    return [basis[index] + distance * part for index, part in normal.items()]
