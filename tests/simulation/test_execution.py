"""Plans that are played from perturbed starts: what is counted, and why a start is lost."""

from dataclasses import replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from piaffe import models, ocp
from piaffe.errors import ModelError, ProblemError
from piaffe.models import stance
from piaffe.simulation import (
    Deviation,
    Execution,
    Perturbation,
    Policy,
    Simulation,
    Trial,
    declared_friction,
    execute,
    run_policy,
    torque_plant,
)
from piaffe.simulation.declared_plant import declared_robot
from tests.problems import bouncing_ball
from tests.simulation.plans import BODY, KD, KP, ROBOT, bow

ALL = stance("FL FR HL HR")
PUSH = np.tile([1.0, 0.0, 0.7], 4) * np.repeat([[1, 1, 1], [1, 1, -1]], 2, axis=0).ravel()  # [Nm]


@cache
def problem(mu: float | None = 0.7) -> ocp.CompiledProblem:
    """The problem that the bow would be a solution of."""
    motion = ocp.Motion(ocp.Phase("bend", ALL, 0.1), ocp.Phase("turn", ALL, 0.1))
    limits = ocp.Constraints() if mu is None else ocp.Constraints(models.friction_cone(mu))
    objective = ocp.Objective(ocp.regularize("joints.torque"))
    declared = ocp.Problem(motion, BODY.until_end(0.02), objective, limits, initial=BODY.state(joints="stand"))
    return ocp.compile_problem(declared)


class Bow:
    """A plan of two phases, as a solver would return it."""

    def __init__(self, **changes: Any) -> None:
        trajectory, gains = bow()
        self.trajectory = ocp.Trajectory(tuple(replace(part, **changes) for part in trajectory.phases))
        self.phases = tuple(type("Gains", (), {"feedback": table})() for table in gains)


def test_without_a_perturbation_a_trial_is_the_run_of_the_policy() -> None:
    made = execute(Bow(), problem(), seeds=1, perturbation=Perturbation().scaled(0))
    run = run_policy(Policy(*bow()), torque_plant(ROBOT, friction=0.7))
    assert made.friction == 0.7
    assert made.duration == pytest.approx(0.2)
    assert made.trials[0].position == pytest.approx(run.position[-1], rel=1e-9)
    assert made.trials[0].orientation == pytest.approx(run.orientation[-1], rel=1e-9)
    assert (made.followed, made.holds) == (1, True)


def test_trials_start_as_their_seeds_say() -> None:
    plant, policy = torque_plant(ROBOT, friction=0.7), Policy(*bow())
    made = execute(Bow(), problem(), seeds=(3, 8))
    assert [trial.seed for trial in made.trials] == [3, 8]
    for trial in made.trials:
        run = run_policy(policy, plant, Perturbation().around(plant, policy.initial, trial.seed))
        assert trial.position == pytest.approx(run.position[-1], rel=1e-9)
    errors = [trial.position for trial in made.trials]
    assert made.median_error == pytest.approx(np.mean(errors))
    assert made.worst_error == max(errors)
    assert [trial.seed for trial in execute(Bow(), problem(), seeds=3).trials] == [0, 1, 2]


def test_a_low_level_controller_acts_in_place_of_the_policy() -> None:
    policy, times = Policy(*bow()), []

    def control(x: np.ndarray, t: float) -> np.ndarray:
        times.append(t)
        return policy.control(x, t)

    usual, same = execute(Bow(), problem(), seeds=2), execute(Bow(), problem(), seeds=2, control=control)
    assert [trial.position for trial in same.trials] == [trial.position for trial in usual.trials]
    np.testing.assert_allclose(times[:201], np.arange(201) * 1e-3, atol=1e-12)
    limp = execute(Bow(), problem(), seeds=2, control=lambda x, t: np.zeros(12))
    assert limp.median_error > 2 * usual.median_error
    run = run_policy(policy, torque_plant(ROBOT, friction=0.7), control=lambda x, t: np.full(12, 50.0))
    assert run.full.all()


def test_friction_is_the_declared_one_also_after_a_change() -> None:
    assert declared_friction(problem(0.35)) == 0.35
    assert declared_friction(problem(None)) == 0.6
    assert declared_friction(problem(0.35).with_parameters({"friction cone.mu": 0.2})) == 0.2
    assert execute(Bow(), problem(), seeds=1, friction=0.9).friction == 0.9


def test_of_several_friction_cones_the_smallest_coefficient_counts() -> None:
    limits = ocp.Constraints(*map(models.friction_cone, (0.7, 0.35, 0.5)))
    motion, objective = ocp.Motion(ocp.Phase("bend", ALL, 0.1)), ocp.Objective(ocp.regularize("joints.torque"))
    declared = ocp.Problem(motion, BODY.until_end(0.02), objective, limits, initial=BODY.state(joints="stand"))
    assert declared_friction(ocp.compile_problem(declared)) == 0.35


def test_deviations_that_most_trials_have_come_first() -> None:
    slips = [Deviation("slipped", foot, 0.1, "turn", 0.03) for foot in ("FL", "FR")]
    trials = tuple(Trial(i, None, 0.0, 0.0, 0.0, tuple(slips[: 1 + (i == 2)])) for i in range(3))
    made = Execution(trials, 0.2, 0.7, Perturbation())
    assert [(each.name, count) for each, count in made.frequent()] == [("FL", 3), ("FR", 1)]


def leaning() -> Bow:
    """A plan to stand on springs, with hips that push all feet to one side: the feet need friction."""
    made = Bow(states=np.tile(BODY.state(joints="stand"), (6, 1)), controls=np.tile(PUSH, (5, 1)))
    gains = np.zeros((5, 12, 36))
    gains[:, :, 6:18], gains[:, :, 24:36] = -KP * np.eye(12), -KD * np.eye(12)
    made.phases = tuple(type("Gains", (), {"feedback": gains})() for _ in made.phases)
    return made


def test_with_little_friction_feet_slip_and_are_named() -> None:
    still = Perturbation().scaled(0)
    rough, smooth = (execute(leaning(), problem(), seeds=1, friction=mu, perturbation=still) for mu in (1.0, 0.1))
    assert {each.name for each in smooth.trials[0].deviations if each.what == "slipped"} == set(ROBOT.foot_names)
    assert not [each for each in rough.trials[0].deviations if each.what == "slipped"]
    assert "slipped" in str(smooth.trials[0])


def test_a_plan_that_falls_is_lost_and_says_why() -> None:
    trajectory, _ = bow()
    limp = Bow(controls=np.zeros((5, 12)))
    limp.phases = tuple(type("Gains", (), {"feedback": np.zeros((5, 12, 36))})() for _ in trajectory.phases)
    jump = np.r_[0, 0, 0.31, np.zeros(34)]
    parts = (limp.trajectory.phases[0], replace(limp.trajectory.phases[1], states=trajectory.phases[1].states + jump))
    limp.trajectory = ocp.Trajectory(parts)
    made = execute(limp, problem(), seeds=2)
    assert made.followed == 0
    assert not made.holds
    assert all(trial.lost_at == pytest.approx(0.1, abs=2e-3) for trial in made.trials)
    assert str(made).startswith(
        "0 of 2 starts followed to the end, 0.20 s, at friction 0.7; last error of the base 0.3"
    )
    assert str(made.trials[1]).startswith("seed 1: lost at 0.10 s, base off by 0.3")


def test_feet_that_are_still_in_the_air_when_they_should_stand_are_absent() -> None:
    motion = ocp.Motion(ocp.Phase("bend", stance(""), 0.1), ocp.Phase("turn", ALL, 0.1))
    objective, start = ocp.Objective(ocp.regularize("joints.torque")), BODY.state(joints="stand")
    start[2] += 0.3  # it falls by 0.2 m in this time
    falling = Bow(states=np.tile(start, (6, 1)), controls=np.zeros((5, 12)))
    falling.phases = tuple(type("Gains", (), {"feedback": np.zeros((5, 12, 36))})() for _ in falling.phases)
    declared = ocp.Problem(motion, BODY.until_end(0.02), objective, initial=start)
    (trial,) = execute(falling, declared, seeds=1, perturbation=Perturbation().scaled(0)).trials
    assert trial.followed
    assert {(each.what, each.name, each.phase) for each in trial.deviations} == {
        ("absent", foot, "turn") for foot in ROBOT.foot_names
    }


def test_frequent_deviations_are_counted_once_per_trial() -> None:
    made = execute(leaning(), problem(), seeds=3, friction=0.1)
    (first, count), *_ = made.frequent(1)
    assert count == 3
    amounts = [
        max(d.amount for d in trial.deviations if (d.what, d.name, d.phase) == (first.what, first.name, first.phase))
        for trial in made.trials
    ]
    assert first.amount == max(amounts)


def test_progress_is_told_every_trial() -> None:
    seen: list[int] = []
    execute(Bow(), problem(), seeds=2, progress=lambda trial: seen.append(trial.seed))
    assert seen == [0, 1]


def test_a_raised_ground_is_where_the_problem_has_it() -> None:
    raised = problem().with_parameters({"solo12.terrain": 0.05})
    up = np.r_[0, 0, 0.05, np.zeros(34)]
    high = Bow()
    high.trajectory = ocp.Trajectory(tuple(replace(p, states=p.states + up) for p in high.trajectory.phases))
    still = Perturbation().scaled(0)
    on_it, level = (
        execute(high, raised, seeds=1, perturbation=still),
        execute(Bow(), problem(), seeds=1, perturbation=still),
    )
    assert on_it.trials[0].position == pytest.approx(level.trials[0].position, abs=1e-9)


def test_the_robot_is_the_problems() -> None:
    mass, com = 1.2 * BODY.tree.mass, (BODY.tree.com + 0.01).ravel()
    changed = problem().with_parameters({
        "solo12.gravity": (0.4, 0.0, -1.62), "solo12.link_mass": mass, "solo12.link_com": com,
        "solo12.link_inertia": 2 * BODY.tree.inertia.ravel(), "solo12.armature": np.full(12, 0.02),
        "solo12.joint_damping": np.full(12, 0.03), "solo12.joint_friction": np.full(12, 0.04),
    })  # fmt: skip
    heavy = models.WholeBody(declared_robot(changed))
    np.testing.assert_array_equal(heavy.robot.model.gravity.linear, (0.4, 0.0, -1.62))
    np.testing.assert_allclose(heavy.tree.mass, mass)
    np.testing.assert_allclose(heavy.tree.com.ravel(), com, rtol=1e-12)
    np.testing.assert_allclose(heavy.tree.inertia, 2 * BODY.tree.inertia, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(heavy.robot.armature, np.full(12, 0.02))
    np.testing.assert_array_equal(heavy.robot.joint_damping, np.full(12, 0.03))
    np.testing.assert_array_equal(heavy.robot.joint_friction, np.full(12, 0.04))
    same = models.WholeBody(declared_robot(problem()))
    np.testing.assert_allclose(same.tree.inertia, BODY.tree.inertia, rtol=1e-12, atol=1e-15)
    assert ROBOT.mass == pytest.approx(BODY.tree.mass.sum())  # the robot itself is as it was


def test_on_the_moon_the_plan_is_simulated_with_the_gravity_of_the_moon() -> None:
    moon = problem().with_parameters({"solo12.gravity": (0.0, 0.0, -1.62)})
    free, still = Bow(controls=np.zeros((5, 12))), Perturbation().scaled(0)
    free.phases = tuple(type("Gains", (), {"feedback": np.zeros((5, 12, 36))})() for _ in free.trajectory.phases)
    on_earth, on_moon = (execute(free, each, seeds=1, perturbation=still).trials[0] for each in (problem(), moon))
    assert on_moon.position < 0.3 * on_earth.position


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seeds": 0}, "execution: seeds out of range - got 0, expected at least one"),
        ({"friction": -0.1}, "execution: friction out of range - got -0.1, expected a positive number"),
    ],
)
def test_what_cannot_be_played_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        execute(Bow(), problem(), **options)


def test_other_problems_and_other_models_are_refused() -> None:
    ball = ocp.compile_problem(bouncing_ball())
    with pytest.raises(ProblemError, match="is not of this problem"):
        execute(Bow(), ball)

    class Fall:
        trajectory = ocp.Trajectory(
            tuple(
                ocp.PhaseTrajectory(
                    phase.name, "fall", "ball", phase.times, phase.guess_states, phase.guess_controls, {},
                    phase.mode.state, phase.mode.model.control,
                )
                for phase in ball.phases
            )
        )  # fmt: skip
        phases = ()

    with pytest.raises(
        ModelError, match="does not begin with a whole body - got model 'ball', expected a models.WholeB"
    ):
        execute(Fall(), ball)


# ---- what the plant measures


def test_slip_is_that_of_the_lowest_point_of_each_foot() -> None:
    """A ball that turns about its contact does not slip; Pinocchio has the velocities here."""
    plant = torque_plant(ROBOT)
    rng = np.random.default_rng(0)
    x = BODY.state(joints="stand") - np.r_[0, 0, 1e-3, np.zeros(34)]  # 1 mm into the ground
    x[19:] = 0.3 * rng.standard_normal(18)
    simulated = Simulation(plant, x)
    simulated.step(np.zeros(12))
    model, data = ROBOT.model, ROBOT.model.createData()
    turn = pin.Quaternion(x[[4, 5, 6, 3]]).matrix()
    v = np.concatenate([turn.T @ x[19:22], x[22:]])
    pin.forwardKinematics(model, data, np.concatenate([x[:3], x[[4, 5, 6, 3]], x[7:19]]), v)
    expected = []
    for foot in ROBOT.feet:
        velocity = pin.getFrameVelocity(model, data, ROBOT.frame_id(foot.frame), pin.LOCAL_WORLD_ALIGNED)
        below = np.array([0.0, 0.0, 5e-4 - ROBOT.foot_radius])  # MuJoCo's contact is in the middle of the overlap
        expected.append(np.linalg.norm((velocity.linear + np.cross(velocity.angular, below))[:2]))
    np.testing.assert_allclose(simulated.foot_slip(), 1e-3 * np.array(expected), rtol=1e-6)
    assert min(expected) > 0.01


def test_feet_in_the_air_do_not_slip() -> None:
    simulated = Simulation(
        torque_plant(ROBOT), BODY.state(joints="stand", position=(0, 0, 0.6), linear_velocity=(1, 0, 0))
    )
    simulated.step(np.zeros(12))
    np.testing.assert_array_equal(simulated.foot_slip(), np.zeros(4))
    assert simulated.others_in_contact() == ()


def test_a_base_on_the_ground_is_named() -> None:
    simulated = Simulation(torque_plant(ROBOT), BODY.state(joints="stand", position=(0, 0, 0.01)))
    simulated.step(np.zeros(12))
    assert "base hull" in simulated.others_in_contact()
    assert not set(simulated.others_in_contact()) & {*ROBOT.foot_names, models.terrain.FLOOR}


def test_the_plant_has_an_elliptic_cone_and_a_hull() -> None:
    compiled = torque_plant(ROBOT, friction=0.4).compiled()
    assert compiled.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert compiled.pair_friction[:, 0] == pytest.approx(0.4)
    touching = {
        compiled.geom(i).name for pair in zip(compiled.pair_geom1, compiled.pair_geom2, strict=True) for i in pair
    }
    assert {*ROBOT.foot_names, "base hull", "FL_KFE hull"} <= touching


def test_an_execution_is_a_value() -> None:
    made = execute(Bow(), problem(), seeds=1)
    assert isinstance(made, Execution)
    with pytest.raises(AttributeError):
        made.friction = 1.0  # type: ignore[misc]
