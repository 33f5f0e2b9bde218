"""Surfaces of the table ``patches``, evaluated without a CAD kernel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from breplake.errors import UsageError
from breplake.schema.curves import CurveSet
from breplake.schema.elementary import ELEMENTARY, extruded, revolved, sphere_curvature
from breplake.schema.grouping import grouped, query, selected
from breplake.schema.jets import SurfaceJet, SurfacePoints, times_known
from breplake.schema.namespace import Array, Floats, Ints, gather, namespace, vanishing
from breplake.schema.offsets import offset_surface
from breplake.schema.parameters import with_parameters
from breplake.schema.projection import project_points
from breplake.schema.splines import SplineSurfaces
from breplake.schema.surface_parameters import SurfaceKind, SurfaceParameters
from breplake.schema.surface_points import surface_points
from breplake.schema.transfer import transferred

__all__ = ["SurfaceKind", "SurfaceSet"]

_BATCH: Final = 16_384  # points times poles and one more, whose temporaries stay in the cache
_BATCH_OF_CLOSED: Final = 16_384  # the same for elementary surfaces, which need few


@dataclass(frozen=True, slots=True)
class SurfaceSet:
    """Surfaces of a table, ready to be evaluated at many points of many rows at once.

    Build one with :meth:`from_patches`. Normals are those of du x dv: the caller applies
    the column ``reversed``.

    Attributes
    ----------
    known : array
        ``(n_rows,)`` bool: the row has a type that can be evaluated, with its parameters.
    least : array
        ``(2, n_rows)`` lengths of du and dv at and below which rounding decides them.
    kinds : tuple of SurfaceKind
        All kinds of surfaces of the table.
    group : array
        ``(n_rows,)`` place in `kinds`; negative if unknown.
    axes, size, side, curves, splines, offset
        Parameters of the surfaces.
    """

    known: Array
    least: Array
    kinds: tuple[SurfaceKind, ...]
    group: Array
    axes: Array  # (12, n_rows) location, x, y and z axis
    size: Array  # (3, n_rows)
    side: Array  # (n_rows,) 1 for right-handed axes, -1 for left-handed ones
    curves: CurveSet
    splines: SplineSurfaces
    offset: Array  # (n_rows,) mm along du x dv

    @staticmethod
    def from_patches(table: pa.Table) -> SurfaceSet:
        """Read the columns of ``patches`` that describe geometry.

        Columns that are missing count as null; ids, areas and the like are not needed.

        Raises
        ------
        UsageError
            If the table has no column ``type``.
        """
        read = SurfaceParameters.read(table)
        known = read.complete
        kinds, group = read.kinds(known)
        return SurfaceSet(
            known=known,
            least=np.where(known, read.least, 0.0),
            kinds=kinds,
            group=group,
            axes=read.axes,
            size=read.size,
            side=np.where(read.mirrored, -1.0, 1.0),
            curves=read.curves,
            splines=read.splines,
            offset=read.offset,
        )

    def to(self, like: Any = None, *, device: Any = None, dtype: Any = None) -> SurfaceSet:
        """Return these surfaces as tensors of torch.

        They are then evaluated by torch, on the device where they are, and results are
        differentiable by u and v. float32 halves memory and time; see ``docs/evaluate.md``
        for what it costs in accuracy.

        Parameters
        ----------
        like : torch.Tensor, optional
            Its device and type count where the others are not given.
        device : torch.device or str, optional
            By default the device of the arrays: the CPU if they are numpy's.
        dtype : torch.dtype, optional
            ``torch.float64`` or ``torch.float32``; by default that of the arrays.

        Examples
        --------
        >>> import torch
        >>> gpu = surfaces.to(device="cuda", dtype=torch.float32)  # doctest: +SKIP
        >>> gpu.points(row, u, v).normal  # doctest: +SKIP
        """
        moved = transferred(self, like, device=device, dtype=dtype)
        return replace(moved, least=moved.least * (vanishing(moved.least) / vanishing(self.least)))

    def parameters(self) -> dict[str, Array]:
        """Return what the surfaces are made of, as `with_parameters` takes it.

        Returns
        -------
        dict
            ``axes`` ``(12, n_rows)`` location, x, y and z axis, of an extrusion its direction
            last; ``size`` ``(3, n_rows)`` radius, or radius, sine and cosine of the half angle
            of a cone, or major and minor radius of a torus; ``offset`` ``(n_rows,)``;
            ``poles`` ``(3, n_poles)`` and ``weights`` ``(n_poles,)`` of all splines, end to
            end, v running fastest: those of row r are where ``splines.poles.owner`` is r.
            Those of the curves that are swept are called ``curve_frame`` and so on; see
            ``CurveSet.parameters``. Lengths are in mm.
        """
        poles = self.splines.poles
        own = {name: getattr(self, name) for name in ("axes", "size", "offset")}
        swept = {f"curve_{name}": part for name, part in self.curves.parameters().items()}
        return {**own, "poles": poles.points, "weights": poles.buffer[-1], **swept}

    def with_parameters(self, **changed: Array) -> SurfaceSet:
        """Return the same surfaces with other parameters.

        What is evaluated is differentiable by tensors given here: so poles, radii and places
        can be optimised. Types, degrees and knots stay, and so does which rows are rational.
        Axes are taken to be as orthonormal as they were.

        Parameters
        ----------
        **changed : array
            By names of `parameters`, of the same shape as there.

        Raises
        ------
        UsageError
            If a name is no parameter, or the shape of one changes.

        Examples
        --------
        >>> poles = surfaces.parameters()["poles"].requires_grad_()  # doctest: +SKIP
        >>> point = surfaces.with_parameters(poles=poles).points(row, u, v).point  # doctest: +SKIP
        >>> ((point - target) ** 2).sum().backward()  # doctest: +SKIP
        """
        curves = {name: part for name, part in changed.items() if name.startswith("curve_")}
        own = {name: part for name, part in changed.items() if name not in curves}
        swept = {name.removeprefix("curve_"): part for name, part in curves.items()}
        return replace(with_parameters(self, own), curves=with_parameters(self.curves, swept))

    def points(self, row: Any, u: Any, v: Any) -> SurfacePoints:
        """Evaluate surfaces with their normals and principal curvatures.

        It is several times as fast as `evaluate`, which returns the derivatives and from
        these the principal directions as well.

        Parameters
        ----------
        row : array_like
            ``(n,)`` row of the table, or one row for all. It is fastest where the points of
            a row follow each other.
        u, v : array_like
            ``(n,)`` parameters on that surface.

        Returns
        -------
        SurfacePoints
            NaN for rows that are not `known`.

        Raises
        ------
        UsageError
            If a row is outside the table or the shapes do not match.
        """
        rows, (us, vs) = query(len(self.known), self.size, row, u, v)
        out = surface_points(self, rows, us, vs)
        return SurfacePoints(out[0:3].T, out[3:6].T, out[6], out[7])

    def evaluate(self, row: Any, u: Any, v: Any) -> SurfaceJet:
        """Evaluate surfaces with their first and second derivatives.

        Parameters
        ----------
        row : array_like
            ``(n,)`` row of the table, or one row for all.
        u, v : array_like
            ``(n,)`` parameters on that surface. Periodic splines wrap; others continue
            their end spans.

        Returns
        -------
        SurfaceJet
            NaN for rows that are not `known`. It takes 160 bytes a point.

        Raises
        ------
        UsageError
            If a row is outside the table or the shapes do not match.
        """
        rows, (us, vs) = query(len(self.known), self.size, row, u, v)

        def work(group: int, index: Any) -> list[Array]:
            return self.jet(group, selected(rows, index), us[index], vs[index])

        groups = gather(self.group, rows)
        out = grouped(groups, len(us), self.batches, work, 18, self.size)
        point, du, dv, duu, duv, dvv = (out[i : i + 3].T for i in range(0, 18, 3))
        least = namespace(us).broadcast_to(gather(self.least, rows), (2, len(us))).T
        umbilic = self._sphere_curvature(rows, groups, vs)
        radial = None if umbilic is None else times_known(umbilic, dvv)
        return SurfaceJet(point, du, dv, duu, duv, dvv, least, radial, umbilic)

    @property
    def batches(self) -> list[int]:
        """Points of each kind whose temporaries stay in the cache."""
        return [_BATCH_OF_CLOSED if k.closed else _BATCH // (k.degrees[0] + 2) for k in self.kinds]

    def _sphere_curvature(self, row: Array, group: Array, v: Array) -> Array | None:
        """Return the curvature of spheres towards du x dv, NaN elsewhere; None without any."""
        spheres = [i for i, k in enumerate(self.kinds) if k.name == "Sphere" and not k.offset]
        if not spheres:
            return None
        xp, mine = namespace(v), group == spheres[0]
        for other in spheres[1:]:
            mine = mine | (group == other)
        radius = xp.where(mine, gather(self.size, row)[0], 1.0)
        curvature = sphere_curvature(-gather(self.side, row) / radius, v)
        return xp.where(mine, curvature, xp.nan)

    def jet(self, group: int, row: Array, u: Array, v: Array, order: int = 2) -> list[Array]:
        """Return point, du, dv, duu, duv, dvv ``(3, n)`` for rows that are all of `group`."""
        if not self.kinds[group].offset:
            return self.basis_jet(group, row, u, v, order)
        basis = self.basis_jet(group, row, u, v, order + 1)
        return offset_surface(basis, gather(self.offset, row), order)

    def basis_jet(self, group: int, row: Array, u: Array, v: Array, order: int) -> list[Array]:
        """Return the jet that an offset surface starts from; else the same as `jet`."""
        kind = self.kinds[group]
        if kind.name == "BSpline":
            about = kind.degrees, kind.rational, kind.periodic
            return self.splines.evaluate(row, u, v, *about, order)
        axes = gather(self.axes, row)
        if kind.name == "Revolution":
            return revolved(axes, u, self.curves.jet(kind.curve, row, v, order), order)
        if kind.name == "Extrusion":
            return extruded(axes, v, self.curves.jet(kind.curve, row, u, order), order)
        return ELEMENTARY[kind.name](axes, gather(self.size, row), u, v, order)

    def project(
        self,
        row: ArrayLike,
        points: ArrayLike,
        u0: ArrayLike,
        v0: ArrayLike,
        bounds: ArrayLike | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Find the foot points of 3D points on their surfaces, near a first guess.

        Parameters
        ----------
        row : array_like
            ``(n,)`` row of the table, or one row for all.
        points : array_like
            ``(n, 3)`` mm.
        u0, v0 : array_like
            ``(n,)`` parameters to start from. No branch is jumped: the search only
            ever goes downhill.
        bounds : array_like, optional
            ``(n, 4)`` or ``(4,)``: least and greatest u, least and greatest v. By default
            splines are left by no more than the length of their knot range.

        Returns
        -------
        u, v : numpy.ndarray
            ``(n,)``; the start itself where nothing nearer was found.
        residual : numpy.ndarray
            ``(n,)`` distance of p(u, v) to the point, mm; NaN for unknown rows.

        Raises
        ------
        UsageError
            If a row is outside the table or the shapes do not match.
        """
        rows, (us, vs) = query(len(self.known), self.size, row, u0, v0)
        if not isinstance(self.size, np.ndarray):
            raise UsageError("foot points are found by numpy; ask the surfaces before to(...)")
        rows = np.broadcast_to(rows, us.shape)
        if bounds is None:
            bounds = self._around(rows, us, vs)
        return project_points(self.evaluate, rows, points, us, vs, bounds)

    def _around(self, row: Ints, u: Floats, v: Floats) -> Floats:
        """Return bounds ``(n, 4)`` that keep the search near splines and hold its start."""
        names = np.array([*(kind.name for kind in self.kinds), ""])[self.group[row]]
        curve, own = self.curves.splines, self.splines
        curved = curve.valid[row]
        box = np.tile([-np.inf, np.inf], (2, len(row), 1))  # (u and v, n, least and greatest)
        for side, knots, mine in (
            (0, own.u_knots, names == "BSpline"),
            (1, own.v_knots, names == "BSpline"),
            (0, curve.knots, curved & (names == "Extrusion")),
            (1, curve.knots, curved & (names == "Revolution")),
        ):
            mine = mine & ~knots.periodic[row]
            low, high = knots.low[row[mine]], knots.high[row[mine]]
            start = (u, v)[side][mine]
            box[side, mine, 0] = np.minimum(2 * low - high, start)
            box[side, mine, 1] = np.maximum(2 * high - low, start)
        return np.concatenate([box[0], box[1]], axis=1)
