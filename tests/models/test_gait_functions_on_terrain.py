"""Gaits on a terrain as functions of time, command and the plan's place in the world, against the gaits in NumPy."""

from dataclasses import replace
from math import inf

import casadi as cs
import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models import gaits, terrain
from piaffe.models.obstacles import planes_about, within
from piaffe.models.placed_ground import PlacedGround
from piaffe.ocp.language.path import PlacedPiece
from tests.gaits import GaitPair, disturbed

GROUNDS = {
    "slope": terrain.incline(0.18, start=-inf, direction=0.4),
    "ramp": terrain.incline(0.18, start=0.3),
    "stairs": terrain.stairs(0.04, 0.25, 3, start=0.3, direction=0.2),
    "box": terrain.boxes(
        terrain.Box((0.6, 0.1), (0.5, 1.0), 0.05, yaw=0.3), terrain.Box((0.2, -0.6), (0.4, 0.3), 0.03)
    ),
}
BUMPS = terrain.heightfield(0.1 * np.random.default_rng(3).random((5, 7)), size=(2.4, 2.0), centre=(0.2, 0.1))
ROBOTS = {"solo12": 0.25, "go2": 0.29}


@pytest.fixture(params=GROUNDS.values(), ids=GROUNDS.keys())
def ground(request):
    return request.param


def pair_on(ground, robot="solo12", gait="trot", **options):
    """Return a gait on a ground, over whose edges it goes."""
    body = models.WholeBody(models.load(robot), terrain=ground)
    command = {"height": ROBOTS[robot], "yaw_rate": 0.15, "lateral_speed": 0.05, "ramp": 0.5, **options}
    motion = getattr(gaits, gait)(0.3, **command)
    return GaitPair(body, motion, np.random.default_rng(0), body.state(rpy=(0.03, -0.05, 0.1), joints="stand"))


# ---- the ground as expressions


@pytest.mark.parametrize("anchor", [ocp.ORIGIN, (0.3, -0.2, 0.7)])
@pytest.mark.parametrize("ground", [*GROUNDS.values(), BUMPS], ids=[*GROUNDS, "bumps"])
def test_the_ground_in_a_frame_is_the_ground_of_the_world(ground, anchor):
    radius, place, at = 0.02, cs.SX.sym("place", 3), cs.SX.sym("anchor", 3)
    placed = PlacedGround(ground, radius, at)
    parts = [
        *placed.surface(place), placed.standing(place), placed.clear(place, 0.03, 0.05), placed.height(place),
        *(each for plane in placed.about(place) for each in plane), *placed.within(place),
    ]  # fmt: skip
    function = cs.Function("ground", [place, at], parts)
    rng, back = np.random.default_rng(0), ocp.relative(ocp.ORIGIN, anchor)
    for _ in range(300):
        world = np.array([*rng.uniform(-0.4, 1.6, 2), rng.uniform(0.0, 0.15)])
        got = [each.full().ravel() for each in function(moved(world, back), np.array(anchor))]
        point, normal = (each[0] for each in ground.surface(world[None, :2]))
        over, beside = planes_about(ground, world, radius)
        lands = within(ground, world, radius)
        clear = ground.clear(world[None, :2], 0.03, 0.05)[0]
        expected = [
            moved(point, back), turned(normal, back), moved(ground.standing(world[None, :2], radius)[0], back),
            moved(np.array([*clear, 0.0]), back)[:2], point[2:],
            moved(over[0], back), turned(over[1], back), moved(beside[0], back), turned(beside[1], back),
            moved(lands[0], back), turned(lands[1], back),
        ]  # fmt: skip
        for one, other in zip(got[:5], expected[:5], strict=True):
            assert one == pytest.approx(other, abs=1e-12)
        for i in range(5, len(got), 2):  # one plane may have several points: two steps end at one edge
            assert got[i + 1] == pytest.approx(expected[i + 1], abs=1e-12)
            assert got[i] @ got[i + 1] == pytest.approx(expected[i] @ expected[i + 1], abs=1e-12)


def turned(vector, motion):
    c, s = np.cos(motion[2]), np.sin(motion[2])
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]])


def moved(point, motion):
    return turned(point, motion) + np.array([motion[0], motion[1], 0.0])


# ---- the gait


@pytest.mark.parametrize(("robot", "gait"), [("solo12", "trot"), ("go2", "bound")])
def test_functions_of_a_gait_are_the_gait_on_terrain(ground, robot, gait):
    pair, rng, exact = pair_on(ground, robot, gait), np.random.default_rng(1), 0
    for _ in range(30):
        exact += pair.check(*pair.some_time(rng, 0.0, 4.0))
    assert exact > 20  # the feet are within reach


def test_a_gait_that_advances_is_the_anchored_gait_on_terrain(ground):
    pair, rng, now, exact = pair_on(ground), np.random.default_rng(2), 0.0, 0
    for _ in range(20):
        later, interval = pair.some_time(rng, now, now + rng.choice([0.02, 0.3, 0.5]))
        x, actual = disturbed(pair, later, rng)
        pair.advance(now, later - now, x, interval)
        pair.numpy, now = pair.numpy.anchored(later, actual), later
        exact += check_moved(pair, *pair.some_time(rng, now, now + 1.0), now)
    assert exact > 12


def check_moved(pair, t, interval, now):
    """Compare; the planes are those of the gait as it now is."""
    own = pair.path.added[0]
    kept = vars(own).copy()
    own._path = replace(own._path, placed=(PlacedPiece(0.0, pair.numpy),))
    own._stances, own._done, own._known = [[] for _ in pair.model.robot.feet], 0, -1.0
    try:
        return pair.check(t, interval, now)
    finally:
        vars(own).update(kept)
