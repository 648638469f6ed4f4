"""The verification finds what a trajectory misses, by itself."""

import ast
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ProblemError
from piaffe.models import stance
from piaffe.ocp.compiler.compiled import CompiledProblem
from piaffe.ocp.language.trajectory import PhaseTrajectory, Trajectory
from piaffe.ocp.reports.verify import quantity_values, verify

RESTITUTION = 0.8


@cache
def problem() -> CompiledProblem:
    """A ball that falls freely is verified in closed form: explicit Euler, v = −g t, z = z0 − g dt² k (k − 1) / 2."""
    ball = ocp.Model(
        "ball", state={"z": 1, "vz": 1}, control={"thrust": 1},
        modes={"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}},
    )  # fmt: skip
    motion = ocp.Motion(
        ocp.Phase(
            "drop", "fall", 0.3, until=ocp.equality(lambda s: s.z, name="ground", unit="m", scale=0.5),
            reset=ocp.reset(lambda s: {"vz": -RESTITUTION * s.vz}),
        ),
        ocp.Phase("rise", "fall", 0.2),
    )  # fmt: skip
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.thrust, lower=-1.0, upper=1.0, name="thrust limit", unit="N", scale=2.0),
        ocp.inequality(lambda s: s.z, lower=-0.1, when="rise", name="height", unit="m"),
    )
    objective = ocp.Objective(ocp.regularize("thrust"))
    return ocp.compile_problem(ocp.Problem(motion, ball.until_end(dt=0.1), objective, limits, initial=[0.2943, 0.0]))


def exact() -> Trajectory:
    """The free fall of the ball: it is on the ground after 0.3 s."""
    states, parts, start = [], [], 0
    x = np.array([0.2943, 0.0])
    for phase in problem().phases:
        states = [x]
        for _ in range(phase.num_stages):
            x = np.array([x[0] + 0.1 * x[1], x[1] - 0.981])
            states.append(x)
        times = 0.1 * np.arange(start, start + len(states))
        start += phase.num_stages
        space = phase.mode.model
        parts.append(
            PhaseTrajectory(phase.name, "fall", "ball", times, np.array(states), np.zeros((phase.num_stages, 1)), {},
                            space.state, space.control)
        )  # fmt: skip
        x = x * (1.0, -RESTITUTION)
    return Trajectory(tuple(parts))


def changed(
    phase: int, *, states: tuple[int, int, float] | None = None, control: tuple[int, float] | None = None
) -> Trajectory:
    """Return the exact trajectory with one entry of its states, or one control, increased."""
    parts = list(exact().phases)
    x, u = parts[phase].states.copy(), parts[phase].controls.copy()
    if states is not None:
        x[states[0], states[1]] += states[2]
    if control is not None:
        u[control[0], 0] += control[1]
    parts[phase] = replace(parts[phase], states=x, controls=u)
    return Trajectory(tuple(parts))


def test_an_exact_trajectory_has_no_defects() -> None:
    result = verify(problem(), exact())
    assert result.max_defect < 1e-15
    assert result.max_equality < 1e-15
    assert result.max_inequality == 0.0
    assert result.holds


def test_the_initial_state_counts() -> None:
    worst = verify(problem(), changed(0, states=(0, 1, 0.01))).worst("defect")
    assert worst is not None
    assert (worst.phase, worst.node, worst.name) == ("drop", 0, "vz ")
    assert worst.amount == pytest.approx(0.01)


def test_the_reset_map_counts() -> None:
    worst = verify(problem(), changed(1, states=(0, 1, 0.02))).worst("defect")
    assert worst is not None
    assert (worst.phase, worst.node) == ("rise", 0)
    assert worst.amount == pytest.approx(0.02)


def test_a_stage_counts_at_the_node_that_it_misses() -> None:
    worst = verify(problem(), changed(1, states=(2, 0, -0.03))).worst("defect")
    assert worst is not None
    assert (worst.phase, worst.node) == ("rise", 2)
    assert worst.amount == pytest.approx(0.03)


def test_violations_are_raw_amounts_over_the_scale() -> None:
    result = verify(problem(), changed(0, control=(2, 1.5)))
    worst = result.worst("inequality")
    assert worst is not None
    assert (worst.name, worst.phase, worst.node, worst.unit) == ("thrust limit upper", "drop", 2, "N")
    assert worst.amount == pytest.approx(0.5 / 2.0)
    ground = verify(problem(), changed(0, states=(3, 0, 0.04))).worst("equality")
    assert ground is not None
    assert (ground.name, ground.node) == ("ground", 3)
    assert ground.amount == pytest.approx(0.04 / 0.5)
    assert ground.source.startswith("test_verification.py:")


def test_rows_of_the_state_count_at_the_last_node_too() -> None:
    worst = verify(problem(), changed(1, states=(2, 0, -1.0))).worst("inequality")
    assert worst is not None
    assert (worst.name, worst.node) == ("height lower", 2)


def test_masked_rows_do_not_count() -> None:
    assert verify(problem(), changed(0, states=(1, 0, -1.0))).max_inequality == 0.0  # "height" is asked for in "rise"


def test_what_is_not_finite_is_infinitely_wrong() -> None:
    result = verify(problem(), changed(1, states=(1, 0, np.nan)))
    assert result.max_defect == np.inf
    assert not result.holds


def test_the_worst_row_is_the_worst_for_its_bound() -> None:
    both = changed(0, states=(3, 0, 5e-4))  # a defect of 5e-4 (bound 1e-4) and an equality of 1e-3 (bound 1e-3)
    worst = verify(problem(), both).worst()
    assert worst is not None
    assert worst.kind == "defect"


def test_quaternions_must_have_unit_length() -> None:
    model = ocp.Model("top", state={"q": "rotation"}, modes={"rest": lambda s: {"q": np.zeros(3)}})
    motion = ocp.Motion(ocp.Phase("rest", "rest", 0.2))
    compiled = ocp.compile_problem(ocp.Problem(motion, model.until_end(dt=0.1), ocp.Objective(), initial=[1, 0, 0, 0]))
    states = np.tile([1.1, 0.0, 0.0, 0.0], (3, 1))
    part = PhaseTrajectory(
        "rest", "rest", "top", np.arange(3) / 10, states, np.zeros((2, 0)), {}, model.state, model.control
    )
    worst = verify(compiled, Trajectory((part,))).worst()
    assert worst is not None
    assert worst.name == "q length"
    assert worst.amount == pytest.approx(0.1)


def test_a_trajectory_of_another_problem_is_refused() -> None:
    parts = exact().phases
    with pytest.raises(
        ProblemError, match=r"phase 0: is not of this problem - got .*'rise', 2, 2, 1\), expected .*'drop', 3, 2, 1"
    ):
        verify(problem(), Trajectory(parts[::-1]))
    with pytest.raises(ProblemError, match="got 1 phases, expected 2"):
        verify(problem(), Trajectory(parts[:1]))


def test_contacts_are_solved_for_here() -> None:
    """The robot's own step, written independently of the compiled functions, makes a trajectory without defects."""
    robot = models.load("mini_cheetah")
    body = models.WholeBody(robot)
    motion = ocp.Motion(ocp.Phase("stand", stance("FL HR"), 0.02), ocp.Phase("land", stance("FL FR HL HR"), 0.02))
    objective = ocp.Objective(ocp.regularize("joints.torque"))
    start = body.state(joints="stand", angular_velocity=(0.1, 0.2, 0.3))
    compiled = ocp.compile_problem(ocp.Problem(motion, body.until_end(dt=0.01), objective, initial=start))
    rng = np.random.default_rng(0)
    parts, x = [], start
    for i, (phase, feet) in enumerate(zip(compiled.phases, ("FL HR", "FL FR HL HR"), strict=True)):
        controls = rng.standard_normal((2, 12))
        states = [x]
        for u in controls:
            x = body.step(x, u, feet, 0.01, gamma=200.0)  # 2/dt, as in a compiled problem
            states.append(x)
        parts.append(
            PhaseTrajectory(
                phase.name, feet, "mini_cheetah", phase.times, np.array(states), controls, {}, body.state, body.control
            )
        )
        if i == 0:
            x = body.impact(x, "FL FR HL HR")
    trajectory = Trajectory(tuple(parts))
    result = verify(compiled, trajectory)
    assert result.max_defect < 1e-9
    assert result.largest("equality") > 0  # nothing made the feet land where the ground is
    heights = quantity_values(compiled, trajectory, models.feet.height)[0]
    assert heights is not None
    assert heights[0] == pytest.approx(body.foot_positions(start)[:, 2] - robot.foot_radius)


def test_it_uses_no_solver() -> None:
    """Neither this module nor any that it imports is a solver's."""
    source = Path(ocp.__file__).parent / "reports" / "verify.py"
    imported = {node.module for node in ast.walk(ast.parse(source.read_text())) if isinstance(node, ast.ImportFrom)}
    assert not {module for module in imported if module and "solver" in module}
