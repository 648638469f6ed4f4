"""Constants of the algorithm are in one table: a change of it changes both backends, and makes another library."""

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from piaffe import ocp, solvers
from piaffe.ocp import CompiledProblem, compile_problem
from piaffe.solvers import MSiLQR, Options, Solution, constants
from piaffe.solvers.ilqr.native.backend import Backend
from piaffe.solvers.ilqr.native.program import TEMPLATES

from ....problems import PROBLEMS, bouncing_ball
from ...infeasible_problems import slippery_start
from .test_solver import GCC, assert_same_history, compiled

MAKE = {**PROBLEMS, "ball that is too slow": lambda: bouncing_ball(limit=0.5), "slippery start": slippery_start}


@dataclass(frozen=True)
class Case:
    """A solve in which a constant matters.

    Args:
        value: another value of the constant.
        problem: name of the problem.
        iterations: limit of the solve; both backends make the same decisions that far.
        options: further options.
        others: values of other constants.
        warm: whether to start from a half solve of the problem from another initial state.
    """

    value: float
    problem: str
    iterations: int = 60
    options: Mapping[str, float] = field(default_factory=dict)
    others: Mapping[str, float] = field(default_factory=dict)
    warm: bool = False


FAILING = {"armijo": 0.9, "min_step": 0.2}
CASES = {
    "PATIENCE": Case(1, "swing up", 30, {"cost_tolerance": 1e-3, "max_defect": 1.0, "cost_scale": 1.0}),
    "NEARLY_CLOSED": Case(0.15, "swing up", 12),
    "REGULARIZATION_FACTOR": Case(2.0, "rope", 12, FAILING),
    "RAISES_AFTER_FAILURE": Case(1, "rope", 12, FAILING),
    "LONG_STEP": Case(0.2, "rope", 12, FAILING),
    "SHORT_STEP": Case(0.3, "rope", 12),
    "SMALLEST_GAP": Case(1e3, "swing up", 8),
    "RHO_DECAY": Case(0.3, "swing up", 8),
    "LONG_SUBPROBLEM": Case(0.2, "swing up", 12),
    "LEAST_RHO_FACTOR": Case(8.0, "swing up", 12, {"max_inner": 1}),
    "STEPS_BACK": Case(1, "rope", 8),
    "MERIT_ROUNDING": Case(0.5, "swing up", 8),
    "GAP_DECREASE": Case(0.2, "rope", 8),
    "SAME_MERIT": Case(1e3, "swing up", 4, warm=True),
    "NEARLY_MET": Case(1000.0, "rope"),
    "NEAR_BOUND": Case(1e-3, "swing up", 30, {"max_inner": 1, "cost_scale": 1.0}),
    "SLACK": Case(0.75, "bouncing ball", 60, {"cost_scale": 1.0}),
    "AT_FLOOR": Case(3.0, "hopper"),
    "LARGEST_SHRINK": Case(9.0, "rope", 12),
    "LEAST_SHRINK": Case(0.2, "rope", 12),
    "SLOW_DECREASE": Case(0.8, "rope", 20),
    "SCALE_PENALTY": Case(1.0, "hopper", 12),
    "SCALE_RELAXATION": Case(0.5, "rope", 12),
    "SCALE_RIDGE": Case(1e3, "rope", 12),
    "SHARE_OF_COST": Case(1e9, "slippery start"),
    "SHORTEST_ATTEMPT": Case(2.0, "slippery start"),
    "IMPROVED": Case(1e-9, "slippery start"),
    "NO_PROGRESS": Case(1.5, "ball that is too slow", 40, {"max_penalty": 1e4, "max_stiffness": 1e6}),
    "MAX_UNMOVED": Case(2, "ball that is too slow"),
}


def changed(monkeypatch: pytest.MonkeyPatch, values: Mapping[str, float]) -> None:
    for name, value in values.items():
        monkeypatch.setattr(constants, name, value)


def solve(case: Case, backend: Backend) -> Solution:
    """Solve with a problem that is compiled afresh, whose library is therefore not loaded yet."""
    problem = compile_problem(MAKE[case.problem]())
    start = None
    if case.warm:
        moved = replace(problem, initial=problem.initial + 0.01)
        start = MSiLQR(moved, Options(max_iterations=10), backend="numpy").solve()
    return MSiLQR(problem, Options(max_iterations=case.iterations, **case.options), backend=backend).solve(start)


def decided(solution: Solution) -> list[tuple[float, ...]]:
    return [(r.step_size, r.regularization, r.barrier_weight, r.merit) for r in solution.history]


@pytest.mark.skipif(GCC is None, reason="no C compiler on the path")
@pytest.mark.parametrize("name", CASES)
def test_changed_constant_changes_both_backends_alike(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES[name]
    changed(monkeypatch, case.others)
    before = solve(case, "numpy")
    changed(monkeypatch, {name: case.value})
    by_numpy, in_c = solve(case, "numpy"), solve(case, "native")
    assert decided(by_numpy) != decided(before)
    assert_same_history(in_c, by_numpy)


def twins() -> CompiledProblem:
    """Two controls of which only the sum matters. It costs 2⁵⁸: a regularisation below 2⁵ is lost in rounding."""
    model = ocp.Model("twins", state={"a": 1}, control={"u": 2}, modes={"sum": lambda s: {"a": s.u[0] + s.u[1]}})
    objective = ocp.Objective(ocp.track("a", 1.0), ocp.residual(lambda s: s.u[0] + s.u[1]).weighted(2.0**60))
    motion = ocp.Motion(ocp.Phase("one", "sum", 0.5, {"a": 1.0}))
    return compile_problem(ocp.Problem(motion, model.until_end(dt=0.25), objective, initial=[0.0]))


@pytest.mark.skipif(GCC is None, reason="no C compiler on the path")
@pytest.mark.parametrize(("factor", "regularization"), [(10.0, 100.0), (3.0, 81.0)])
def test_policy_is_regularised_in_steps_of_its_factor(
    factor: float, regularization: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed(monkeypatch, {"POLICY_REGULARIZATION_FACTOR": factor})
    for backend in ("numpy", "native"):
        options = Options(regularization=1.0, max_iterations=1, cost_scale=1.0)
        (phase,) = MSiLQR(twins(), options, backend=backend).solve().phases
        assert phase.Q_xx[-1].item() == pytest.approx(0.25 + regularization, rel=1e-6)


@pytest.mark.skipif(GCC is None, reason="no C compiler on the path")
def test_only_the_last_gains_of_a_stored_search_are_used() -> None:
    half = MSiLQR(compiled("swing up"), Options(max_iterations=20, cost_scale=1.0), backend="numpy").solve()
    assert half.search is not None
    gains = tuple(1.0 + k for k in range(constants.PATIENCE + 3))
    start = replace(half, search=replace(half.search, gains=gains))
    for backend in ("numpy", "native"):
        rest = MSiLQR(compiled("swing up"), Options(max_iterations=1, cost_scale=1.0), backend=backend).solve(start)
        assert rest.search is not None
        assert rest.search.gains[:-1] == gains[-constants.PATIENCE + 1 :]


@pytest.mark.skipif(GCC is None, reason="no C compiler on the path")
def test_multiple_of_a_large_max_inner_does_not_overflow() -> None:
    options = Options(max_inner=10**9)
    in_c, by_numpy = (MSiLQR(compiled("rope"), options, backend=backend).solve() for backend in ("native", "numpy"))
    assert_same_history(in_c, by_numpy)


# ---- no number beside the table

LOOP = ("solver.c", "direction.inc", "search.inc", "outer.inc")
MODULES = ("ilqr/run.py", "ilqr/outer.py", "ilqr/barrier.py", "ilqr/result.py", "solution/search_state.py")
PLAIN = {0.0, 0.5, 1.0, 2.0}
"""Of formulas: halves and squares."""
OTHERS = {"solver.c": {1e-9, 200809.0}}
"""Nanoseconds, and the version of POSIX."""
NUMBER = re.compile(r"(?<![\w.])(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def code(file: str) -> str:
    """Return a template without comments."""
    return re.sub(r"/\*.*?\*/", "", TEMPLATES[file], flags=re.DOTALL)


def source(module: str) -> str:
    return (Path(solvers.__file__).parent / module).read_text(encoding="utf-8")


def test_every_constant_is_changed_in_a_test() -> None:
    assert {*CASES, "POLICY_REGULARIZATION_FACTOR"} == set(constants.table())


@pytest.mark.parametrize("name", constants.table())
def test_both_backends_read_the_constant_by_name(name: str) -> None:
    assert any(re.search(rf"\b{name}\b", code(file)) for file in LOOP)
    assert any(f"constants.{name}" in source(module) for module in (*MODULES, "ilqr/scale.py"))


@pytest.mark.parametrize("file", LOOP)
def test_compiled_loop_has_no_numbers_of_its_own(file: str) -> None:
    numbers = {float(number) for number in NUMBER.findall(code(file))}
    assert numbers - PLAIN - OTHERS.get(file, set()) == set()


@pytest.mark.parametrize("module", MODULES)
def test_loop_in_numpy_has_no_numbers_of_its_own(module: str) -> None:
    numbers = {
        float(node.value)
        for node in ast.walk(ast.parse(source(module)))
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float)
    }
    assert numbers - PLAIN == set()
