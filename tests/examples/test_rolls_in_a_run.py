"""Rolls and a front flip in a run: what their paths promise, and one plant each."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from piaffe import models, simulation
from piaffe.models import feet

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture(scope="module")
def load():
    """Import examples by their names, as those that build on each other do."""
    sys.path.insert(0, str(EXAMPLES))
    yield importlib.import_module
    sys.path.remove(str(EXAMPLES))


def phases_of(problem):
    """Return the phases of the path that the motion in the middle follows."""
    return problem.motion.pieces[1].reference.trajectory.phases


def test_the_running_roll_begins_out_of_the_stance_of_one_side(load):
    placed = load("running_roll").problem().motion.intervals()
    phases = [next(placed).phase for _ in range(10)]
    assert [phase.name for phase in phases[-3:]] == ["right", "left", "lean"]
    assert phases[-1].mode == "FR HR"
    assert all(phase.name != "stand" for phase in phases[1:])  # all feet stand at the very start alone


def test_the_path_of_the_running_roll_clears_the_bar_within_every_limit(load):
    module = load("running_roll")
    path = phases_of(module.problem())
    states = np.vstack([phase.states for phase in path])
    shapes = models.mujoco_model(module.robot, hull=True)
    assert simulation.highest_bar(shapes, states).height >= 0.45
    assert states[:, 2].max() >= 0.55
    for phase in path:
        assert np.abs(phase.controls).max() <= 0.9 * module.robot.torque_limit.max() + 1e-3
        if phase.name in ("flight", "hop"):  # they land: impulses are within the cone of the ground
            impulse = phase.reset_outputs[feet.impulse].reshape(4, 3)
            assert np.all(np.abs(impulse[:, :2]) <= 0.6 * impulse[:, 2:] + 1e-3)


def test_the_robot_runs_in_rolls_over_a_bar_and_runs_on(load, capsys):
    assert load("running_roll").main(seeds=1, first=500) == 1.0
    assert "seed 500: upright, " in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("gait", ["trot", "pace"])
def test_a_gait_stops_on_all_feet_rolls_and_goes_on(gait, load):
    assert load("run_roll_run_mpc").main(seeds=2, first=500, gait=gait) == 1.0


@pytest.mark.slow
def test_the_robot_flips_forwards_in_a_run(load):
    module = load("front_flip_run")
    problem = module.problem()
    flight = next(phase for phase in phases_of(problem) if phase.name == "flight")
    turned = np.sum(np.diff(flight.times) * flight.states[:-1, 23])  # about the base's y axis
    assert 0.6 * np.pi < turned < 2 * np.pi  # what the stances before and after it leave of a full turn
    assert module.main(seeds=2, first=500) == 1.0
