"""A model whose rows are written down by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from breplake.schema.identity import model_id
from breplake.schema.tables import TABLES
from breplake.schema.types import CURVE_TYPES, SURFACE_TYPES, count_column

from ..rows import complete, vec


def number(x: Any) -> float | None:
    return None if np.isnan(x) else float(x)


@dataclass
class Solid:
    """A model under construction: add patches, then corners and curves, then `finish`."""

    name: str
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=lambda: {t: [] for t in TABLES})
    points: dict[tuple[float, ...], np.ndarray] = field(default_factory=dict)

    @property
    def id(self) -> int:
        return model_id("hand", self.name)

    def rows(self, table: str) -> list[dict[str, Any]]:
        return self.tables[table]

    def vertex(self, point: Any) -> int:
        """The mesh vertex at a point; points closer than a nanometre are one."""
        key = tuple(np.round(np.asarray(point, float), 9) + 0.0)
        self.points.setdefault(key, np.asarray(point, float))
        return list(self.points).index(key)

    @property
    def positions(self) -> np.ndarray:
        return np.array(list(self.points.values())).reshape(-1, 3)

    def patch(self, row: dict[str, Any], uv: Any, truth: Callable[[Any, Any], tuple[Any, ...]],
              triangles: Any) -> None:  # fmt: skip
        """Add a patch with its mesh; `truth` gives point, outward normal, k and d."""
        patch_id, first = len(self.rows("patches")), len(self.rows("vertices"))
        for u, v in uv:
            p, n, k_min, k_max, d_min, d_max = truth(u, v)
            vertex = self.vertex(p)
            row_of = {
                "normal_id": len(self.rows("vertices")), "vertex_id": vertex, "patch_id": patch_id,
                "is_primary": all(r["vertex_id"] != vertex for r in self.rows("vertices")),
                **dict(zip(("x", "y", "z"), map(float, self.positions[vertex]), strict=True)),
                **dict(zip(("nx", "ny", "nz"), map(number, n), strict=True)),
                "u": float(u), "v": float(v), "k_min": number(k_min), "k_max": number(k_max),
                "d_min": vec(d_min), "d_max": vec(d_max),
                "residual": float(np.linalg.norm(np.asarray(p) - self.positions[vertex])),
            }  # fmt: skip
            self.rows("vertices").append(row_of)
        for triangle in triangles:
            normal_ids = [first + int(i) for i in triangle]
            v = [self.rows("vertices")[i]["vertex_id"] for i in normal_ids]
            self.rows("faces").append(
                dict(zip(("v0", "v1", "v2"), v, strict=True))
                | dict(zip(("n0", "n1", "n2"), normal_ids, strict=True))
                | {"face_id": len(self.rows("faces")), "patch_id": patch_id}
            )
        self.rows("patches").append(
            {"patch_id": patch_id, "part_id": 0, "reversed": False, "u_closed": False,
             "v_closed": False, "u_periodic": False, "v_periodic": False, "tolerance": 1e-7,
             "u_min": float(min(u for u, _ in uv)), "u_max": float(max(u for u, _ in uv)),
             "v_min": float(min(v for _, v in uv)), "v_max": float(max(v for _, v in uv)), **row}
        )  # fmt: skip

    def corner(self, point: Any) -> int:
        row = {"corner_id": len(self.rows("corners")), "point": vec(point), "tolerance": 1e-7}
        mesh = self.vertex(point) if self.rows("patches") else None
        self.rows("corners").append(row | {"vertex_id": mesh})
        for other in self.rows("vertices"):
            if other["vertex_id"] == mesh:
                other["corner_id"] = row["corner_id"]
        return row["corner_id"]

    def curve(self, row: dict[str, Any], t: Any, at: Callable[[float], Any], uses: Any,
              ends: tuple[int, int]) -> None:  # fmt: skip
        """Add a curve; `uses` are (patch, loop, reversed) of its coedges."""
        curve_id, mesh = len(self.rows("curves")), [self.vertex(at(x)) for x in t]
        patches = [patch for patch, _, _ in uses]
        self.rows("curves").append(
            {"curve_id": curve_id, "tolerance": 1e-7, "t_min": float(t[0]), "t_max": float(t[-1]),
             "start_corner": ends[0], "end_corner": ends[1], "n_patches": len(set(patches)),
             "left_patch": next((p for p, _, r in uses if not r), None),
             "right_patch": next((p for p, _, r in uses if r), None),
             "sharp": row["kind"] == "sharp", "vert_indices": mesh,
             "vert_parameters": [float(x) for x in t], **row}
        )  # fmt: skip
        for patch, loop, against in uses:
            self.rows("coedges").append(
                {"patch_id": patch, "loop": loop, "curve_id": curve_id, "reversed": against}
            )
        for other in self.rows("vertices"):
            if other["vertex_id"] in mesh and "corner_id" not in other:
                other["curve_id"] = curve_id

    def finish(self, *, volume: float | None, closed: bool) -> Solid:
        coedges = sorted(self.rows("coedges"), key=lambda c: (c["patch_id"], c["loop"]))
        for i, c in enumerate(coedges):
            same = [
                d for d in coedges[:i] if (d["patch_id"], d["loop"]) == (c["patch_id"], c["loop"])
            ]
            c["place"] = len(same)
        self.tables["coedges"] = coedges
        patches, curves = self.rows("patches"), self.rows("curves")
        for p in patches:
            p["n_loops"] = len({c["loop"] for c in coedges if c["patch_id"] == p["patch_id"]})
        points = self.positions
        if not patches:
            points = np.array([[-1e3] * 3, [1e3] * 3])
        low, high = points.min(axis=0), points.max(axis=0)
        area = math.fsum(p["area"] for p in patches)
        if patches:
            self.rows("parts").append(
                {"part_id": 0, "kind": "solid" if volume else "face", "volume": volume,
                 "area": area, "is_closed": closed}
            )  # fmt: skip
        row: dict[str, Any] = {
            "collection": "hand", "name": self.name, "format": "step", "sha256": f"{self.id:064x}",
            "bbox_min": vec(low),
            "bbox_max": vec(high), "diagonal": float(np.linalg.norm(high - low)), "area": area,
            "volume": volume, "is_valid": True, "is_closed": closed,
            "duplicate_group": self.id, "shard": "s0",
            "n_parts": len(self.rows("parts")), "n_solids": int(volume is not None),
            "n_patches": len(patches), "n_curves": len(curves),
            "n_corners": len(self.rows("corners")),
            "n_sharp_curves": sum(c["sharp"] for c in curves),
        }  # fmt: skip
        for t in SURFACE_TYPES:
            row[count_column(t)] = sum(p["type"] == t for p in patches)
        for t in CURVE_TYPES:
            row[count_column(t, curve=True)] = sum(c["type"] == t for c in curves)
        self.tables["models"] = [row | (self.mesh_row(points) if patches else {})]
        return self

    def mesh_row(self, points: Any) -> dict[str, Any]:
        faces = np.array([[f["v0"], f["v1"], f["v2"]] for f in self.rows("faces")])
        edges: dict[tuple[int, ...], int] = {}
        sides, angles = [], []
        for f in faces:
            for i in range(3):
                a, b, c = points[f[i]], points[f[i - 2]], points[f[i - 1]]
                sides.append(np.linalg.norm(b - a))
                angles.append(
                    math.acos((b - a) @ (c - a) / np.linalg.norm(b - a) / np.linalg.norm(c - a))
                )
                key = tuple(sorted((int(f[i]), int(f[i - 2]))))
                edges[key] = edges.get(key, 0) + 1
        return {
            "mesh_kind": "uniform", "mesh_limit": float(max(sides)), "n_vertices": len(points),
            "n_normals": len(self.rows("vertices")), "n_faces": len(faces),
            "max_edge": float(max(sides)), "min_angle": min(angles),
            "regular_angles": float(np.mean([math.pi / 6 <= a <= math.pi / 2 for a in angles])),
            "is_watertight": all(n == 2 for n in edges.values()),
            "n_boundary_edges": sum(n == 1 for n in edges.values()),
            "n_nonmanifold_edges": sum(n > 2 for n in edges.values()),
            "vertex_offset": 0, "normal_offset": 0, "face_offset": 0,
        }  # fmt: skip

    def table(self, name: str) -> pa.Table:
        rows = [complete(TABLES[name], {"model_id": self.id} | row) for row in self.rows(name)]
        return TABLES[name].from_rows(rows)

    def arrays(self) -> dict[str, np.ndarray] | None:
        rows, faces = self.rows("vertices"), self.rows("faces")
        if not rows:
            return None
        feature = np.zeros(len(self.points), np.uint8)
        for c in self.rows("curves"):
            mesh = c["vert_indices"] or []
            feature[mesh] = np.maximum(feature[mesh], 2 if c["sharp"] else 1)
        feature[[c["vertex_id"] for c in self.rows("corners")]] = 3

        def column(rows: Any, names: str, kind: Any) -> np.ndarray:
            values = [[math.nan if r[n] is None else r[n] for n in names.split()] for r in rows]
            return np.array(values).astype(kind)

        primary = sorted((r for r in rows if r["is_primary"]), key=lambda r: r["vertex_id"])
        return {
            "position": column(primary, "x y z", np.float32),
            "feature": feature,
            "normal": column(rows, "nx ny nz", np.float32),
            "curvature": column(rows, "k_min k_max", np.float32),
            "patch": column(rows, "patch_id", np.int32)[:, 0],
            "triangle": column(faces, "v0 v1 v2", np.int32),
            "triangle_normal": column(faces, "n0 n1 n2", np.int32),
            "triangle_patch": column(faces, "patch_id", np.int32)[:, 0],
        }  # fmt: skip
