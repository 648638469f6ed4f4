"""Terrains: expressions, numbers and MuJoCo's geoms are one ground."""

from math import inf, pi

import casadi as cs
import mujoco
import numpy as np
import pytest

from piaffe.errors import ModelError
from piaffe.models import terrain

_RNG = np.random.default_rng(5)
GROUNDS = {
    "flat": terrain.flat(0.1),
    "incline": terrain.incline(pi / 18),
    "incline sideways": terrain.incline(0.3, start=-0.2, direction=2.0),
    "slope everywhere": terrain.incline(-0.2, start=-inf, direction=0.5),
    "stairs": terrain.stairs(rise=0.05, run=0.25, steps=3, start=-0.3, width=1.5, platform=0.6),
    "stairs aslant": terrain.stairs(rise=0.1, run=0.2, steps=4, start=-0.4, direction=-1.0, platform=0.5),
    "boxes": terrain.boxes(
        terrain.Box((0.2, 0.1), (0.8, 0.5), 0.1), terrain.Box((0.4, -0.1), (0.5, 0.9), 0.07, yaw=0.6)
    ),
    "heightfield": terrain.heightfield(0.2 * _RNG.random((4, 6)), size=(1.6, 1.1), centre=(0.1, -0.2)),
    "plateau": terrain.heightfield(np.full((2, 3), 0.1), size=(1.0, 0.6)),
}


@pytest.fixture(params=GROUNDS.values(), ids=GROUNDS.keys())
def ground(request):
    return request.param


def places():
    return np.random.default_rng(0).uniform(-1, 1, (400, 2)).T


def test_expression_is_the_number(ground):
    x, y = cs.SX.sym("x"), cs.SX.sym("y")
    function = cs.Function("height", [x, y], [cs.SX(ground.height(x, y))])
    xs, ys = places()
    symbolic = function.map(xs.size)(xs[None], ys[None]).full().ravel()
    assert symbolic == pytest.approx(ground.height(xs, ys), abs=1e-14)
    assert ground.height(xs.reshape(20, 20), ys.reshape(20, 20)).shape == (20, 20)


def test_rays_hit_the_geoms_at_the_height(ground):
    spec = mujoco.MjSpec()
    ground.add_to(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom, down = np.zeros(1, np.int32), np.array([0.0, 0.0, -1.0])
    xs, ys = places()
    hits = [
        mujoco.mj_ray(model, data, np.array([x, y, 2.0]), down, None, 1, -1, geom) for x, y in zip(xs, ys, strict=True)
    ]
    assert 2.0 - np.array(hits) == pytest.approx(ground.height(xs, ys), abs=1e-7)  # float32 in height fields


def test_slope_is_that_of_the_plane_that_fits_best(ground):
    xs, ys = places()[:, :6]
    zs = ground.height(xs, ys)
    fitted, *_ = np.linalg.lstsq(np.column_stack([xs, ys, np.ones(6)]), zs, rcond=None)
    assert ground.slope(list(xs), list(ys)) == pytest.approx(fitted[:2], abs=1e-4)


def test_places_on_a_line_give_no_slope_across_it():
    ground = terrain.incline(0.3, start=-inf)
    along, across = ground.slope([0.0, 0.0], [-0.2, 0.2])
    assert abs(along) < 1e-9
    assert abs(across) < 1e-9
    assert ground.slope([-0.2, 0.2], [0.0, 0.0])[0] == pytest.approx(np.tan(0.3), abs=1e-4)


def test_terrains_differ_from_a_plane():
    xs, ys = places()
    for name, ground in GROUNDS.items():
        assert np.ptp(ground.height(xs, ys)) > 0.02 or name == "flat"


def test_mean_height_is_that_of_the_places():
    xs, ys = places()
    for ground in GROUNDS.values():
        mean = ground.mean_height(list(xs[:4]), list(ys[:4]))
        assert float(mean) == pytest.approx(np.mean(ground.height(xs[:4], ys[:4])), abs=1e-15)


def test_terrains_are_values():
    assert terrain.stairs(0.05, 0.3) == terrain.stairs(0.05, 0.3) != terrain.stairs(0.04, 0.3)
    assert terrain.heightfield([[0, 1], [0, 0]], (1, 1)) == terrain.heightfield([[0, 1], [0, 0]], (1, 1))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: terrain.incline(2.0), "terrain incline: angle is out of range - got 2.0, expected an angle between"),
        (lambda: terrain.incline(-0.1), "terrain incline: angle is out of range - got -0.1, expected an angle ≥ 0"),
        (
            lambda: terrain.stairs(0.0, 0.3),
            "terrain stairs: rise is out of range - got 0.0, expected a positive number",
        ),
        (lambda: terrain.stairs(0.1, 0.3, 2.5), "terrain stairs: steps is out of range - got 2.5, expected a whole"),
        (lambda: terrain.boxes(3), "terrain boxes: a block is out of range - got 3, expected models.terrain.Box"),
        (lambda: terrain.Box((0, 0), (1, 0), 1), "terrain box: numbers are out of range - got place"),
        (lambda: terrain.heightfield([[-1, 0], [0, 0]], (1, 1)), "terrain heightfield: lowest height is out of range"),
        (lambda: terrain.heightfield(np.zeros((21, 20)), (1, 1)), "terrain heightfield: shape is out of range"),
    ],
)
def test_arguments_out_of_range_are_refused(make, message):
    with pytest.raises(ModelError, match="^" + message.replace("(", r"\(")):
        make()
