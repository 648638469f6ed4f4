"""Evaluators: shapes, strides, buffers, threads, what is said of mistakes; and rows of other functions."""

import subprocess
import sys
from functools import lru_cache

import casadi as cs
import numpy as np
import pytest

from piaffe import ocp
from piaffe.codegen import NoCompilerWarning
from piaffe.codegen.compilers import NoCompilerError
from piaffe.errors import ModelError, SamplingError, ShapeError
from piaffe.sampling.evaluators import evaluator, rows
from piaffe.sampling.evaluators.scoring import scoring

ENGINES = ("native", "numpy", "vm", "jax")
STEPS = 3


@lru_cache
def cart():
    """Return a cart on a rail with a bound on speed, one on force, and an end where it is to rest."""
    model = ocp.Model(
        "cart", state={"s": 1, "v": 1}, control={"force": 1}, modes={"roll": lambda n: {"s": n.v, "v": n.force}}
    )
    motion = ocp.Motion(ocp.Phase("go", "roll", 0.3, target={"s": 1.0}))
    objective = ocp.Objective(
        ocp.track("s", weight=4.0), ocp.regularize("force", weight=0.5), ocp.track("s", weight=8.0, at="end")
    )
    limits = ocp.Constraints(
        ocp.inequality(lambda n: n.v, lower=-1.0, upper=2.0, unit="m/s", scale=2.0, name="speed"),
        ocp.inequality(lambda n: n.force, upper=3.0, unit="N", name="push"),
        ocp.equality(lambda n: n.v, unit="m/s", name="rest", at="end"),
        ocp.equality(lambda n: n.s - n.force, unit="m", name="odd"),
    )
    return ocp.compile_problem(ocp.Problem(motion, model.until_end(dt=0.1), objective, limits, initial=[0.0, 0.0]))


def mode():
    return cart().phases[0].mode


def arguments(samples=11, states=None):
    phase, random = cart().phases[0], np.random.default_rng(3)
    return {
        "states": 2 * random.normal(size=(samples, STEPS, 2)) if states is None else states,
        "controls": 3 * random.normal(size=(samples, STEPS, 1)),
        "p": phase.p, "weight": phase.weight, "g_mask": phase.g_mask, "h_mask": phase.h_mask,
    }  # fmt: skip


def by_hand(given):
    """Return the cost and violation of the cart as the declaration reads; its target moves to 1 m evenly."""
    s, v, force = given["states"][..., 0], given["states"][..., 1], given["controls"][..., 0]
    target = np.arange(STEPS) / 3
    cost = 0.5 * (4.0 * (s - target) ** 2 + 0.5 * force**2)
    violation = [np.maximum(-1 - v, 0) / 2, np.maximum(v - 2, 0) / 2, np.maximum(force - 3, 0), np.abs(s - force)]
    return cost, np.array(violation)


# ---- numbers


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("samples", [1, 7, 8, 11, 40])
def test_cost_and_violation_are_those_of_the_declaration(engine, samples):
    given = arguments(samples)
    cost, violation = evaluator(mode(), engine, threads=3).stage(**given)
    want_cost, want_violation = by_hand(given)
    assert np.asarray(cost).shape == (samples, STEPS)
    tolerance = {"rtol": 1e-5, "atol": 1e-5} if engine == "jax" else {"rtol": 1e-12, "atol": 1e-12}
    np.testing.assert_allclose(cost, want_cost, **tolerance)
    np.testing.assert_allclose(violation, want_violation, **tolerance)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_last_node_has_its_own_cost_and_rows(engine):
    phase, x = cart().phases[0], np.array([[1.5, 3.0], [1.0, 0.0]])
    own = evaluator(mode(), engine)
    cost, violation = own.terminal(x, phase.p_end, phase.end_weight, phase.end_g_mask, phase.end_h_mask)
    np.testing.assert_allclose(cost, [0.5 * 8.0 * 0.5**2, 0.0], atol=1e-6)
    np.testing.assert_allclose(violation, [[0.0, 0.0], [0.5, 0.0], [3.0, 0.0]], atol=1e-6)
    names = own.scoring.end_names(cart().terms)
    assert names == ("speed lower", "speed upper", "rest")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_masked_row_and_a_weight_of_zero_count_for_nothing(engine):
    given = arguments()
    given |= {key: np.zeros_like(given[key]) for key in ("weight", "g_mask", "h_mask")}
    cost, violation = evaluator(mode(), engine).stage(**given)
    assert not np.any(cost)
    assert not np.any(violation)


@pytest.mark.parametrize("engine", ENGINES)
def test_numbers_of_a_step_apply_to_that_step(engine):
    given = arguments()
    given["weight"] = given["weight"] * np.array([[0.0], [1.0], [2.0]])
    cost, _ = evaluator(mode(), engine).stage(**given)
    np.testing.assert_allclose(cost, by_hand(given)[0] * [0, 1, 2], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_state_that_is_no_number_gives_such_a_cost_and_no_violation(engine):
    given = arguments()
    given["states"][4, 1] = np.nan
    cost, violation = (np.asarray(a) for a in evaluator(mode(), engine).stage(**given))
    assert np.isnan(cost[4, 1])
    assert np.isnan(cost).sum() == 1
    assert np.isfinite(violation).all()
    assert not violation[[0, 1, 3], 4, 1].any()


def test_rows_are_named_inequalities_first():
    own = evaluator(mode(), "numpy")
    assert own.constraints(cart().terms) == ("speed", "speed", "push", "odd")
    assert own.scoring.names(cart().terms) == ("speed lower", "speed upper", "push upper", "odd")
    assert [row.unit for row in own.scoring.rows] == ["m/s", "m/s", "N", "m"]
    assert scoring(mode()) is own.scoring


# ---- memory


@pytest.mark.parametrize("engine", ENGINES)
def test_views_with_strides_give_what_copies_give(engine):
    random = np.random.default_rng(5)
    rolled = 2 * random.normal(size=(11, STEPS + 1, 9))
    backwards = np.asfortranarray(rolled)
    for states in (rolled[:, :-1, 4:6], rolled[::-1, 1:, 2:6:2], backwards[:, 1:, :2], rolled[:, ::-1][:, 1:, 7:]):
        given = arguments(states=states)
        cost, violation = evaluator(mode(), engine).stage(**given)
        want_cost, want_violation = by_hand(given)
        np.testing.assert_allclose(cost, want_cost, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(violation, want_violation, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("engine", ["native", "numpy", "vm"])
def test_a_row_of_violations_lies_together(engine):
    cost, violation = evaluator(mode(), engine).stage(**arguments())
    for row in (cost, *violation):
        assert row.T.flags.c_contiguous


def test_native_results_are_kept_and_overwritten():
    own = evaluator(mode(), "native")
    first, _ = own.stage(**arguments())
    before = first.copy()
    other, _ = own.stage(**arguments(40))
    np.testing.assert_array_equal(first, before)
    again, _ = own.stage(**(arguments() | {"controls": np.zeros((11, STEPS, 1))}))
    assert again is first or np.shares_memory(again, first)
    assert not np.array_equal(first, before)
    assert other.shape == (40, STEPS)


def test_results_of_many_sizes_are_not_all_kept():
    own = evaluator(mode(), "native")
    first, _ = own.stage(**arguments(11))
    before = first.copy()
    for samples in range(20, 40):
        own.stage(**arguments(samples))
    again, _ = own.stage(**(arguments(11) | {"controls": np.zeros((11, STEPS, 1))}))
    assert not np.shares_memory(again, first)
    np.testing.assert_array_equal(first, before)


def test_threads_do_not_change_a_number():
    given = arguments(3003)  # a share of some threads ends in a block that is not full
    results = [evaluator(mode(), "native", threads=threads).stage(**given) for threads in (1, 2, 5, 64)]
    np.testing.assert_allclose(results[0][0], by_hand(given)[0], rtol=1e-12)
    for cost, violation in results[1:]:
        np.testing.assert_array_equal(cost, results[0][0])
        np.testing.assert_array_equal(violation, results[0][1])


@pytest.mark.parametrize("engine", ENGINES)
def test_no_samples_are_none(engine):
    cost, violation = evaluator(mode(), engine).stage(**arguments(0))
    assert cost.shape == (0, STEPS)
    assert violation.shape == (4, 0, STEPS)


# ---- rows


def node_function():
    x, p = cs.SX.sym("x", 2), cs.SX.sym("p", 1)
    return cs.Function("inputs", [x, p], [cs.vertcat(x[1] * p, cs.SX(1, 1), x[0] - p)], ["x", "p"], ["y"])


@pytest.mark.parametrize("engine", ENGINES)
def test_rows_of_a_function_of_some_of_a_nodes_inputs(engine):
    x, p = np.random.default_rng(1).normal(size=(11, STEPS, 2)), np.array([[1.0], [2.0], [3.0]])
    got = rows(node_function(), engine)(x, None, p)
    want = np.stack([x[..., 1] * p[:, 0], 0 * x[..., 0], x[..., 0] - p[:, 0]], axis=-1)
    np.testing.assert_allclose(got, want, rtol=1e-5, atol=1e-5)


def test_native_rows_of_a_sample_lie_together():
    got = rows(node_function(), "native")(np.zeros((11, STEPS, 2)), p=np.zeros((STEPS, 1)))
    assert got.flags.c_contiguous


# ---- mistakes


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("name", "shape", "expected"),
    [
        ("states", (11, STEPS, 3), "(11, 3, 2)"), ("controls", (10, STEPS, 1), "(11, 3, 1)"),
        ("weight", (STEPS + 1, 2), "(3, 2)"), ("g_mask", (3,), "(3, 3)"), ("p", (1, 1), "(3, "),
    ],
)  # fmt: skip
def test_an_array_that_does_not_fit_is_named(engine, name, shape, expected):
    with pytest.raises(ShapeError) as raised:
        evaluator(mode(), engine).stage(**(arguments() | {name: np.zeros(shape)}))
    assert f"evaluator of 'cart', stage: {name} does not fit - got {shape}, expected {expected}" in str(raised.value)


def test_a_missing_array_is_named():
    with pytest.raises(ShapeError, match=r"rows of 'inputs': p does not fit - got none, expected \(3, 1\); pass it"):
        rows(node_function(), "numpy")(np.zeros((2, 3, 2)))


def test_an_unknown_engine_lists_those_that_are():
    with pytest.raises(SamplingError, match="got 'cuda', expected 'native' or 'numpy' or 'vm' or 'jax'; choose one"):
        evaluator(mode(), "cuda")
    with pytest.raises(SamplingError, match="threads - got 0, expected 1 or more"):
        evaluator(mode(), "native", threads=0)


def test_a_function_that_is_not_of_a_node_is_refused():
    a = cs.SX.sym("a", 2)
    with pytest.raises(ShapeError, match="rows of 'f': not a function of a node"):
        rows(cs.Function("f", [a], [a], ["a"], ["y"]))
    with pytest.raises(ModelError, match="OP_ERFINV"):
        rows(cs.Function("f", [a], [cs.erfinv(a)], ["x"], ["y"]), "numpy")


def test_without_a_compiler_numpy_evaluates_with_one_warning(monkeypatch):
    def no_compiler(*_):
        raise NoCompilerError("no compiler")

    monkeypatch.setattr("piaffe.sampling.evaluators.library_of", no_compiler)
    with pytest.warns(NoCompilerWarning, match="evaluating in NumPy, about ten times slower: no compiler") as warned:
        own = evaluator(mode(), "native")
    assert len(warned) == 1
    assert warned[0].filename == __file__
    assert own.engine == "numpy"
    np.testing.assert_allclose(own.stage(**arguments())[0], by_hand(arguments())[0], rtol=1e-12)


def test_sampling_is_imported_without_jax():
    program = (
        "import sys; sys.modules['jax'] = None\n"
        "import piaffe.sampling.evaluators, piaffe.sampling.translate, piaffe.sampling.controllers.reduce"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
