"""The low level of forces and joint motions, and planners from a part of the plant's state."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from piaffe import models, ocp, simulation, solvers
from piaffe.errors import ModelError
from piaffe.models import base, feet, joints
from piaffe.ocp import rotation

ROBOT = models.load("mini_cheetah")
MODEL, BODY = models.HybridKinodynamic(ROBOT), models.WholeBody(ROBOT)
WHOLE = BODY.state


@dataclass
class Phase:
    """A phase of a plan, as of ``solvers.PlanPhase``: parameters are the contact flags alone."""

    times: np.ndarray
    states: np.ndarray
    controls: np.ndarray
    p: np.ndarray
    mode = SimpleNamespace(layout=SimpleNamespace(slots={"contact": slice(0, 4)}))


class Plan:
    """Two phases of two stages of 10 ms; all feet stand, then a pair of them. The joints move at constant speeds."""

    def __init__(self, local: object = None) -> None:
        rng = np.random.default_rng(2)
        self.speed, start = rng.normal(size=12), MODEL.state(joints="stand")
        self.phases = []
        for i, flags in enumerate(([1.0, 1, 1, 1], [1.0, 0, 0, 1])):
            times = 0.02 * i + np.array([0.0, 0.01, 0.02])
            states = np.tile(start, (3, 1))
            states[:, 7:19] += times[:, None] * self.speed
            controls = rng.normal(size=(2, 24)) + np.tile([0, 0, 20.0] * 4 + [0.0] * 12, (2, 1))
            self.phases.append(Phase(times, states, controls, np.tile(flags, (2, 1))))
        if local is not None:
            self.local = local


def measured() -> np.ndarray:
    return BODY.state(joints="crouch", rpy=(0.3, -0.2, 1.0), joint_velocities=np.linspace(-1, 1, 12))


def low(plan: Plan, **gains: object) -> simulation.ForcesAndJoints:
    return simulation.ForcesAndJoints(MODEL, plan, WHOLE, **gains)  # type: ignore[arg-type]


@pytest.mark.parametrize(("t", "i", "k"), [(0.004, 0, 0), (0.014, 0, 1), (0.02, 1, 0), (0.5, 1, 1), (-1.0, 0, 0)])
def test_forces_of_feet_on_the_ground_become_torques_by_the_jacobian(t: float, i: int, k: int) -> None:
    plan, x = Plan(), measured()
    phase = plan.phases[i]
    forces = phase.controls[k, :12] * np.repeat(phase.p[k], 3)
    expected = -BODY.contact_jacobian(x)[:, 6:].T @ forces
    np.testing.assert_allclose(low(plan, kp=0.0, kd=0.0).control(x, t), expected, atol=1e-12)


def test_gains_keep_the_joints_to_the_plan_with_a_factor_for_legs_on_the_ground() -> None:
    plan, x, t = Plan(), measured(), 0.033
    plain = low(plan, kp=0.0, kd=0.0).control(x, t)
    found = low(plan, kp=3.0, kd=np.full(12, 0.2), in_stance=0.25).control(x, t) - plain
    planned = ROBOT.pose("stand") + t * plan.speed
    factor = np.repeat([0.25, 1.0, 1.0, 0.25], 3)
    expected = factor * (3.0 * (planned - x[7:19]) + 0.2 * (plan.speed - x[25:]))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_the_measured_state_is_moved_into_the_frame_of_the_plan() -> None:
    x, turn = measured(), rotation.np_from_rpy(np.array([0.0, 0.0, -0.7]))

    def local(part: np.ndarray) -> np.ndarray:
        moved = part.copy()
        moved[3:7] = rotation.np_multiply(turn, part[3:7])
        return moved

    plan = Plan(local)
    turned = x.copy()
    turned[3:7] = rotation.np_multiply(turn, x[3:7])
    expected = low(Plan(), kp=1.0).control(turned, 0.004)
    np.testing.assert_allclose(low(plan, kp=1.0).control(x, 0.004), expected, atol=1e-12)


def test_torques_stay_within_the_limits() -> None:
    torques = low(Plan(), kp=1e4).control(measured(), 0.004)
    assert np.all(np.abs(torques) <= ROBOT.torque_limit)
    assert np.any(np.abs(torques) == ROBOT.torque_limit)


def test_wrong_gains_and_states_are_refused() -> None:
    for gains in ({"kp": -1.0}, {"kd": np.ones(3)}, {"in_stance": np.inf}):
        with pytest.raises(ModelError, match=f"forces and joints, {next(iter(gains))}: is out of range - got"):
            low(Plan(), **gains)
    with pytest.raises(ModelError, match="'joints.position' is missing - got a state of base.position, .*, expected"):
        simulation.ForcesAndJoints(MODEL, Plan(), models.SingleRigidBody(ROBOT).state)


def test_a_planner_gets_its_part_of_the_state_and_everything_else() -> None:
    class Planner:
        period = 0.04

        def __init__(self) -> None:
            self.told: list[object] = []

        def reset(self) -> None:
            self.told.append("reset")

        def plan(self, x: np.ndarray, t: float) -> object:
            self.told.append((x, t))
            return "plan"

        def command(self, **values: float) -> None:
            self.told.append(values)

    inner = Planner()
    outer = simulation.PartOfState(inner, models.SingleRigidBody(ROBOT).state, WHOLE)
    x = measured()
    assert outer.period == 0.04
    assert outer.plan(x, 0.1) == "plan"
    outer.command(speed=0.2)
    outer.reset()
    (part, t), commands, last = inner.told  # type: ignore[misc]
    np.testing.assert_array_equal(part, np.r_[x[:7], x[19:25]])
    assert (t, commands, last) == (0.1, {"speed": 0.2}, "reset")
    assert np.isnan(outer.velocity(0.0)).all()


@pytest.mark.slow
def test_a_kinodynamic_trot_with_a_rigid_body_behind_it_keeps_its_speed_on_the_plant() -> None:
    objective = ocp.Objective(
        ocp.track(base.position, weight=(0, 0, 50)),
        ocp.track(base.orientation, weight=2.0),
        ocp.track(base.linear_velocity, weight=10.0),
        ocp.track(base.angular_velocity, weight=1.0),
        ocp.track(joints.position, weight=1.0),
        ocp.track(feet.force, weight=0.0005),
        ocp.regularize(joints.commanded_velocity, weight=0.001),
    )
    limits = ocp.Constraints(models.friction_cone(mu=0.6), models.foot_clearance())
    trot = models.gaits.trot(speed=0.3, velocity_gain=0.02, lag_gain=1.0)
    schedule = MODEL.over(0.3, dt=0.01) + models.SingleRigidBody(ROBOT).over(0.3, dt=0.05)
    problem = ocp.Problem(trot, schedule, objective, limits, initial=MODEL.state(joints="stand"))
    mpc, plant = solvers.RecedingHorizon(problem), simulation.Plant(ROBOT, friction=0.7)
    tracker = low(mpc.plan(problem.initial, 0.0))
    planner = simulation.PartOfState(mpc, MODEL.state, plant.space)
    start = BODY.state(joints="stand")
    episode = simulation.run_online(planner, tracker, plant, seconds=3.0, initial=start)
    assert episode.success
    found = episode.tracking(2.0)
    assert found is not None
    assert found.velocity[0] == pytest.approx(0.3, rel=0.1)
