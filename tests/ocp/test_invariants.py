"""Slip, height and flight of a verification, against Pinocchio's kinematics and a parabola written here."""

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from piaffe import models, ocp
from piaffe.models import stance
from piaffe.ocp import BOUNDS, PhaseTrajectory, Trajectory, compile_problem, verify
from tests.problems import bouncing_ball

ROBOT = models.load("mini_cheetah")
BODY = models.WholeBody(ROBOT, integrator="euler")
G = np.array([0.0, 0.0, -9.81])
DT = 0.01
PHASES = (("stand", "FL FR HL HR", 4), ("diagonal", "FL HR", 3), ("fly", "", 5), ("turn", "", 2), ("land", "FR HL", 3))


@cache
def problem() -> ocp.CompiledProblem:
    """Five phases; FL and HR stand in the first two, and the third and the fourth are one flight."""
    motion = ocp.Motion(*(ocp.Phase(name, stance(feet), n * DT) for name, feet, n in PHASES))
    objective = ocp.Objective(ocp.regularize("joints.torque"))
    return compile_problem(ocp.Problem(motion, BODY.until_end(DT), objective, initial=BODY.state(joints="stand")))


def drifting(seed: int = 0) -> Trajectory:
    """Return a trajectory in which every state is off at random; it obeys no dynamics."""
    rng = np.random.default_rng(seed)
    parts, x = [], BODY.state(joints="stand")
    for phase, (name, feet, n) in zip(problem().phases, PHASES, strict=True):
        states = [x]
        for _ in range(n):
            states.append(BODY.state.np_plus(states[-1], 3e-3 * rng.standard_normal(36)))
        x = states[-1]
        parts.append(
            PhaseTrajectory(
                name, feet, BODY.name, phase.times, np.array(states), np.zeros((n, 12)), {}, BODY.state, BODY.control
            )
        )
    return Trajectory(tuple(parts))


def by_pinocchio(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions of the feet (4, 3), position and velocity of the centre of mass (3,)."""
    model, data = ROBOT.model, ROBOT.model.createData()
    q = np.concatenate([x[:3], x[[4, 5, 6, 3]], x[7:19]])
    turn = pin.Quaternion(q[3:7]).matrix()
    v = np.concatenate([turn.T @ x[19:22], x[22:]])
    pin.framesForwardKinematics(model, data, q)
    places = np.array([data.oMf[ROBOT.frame_id(foot.frame)].translation for foot in ROBOT.feet])
    centre = pin.centerOfMass(model, data, q, v).copy()
    return places, centre, data.vcom[0].copy()


def expected(trajectory: Trajectory, foot: str) -> tuple[float, float]:
    """Return the largest slip and height of a foot over its stances."""
    i, start, slips, heights = ROBOT.foot_names.index(foot), None, [0.0], [0.0]
    for part in trajectory.phases:
        if foot not in part.mode.split():
            start = None
            continue
        for x in part.states:
            place = by_pinocchio(x)[0][i]
            start = place if start is None else start
            slips.append(float(np.linalg.norm(place - start)))
            heights.append(abs(place[2] - ROBOT.foot_radius))
    return max(slips), max(heights)


def amount(trajectory: Trajectory, name: str) -> float:
    return next(each.amount for each in verify(problem(), trajectory).violations if each.name == name)


@pytest.mark.parametrize("foot", ["FL", "FR", "HL", "HR"])
def test_slip_and_height_of_feet_are_those_of_pinocchio(foot: str) -> None:
    slip, height = expected(drifting(), foot)
    assert slip > 1e-3
    assert amount(drifting(), f"{foot} slip") == pytest.approx(slip, abs=1e-12)
    assert amount(drifting(), f"{foot} height") == pytest.approx(height, abs=1e-12)


def test_flight_is_the_distance_from_the_parabola_of_the_first_node() -> None:
    trajectory = drifting(1)
    states = np.vstack([trajectory.phases[2].states, trajectory.phases[3].states[1:]])  # one flight in two phases
    _, p0, v0 = by_pinocchio(states[0])
    off = [
        np.linalg.norm(by_pinocchio(x)[1] - (p0 + v0 * k * DT + 0.5 * G * (k * DT) ** 2)) for k, x in enumerate(states)
    ]
    worst = verify(problem(), trajectory).worst("flight")
    assert worst is not None
    assert worst.name == "centre of mass off its parabola"
    assert worst.amount == pytest.approx(max(off), abs=1e-12)
    assert (worst.phase, worst.node) == (
        ("fly", np.argmax(off)) if np.argmax(off) <= 5 else ("turn", np.argmax(off) - 5)
    )


def thrown(compiled: ocp.CompiledProblem, i: int, start: np.ndarray, v: np.ndarray) -> PhaseTrajectory:
    """Return phase i as a throw without rotation, from a position and a velocity."""
    phase = compiled.phases[i]
    model, t = phase.mode.model, (phase.times - phase.times[0])[:, None]
    states = np.tile(phase.guess_states[0], (len(t), 1))
    states[:, model.state.slices[models.base.position]] = start + v * t + 0.5 * G * t**2
    states[:, model.state.slices[models.base.linear_velocity]] = v + G * t
    controls = np.zeros((phase.num_stages, phase.mode.nu))
    return PhaseTrajectory(
        phase.name, phase.label, model.name, phase.times, states, controls, {}, model.state, model.control
    )


def flights(*phases: ocp.Phase, schedule: ocp.Schedule | None = None) -> ocp.CompiledProblem:
    objective = ocp.Objective(ocp.regularize("joints.torque"), ocp.regularize("feet.force"))
    start = BODY.state(joints="stand", linear_velocity=(0.2, 0.0, 1.0))
    return compile_problem(ocp.Problem(ocp.Motion(*phases), schedule or BODY.until_end(DT), objective, initial=start))


def test_every_flight_has_a_parabola_of_its_own() -> None:
    every = ocp.Phase("stand", stance("FL FR HL HR"), 4 * DT)
    compiled = flights(ocp.Phase("up", stance(""), 4 * DT), every, ocp.Phase("again", stance(""), 4 * DT))
    place, up, again = np.array([0.0, 0.0, 0.3]), np.array([0.2, 0.0, 1.0]), np.array([-0.3, 0.1, 0.5])
    parts = [thrown(compiled, 0, place, up), thrown(compiled, 1, place, 0 * up), thrown(compiled, 2, place, again)]
    assert verify(compiled, Trajectory(tuple(parts))).max_flight < 1e-12


@pytest.mark.parametrize("jump", ["reset", "model", None])
def test_a_flight_goes_on_over_phases_but_not_over_a_reset_or_another_model(jump: str | None) -> None:
    lift = ocp.reset(lambda s: {"base.position": s.base.position + 0.05}) if jump == "reset" else None
    rigid = models.SingleRigidBody(ROBOT, integrator="euler")
    compiled = flights(
        ocp.Phase("up", stance(""), 4 * DT, reset=lift), ocp.Phase("on", stance(""), 4 * DT),
        schedule=BODY.over(4 * DT, dt=DT) + rigid.over(4 * DT, dt=DT) if jump == "model" else None,
    )  # fmt: skip
    place, v, t = np.array([0.0, 0.0, 0.3]), np.array([0.2, 0.0, 1.0]), 4 * DT
    there = place + v * t + 0.5 * G * t**2 + 0.05
    parts = thrown(compiled, 0, place, v), thrown(compiled, 1, there, v + G * t)
    found = verify(compiled, Trajectory(parts)).max_flight
    assert found == pytest.approx(0.0 if jump else 0.05 * 3**0.5, abs=1e-12)


def test_a_moved_foot_is_named_with_its_phase_and_node() -> None:
    still = BODY.state(joints="stand")
    parts = [replace(part, states=np.tile(still, (len(part.states), 1))) for part in drifting().phases]
    assert verify(problem(), Trajectory(tuple(parts))).max_slip == 0.0
    moved = parts[1].states.copy()
    knee = 7 + ROBOT.joint_names.index("HR_KFE")
    moved[2, knee] += 0.05
    parts[1] = replace(parts[1], states=moved)
    result = verify(problem(), Trajectory(tuple(parts)))
    slip, height = result.worst("slip"), result.worst("height")
    assert slip is not None
    assert height is not None
    assert (slip.name, slip.phase, slip.node, slip.unit) == ("HR slip", "diagonal", 2, "m")
    assert (height.name, height.phase, height.node) == ("HR height", "diagonal", 2)
    assert slip.amount > BOUNDS["slip"]
    assert not result.holds


@pytest.mark.parametrize(("i", "node", "knee"), [(1, 3, "HR_KFE"), (4, 3, "FR_KFE")])
def test_the_last_node_of_a_stance_counts(i: int, node: int, knee: str) -> None:
    still = BODY.state(joints="stand")
    parts = [replace(part, states=np.tile(still, (len(part.states), 1))) for part in drifting().phases]
    moved = parts[i].states.copy()
    moved[node, 7 + ROBOT.joint_names.index(knee)] += 0.05
    parts[i] = replace(parts[i], states=moved)
    result = verify(problem(), Trajectory(tuple(parts)))
    for kind, worst in (("slip", result.worst("slip")), ("height", result.worst("height"))):
        assert worst is not None
        assert (worst.name, worst.phase, worst.node) == (f"{knee[:2]} {kind}", PHASES[i][0], node)
        assert worst.amount > BOUNDS[worst.kind]


def test_a_foot_in_the_air_moves_as_it_likes() -> None:
    still = BODY.state(joints="stand")
    parts = [replace(part, states=np.tile(still, (len(part.states), 1))) for part in drifting().phases]
    moved = parts[1].states.copy()
    moved[1:, 7 + ROBOT.joint_names.index("FR_KFE")] += 0.2
    parts[1] = replace(parts[1], states=moved)
    assert verify(problem(), Trajectory(tuple(parts))).max_slip < 1e-12


def test_a_stance_in_the_air_does_not_execute() -> None:
    still = BODY.state(joints="stand") + np.r_[0, 0, 2e-3, np.zeros(34)]
    parts = [replace(part, states=np.tile(still, (len(part.states), 1))) for part in drifting().phases]
    result = verify(problem(), Trajectory(tuple(parts)))
    assert result.max_slip == 0.0
    assert result.max_height == pytest.approx(2e-3, abs=1e-12)


def test_a_flight_of_half_a_second_at_rest_is_found() -> None:
    motion = ocp.Motion(ocp.Phase("fly", stance(""), 0.5))
    body = models.SingleRigidBody(ROBOT)
    objective = ocp.Objective(ocp.regularize("feet.force"))
    compiled = compile_problem(ocp.Problem(motion, body.until_end(0.05), objective, initial=body.state(joints="stand")))
    times = compiled.phases[0].times
    states = np.tile(body.state(joints="stand"), (len(times), 1))

    def flight(states: np.ndarray) -> float:
        part = PhaseTrajectory(
            "fly", "scheduled", body.name, times, states, np.zeros((10, 12)), {}, body.state, body.control
        )
        return verify(compiled, Trajectory((part,))).max_flight

    assert flight(states) == pytest.approx(0.5 * 9.81 * 0.25, rel=1e-12)
    exact = states.copy()
    exact[:, 2] -= 0.5 * 9.81 * times**2
    assert flight(exact) < 1e-12


def test_models_without_invariants_have_no_such_rows() -> None:
    compiled = compile_problem(bouncing_ball())
    parts = tuple(
        PhaseTrajectory(
            phase.name, "fall", "ball", phase.times, phase.guess_states, phase.guess_controls, {},
            phase.mode.state, phase.mode.model.control,
        )
        for phase in compiled.phases
    )  # fmt: skip
    result = verify(compiled, Trajectory(parts))
    assert {each.kind for each in result.violations} == {"defect", "equality", "inequality"}
    assert (result.max_slip, result.max_height, result.max_flight) == (0.0, 0.0, 0.0)


def test_what_is_not_finite_is_infinitely_off() -> None:
    parts = list(drifting().phases)
    states = parts[0].states.copy()
    states[1, 8] = np.nan
    parts[0] = replace(parts[0], states=states)
    assert verify(problem(), Trajectory(tuple(parts))).max_slip == np.inf
