"""The same kernels under torch: the same results, gradients, devices and precisions."""

import numpy as np
import pyarrow as pa
import pytest

from breplake.errors import UsageError
from breplake.schema.curves import CurveSet
from breplake.schema.pcurves import PcurveSet
from breplake.schema.shape_tables import PCURVES
from breplake.schema.tables import CURVES

torch = pytest.importorskip("torch")

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def some(count, seed=0, low=0.15, high=0.85):
    return np.random.default_rng(seed).uniform(low, high, (2, count))


def leaf(values):
    return torch.tensor(values, dtype=torch.float64, requires_grad=True)


def space(rows):
    return CurveSet.from_curves(pa.Table.from_pylist(list(rows.values()), CURVES.schema))


def flat(rows):
    """The same curves in a plane: without their third coordinate."""
    table = []
    for i, row in enumerate(rows.values()):
        plane = {k: uv(v) for k, v in row.items() if not k.startswith(("offset", "basis"))}
        plane["type"] = row.get("basis_type") or row["type"]
        table.append({"model_id": 0, "pcurve_id": 2 * i, **plane})
        moved = {"type": "Offset", "basis": 2 * i, "offset": 0.2}
        table.append({"model_id": 0, "pcurve_id": 2 * i + 1, **moved})
    return PcurveSet.from_pcurves(PCURVES.from_rows(table))


def uv(value):
    if isinstance(value, list) and isinstance(value[0], dict):
        return [uv(v) for v in value]
    return {"u": value["x"], "v": value["z"]} if isinstance(value, dict) else value


def parts(result, names):
    return [getattr(result, name) for name in names]


JET = ("point", "du", "dv", "duu", "duv", "dvv")
BENDS = ("k_min", "k_max")


def test_gradients_of_every_surface(every_surface, surface_name):
    surface = every_surface.alone(surface_name).to(device="cpu")

    def work(u, v):
        jet, points = surface.evaluate(0, u, v), surface.points(0, u, v)
        bend = jet.curvature()
        return (
            *parts(jet, JET),
            jet.normal(),
            *parts(bend, BENDS),
            *parts(points, ("point", "normal", *BENDS)),
        )

    assert torch.autograd.gradcheck(work, (leaf([0.31]), leaf([0.41])))


def test_gradients_by_the_parameters_of_every_surface(every_surface, surface_name):
    surface = every_surface.alone(surface_name).to(device="cpu")
    given = {k: p for k, p in surface.parameters().items() if p.numel() and p.isfinite().all()}
    u, v = torch.tensor([[0.31, 0.62], [0.41, 0.77]], dtype=torch.float64)

    def work(*values):
        jet = surface.with_parameters(**dict(zip(given, values, strict=True))).evaluate(0, u, v)
        return jet.point, jet.du, jet.dvv, jet.normal()

    leaves = tuple(p.clone().requires_grad_() for p in given.values())
    assert torch.autograd.gradcheck(work, leaves, fast_mode=True)


def test_gradients_of_every_curve(curve_rows, curve_name):
    place = list(curve_rows).index(curve_name)
    for curves, rows in (
        (space(curve_rows), [place]),
        (flat(curve_rows), [2 * place, 2 * place + 1]),
    ):
        moved = curves.to(device="cpu")
        for row in rows:
            assert bool(moved.known[row])

            def work(t, moved=moved, row=row):
                return parts(moved.evaluate(row, t), ("point", "d1", "d2"))

            assert torch.autograd.gradcheck(work, (leaf([0.31, 0.62]),))


def test_gradients_by_the_parameters_of_every_curve(curve_rows, curve_name):
    curves = space({curve_name: curve_rows[curve_name]}).to(device="cpu")
    given = {k: p for k, p in curves.parameters().items() if p.numel() and p.isfinite().all()}

    def work(*values):
        changed = curves.with_parameters(**dict(zip(given, values, strict=True)))
        return parts(changed.evaluate(0, torch.tensor([0.31, 0.62])), ("point", "d1", "d2"))

    leaves = tuple(p.clone().requires_grad_() for p in given.values())
    assert torch.autograd.gradcheck(work, leaves, fast_mode=True)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(("dtype", "limit"), [("float64", 1e-10), ("float32", 1e-4)])
def test_results_are_those_of_numpy(every_surface, device, dtype, limit):
    ours = every_surface.set({"type": "Other"})
    theirs = ours.to(device=device, dtype=getattr(torch, dtype))
    row = np.random.default_rng(0).integers(0, len(every_surface.rows) + 1, 4000)
    u, v = (p.astype(dtype).astype(float) for p in some(4000, 1))
    jet, points = ours.evaluate(row, u, v), ours.points(row, u, v)
    other, others = theirs.evaluate(torch.as_tensor(row), u, v), theirs.points(row, u, v)
    assert other.point.device.type == device
    assert other.point.dtype == others.k_min.dtype == getattr(torch, dtype)
    for found, truth in (
        *zip(parts(other, JET), parts(jet, JET), strict=True),
        (other.normal(), jet.normal()),
        *zip(parts(other.curvature(), BENDS), parts(jet.curvature(), BENDS), strict=True),
        *zip(
            parts(others, ("point", "normal", *BENDS)),
            parts(points, ("point", "normal", *BENDS)),
            strict=True,
        ),
    ):
        found = found.double().cpu().numpy()
        assert found.shape == truth.shape
        extra = np.isnan(found) & ~np.isnan(truth)
        assert np.array_equal(np.isnan(found) ^ extra, np.isnan(truth))
        # near the focal points of offsets, errors grow without bound; float32 flags more of it
        near = 0.005 if dtype == "float32" else 0.0
        assert extra.mean() <= near
        assert np.nanquantile(np.abs(found - truth) / (1 + np.abs(truth)), 1 - near) < limit


@pytest.mark.parametrize("device", DEVICES)
def test_curves_are_those_of_numpy(curve_rows, device):
    t = some(900)[0]
    for ours in (space(curve_rows), flat(curve_rows)):
        theirs = ours.to(device=device)
        row = np.random.default_rng(2).integers(0, len(ours.known), len(t))
        jet, other = ours.evaluate(row, t), theirs.evaluate(torch.as_tensor(row), t)
        for name in ("point", "d1", "d2"):
            gap = np.abs(getattr(other, name).cpu().numpy() - getattr(jet, name))
            assert gap.max() < 1e-12 * (1 + np.abs(getattr(jet, name)).max())


def test_float32_far_from_the_origin(every_surface):
    """Only the place of a point is rounded to its size: normals and curvatures keep theirs."""
    far = 4096.0
    near_row = every_surface.rows["BSpline"]
    grid = [[{**p, "x": p["x"] + far} for p in line] for line in near_row["poles"]]
    surfaces = every_surface.only(near_row, near_row | {"poles": grid}).to(dtype=torch.float32)
    u, v = some(500)
    near, away = surfaces.points(0, u, v), surfaces.points(1, u, v)
    assert (near.point + torch.tensor([far, 0, 0]) - away.point).abs().max() < 5e-4
    assert (near.normal - away.normal).abs().max() < 1e-6
    assert (near.k_max - away.k_max).abs().max() < 1e-5


def test_gradients_are_finite_where_quantities_are_undefined(every_surface):
    """Poles, apexes, flat and unknown places yield NaN and a gradient of zero, no NaN."""
    cone = every_surface.rows["Cone"]
    names = [*every_surface.rows, "unknown"]
    surfaces = every_surface.set({"type": "Other"}).to(device="cpu")
    given = {k: p.clone().requires_grad_() for k, p in surfaces.parameters().items()}
    used = {k: p for k, p in given.items() if p.isfinite().all()}
    changed = surfaces.with_parameters(**used)
    apex = -cone["radius"] / np.sin(cone["angle"])
    places = (("Sphere", 0.5, np.pi / 2), ("Cone", 0.5, apex), ("unknown", 0.5, 0.5))
    places += (("Plane", 0.5, 0.5), ("BSpline", 0.0, 0.0), ("offset Plane", 0.5, 0.5))
    row = torch.tensor([names.index(name) for name, _, _ in places])
    u, v = (leaf([place[i] for place in places]) for i in (1, 2))
    jet, points = changed.evaluate(row, u, v), changed.points(row, u, v)
    bend = jet.curvature()
    outputs = (
        jet.point,
        jet.normal(),
        bend.k_min,
        bend.k_max,
        bend.d_min,
        points.normal,
        points.k_max,
    )
    sum(o.nan_to_num().sum() for o in outputs).backward()
    for value in (u, v, *used.values()):
        assert value.grad is None or bool(value.grad.isfinite().all())
    assert bool(u.grad.isfinite().all())
    assert bool(points.normal.isnan().any(-1)[1])


def test_poles_can_be_fitted(every_surface):
    """Gradient descent on the poles brings a spline to points of another one."""
    surface = every_surface.alone("BSpline").to(device="cpu")
    u, v = some(200)
    poles = surface.parameters()["poles"]
    target = surface.with_parameters(poles=poles + 0.3 * torch.sin(7 * poles)).points(0, u, v).point
    moving = poles.clone().requires_grad_()
    optimizer = torch.optim.Adam([moving], lr=0.05)
    for _ in range(150):
        optimizer.zero_grad()
        found = surface.with_parameters(poles=moving).points(0, u, v).point
        loss = ((found - target) ** 2).mean()
        loss.backward()
        optimizer.step()
    assert loss.item() < 1e-4


def test_moving_on(every_surface):
    ours = every_surface.set()
    like = torch.zeros(0, dtype=torch.float32)
    single = ours.to(like)
    assert single.points(0, 0.5, 0.5).point.dtype == torch.float32
    assert single.to(dtype=torch.float64).axes.dtype == torch.float64
    assert ours.to(torch.zeros(0, dtype=torch.int64)).axes.dtype == torch.float64
    assert isinstance(ours.axes, np.ndarray)
    double = ours.to(device="cpu")
    double.axes.zero_()  # does not reach the arrays that it was made of
    assert ours.axes.any()
    assert float(single.least.max()) > 1e3 * float(ours.least.max())


def test_wrong_uses(every_surface):
    ours = every_surface.set()
    with pytest.raises(UsageError, match="move them first"):
        ours.evaluate(0, torch.tensor([0.5]), 0.5)
    with pytest.raises(UsageError, match="floating type"):
        ours.to(dtype=torch.int32)
    theirs = ours.to(device="cpu")
    with pytest.raises(UsageError, match="foot points are found by numpy"):
        theirs.project(0, [[0.0, 0, 0]], 0.0, 0.0)
    with pytest.raises(UsageError, match="integers"):
        theirs.points(torch.tensor([0.0]), 0.5, 0.5)
    with pytest.raises(UsageError, match="no parameter 'radius'"):
        theirs.with_parameters(radius=torch.zeros(3))
    with pytest.raises(UsageError, match="must stay"):
        theirs.with_parameters(poles=torch.zeros(3))


def test_empty_queries(every_surface):
    surfaces = every_surface.set().to(device="cpu")
    assert surfaces.points([], [], []).normal.shape == (0, 3)
    assert surfaces.evaluate([], [], []).curvature().d_min.shape == (0, 3)
