"""The loop of a planner, a low level and a plant, against a loop of ``mj_step`` written here."""

import json
from math import inf, pi
from typing import Any

import mujoco
import numpy as np
import pytest

from piaffe import models
from piaffe.errors import ModelError, ShapeError
from piaffe.simulation import Actuators, Command, Perturbation, Plant, Push, SensorNoise, run_online, torque_plant
from tests.simulation.online import KD, KP, STAND, Angles, Springs, Sway
from tests.simulation.plans import BODY, ROBOT

START = BODY.state(joints="stand")


def stepped(steps: int, lag: int, tick: int, start: float = 0.0) -> np.ndarray:
    """Return the states at every millisecond of a plan each 20 ms, whose targets act ``lag`` ms later."""
    model, sway = torque_plant(ROBOT).compiled(), Sway()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = START[:19], START[19:]
    stiff = ROBOT.torque_limit / 0.675
    states, target, measured, control = [START], None, START, np.zeros(12)
    for i in range(steps):
        x = np.concatenate([data.qpos, data.qvel])
        if i % 20 == 0:
            measured = x
        new = i % 20 == lag
        if new:
            target = sway.target(measured, start + (i - lag) * 1e-3)
        if target is None:
            control = stiff * (STAND - x[7:19]) - 0.02 * stiff * x[25:37]
        elif new or (i % 20) % tick == 0:
            control = KP * (target - x[7:19]) - KD * x[25:37]
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(states)


@pytest.mark.parametrize(("tick", "lag"), [(1, 0), (2, 0), (4, 7), (2, 12), (2, 19)])
def test_a_plan_acts_after_its_latency_and_the_low_level_ticks_in_between(tick: int, lag: int) -> None:
    planner, low = Sway(), Springs()
    made = run_online(
        planner, low, Plant(ROBOT), seconds=0.13, tick=1e-3 * tick, latency=1e-3 * lag, initial=START, start=0.5
    )
    expected = stepped(130, lag, tick, start=0.5)
    np.testing.assert_allclose(made.last, expected[-1], atol=1e-9)
    np.testing.assert_allclose(made.states, expected[np.round(1e3 * (made.times - 0.5)).astype(int)], atol=1e-9)
    np.testing.assert_allclose([t for t, _ in planner.calls], 0.5 + 0.02 * np.arange(7 if lag <= 10 else 6), atol=1e-12)
    np.testing.assert_allclose([x for _, x in planner.calls], expected[: 20 * len(planner.calls) : 20], atol=1e-9)
    assert low.ticks[0] == pytest.approx(0.5 + 1e-3 * lag)
    assert np.abs(np.diff(low.ticks)).max() == pytest.approx(1e-3 * tick)
    assert np.ptp(made.states[:, 7:19], axis=0).max() > 0.05  # it moved
    assert made.end == pytest.approx(0.63)
    assert (planner.resets, made.success, made.fault) == (1, True, "")


def test_a_latency_of_a_whole_period_delays_each_plan_by_one() -> None:
    made = run_online(Sway(), Springs(), Plant(ROBOT), seconds=0.1, tick=1e-3, latency=0.02, initial=START)
    model, sway = torque_plant(ROBOT).compiled(), Sway()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = START[:19], START[19:]
    measured: list[np.ndarray] = []
    stiff = ROBOT.torque_limit / 0.675
    for i in range(100):
        x = np.concatenate([data.qpos, data.qvel])
        if i % 20 == 0:
            measured.append(x)
        if i < 20:
            data.ctrl[:] = stiff * (STAND - x[7:19]) - 0.02 * stiff * x[25:37]
        else:
            target = sway.target(measured[i // 20 - 1], 0.02 * (i // 20 - 1))
            data.ctrl[:] = KP * (target - x[7:19]) - KD * x[25:37]
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(made.last, np.concatenate([data.qpos, data.qvel]), atol=1e-9)
    assert np.nanmax(made.ages) == pytest.approx(0.039)
    assert np.isnan(made.ages[:20]).all()


def test_ages_iterations_and_statuses_are_those_of_the_plans() -> None:
    made = run_online(Sway(), Springs(), Plant(ROBOT), seconds=0.06, latency=0.008, initial=START)
    np.testing.assert_allclose(made.plans.times, [0.0, 0.02, 0.04], atol=1e-12)
    assert made.plans.statuses == ("CONVERGED",) * 3
    np.testing.assert_array_equal(made.plans.iterations, 3)
    acting = made.times >= 0.008 - 1e-9
    np.testing.assert_allclose(made.ages[acting], (made.times[acting] - 0.008) % 0.02 + 0.008, atol=1e-9)
    assert np.isnan(made.ages[~acting]).all()
    assert np.all(made.tick_seconds[acting] >= 0)
    assert np.all(made.plans.seconds >= 0)


def test_without_a_planner_the_low_level_follows_the_plan_that_it_has() -> None:
    low = Springs(Angles(STAND, np.array([1, 1, 1, 0])))
    made = run_online(None, low, Plant(ROBOT), seconds=0.05, latency=0.02, initial=START)
    assert low.ticks[0] == 0.0  # no plan is made, so there is no latency
    np.testing.assert_array_equal(made.planned, np.tile([1, 1, 1, 0], (len(made.times), 1)))
    assert len(made.plans.times) == 0


def test_commands_reach_the_planner_before_the_first_plan_at_their_time() -> None:
    planner = Sway()
    made = run_online(
        planner, Springs(), Plant(ROBOT), seconds=0.1, initial=START,
        commands=(Command(0.05, {"speed": 0.2, "height": 0.2}), Command(0.0, {"speed": 0.1, "yaw_rate": -0.3})),
    )  # fmt: skip
    assert planner.told == [(0, {"speed": 0.1, "yaw_rate": -0.3}), (3, {"speed": 0.2, "height": 0.2})]
    early, late = made.commands[made.times < 0.0599], made.commands[made.times > 0.0599]
    np.testing.assert_array_equal(early, np.tile([0.1, 0.0, -0.3], (len(early), 1)))
    np.testing.assert_array_equal(late, np.tile([0.2, 0.0, -0.3], (len(late), 1)))


def test_a_low_level_that_measures_contacts_gets_the_feet_on_the_ground() -> None:
    low, seen = Springs(Angles(STAND)), []
    own = low.control
    low.measures_contacts = True  # type: ignore[attr-defined]

    def control(x: np.ndarray, t: float, contacts: np.ndarray) -> np.ndarray:
        seen.append(contacts)
        return own(x, t)

    low.control = control  # type: ignore[method-assign, assignment]
    dropped = BODY.state(joints="stand", position=(0, 0, ROBOT.base_height() + 0.01), rpy=(0.02, 0.03, 0))
    made = run_online(None, low, Plant(ROBOT), seconds=0.2, initial=dropped)
    np.testing.assert_array_equal(np.array(seen, dtype=bool), made.touching)
    counts = np.sum(seen, axis=1)
    assert counts[0] == 0
    assert {1, 4} <= set(counts)


def test_a_control_that_is_not_finite_ends_the_episode_and_names_the_joint() -> None:
    low = Springs(Angles(STAND))
    low.spoil[5] = np.where(np.arange(12) == 4, np.nan, 0.0)
    made = run_online(None, low, Plant(ROBOT), seconds=0.1, tick=0.002, initial=START)
    assert made.fault == f"the control is not finite: {ROBOT.joint_names[4]}"
    assert made.end == pytest.approx(0.010)
    assert (made.fell, made.success) == (True, False)
    assert np.all(np.isfinite(made.last))
    assert json.loads(json.dumps(made.summary()))["fault"] == made.fault


def test_a_fall_ends_the_episode_and_says_why() -> None:
    tilted = BODY.state(joints="stand", position=(0, 0, 0.3), rpy=(1.3, 0, 0))
    made = run_online(None, Springs(Angles(STAND)), Plant(ROBOT), seconds=0.1, initial=tilted)
    assert (made.end, made.fault) == (0.0, "the base is tilted by more than 1.2 rad")
    limp = Springs(Angles(STAND))
    limp.control = lambda x, t: np.zeros(12)  # type: ignore[method-assign]
    sunk = run_online(None, limp, Plant(ROBOT), seconds=1.0, initial=START)
    assert "the base is lower than" in sunk.fault
    assert 0.05 < sunk.end < 1.0
    lying = run_online(None, limp, Plant(ROBOT), seconds=0.5, initial=START, fall=models.Fall(tilt=pi, height=-inf))
    assert not lying.fell
    assert lying.upright == lying.success


def test_a_simulation_that_diverges_ends_the_episode() -> None:
    low = Springs(Angles(STAND))
    low.control = lambda x, t: np.full(12, 1e7)  # type: ignore[method-assign]
    plant = Plant(ROBOT, actuators=Actuators(torque_limit=np.inf))
    made = run_online(None, low, plant, seconds=0.1, initial=START)
    assert made.fault == "the simulation diverged"
    assert made.end <= 0.004
    assert np.all(np.isfinite(made.last))


def test_random_starts_are_around_the_state_of_a_plant() -> None:
    plant = Plant(ROBOT)
    starts = [Perturbation().around(plant.model, START, seed) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(starts[0], starts[1])
    assert not np.array_equal(starts[0], starts[2])
    assert run_online(None, Springs(Angles(STAND)), plant, seconds=0.01, initial=starts[2]).success


def test_a_robot_that_lies_on_its_side_at_the_end_has_no_success() -> None:
    tilted = BODY.state(joints="stand", position=(0, 0, 1.0), rpy=(1.0, 0, 0))
    made = run_online(None, Springs(Angles(STAND)), Plant(ROBOT), seconds=0.02, initial=tilted)
    assert (made.fell, made.upright, made.success) == (False, False, False)


def test_the_height_of_a_fall_is_above_the_ground_below_the_base() -> None:
    high = models.terrain.flat(2.0)
    on_top = BODY.state(joints="stand", position=(0, 0, 2.0 + ROBOT.base_height()))
    made = run_online(None, Springs(Angles(STAND)), Plant(ROBOT, terrain=high), seconds=0.02, initial=on_top)
    assert not made.fell
    assert run_online(None, Springs(Angles(STAND)), Plant(ROBOT, terrain=high), seconds=0.02, initial=START).fell


def test_noise_is_what_planner_and_low_level_see_and_it_follows_from_the_seed() -> None:
    noise = SensorNoise(joints=0.01, orientation=0.02, joint_velocity=0.1)
    runs = []
    for seed in (4, 4, 5):
        planner, low = Sway(), Springs()
        made = run_online(planner, low, Plant(ROBOT, noise=noise), seconds=0.2, initial=START, seed=seed)
        runs.append(made)
        np.testing.assert_array_equal(made.estimates, low.seen)
        np.testing.assert_array_equal(planner.calls[3][1], low.seen[30])  # one measurement for both
    np.testing.assert_array_equal(runs[0].states, runs[1].states)
    assert not np.array_equal(runs[0].states, runs[2].states)
    off = np.array([BODY.state.np_minus(a, b) for a, b in zip(runs[0].estimates, runs[0].states, strict=True)])
    assert off[:, 6:18].std() == pytest.approx(0.01, rel=0.1)
    assert off[:, 3:6].std() == pytest.approx(0.02, rel=0.15)
    assert off[:, 24:36].std() == pytest.approx(0.1, rel=0.1)
    assert not off[:, [0, 1, 2, 18, 19, 20, 21, 22, 23]].any()


def test_one_tick_of_so_many_is_recorded_and_the_motion_is_the_same() -> None:
    every = run_online(Sway(), Springs(), Plant(ROBOT), seconds=0.1, initial=START)
    few = run_online(Sway(), Springs(), Plant(ROBOT), seconds=0.1, initial=START, every=7)
    np.testing.assert_array_equal(few.last, every.last)
    for name in ("times", "states", "controls", "torques", "limited", "forces"):
        np.testing.assert_array_equal(getattr(few, name), getattr(every, name)[::7])


def test_the_first_state_is_the_planners_or_the_robot_stands() -> None:
    made = run_online(Sway(), Springs(), Plant(ROBOT), seconds=0.002)
    np.testing.assert_allclose(made.states[0], START, atol=1e-9)
    planner: Any = Sway()
    planner.initial = BODY.state(joints="crouch")
    np.testing.assert_array_equal(
        run_online(planner, Springs(), Plant(ROBOT), seconds=0.002).states[0], planner.initial
    )


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"tick": 0.0015}, r"online: tick is out of range - got 0.0015 s, expected a multiple of 0.001 s, at least"),
        ({"tick": 0.0}, "tick is out of range - got 0 s"),
        ({"tick": np.nan}, "online: tick is not a number - got nan, expected a finite number"),
        ({"tick": 0.003}, "planner's period is out of range - got 0.02 s, expected a multiple of 0.003 s"),
        ({"latency": 0.0123}, "latency is out of range - got 0.0123 s, expected a multiple of 0.001 s"),
        ({"latency": -0.002}, "latency is out of range - got -0.002 s"),
        ({"latency": 0.021}, "latency is out of range - got 0.021 s, expected at most the planner's period, 0.02 s"),
        ({"seconds": 0.0}, "seconds is out of range - got 0 s"),
        ({"seconds": inf}, "seconds is not a number - got inf"),
        ({"every": 0}, "every is out of range - got 0, expected a whole number"),
        ({"start": "soon"}, "start is not a number - got 'soon'"),
        ({"initial": np.full(37, np.nan)}, "state is not finite"),
        ({"pushes": (Push(time=0.0105, velocity=(1, 0, 0)),) , "tick": 0.001, "start": 0.0002}, "push: time after the"),
        ({"pushes": (Push(time=0.1, velocity=(1, 0, 0), duration=0.0015),)}, "push: duration is out of range"),
        ({"pushes": (Push(time=0.1, velocity=(1, 0, 0)),), "start": 0.5}, "push: time after the start at 0.5 s"),
    ],
)  # fmt: skip
def test_numbers_out_of_range_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ModelError, match=text):
        run_online(Sway(), Springs(), Plant(ROBOT), **{"seconds": 0.1, "initial": START, **changes})


def test_states_and_controls_of_another_size_and_planners_without_commands_are_refused() -> None:
    with pytest.raises(ShapeError, match=r"state has the wrong size - got shape \(36,\), expected \(37,\)"):
        run_online(Sway(), Springs(), Plant(ROBOT), seconds=0.1, initial=np.zeros(36))
    low = Springs(Angles(STAND))
    low.spoil[0] = np.zeros(11)
    with pytest.raises(ShapeError, match=r"control has the wrong size - got shape \(11,\), expected \(12,\)"):
        run_online(None, low, Plant(ROBOT), seconds=0.1, initial=START)
    with pytest.raises(ModelError, match="the planner takes no commands - got 1 of them and None"):
        run_online(None, low, Plant(ROBOT), seconds=0.1, initial=START, commands=(Command(0.0, {"speed": 1.0}),))
