"""A robot scaled in length, with masses, times and weights scaled alike, takes the same iterations."""

from functools import cache

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models import base, feet, joints, stance
from piaffe.ocp import compile_problem
from piaffe.solvers import MSiLQR, Solution

from ..robots import scaled

SIZES = (0.01, 0.1, 10.0)


def hop(robot: models.Robot, size: float, *, rigid: bool = False) -> ocp.Problem:
    """Return a hop of a whole quadruped, or of one rigid body: crouch, flight, landing, 0.1 lengths ahead.

    Args:
        robot: the robot of this size.
        size: its lengths, relative to those of the robot for which the numbers are.
        rigid: whether it is one rigid body.
    """
    time, mass, height, four = size**0.5, size**3, robot.base_height("stand"), stance(roles="all")
    body = models.SingleRigidBody(robot) if rigid else models.WholeBody(robot)
    pose = {} if rigid else {"joints": "stand"}

    def phase(name: str, on: models.Stance, duration: float, x: float, lift: float, pitch: float) -> ocp.Phase:
        keyframe = ocp.Keyframe(position=(x * size, 0, lift * height), rpy=(0, pitch, 0), **pose)
        return ocp.Phase(name, on, duration * time, keyframe)

    motion = ocp.Motion(
        phase("push", four, 0.18, 0.03, 1.15, -0.1), phase("fly", stance(""), 0.1, 0.08, 1.1, 0.0),
        phase("land", four, 0.16, 0.1, 1.0, 0.0),
    )  # fmt: skip
    place, running = np.array([1.0, 1.0, 30.0]) / size**2, 1 / time  # running costs are integrals over time
    costs = [
        ocp.track(base.position, weight=place * running), ocp.track(base.orientation, weight=5 * running),
        ocp.track(base.linear_velocity, weight=running / size), ocp.track(base.angular_velocity, weight=running * size),
        ocp.track(base.position, weight=place, at="end"), ocp.track(base.orientation, weight=5.0, at="end"),
    ]  # fmt: skip
    limits = [
        models.friction_cone(0.6),
        ocp.inequality(lambda s: s.base.position[2], lower=0.6 * height, unit="m", name="belly"),
    ]
    if rigid:
        costs.append(ocp.regularize(feet.force, weight=1e-4 * running / mass**2))
        initial = body.state(position=(0, 0, height))
    else:
        costs += [
            ocp.track(joints.position, weight=running), ocp.track(joints.velocity, weight=0.02 * running * size),
            ocp.regularize(joints.torque, weight=0.03 * running / (mass * size) ** 2),
        ]  # fmt: skip
        limits += [models.torque_limits(0.9), models.joint_limits(), models.joint_speed_limits()]
        limits.append(models.foot_clearance())
        initial = body.state(joints="stand")
    return ocp.Problem(
        motion, body.until_end(dt=0.01 * time), ocp.Objective(*costs), ocp.Constraints(*limits), initial=initial
    )


def mini_cheetah() -> models.Robot:
    return models.load("mini_cheetah", rotors=True, joint_damping=0.01, joint_friction=0.1)


@cache
def solved(name: str, size: float) -> Solution:
    robot = mini_cheetah() if name == "mini_cheetah" else models.load(name)
    return MSiLQR(hop(scaled(robot, size), size), backend="numpy").solve()


@pytest.mark.parametrize("size", SIZES)
def test_a_similar_quadruped_takes_the_same_iterations(size: float) -> None:
    """Mini Cheetah has natural sizes of 1, so the others solve the same numbers."""
    reference, solution = solved("mini_cheetah", 1.0), solved("mini_cheetah", size)
    assert reference.converged, reference.explain()
    assert solution.converged, solution.explain()
    assert solution.iterations == reference.iterations
    assert solution.cost == pytest.approx(reference.cost, rel=1e-9)
    for of, part in zip(reference.trajectory.phases, solution.trajectory.phases, strict=True):
        sizes = np.concatenate([np.full(3, size), np.ones(16)])  # place, quaternion, joints
        np.testing.assert_allclose(part.states[:, :19] / sizes, of.states[:, :19], atol=1e-7)


@pytest.mark.parametrize("size", [0.01, 10.0])
def test_a_quadruped_that_counts_in_si_units_takes_at_most_twice_the_iterations(size: float) -> None:
    """Go2 counts in SI units at its own size, and in natural sizes if it is scaled."""
    reference, solution = solved("go2", 1.0), solved("go2", size)
    assert reference.converged, reference.explain()
    assert solution.converged, solution.explain()
    assert reference.iterations / 2 <= solution.iterations <= 2 * reference.iterations
    assert solution.cost == pytest.approx(reference.cost, rel=1e-4)


def test_a_large_quadruped_has_natural_sizes_at_its_own_size() -> None:
    reference, solution = solved("anymal_c", 1.0), solved("anymal_c", 0.1)
    assert reference.converged, reference.explain()
    assert solution.iterations == reference.iterations
    assert solution.cost == pytest.approx(reference.cost, rel=1e-9)


@pytest.mark.parametrize("size", SIZES)
def test_the_compiled_solver_has_the_same_sizes(size: float) -> None:
    problem = compile_problem(hop(scaled(mini_cheetah(), size), size, rigid=True))
    native, numpy = MSiLQR(problem).solve(), MSiLQR(problem, backend="numpy").solve()
    assert native.converged, native.explain()
    assert native.iterations == numpy.iterations
    assert native.cost == pytest.approx(numpy.cost, rel=1e-9)
    for a, b in zip(native.history, numpy.history, strict=True):
        assert (a.step_size, a.regularization, a.barrier_weight) == pytest.approx(
            (b.step_size, b.regularization, b.barrier_weight), rel=1e-9
        )
        assert a.merit == pytest.approx(b.merit, rel=1e-6)
        assert a.max_defect == pytest.approx(b.max_defect, rel=1e-3, abs=1e-9)
