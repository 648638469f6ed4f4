"""What is not finite: refused by name before a solve; born inside one, it ends in a status that names its function."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace

import casadi as cs
import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import ProblemError, SolverError
from piaffe.ocp import CompiledProblem, ParameterKey, Trajectory, compile_problem
from piaffe.solvers import MSiLQR, Options, Solution, Status

from ...problems import PROBLEMS, rope

BACKENDS = ("native", "numpy")
pytestmark = pytest.mark.filterwarnings("ignore::piaffe.codegen.NoCompilerWarning")


def cart(
    residual: Callable | None = None,
    limit: Callable | None = None,
    drag: Callable | None = None,
    start: float = 1.0,
    target: float = 1.0,
) -> ocp.Problem:
    """A cart with terms of a test's own."""

    def move(s):
        return {"x": s.v, "v": s.push - (drag(s) if drag else 0.0)}

    model = ocp.Model("cart", state={"x": 1, "v": 1}, control={"push": 1}, modes={"drive": move})
    motion = ocp.Motion(ocp.Phase("go", "drive", 0.5, {"x": start}))
    costs = [ocp.regularize("push", 0.1), ocp.track("x", 100.0, at="end", to=target)]
    if residual:
        costs.append(ocp.residual(residual).weighted(1.0))
    limits = ocp.Constraints(*([ocp.inequality(limit, name="range")] if limit else []))
    return ocp.Problem(motion, model.until_end(dt=0.05), ocp.Objective(*costs), limits, initial=[start, 0.0])


# ---- refused before the solve


def poison(problem: CompiledProblem, name: str | ParameterKey, bad: float) -> CompiledProblem:
    """Return a problem with one bad number."""
    first, *rest = problem.phases
    if name == "initial":
        initial = problem.initial.copy()
        initial[1] = bad
        return replace(problem, initial=initial)
    if name == "transition":
        p = first.p_transition.copy()
        p[first.transition.layout.slots["mass"]] = bad
        return replace(problem, phases=(replace(first, p_transition=p), *rest))
    if name in ("weight", "end_weight", "guess_states", "g_mask"):
        table = getattr(first, name).copy()
        table.reshape(-1)[-1] = bad
        return replace(problem, phases=(replace(first, **{name: table}), *rest))
    assert isinstance(name, ParameterKey)
    p = first.p.copy()
    p[4, first.mode.layout.slices[name]] = bad
    return replace(problem, phases=(replace(first, p=p), *rest))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("initial", "compiled problem: initial state is not finite - got {} at entry 1, 'place z' of model 'rope'"),
        (
            ParameterKey("slot", "mass", model="rope"),
            "model 'rope', number 'mass', phase 'throw', node 4 is not finite - got {} at entry 0",
        ),
        ("transition", "model 'rope', number 'mass', phase 'throw', reset is not finite - got {} at entry 0"),
        (ParameterKey("weight", term=0), "term 'regularize force' (problems.py:"),
        (ParameterKey("target", term=2), "target, phase 'throw', node 4 is not finite - got {} at entry 0"),
        (ParameterKey("upper", term=5), "constraint 'force limit' (problems.py:"),
        ("weight", "term 'regularize tension' (problems.py:"),
        ("end_weight", "phase 0 'throw' (problems.py:"),
        ("guess_states", "node 20: initial guess of the states is not finite - got {} at entry 3"),
        ("g_mask", "node 19: mask is not finite - got {}"),
    ],
)
def test_number_that_is_not_finite_is_refused_by_name(
    name: str | ParameterKey, told: str, bad: float, backend: str
) -> None:
    problem = poison(compile_problem(rope()), name, bad)
    with pytest.raises(ProblemError, match=re.escape(told.format(bad))) as caught:
        MSiLQR(problem, backend=backend).solve()
    assert str(caught.value).endswith("expected finite numbers; fix it")


def test_parameter_of_a_term_is_refused_when_the_problem_is_compiled() -> None:
    near = ocp.inequality(lambda s, reach: reach - s.x, name="near", parameters={"reach": np.nan})
    problem = cart()
    problem = ocp.Problem(
        problem.motion, problem.schedule, problem.objective, ocp.Constraints(near), initial=problem.initial
    )
    told = r"constraint 'near' \(test_not_finite.py:\d+\): reach, phase 'go', node 0 is not finite - got nan at entry 0"
    with pytest.raises(ProblemError, match=told):
        compile_problem(problem)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("what", "told"),
    [
        ("states", "warm start, phase 'swing', node 3, state 'speed x': is not finite - got nan"),
        ("controls", "warm start, phase 'swing', node 3, control 'force z': is not finite - got nan"),
        ("shift", "warm start, phase 'swing', node 3, shift, row 1: is not finite - got nan"),
        ("weight", "warm start: barrier weight is not finite - got nan"),
    ],
)
def test_warm_start_that_is_not_finite_is_refused_by_name(what: str, told: str, backend: str) -> None:
    solver = MSiLQR(rope(), Options(max_iterations=1), backend=backend)
    good = solver.solve()
    part, policy = good.trajectory.phases[1], good.phases[1]
    if what == "weight":
        bad = replace(good, barrier_weight=np.nan)
    elif what == "shift":
        table = policy.multipliers["shift"].copy()
        table[3, 1] = np.nan
        policy = replace(policy, multipliers={**policy.multipliers, "shift": table})
        bad = replace(good, phases=(good.phases[0], policy))
    else:
        table = getattr(part, what).copy()
        table[3, {"states": 2, "controls": 1}[what]] = np.nan
        bad = replace(good, trajectory=Trajectory((good.trajectory.phases[0], replace(part, **{what: table}))))
    with pytest.raises(SolverError, match=re.escape(told)):
        solver.solve(bad)


# ---- born inside a solve


def both(problem: ocp.Problem, **options: float) -> list[Solution]:
    compiled = compile_problem(problem)
    return [MSiLQR(compiled, Options(**options), backend=backend).solve() for backend in BACKENDS]


def test_trial_that_is_not_finite_only_shortens_the_step() -> None:
    """The full first step goes to x < 0, where the logarithm is not defined."""
    problem = cart(residual=lambda s: 100.0 * cs.log(s.x), start=4.0)
    for solution in both(problem):
        assert solution.converged, solution.explain()
        assert min(record.step_size for record in solution.history) < 1
        assert not solution.fault
        assert np.all(solution.states[:, 0] > 0)


CASES = {
    "residual": (
        {"residual": lambda s: cs.sqrt(s.x - 1.0), "start": 2.0, "target": -2.0},
        r"term 'residual' \(test_not_finite.py:\d+\)",
    ),
    "inequality": (
        {"limit": lambda s: 5 + cs.sqrt(s.x - 1.0), "start": 2.0, "target": -2.0},
        r"term 'range lower' \(test_not_finite.py:\d+\)",
    ),
    "dynamics": (
        {"drag": lambda s: 0.01 * cs.sqrt(s.x - 1.0), "start": 2.0, "target": -2.0},
        r"dynamics of model 'cart' \(test_not_finite.py:\d+\), next 'v'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_no_step_around_what_is_not_defined_ends_by_naming_it(name: str) -> None:
    arguments, owner = CASES[name]
    native, numpy = both(cart(**arguments), max_iterations=300)
    for solution in (native, numpy):
        assert solution.status is Status.NOT_FINITE, solution.explain()
        assert re.search(owner, solution.fault), solution.fault
        assert re.search(r"in phase 'go' \(drive\), node \d+, at 0\.\d+ s", solution.fault), solution.fault
        assert solution.fault in solution.explain()
        with pytest.raises(SolverError, match=re.escape(solution.fault)):
            solution.raise_if_failed()
    assert native.iterations == numpy.iterations
    assert native.fault == numpy.fault


def test_derivative_that_is_not_finite_at_an_accepted_iterate_ends_by_naming_it() -> None:
    """|x|^(1/2) is finite at the optimum, x = 0, and its slope is not."""
    problem = cart(residual=lambda s: cs.sqrt(cs.fabs(s.x)), start=0.0)
    compiled = compile_problem(problem, checks=False)
    for backend in BACKENDS:
        solution = MSiLQR(compiled, backend=backend).solve()
        assert solution.status is Status.NOT_FINITE
        assert solution.iterations == 0
        assert solution.fault.startswith("derivative of term '")
        assert "in phase 'go' (drive), node 0, at 0 s" in solution.fault


def test_start_where_a_value_is_not_finite_ends_by_naming_it() -> None:
    problem = compile_problem(cart(residual=lambda s: cs.log(s.x), start=1.0))
    problem = replace(problem, initial=np.array([-1.0, 0.0]))
    for backend in BACKENDS:
        good = MSiLQR(
            replace(problem, initial=np.array([1.0, 0.0])), Options(max_iterations=1), backend=backend
        ).solve()
        solution = MSiLQR(problem, backend=backend).solve(good)
        assert solution.status is Status.NOT_FINITE
        assert re.match(r"term '.*' \(test_not_finite.py:\d+\) is NaN in phase 'go' \(drive\), node 0", solution.fault)


def test_implicit_dynamics_without_a_solution_are_named() -> None:
    problem = compile_problem(rope())
    first, second = problem.phases
    p = second.p.copy()
    p[5:, second.mode.layout.slots["mass"]] = 0.0
    for backend in BACKENDS:
        solution = MSiLQR(replace(problem, phases=(first, replace(second, p=p))), backend=backend).solve()
        assert solution.status is Status.NOT_FINITE
        assert solution.fault.startswith("implicit dynamics of model 'rope' (problems.py:"), solution.fault
        assert "phase 'swing' (taut), node" in solution.fault


class Swapped(ocp.ModelBase):
    """A mass whose implicit equations are regular, but not in the order in which they stand: K = [0 1; 1 0]."""

    def __init__(self) -> None:
        state = ocp.Manifold((ocp.Block(ocp.Quantity("x"), ("",)), ocp.Block(ocp.Quantity("v"), ("",))))
        super().__init__("swapped", state, ocp.Manifold((ocp.Block(ocp.Quantity("push"), ("",)),)))

    def mode_key(self, mode: object) -> str:
        return "drive"

    def implicit_size(self, key: str) -> int:
        return 2

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> ocp.Dynamics:
        makers = {
            b.quantity.path: lambda b=b, v=v: ocp.Bound(b.quantity, v, b.labels)
            for b, v in zip((*self.state.blocks, *self.control.blocks), (x[0], x[1], u), strict=True)
        }
        after = cs.vertcat(x[0] + p["dt"] * x[1], x[1] + p["dt"] * z[0])
        return ocp.Dynamics(cs.vertcat(z[1] - x[1], z[0] - u), after, ocp.Quantities("swapped", makers))


def test_elimination_without_a_pivot_is_named_where_numpy_finds_nothing_wrong() -> None:
    motion = ocp.Motion(ocp.Phase("go", "drive", 0.5, {"x": 1.0}))
    objective = ocp.Objective(ocp.regularize("push", 0.1), ocp.track("x", 10.0, at="end"))
    problem = ocp.Problem(motion, Swapped().until_end(dt=0.05), objective, initial=[0.0, 0.0])
    native, numpy = both(problem)
    assert numpy.converged
    assert native.status is Status.NOT_FINITE
    assert re.match(
        r"dynamics of model 'swapped' \(test_not_finite.py:\d+\) is not finite as compiled, without pivots, in phase "
        r"'go' \(drive\), node 0, at 0 s",
        native.fault,
    )


def test_fault_is_kept_in_the_file(tmp_path) -> None:
    problem = compile_problem(cart(residual=lambda s: cs.sqrt(cs.fabs(s.x)), start=0.0), checks=False)
    solution = MSiLQR(problem, backend="numpy").solve()
    assert Solution.load(solution.save(tmp_path / "a.npz")).fault == solution.fault


@pytest.mark.parametrize("name", PROBLEMS)
def test_problems_have_no_fault(name: str) -> None:
    assert not MSiLQR(PROBLEMS[name](), backend="numpy").solve().fault


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_term_at_the_end_is_named_in_its_own_phase(backend: str) -> None:
    """Its derivative is not finite at rest, also at the end of the first phase, to which it does not apply."""
    model = ocp.Model("cart", state={"x": 1, "v": 1}, control={"u": 1}, modes={"go": lambda s: {"x": s.v, "v": s.u}})
    motion = ocp.Motion(ocp.Phase("first", "go", 0.2, {"x": 0.5}), ocp.Phase("last", "go", 0.2, {"x": 0.5}))
    size = ocp.equality(lambda s: cs.sqrt(s.x**2 + s.v**2), at="end", name="size")
    objective = ocp.Objective(ocp.regularize("u", 1.0))
    problem = ocp.Problem(motion, model.until_end(dt=0.1), objective, ocp.Constraints(size), initial=[0.5, 0.0])
    solver = MSiLQR(problem, backend=backend)
    found = solver.solve()
    rests = tuple(replace(p, states=0 * p.states, controls=0 * p.controls) for p in found.trajectory.phases)
    solution = solver.solve(replace(found, trajectory=replace(found.trajectory, phases=rests), search=None))
    assert solution.status is Status.NOT_FINITE
    assert "'size'" in solution.fault
    assert "phase 'last'" in solution.fault
