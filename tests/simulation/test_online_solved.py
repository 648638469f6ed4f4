"""Solved motions on a plant: the low levels of ``piaffe.solvers`` in the online loop."""

import json
from functools import cache
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from piaffe import models, ocp, solvers
from piaffe.simulation import Actuators, Plant, SensorNoise, parse_pushes, planned_contacts, run_online
from piaffe.solvers.tracking import stage_at

ROLL = ocp.load_problem(str(Path(__file__).parents[2] / "examples" / "barrel_roll.py"))
ROBOT = models.load("mini_cheetah")
ROLLS = models.Fall(tilt=pi, height=0.08)


@cache
def plan() -> solvers.SolvedPlan:
    compiled = ocp.compile_problem(ROLL)
    return solvers.SolvedPlan(solvers.MSiLQR(compiled).solve().raise_if_failed(), compiled)


def run(low: Any, plant: Plant | None = None, **changes: Any) -> Any:
    plant = plant or Plant(ROBOT)
    seconds = round(float(plan().phases[-1].times[-1]), 6)
    return run_online(None, low, plant, seconds=seconds, fall=ROLLS, **changes)


def test_a_roll_executes_with_the_low_level_that_minimises_the_action_value() -> None:
    low = solvers.Vwbc(plan())
    made = run(low)
    assert made.success
    assert made.excess()["torque"] == 0.0
    assert (made.fallbacks, made.relaxed, made.damped) == (low.fallbacks, low.relaxed, low.damped)
    assert len(made.times) == low.ticks
    assert len(made.touchdowns) == 8  # four feet land twice
    assert all(each.late is not None and abs(each.late) <= 0.02 for each in made.touchdowns)
    rolled = made.states[made.times > 0.4][0, made.space.slices[models.base.orientation]]
    assert rolled[0] < 0.8  # on its side
    assert json.loads(json.dumps(made.summary()))["success"] is True


def test_planned_contacts_are_those_of_the_low_level() -> None:
    made = run(solvers.Riccati(plan()))
    for t, flags in zip(made.times[::20], made.planned[::20], strict=True):
        stage = stage_at(plan(), t)
        np.testing.assert_array_equal(flags, stage.p[stage.mode.layout.slots["contact"]])
    assert planned_contacts(solvers.Riccati(plan())) is not None
    assert set(np.unique(made.planned)) == {0.0, 1.0}


def test_a_disturbed_plant_disturbs_and_says_so() -> None:
    plain = run(solvers.Vwbc(plan()))
    pushed = run(solvers.Vwbc(plan()), pushes=parse_pushes("0.3@0.1:y"))
    noisy = run(solvers.Vwbc(plan()), Plant(ROBOT, noise=SensorNoise(joints=0.005)))
    weak = run(solvers.Vwbc(plan()), Plant(ROBOT, actuators=Actuators(torque_limit=9.0)))
    for other in (pushed, noisy, weak):
        n = min(len(plain.states), len(other.states))
        assert np.abs(other.states[:n] - plain.states[:n]).max() > 0.05
    assert weak.limited.mean() > plain.limited.mean()
    assert weak.excess()["torque"] > 1.0
