"""A receding horizon on terrain: ticks in C equal those in NumPy, landings are where the ground is."""

from functools import lru_cache

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.models import stance, terrain

from .test_ticks import ahead, assert_same, hop_then, make_equal, terms

STAIRS = terrain.stairs(0.04, 0.25, 3, start=0.28, direction=0.1)
SLOPE = terrain.incline(0.15, start=-np.inf)
UP = 21  # vertical velocity of the base in the state


def problem(motion, ground):
    robot = models.load("mini_cheetah")
    body, srb = models.WholeBody(robot, terrain=ground), models.SingleRigidBody(robot, terrain=ground)
    objective, limits, effort = terms()
    schedule = body.over(0.16, dt=0.01).without(effort) + srb.over(0.2, dt=0.05).without(limits)
    return ocp.Problem(motion, schedule, objective + effort, limits, initial=body.state(joints="stand"))


MOTIONS = {
    "trot": lambda: models.gaits.trot(speed=0.5, yaw_rate=0.2, stance_time=0.15, height=0.24, ramp=0.3),
    "hop": lambda: hop_then(models.gaits.trot(speed=0.4, height=0.24)),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_ticks_in_c_equal_those_in_numpy_on_stairs(name):
    declared = problem(MOTIONS[name](), STAIRS)
    both = [
        solvers.RecedingHorizon(declared, iterations=1, first_iterations=4, backend=backend)
        for backend in ("native", "numpy")
    ]
    rng, t = np.random.default_rng(0), 0.0
    x = np.array(declared.initial)
    x[0] += 0.05  # not where it was declared
    steps = set()
    for _ in range(24):
        got, expected = (each.plan(x, t) for each in both)
        assert_same(got, expected, 1e-8)
        make_equal(both[0], got, both[1], expected)
        slots = got.parts[0].mode.layout.slots
        standing = got.parts[0].p[0][slots["contact"]] > 0
        steps |= {round(z, 9) for z in got.parts[0].p[0][slots["surfaces"]].reshape(-1, 3)[:4, 2][standing]}
        t = round(t + 0.02, 2)
        x = ahead(expected, t, rng, 1e-3)
    assert {0.0, 0.04} <= steps  # some feet stand on the floor, some on a step


# ---- landings


def hop(height=0.28):
    return ocp.Motion(
        ocp.Phase("push", stance("FL FR HL HR"), 0.12, ocp.Keyframe(position=(0.0, 0, 0.27))),
        ocp.Phase("air", stance(""), 0.12, ocp.Keyframe(position=(0.1, 0, height))),
        ocp.Phase("land", stance("FL FR HL HR"), 0.2, ocp.Keyframe(position=(0.1, 0, height))),
    )


@lru_cache(maxsize=1)
def hopping():
    return solvers.RecedingHorizon(problem(hop(), SLOPE), retiming=solvers.Retiming(limit=0.3, gain=1.0))


@pytest.mark.parametrize("shift", [0.0, 0.3, -0.3])
def test_a_landing_is_at_the_height_of_the_ground_where_the_robot_is(shift):
    """A robot that hops elsewhere on a slope, and as much higher, lands at the time of one that hops as declared."""
    mpc, found = hopping(), []
    mpc.reset()
    for moved in (0.0, shift):
        rise = moved * np.tan(SLOPE.angle)
        x, t = np.array(mpc.initial), 0.0
        mpc.reset()
        for _ in range(9):
            placed = x.copy()
            placed[0] += moved
            placed[2] += rise
            plan = mpc.plan(placed, t)
            t = round(t + 0.02, 2)
            x = ahead(plan, t, np.random.default_rng(0), 0.0)
            x[0] -= moved
            x[2] -= rise
            if t == 0.14:
                x[UP] += 0.2
        found.append((plan.shift, x))
    assert found[0][0] == found[1][0] > 0.0
    assert found[1][1] == pytest.approx(found[0][1], abs=1e-6)


def test_clocks_in_c_equal_those_in_numpy_on_a_slope():
    declared, retiming = problem(hop(), SLOPE), solvers.Retiming(limit=0.05, gain=0.7)
    both = [
        solvers.RecedingHorizon(declared, iterations=1, first_iterations=6, backend=backend, retiming=retiming)
        for backend in ("native", "numpy")
    ]
    rng, t, shifts = np.random.default_rng(4), 0.0, set()
    x = np.array(declared.initial)
    x[0] += 0.2
    for _ in range(14):
        got, expected = (each.plan(x, t) for each in both)
        assert got.shift == pytest.approx(expected.shift, abs=1e-12)
        assert_same(got, expected, 1e-8)
        make_equal(both[0], got, both[1], expected)
        shifts.add(round(got.shift, 3))
        t = round(t + 0.02, 2)
        x = ahead(expected, t, rng, 1e-3)
        if 0.12 < t < 0.22:
            x[UP] += 0.15
    assert len(shifts) > 1
