"""What acts during a stage is taken at its middle, by models on which something acts."""

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models import base, feet, joints, stance

ALL, DIAGONAL = "FL FR HL HR", "FL HR"
ROBOT = models.load("mini_cheetah")


def phases_of(model, first, dt=0.05):
    """Two phases that meet at ``first`` [s], a term for each, and a path that moves all the time."""
    motion = ocp.Motion(
        ocp.Phase("stand", stance(ALL), first, ocp.Keyframe(position=(0.1, 0, 0.26))),
        ocp.Phase("lift", stance(DIAGONAL), 0.3 - first, ocp.Keyframe(position=(0.4, 0, 0.3))),
    )
    objective = ocp.Objective(
        ocp.track(base.position, weight=ocp.by_phase(1.0, lift=3.0)), ocp.track(base.orientation, weight=1.0),
        ocp.track(base.linear_velocity, weight=1.0), ocp.track(base.angular_velocity, weight=1.0),
        ocp.regularize(feet.force, weight=0.01),
    )  # fmt: skip
    initial = models.WholeBody(ROBOT).state(joints="stand")[[*range(7), *range(19, 25)]]
    return ocp.compile_problem(ocp.Problem(motion, model.over(0.3, dt=dt), objective, initial=initial)).phases


def slots(phase, name):
    return phase.p[:, phase.mode.layout.slots[name]]


@pytest.mark.parametrize(("first", "stage"), [(0.1, 2), (0.12, 2), (0.125, 2), (0.13, 3), (0.14, 3), (0.15, 3)])
def test_a_stage_belongs_to_the_phase_at_its_middle(first, stage):
    (phase,) = phases_of(models.SingleRigidBody(ROBOT), first)
    flags = slots(phase, "contact")
    assert np.array_equal(np.flatnonzero(flags[:, 1] == 0), np.arange(stage, 6))  # FR leaves the ground
    assert np.all(flags[:, 0] == 1)
    heavy = phase.weight[:, :3].max(axis=1) == 3.0
    assert np.array_equal(np.flatnonzero(heavy), np.arange(stage, 6))


def test_footholds_and_forces_are_those_at_the_middle_and_states_those_at_the_start():
    model = models.SingleRigidBody(ROBOT)
    objective = ocp.Objective(
        ocp.track(base.position, weight=1.0), ocp.track(base.orientation, weight=1.0),
        ocp.track(base.linear_velocity, weight=1.0), ocp.track(base.angular_velocity, weight=1.0),
        ocp.track(feet.force, weight=0.01),
    )  # fmt: skip
    initial = models.WholeBody(ROBOT).state(joints="stand")[[*range(7), *range(19, 25)]]
    motion, schedule = models.gaits.trot(speed=0.5), model.over(0.5, dt=0.05)
    compiled = ocp.compile_problem(ocp.Problem(motion, schedule, objective, initial=initial))
    (phase,) = compiled.phases
    layout = phase.mode.layout
    keys = [key for key in layout.slices if key.kind == "target"]
    part = {compiled.terms[key.term].quantity.path: layout.slices[key] for key in keys}
    path = compiled.path
    for k, t in enumerate(phase.times[:-1]):
        start, middle = (path.sample(at, path.interval_at(at)) for at in (t, t + 0.025))
        assert phase.p[k, part["base.position"]] == pytest.approx(start[base.position], abs=1e-12)
        assert phase.p[k, part["feet.force"]] == pytest.approx(np.ravel(middle[feet.force]), abs=1e-12)
        assert slots(phase, "footholds")[k] == pytest.approx(np.ravel(middle[feet.position]), abs=1e-12)
    end = path.sample(0.5, path.interval_before(0.5))
    assert phase.p_end[part["base.position"]] == pytest.approx(end[base.position], abs=1e-12)


def test_a_simulator_s_stages_are_those_of_their_start():
    plant = models.Mujoco(ROBOT)
    motion = ocp.Motion(
        ocp.Phase("stand", stance(ALL), 0.11, ocp.Keyframe(joints="stand")),
        ocp.Phase("lift", stance(DIAGONAL), 0.09, ocp.Keyframe(joints="crouch")),
    )
    objective = ocp.Objective(ocp.track(joints.position, weight=ocp.by_phase(1.0, lift=3.0)))
    problem = ocp.Problem(motion, plant.over(0.2, dt=0.02), objective, initial=plant.state(joints="stand"))
    (phase,) = ocp.compile_problem(problem, checks=False).phases
    assert np.array_equal(phase.weight.max(axis=1), [1] * 6 + [3] * 4)  # the sixth stage begins at 100 ms
