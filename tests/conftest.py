"""Fixtures that many tests share.

``tiny_lake`` is made through the contracts alone, without a CAD kernel: boxes, whose tables
and mesh are known by hand.
"""

# ruff: noqa: C408 -- rows written as dict(name=value) read like the tables they fill

from __future__ import annotations

import itertools
import os
import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, settings

from breplake.schema.arrays import ArrayShardWriter
from breplake.schema.identity import model_id
from breplake.schema.lake import LakeStore
from breplake.schema.tables import SCHEMA_VERSION, TABLES

from .rows import complete, vec

# A busy machine is no fault of the code under test.
settings.register_profile("breplake", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("breplake")


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory):
    """What ingest remembers of the files of tests stays out of the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("BREPLAKE_CACHE", raising=False)
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


COLLECTION = "boxes"
TINY = {
    "s0": {"small": (1, 1, 1), "long/flat": (9, 2, 1)},
    "s1": {"big": (4, 5, 6), "wide": (7, 8, 2)},
}
"""Shard -> model -> size of the box in mm. Shard s1 also has a model without mesh and a failure."""


def box_mesh(size: Any) -> dict[str, np.ndarray]:
    """A box with one corner at the origin: 8 vertices, 6 patches of 4 normals and 2 triangles."""
    corner = np.array(list(itertools.product((0, 1), repeat=3)))  # (8, 3)
    vertex, normal, triangle = [], [], []
    for axis, side in itertools.product(range(3), (0, 1)):
        on = np.flatnonzero(corner[:, axis] == side)  # (4,)
        out = np.eye(3)[axis] * (2 * side - 1)
        a, b, c, d = on
        turn = np.cross(corner[b] - corner[a], corner[c] - corner[a]) @ out
        first = len(vertex)
        vertex += [a, b, c, d]
        normal += [out] * 4
        quad = [[0, 1, 2], [1, 3, 2]] if turn > 0 else [[0, 2, 1], [1, 2, 3]]
        triangle += (np.array(quad) + first).tolist()
    vertex, triangle_normal = np.array(vertex), np.array(triangle)  # (24,), (12, 3)
    patch = np.repeat(np.arange(6), 4)
    return {
        "position": (corner * np.asarray(size)).astype(np.float32),
        "feature": np.full(8, 3, np.uint8),
        "normal": np.array(normal, np.float32),
        "curvature": np.zeros((24, 2), np.float32),
        "patch": patch.astype(np.int32),
        "triangle": vertex[triangle_normal].astype(np.int32),
        "triangle_normal": triangle_normal.astype(np.int32),
        "triangle_patch": np.repeat(np.arange(6), 2).astype(np.int32),
        "vertex_of_normal": vertex,
    }


def box_curves(identity: int, size: Any) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The 12 edges of a box and their uses. Patch 2 * axis + side, corners as in `box_mesh`."""
    curves, coedges = [], []
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        for sides in itertools.product((0, 1), repeat=2):
            at = np.zeros(3, int)
            at[others] = sides
            end = at + np.eye(3, dtype=int)[axis]
            left, right = (2 * a + s for a, s in zip(others, sides, strict=True))
            spot = dict(model_id=identity, curve_id=len(curves))
            curves.append(
                spot
                | dict(
                    type="Line", location=vec(at * size), direction=vec(np.eye(3)[axis]),
                    t_min=0.0, t_max=float(size[axis]), length=float(size[axis]), tolerance=1e-7,
                    start_corner=int(at @ [4, 2, 1]), end_corner=int(end @ [4, 2, 1]),
                    left_patch=left, right_patch=right, n_patches=2, kind="sharp",
                    angle_min=np.pi / 2, angle_max=np.pi / 2, convexity="convex", sharp=True,
                )
            )  # fmt: skip
            for p in (left, right):
                place = sum(coedge["patch_id"] == p for coedge in coedges)
                coedges.append(spot | dict(patch_id=p, loop=0, place=place, reversed=p == right))
    return curves, coedges


def box_rows(name: str, size: Any, shard: str) -> dict[str, list[dict[str, Any]]]:
    """The rows of all tables of one box."""
    identity = model_id(COLLECTION, name)
    size = np.asarray(size, float)
    mesh = box_mesh(size)
    a, b, c = size
    vertex = mesh["vertex_of_normal"]
    areas = np.repeat([b * c, a * c, a * b], 2)
    curves, coedges = box_curves(identity, size)
    model = dict(
        model_id=identity, collection=COLLECTION, name=name, path=f"{name}.step", format="step",
        bytes=1000, sha256=f"{identity:064x}", length_unit="mm", scale_to_mm=1.0, n_parts=1,
        n_solids=1, n_shells=1, n_patches=6, n_curves=12, n_corners=8, n_plane=6, n_line=12,
        n_sharp_curves=12, bbox_min=vec([0, 0, 0]), bbox_max=vec(size),
        diagonal=float(np.linalg.norm(size)), area=float(areas.sum()), volume=float(a * b * c),
        is_valid=True, is_closed=True, is_single_primitive=True, mesh_kind="uniform", n_vertices=8,
        n_normals=24, n_faces=12, is_watertight=True, fingerprint=name, duplicate_group=identity,
        shard=shard, occt_version="7.9", gmsh_version="4.15", breplake_version="0", config_hash="c",
    )  # fmt: skip
    patches = [
        dict(
            model_id=identity,
            patch_id=p,
            type="Plane",
            area=float(areas[p]),
            n_loops=1,
            tolerance=1e-7,
        )
        for p in range(6)
    ]
    vertices = [
        dict(zip(("x", "y", "z"), map(float, mesh["position"][v]), strict=True))
        | dict(zip(("nx", "ny", "nz"), map(float, mesh["normal"][i]), strict=True))
        | dict(model_id=identity, normal_id=i, vertex_id=int(v), patch_id=int(mesh["patch"][i]))
        | dict(is_primary=bool(v not in vertex[:i]), corner_id=int(v), k_min=0.0, k_max=0.0)
        for i, v in enumerate(vertex)
    ]
    faces = [
        dict(model_id=identity, face_id=i, patch_id=int(mesh["triangle_patch"][i]))
        | {f"v{j}": int(mesh["triangle"][i, j]) for j in range(3)}
        | {f"n{j}": int(mesh["triangle_normal"][i, j]) for j in range(3)}
        for i in range(12)
    ]
    corners = [
        dict(model_id=identity, corner_id=i, point=vec(mesh["position"][i]), vertex_id=i)
        for i in range(8)
    ]
    part = dict(model_id=identity, kind="solid", volume=float(a * b * c), area=float(areas.sum()))
    return {
        "models": [model], "parts": [part | dict(is_closed=True)], "patches": patches,
        "curves": curves, "coedges": coedges, "corners": corners, "vertices": vertices,
        "faces": faces, "failures": [],
    }  # fmt: skip


def extra_rows(shard: str) -> dict[str, list[dict[str, Any]]]:
    """A model that was read but not meshed, and an input that was not read at all."""
    bare = box_rows("bare", (3, 3, 3), shard)
    for column in ("mesh_kind", "n_vertices", "n_normals", "n_faces", "is_watertight"):
        bare["models"][0][column] = None
    bare |= {"vertices": [], "faces": []}
    identity = model_id(COLLECTION, "broken")
    place = dict(model_id=identity, collection=COLLECTION, name="broken", path="broken.step")
    bare["failures"] = [
        dict(model_id=bare["models"][0]["model_id"], collection=COLLECTION, name="bare",
             stage="mesh", kind="timeout", message="took longer than 1 s", config_hash="c"),
        place | dict(stage="read", kind="not-cad", message="no STEP header", fatal=True),
    ]  # fmt: skip
    return bare


def write_shard(
    store: LakeStore, shard: str, boxes: Mapping[str, Any], *, extra: bool = False
) -> None:
    """Write the files of a shard, unregistered."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TABLES}
    with ArrayShardWriter(store.array_path(shard)) as writer:
        for name, size in boxes.items():
            box = box_rows(name, size, shard)
            mesh = box_mesh(size)
            del mesh["vertex_of_normal"]
            first = writer.append(mesh)
            box["models"][0] |= dict(
                vertex_offset=first.vertex, normal_offset=first.normal, face_offset=first.face
            )
            for table, new in box.items():
                rows[table] += new
    if extra:
        for table, new in extra_rows(shard).items():
            rows[table] += new
    for name, table in TABLES.items():
        full = table.from_rows([complete(table, row) for row in rows[name]])
        if full.num_rows or name == "models":
            full = full.sort_by([(key, "ascending") for key in table.key])
            pq.write_table(full, store.table_path(name, shard), row_group_size=table.row_group)


def write_tiny_lake(path: Path) -> Path:
    """Two commits: shard s0, then s1."""
    store = LakeStore.create(path)
    for shard, boxes in TINY.items():
        write_shard(store, shard, boxes, extra=shard == "s1")
        store.commit(
            store.register_shard(shard),
            message=f"add {shard}",
            tools={"breplake": "0", "schema": str(SCHEMA_VERSION)},
            config_hash="c",
        )
    return path


@pytest.fixture(scope="session")
def tiny_lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lake of four boxes, a model without mesh and a failure, in two snapshots. Read only."""
    return write_tiny_lake(tmp_path_factory.mktemp("tiny") / "lake")


@pytest.fixture
def own_lake(tmp_path: Path) -> Path:
    """A lake like ``tiny_lake`` that a test may change."""
    return write_tiny_lake(tmp_path / "lake")


@pytest.fixture
def new_shard():
    """The function that writes a shard of boxes: ``new_shard(store, "s2", {"a": (1, 2, 3)})``."""
    return write_shard


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch):
    """URL of a folder in an S3 server of this process, whose credentials are in the environment.

    A test that takes it is marked ``@pytest.mark.filterwarnings("ignore::DeprecationWarning")``:
    botocore and moto give some.
    """
    server_of = pytest.importorskip("moto.server").ThreadedMotoServer
    import boto3

    server = server_of(ip_address="127.0.0.1", port=0)
    server.start()
    for name, value in {
        "AWS_ACCESS_KEY_ID": "x",
        "AWS_SECRET_ACCESS_KEY": "y",
        "AWS_REGION": "us-east-1",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": "http://{}:{}".format(*server.get_host_and_port()),
        "AWS_ALLOW_HTTP": "true",
    }.items():
        monkeypatch.setenv(name, value)
    name = uuid.uuid4().hex  # moto keeps its buckets from test to test
    boto3.client("s3").create_bucket(Bucket=name)
    yield f"s3://{name}/lakes/one"
    server.stop()


SAMPLES = (
    *("bellows", "spindle_grip", "base_plate_inch", "base_plate_mm", "trough_parabolic"),
    *("cooling_tower", "bottle", "nozzle_nurbs", "panel_offset", "flange_joint", "hinge"),
    *("ball_steel", "weight_lemon", "plumb_bob", "gear_spur", "spring_compression", "mug"),
    *("duct_surface", "shelf_brackets", "gasket_wave", "screw_countersunk", "handwheel"),
)
"""Sample parts that together have every type of patch and curve, two with many tori."""


@pytest.fixture(scope="session")
def shared_lake(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """A function that ingests sample parts into a lake of that name, once for all workers."""
    pytest.importorskip("OCP")
    from filelock import FileLock

    base = tmp_path_factory.getbasetemp()
    shared = base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base

    def make(name: str, parts: Sequence[str], max_edge: float) -> Path:
        lake = shared / f"{name}_lake"
        with FileLock(shared / f"{name}_lake.lock"):
            if not (shared / f"{name}_lake.done").exists():
                from breplake.ingest.run import ingest
                from breplake.ingest.samples import write_samples
                from breplake.ingest.settings import Settings

                write_samples(shared / name, parts)
                ingest([shared / name], lake, settings=Settings(max_edge=max_edge), message=name)
                (shared / f"{name}_lake.done").touch()
        return lake

    return make


@pytest.fixture(scope="session")
def sample_lake(shared_lake: Callable[..., Path]) -> Path:
    """A lake ingested from sample parts, coarsely meshed."""
    return shared_lake("samples", SAMPLES, max_edge=0.02)
