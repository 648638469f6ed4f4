"""A value function that grows beyond bounds: its status, and the phase, times and direction in the explanation."""

from pathlib import Path

import casadi as cs
import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models import base, joints, stance
from piaffe.solvers import MSiLQR, Solution, Status, solve_batch
from piaffe.solvers.ilqr import Backend, Options, Outer, ProblemFunctions, first_iterate, with_cause
from tests.problems import PROBLEMS

BACKENDS = ("numpy", "native")
AXES = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]  # no axis is one of the state's


def drifting(rate: float, *phases: ocp.Phase) -> ocp.Problem:
    """Return a problem in which one direction grows at a rate [1/s] in its middle phase, and no control moves it."""
    growth = ocp.parameter("growth", rate)
    along, rest = cs.DM(np.outer(AXES[:, 0], AXES[:, 0])), cs.DM(np.outer(AXES[:, 1], AXES[:, 2]))

    def drift(s: ocp.NodeView, growth: object) -> dict[str, cs.SX]:
        return {"place": growth * (along @ s.place) + rest @ s.place + cs.DM(AXES[:, 2]) @ s.push}

    modes = {"rest": lambda s: drift(s, 0.0), "climb": lambda s: drift(s, growth)}
    model = ocp.Model("slope", state={"place": 3}, control={"push": 1}, modes=modes)
    usual = ocp.Phase("wait", "rest", 0.4), ocp.Phase("up", "climb", 5.0), ocp.Phase("stay", "rest", 0.4)
    objective = ocp.Objective(ocp.track("place"), ocp.regularize("push", 0.1))
    return ocp.Problem(ocp.Motion(*(phases or usual)), model.until_end(dt=0.02), objective, initial=0.1 * AXES[:, 1])


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_sweep_that_grows_names_the_phase_and_the_direction(backend: Backend, tmp_path: Path) -> None:
    solution = MSiLQR(drifting(8.0), backend=backend).solve()
    assert (solution.status, solution.iterations) == (Status.UNSTABLE, 0)
    assert "In phase 'up' (climb) the value function grows from " in solution.fault
    assert " at 5.4 s backwards to " in solution.fault
    strongest = np.argsort(-np.abs(AXES[:, 0]))[:2]
    assert " and ".join(f"'place {i}'" for i in strongest) in solution.fault
    text = solution.explain()
    assert text.startswith(f"{Status.UNSTABLE.advice}\n{solution.fault}")
    assert "Smallest relaxation" not in text
    loaded = Solution.load(solution.save(tmp_path / "grown.npz"))
    assert (loaded.status, loaded.fault) == (Status.UNSTABLE, solution.fault)


@pytest.mark.parametrize("backend", BACKENDS)
def test_growth_within_bounds_is_solved(backend: Backend) -> None:
    solution = MSiLQR(drifting(1.0), backend=backend).solve()
    assert (solution.status, solution.fault) == (Status.CONVERGED, "")


@pytest.mark.parametrize("backend", BACKENDS)
def test_instances_of_a_batch_that_grow_say_so(backend: Backend) -> None:
    batch = solve_batch(drifting(1.0), parameters={"growth": np.array([1.0, 8.0])}, backend=backend)
    assert batch.status == (Status.CONVERGED, Status.UNSTABLE)
    assert batch.faults[0] == ""
    assert "- instance 1: In phase 'up' (climb) the value function grows from" in batch.explain()


def cause_at_the_start(problem: ocp.Problem) -> tuple[Status, str]:
    """Return the cause if the line search had failed at the first iterate."""
    compiled = ocp.compile_problem(problem)
    functions, outer = ProblemFunctions(compiled), Outer(compiled, Options())
    return with_cause(Status.LINE_SEARCH_FAILED, functions, first_iterate(compiled, None), outer, None)


def test_growth_adds_up_over_phases() -> None:
    climbs = [ocp.Phase(f"up {i}", "climb", 0.8) for i in range(4)]
    assert cause_at_the_start(drifting(8.0, climbs[0])) == (Status.LINE_SEARCH_FAILED, "")  # e^12.8 is within bounds
    status, sentence = cause_at_the_start(drifting(8.0, *climbs))
    assert status is Status.UNSTABLE
    assert "In phase 'up " in sentence


def test_growth_that_a_reset_ends_is_still_told() -> None:
    back = ocp.reset(lambda s: {"place": cs.DM(0.1 * AXES[:, 1])})  # what comes before has no effect on what follows
    phases = ocp.Phase("wait", "rest", 0.4, reset=back), ocp.Phase("up", "climb", 1.8)
    status, sentence = cause_at_the_start(drifting(8.0, *phases))
    assert status is Status.UNSTABLE
    assert "In phase 'up' (climb) the value function grows from " in sentence


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_failed_line_search_for_another_reason_keeps_its_status(name: str) -> None:
    compiled = ocp.compile_problem(PROBLEMS[name]())
    outer = Outer(compiled, Options())
    ended = with_cause(
        Status.LINE_SEARCH_FAILED, ProblemFunctions(compiled), first_iterate(compiled, None), outer, None
    )
    assert ended == (Status.LINE_SEARCH_FAILED, "")


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_robot_that_falls_for_twenty_seconds_names_the_distances_of_its_feet(backend: Backend) -> None:
    body, every = models.WholeBody(models.load("mini_cheetah")), stance("FL FR HL HR")
    limp = ocp.Keyframe(joints="stand", **{"joints.torque": np.zeros(12)})
    objective = ocp.Objective(
        ocp.track(base.position, weight=(1, 1, 10)), ocp.track(base.orientation, weight=2.0),
        ocp.track(base.linear_velocity, weight=0.5), ocp.track(base.angular_velocity, weight=0.1),
        ocp.track(joints.position, weight=0.5), ocp.track(joints.velocity, weight=0.05),
        ocp.regularize(joints.torque, weight=0.02),
    )  # fmt: skip
    problem = ocp.Problem(
        ocp.Motion(ocp.Phase("stand", every, 20.0, limp)), body.until_end(dt=0.01), objective,
        ocp.Constraints(models.friction_cone(0.6)), initial=body.state(joints="stand"),
    )  # fmt: skip
    solution = MSiLQR(problem, backend=backend).solve()
    assert (solution.status, solution.iterations) == (Status.UNSTABLE, 0)
    assert "In phase 'stand' (FL FR HL HR) the value function grows from " in solution.fault
    assert solution.fault.count("HAA'") == 2  # abduction of the legs
