"""What a motion amounts to."""

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models import measures, stance
from piaffe.ocp import PhaseTrajectory, Trajectory, rotation


def spinning(body: models.WholeBody, rolls: np.ndarray, heights: np.ndarray) -> Trajectory:
    states = np.array(
        [body.state(position=(0, 0, z), rpy=(roll, 0, 0)) for roll, z in zip(rolls, heights, strict=True)]
    )
    times = 0.1 * np.arange(len(states))
    controls = np.zeros((len(states) - 1, 12))
    return Trajectory(
        (PhaseTrajectory("spin", "", "mini_cheetah", times, states, controls, {}, body.state, body.control),)
    )


def test_turns_keep_their_winding() -> None:
    body = models.WholeBody(models.load("mini_cheetah"))
    rolls = np.linspace(0, 4 * np.pi + 0.3, 30)
    motion = spinning(body, rolls, 0.4 + 0.1 * np.sin(rolls / 4))
    assert measures.turns(motion) == pytest.approx([4 * np.pi + 0.3, 0, 0], abs=1e-12)
    assert measures.apex(motion) == pytest.approx(0.5, abs=1e-3)


def test_turns_do_not_mind_the_sign_of_quaternions() -> None:
    body = models.WholeBody(models.load("mini_cheetah"))
    motion = spinning(body, np.linspace(0, 3, 10), np.full(10, 0.3))
    motion.phases[0].states[4:, 3:7] *= -1
    assert measures.turns(motion) == pytest.approx([3, 0, 0])
    assert rotation.np_to_rpy(motion.phases[0].states[-1, 3:7])[0] == pytest.approx(3)


def test_lowest_foot_is_relative_to_terrain_and_radius() -> None:
    body = models.WholeBody(models.load("mini_cheetah"))
    motion = ocp.Motion(ocp.Phase("spin", stance("FL FR HL HR"), 0.2))
    objective = ocp.Objective(ocp.regularize("joints.torque"))
    low = body.state()[2]
    trajectory = spinning(body, np.zeros(3), np.array([low + 0.1, low + 0.05, low + 0.2]))
    for terrain in (0.0, 0.02):
        problem = ocp.Problem(
            motion,
            body.until_end(dt=0.1),
            objective,
            initial=body.state(),
            parameters={"mini_cheetah.terrain": terrain},
        )
        assert measures.lowest_foot(ocp.compile_problem(problem, checks=False), trajectory) == pytest.approx(
            0.05 - terrain
        )


def test_models_without_a_base_have_no_measures() -> None:
    ball = ocp.Model("ball", state={"z": 1}, modes={"rest": lambda s: {"z": 0.0}})
    states = np.zeros((2, 1))
    part = PhaseTrajectory(
        "rest", "rest", "ball", np.arange(2.0), states, np.zeros((1, 0)), {}, ball.state, ball.control
    )
    assert measures.turns(Trajectory((part,))) is None
    assert measures.apex(Trajectory((part,))) is None
