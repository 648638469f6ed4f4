"""Targets from a trajectory of another robot are named before a solve, from memory and from a file."""

from dataclasses import replace

import pytest

from piaffe import models, ocp, solvers
from piaffe.models import base, joints, stance


def problem_of(name, motion=None):
    robot = models.load(name)
    body = models.WholeBody(robot)
    height = robot.base_height("stand")
    stand = ocp.Phase("stand", stance(roles="all"), 0.05, ocp.Keyframe(position=(0, 0, height), joints="stand"))
    objective = ocp.Objective(
        ocp.track(base.position, weight=10.0), ocp.track(joints.position, weight=1.0),
        ocp.regularize(joints.torque, weight=0.01),
    )  # fmt: skip
    return ocp.Problem(motion or ocp.Motion(stand), body.until_end(dt=0.01), objective, initial=body.state())


def warnings_of(problem):
    return [f"{one.where}: {one.text}" for one in ocp.find_warnings(ocp.compile_problem(problem))]


@pytest.fixture(scope="module")
def stand():
    return solvers.MSiLQR(problem_of("mini_cheetah"), solvers.Options(max_iterations=1), backend="numpy").solve()


def test_a_trajectory_of_this_robot_has_no_warning(stand):
    assert warnings_of(problem_of("mini_cheetah", ocp.Motion.from_solution(stand))) == []


def test_a_trajectory_of_another_robot_is_named(stand):
    (told,) = [each for each in warnings_of(problem_of("solo12", ocp.Motion.from_solution(stand))) if "targets" in each]
    assert "the targets are of another robot - got a trajectory of 'mini_cheetah', expected one of 'solo12'" in told


def test_so_is_one_from_a_file(stand, tmp_path):
    again = solvers.Solution.load(stand.save(tmp_path / "stand.npz"))
    assert warnings_of(problem_of("mini_cheetah", ocp.Motion.from_solution(again))) == []
    told = [each for each in warnings_of(problem_of("solo12", ocp.Motion.from_solution(again))) if "targets" in each]
    assert len(told) == 1
    assert "standing foot is not on the ground in the trajectory of the targets - got FL 0." in told[0]
    assert "the trajectory is of model 'mini_cheetah'" in told[0]


def test_a_changed_copy_of_a_robot_is_the_same_robot(stand):
    heavier = replace(
        models.load("mini_cheetah"), name="strong", torque_limit=models.load("mini_cheetah").torque_limit * 2
    )
    body = models.WholeBody(heavier)
    declared = problem_of("mini_cheetah", ocp.Motion.from_solution(stand))
    changed = ocp.Problem(declared.motion, body.until_end(dt=0.01), declared.objective, initial=body.state())
    assert warnings_of(changed) == []
