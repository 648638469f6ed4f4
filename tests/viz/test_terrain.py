"""Films and figures of motions on terrain."""

import mujoco
import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.models import base, joints, stance, terrain
from piaffe.simulation.declared_plant import declared_ground
from piaffe.viz import Playback
from piaffe.viz.curves import forces

SLOPE = terrain.incline(0.2, start=-np.inf)


@pytest.fixture(scope="module")
def solved():
    robot = models.load("go2")
    body = models.WholeBody(robot, terrain=SLOPE)
    x = body.state(rpy=(0, -0.2, 0), joints="stand")
    key = ocp.Keyframe(position=tuple(x[:3]), rpy=(0, -0.2, 0), joints="stand")
    motion = ocp.Motion(ocp.Phase("stand", stance(roles="all"), 0.1, key))
    objective = ocp.Objective(
        ocp.track(base.position, weight=10.0), ocp.track(base.orientation, weight=10.0),
        ocp.track(joints.velocity, weight=0.1), ocp.regularize(joints.torque, weight=0.01),
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(0.6))
    problem = ocp.Problem(motion, body.until_end(dt=0.02), objective, limits, initial=x)
    return problem, solvers.MSiLQR(problem, backend="numpy").solve()


def test_a_saved_solution_knows_its_ground(solved, tmp_path):
    problem, solution = solved
    playback = Playback(solvers.Solution.load(solution.save(tmp_path / "stand.npz")))
    assert playback.terrain == SLOPE
    model = playback.scene().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.geom("floor").xmat.reshape(3, 3)[:, 2] == pytest.approx([-np.sin(0.2), 0, np.cos(0.2)], abs=1e-12)
    assert declared_ground(ocp.compile_problem(problem)) == SLOPE


def test_a_figure_shows_forces_against_the_ground(solved):
    _, solution = solved
    _, shown = forces(solution)
    part = solution.trajectory.phases[0]
    world = next(value for quantity, value in part.outputs.items() if quantity.path == "feet.force").reshape(-1, 4, 3)
    normal = np.array([-np.sin(0.2), 0.0, np.cos(0.2)])
    assert shown[:-1, :, 2] == pytest.approx(world @ normal, abs=1e-9)
    assert np.all(np.abs(shown[..., :2]).max(axis=-1) <= 0.6 * shown[..., 2] + 1e-3)
