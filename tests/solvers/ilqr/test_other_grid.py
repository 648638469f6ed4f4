"""Warm starts from solutions with other time steps, durations or horizons, and those of others that are refused."""

from pathlib import Path

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import SolverError
from piaffe.models import base, joints, stance

FOUR = stance("FL FR HL HR")
ROOT = Path(__file__).parents[3]


def hop(dt=0.02, push=0.2, name="solo12", land="land", phases=3):
    robot = models.load(name)
    body = models.WholeBody(robot)
    height = robot.base_height()
    keyframe = ocp.Keyframe(position=(0, 0, height))
    motion = [
        ocp.Phase("push", FOUR, push, keyframe), ocp.Phase("fly", stance(""), 0.12, keyframe),
        ocp.Phase(land, FOUR, 0.2, keyframe),
    ]  # fmt: skip
    objective = ocp.Objective(
        ocp.track(base.position, weight=30.0), ocp.track(base.orientation, weight=20.0),
        ocp.track(joints.position, weight=1.0), ocp.track(joints.velocity, weight=0.01),
        ocp.regularize(joints.torque, weight=0.05),
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(0.6), models.torque_limits())
    return ocp.Problem(
        ocp.Motion(*motion[:phases]), body.until_end(dt=dt), objective, limits, initial=body.state(joints="stand")
    )


@pytest.fixture(scope="module")
def coarse() -> solvers.Solution:
    return solvers.MSiLQR(hop()).solve().raise_if_failed()


@pytest.mark.parametrize("backend", ["native", "numpy"])
@pytest.mark.parametrize("options", [{"dt": 0.01}, {"push": 0.24}, {"dt": 0.005, "push": 0.16}, {"phases": 2}])
def test_a_solution_of_another_grid_is_interpolated_phase_by_phase(coarse, options, backend) -> None:
    solver = solvers.MSiLQR(hop(**options), backend=backend)
    start = solver.start(coarse)
    parts = coarse.trajectory.phases[: len(start.states)]
    for x, u, phase, part in zip(start.states, start.controls, solver.problem.phases, parts, strict=True):
        assert x.shape == (phase.num_stages + 1, phase.mode.state.nx)
        assert u.shape == (phase.num_stages, phase.mode.nu)
        assert np.allclose(x[-1], part.states[-1], atol=1e-12)
        assert np.allclose(np.linalg.norm(x[:, 3:7], axis=1), 1.0, atol=1e-12)
        share = np.linspace(0, 1, len(x))
        on_line = np.interp(share, np.linspace(0, 1, len(part.states)), part.states[:, 2])
        assert np.allclose(x[:, 2], on_line, atol=1e-12)
        assert np.array_equal(u[0], part.controls[0])


def test_it_saves_iterations() -> None:
    """The backflip with half its time step: 39 iterations in place of 56."""
    problem = ocp.load_problem(str(ROOT / "examples" / "backflip.py"))
    earlier, (segment,) = solvers.MSiLQR(problem).solve(), problem.schedule.segments
    solver = solvers.MSiLQR(problem.with_schedule(segment.model.until_end(dt=segment.dt / 2)))
    cold, warm = solver.solve(), solver.solve(earlier)
    assert cold.converged
    assert warm.converged
    assert warm.iterations <= cold.iterations - 8
    assert warm.cost == pytest.approx(cold.cost, rel=1e-4)


def test_phases_of_one_name_are_taken_in_their_order() -> None:
    def problem(dt):
        robot = models.load("mini_cheetah")
        body = models.WholeBody(robot)
        objective = ocp.Objective(ocp.track(base.position, weight=1.0), ocp.regularize(joints.torque, weight=0.1))
        motion = models.gaits.trot(speed=0.3).cycles(2)
        return ocp.Problem(motion, body.until_end(dt=dt), objective, initial=body.state(joints="stand"))

    found = solvers.MSiLQR(problem(0.01), solvers.Options(max_iterations=2)).solve()
    solver = solvers.MSiLQR(problem(0.005), backend="numpy")
    ahead = [x[-1, 0] for x in solver.start(found).states]
    assert np.allclose(ahead, [part.states[-1, 0] for part in found.trajectory.phases], atol=1e-12)
    assert len({phase.name for phase in found.trajectory.phases}) < len(ahead)


def test_a_solution_without_a_phase_is_refused(coarse) -> None:
    with pytest.raises(SolverError, match=r"warm start: does not fit .*'push' of 'solo12', .* phase 1 of 'settle'"):
        solvers.MSiLQR(hop(dt=0.01, land="settle")).solve(coarse)


def test_a_solution_of_another_robot_is_refused(coarse) -> None:
    """Solo12 and Mini Cheetah have states and controls of the same sizes."""
    with pytest.raises(SolverError, match=r"is of other models - got \['solo12'\], expected 'mini_cheetah'"):
        solvers.MSiLQR(hop(name="mini_cheetah")).solve(coarse)
