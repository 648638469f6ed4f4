"""Roll-out nodes in C: the iterates of NumPy, states that follow from the dynamics, and no trace in a later solve."""

from functools import cache

import casadi as cs
import numpy as np
import pytest

from piaffe import ocp
from piaffe.ocp import CompiledProblem, compile_problem
from piaffe.solvers import MSiLQR, Options, Solution, Status
from piaffe.solvers.ilqr.native import Backend
from piaffe.solvers.ilqr.rollout import Flags

from ....problems import linear_quadratic
from .memory import TOOLS, check, example
from .test_memory import needs
from .test_solver import (
    ALL,
    assert_equal_bits,
    assert_same_history,
    assert_same_result,
    compiled,
    in_c,
    native,
    of_width,
    pytestmark,
)  # fmt: skip

__all__ = ["pytestmark"]
MIXTURES = ("none", "odd", "random", "first phase follows", "last phase follows")


def mixture(problem: CompiledProblem, kind: str) -> list[Flags]:
    """Return which nodes are shooting nodes."""
    rng, last = np.random.default_rng(0), len(problem.phases) - 1
    sizes = [phase.num_stages + 1 for phase in problem.phases]
    return {
        "none": [np.zeros(n, dtype=bool) for n in sizes],
        "odd": [np.arange(n) % 2 == 1 for n in sizes],
        "random": [rng.random(n) < 0.5 for n in sizes],
        "first phase follows": [np.full(n, i > 0) for i, n in enumerate(sizes)],
        "last phase follows": [np.full(n, i < last) for i, n in enumerate(sizes)],
    }[kind]


def reached(problem: CompiledProblem, solution: Solution, i: int, k: int) -> np.ndarray:
    """Return what dynamics or reset make of the node before node k of phase i, by CasADi's own functions."""
    if k == 0 and i == 0:
        return problem.initial
    if k == 0:
        phase, x = problem.phases[i - 1], solution.trajectory.phases[i - 1].states[-1]
        f, p = phase.transition.functions, phase.p_transition
        return f["reset"](x, _solved(*f["implicit"](x, p)), p).full().ravel()
    phase, part = problem.phases[i], solution.trajectory.phases[i]
    f, x, u, p = phase.mode.functions, part.states[k - 1], part.controls[k - 1], phase.p[k - 1]
    return f["stage"](x, u, _solved(*f["implicit"](x, u, p)), p)[0].full().ravel()


def _solved(K: cs.DM, r: cs.DM) -> np.ndarray:
    return -np.linalg.solve(K.full(), r.full()) if r.numel() else np.zeros(0)


UNIT = Options(cost_scale=1.0)


@pytest.mark.parametrize("kind", MIXTURES)
@pytest.mark.parametrize("name", ALL)
def test_history_and_result_are_those_of_numpy(name: str, kind: str) -> None:
    problem = compiled(name)
    flags = mixture(problem, kind)
    # with its own scale, a roll-out of the pole is once so far outside that rounding shows in the merit
    solver, options = (MSiLQR(problem, UNIT), UNIT) if name == "swing up" else (native(name), None)
    a = solver.solve(shooting=flags)
    b = MSiLQR(problem, options, backend="numpy").solve(shooting=flags)
    assert a.status is Status.CONVERGED
    assert_same_history(a, b)
    assert_same_result(a, b)


@cache
def of_example(name: str) -> CompiledProblem:
    return compile_problem(example(name))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["random", "phase after an impact"])
@pytest.mark.parametrize(
    ("name", "after"), [("own_dynamics", 1), ("gaits:bound", 1), ("gaits:bound", 3), ("cascade", 1)]
)
def test_history_of_an_example_is_that_of_numpy(name: str, after: int, kind: str) -> None:
    problem, options = of_example(name), Options(max_iterations=6)
    flags = [np.full(phase.num_stages + 1, i != after) for i, phase in enumerate(problem.phases)]
    if kind == "random":
        flags = mixture(problem, kind)
    a, b = (MSiLQR(problem, options, backend=backend).solve(shooting=flags) for backend in ("native", "numpy"))
    assert a.iterations > 1
    assert_same_history(a, b)


@pytest.mark.parametrize("kind", MIXTURES)
@pytest.mark.parametrize("name", ["flying body", "jerked rope", "landing"])
def test_states_follow_from_the_dynamics_at_every_iterate(name: str, kind: str) -> None:
    problem = compiled(name)
    flags = mixture(problem, kind)
    for limit in (1, 2, 5):
        solver = MSiLQR(problem, Options(max_iterations=limit))
        solution = solver.solve(shooting=flags)
        assert solver.memory is not None
        for i, (own, phase) in enumerate(zip(flags, problem.phases, strict=True)):
            assert not np.any(solver.memory.accepted(i, "d").reshape(len(own), -1)[~own])
            for k in np.flatnonzero(~own):
                got, expected = solution.trajectory.phases[i].states[k], reached(problem, solution, i, k)
                np.testing.assert_allclose(phase.mode.state.np_minus(got, expected), 0.0, atol=1e-10)


@pytest.mark.parametrize("width", [1, 2, 4, 8])
@pytest.mark.parametrize("name", ["hopper", "rope"])
def test_vector_width_changes_nothing(name: str, width: int) -> None:
    flags = mixture(compiled(name), "random")
    a = of_width(compiled(name), width).solve(shooting=flags)
    b = MSiLQR(compiled(name), backend="numpy").solve(shooting=flags)
    assert_same_history(a, b)
    assert_same_result(a, b)


def test_warm_start_is_rolled_out_again_and_goes_on_as_in_numpy() -> None:
    half = MSiLQR(compiled("rope"), Options(max_iterations=6), backend="numpy").solve()
    flags = mixture(compiled("rope"), "last phase follows")
    a, b = (MSiLQR(compiled("rope"), backend=backend).solve(half, shooting=flags) for backend in ("native", "numpy"))
    assert a.iterations > 3
    assert_same_history(a, b)


def test_the_caller_need_not_roll_out_the_start() -> None:
    """Arbitrary states of roll-out nodes in the memory have no effect."""
    solver, flags = MSiLQR(compiled("rope")), mixture(compiled("rope"), "odd")
    expected = solver.solve(shooting=flags)
    memory = solver.memory
    assert memory is not None
    library, spoilt = memory.library, []

    class Spoiling:
        """The library, with other states of the roll-out nodes before a solve."""

        def __getattr__(self, name: str) -> object:
            return getattr(library, name)

        def piaffe_solve(self, *arguments: object) -> int:
            for i, own in enumerate(flags):
                memory.trial(i, "x").reshape(len(own), -1)[~own] = np.nan
                spoilt.append(i)
            return int(library.piaffe_solve(*arguments))

    memory.library = Spoiling()  # type: ignore[assignment]  # a stand-in for a test
    assert_equal_bits(solver.solve(shooting=flags), expected)
    assert spoilt


def test_a_later_solve_with_shooting_nodes_is_what_it_was() -> None:
    solver = MSiLQR(compiled("hopper"))
    never = MSiLQR(compiled("hopper")).solve()
    mixed = solver.solve(shooting=mixture(compiled("hopper"), "random"))
    assert mixed.history[0].cost != never.history[0].cost
    assert_equal_bits(solver.solve(), never)


def runaway(start: float, push: float) -> CompiledProblem:
    """x' = x⁹ + u; the cost wants a push and does not see the state."""
    model = ocp.Model("runaway", state={"x": 1}, control={"u": 1}, modes={"go": lambda s: {"x": s.x**9 + s.u}})
    motion, cost = ocp.Motion(ocp.Phase("go", "go", 0.4)), ocp.Objective(ocp.track("u", 1.0, to=push))
    return compile_problem(ocp.Problem(motion, model.until_end(dt=0.1), cost, initial=[start]))


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_roll_out_that_is_not_finite_is_told(backend: Backend) -> None:
    assert MSiLQR(runaway(100.0, 1.0), backend=backend).solve(shooting=False).status is Status.NOT_FINITE


@pytest.mark.parametrize("backend", ["native", "numpy"])
def test_step_to_an_infinite_state_is_not_taken(backend: Backend) -> None:
    """The full step makes the last state infinite, on which neither cost nor another node depends."""
    solution = MSiLQR(runaway(0.0, 50.0), backend=backend).solve(shooting=False)
    assert np.all(np.isfinite(solution.states))
    assert solution.history[0].step_size < 1.0


@pytest.mark.parametrize("tool", TOOLS)
def test_no_error_of_memory_is_found(tool: str) -> None:
    needs(tool)
    problem = compiled("rope")
    assert check(problem, TOOLS[tool], TOOLS[tool].example, shooting=mixture(problem, "random"))[0].converged


def test_a_linear_problem_is_solved_by_one_roll_out() -> None:
    solution = MSiLQR(linear_quadratic()).solve(shooting=False)
    assert solution.iterations == 1
    assert solution.cost == pytest.approx(in_c("linear-quadratic").cost, rel=1e-12)
