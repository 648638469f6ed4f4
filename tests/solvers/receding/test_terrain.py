"""A receding horizon on terrain: ticks in C equal those in NumPy, landings are where the ground is, a robot climbs."""

from functools import lru_cache

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.models import base, feet, stance, terrain
from piaffe.simulation import Plant, run_online

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


def swing(s):
    return 1 - s.feet.contact


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


# ---- closed loop


@pytest.mark.parametrize("ground", [STAIRS, terrain.incline(0.18, start=0.3)], ids=["stairs", "slope"])
def test_a_trot_goes_up(ground):
    """On a plant with less friction, from a start that is not the declared one."""
    declared = problem(models.gaits.trot(speed=0.5, height=0.25, velocity_gain=0.02), ground)
    declared = ocp.Problem(
        declared.motion, declared.schedule,
        declared.objective + ocp.track(base.position, weight=(0, 0, 50)) + ocp.track(base.linear_velocity, weight=10.0)
        + ocp.track(feet.position, weight=10.0, mask=swing) + ocp.track(feet.velocity, weight=1.0, mask=swing),
        declared.constraints, initial=declared.initial,
    )  # fmt: skip
    mpc = solvers.RecedingHorizon(declared)
    low = solvers.Vwbc(mpc.plan(declared.initial, 0.0), leave_out=("base.position x", "base.position y"))
    robot, start = models.load("mini_cheetah"), declared.initial.copy()
    start[0], start[1] = 0.08, -0.05
    episode = run_online(mpc, low, Plant(robot, friction=0.6, terrain=ground), seconds=3.0, initial=start)
    assert not episode.fault
    x = episode.last
    above = x[2] - float(ground.height(x[0], x[1]))
    assert x[0] > 0.9
    assert above == pytest.approx(0.25, abs=0.05)
    assert episode.summary()["fallbacks"] == 0
