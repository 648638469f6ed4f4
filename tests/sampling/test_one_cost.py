"""One cost: for every shipped motion all engines give what CasADi's own functions give, on 100 000 random points."""

import importlib.util
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import jax
import numpy as np
import pytest

from piaffe import ocp
from piaffe.sampling.evaluators import evaluator

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
STEPS, SAMPLES = 20, 5000
POINTS = STEPS * SAMPLES
ENGINES = ("native", "numpy", "vm")


# ------------------------------------------------------------------------------------------------- motions and points


@lru_cache
def example(name):
    if str(EXAMPLES) not in sys.path:  # as when one of them is run: some build on another
        sys.path.insert(0, str(EXAMPLES))
    spec = importlib.util.spec_from_file_location(f"one_cost_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def applies(term, motion):
    """Return whether a motion has the phases that a term names."""
    return set(term.when or ()) <= {phase.name for piece in motion.pieces for phase in piece.phases}


def problems(name):
    """Return an example's problems by name; of one that solves others first, its motions with its terms."""
    module = example(name)
    found = {key: value for key, value in vars(module).items() if isinstance(value, ocp.Problem)}
    if not found:
        motions = {key: value for key, value in vars(module).items() if isinstance(value, ocp.Motion)}
        terms = module if hasattr(module, "objective") else example("running_roll")  # those without build on it
        body = terms.body
        found = {
            key: ocp.Problem(
                motion, body.until_end(dt=0.01) if np.isfinite(motion.duration) else body.over(0.5, dt=0.01),
                terms.objective, ocp.Constraints(*(each for each in terms.limits if applies(each, motion))),
                initial=body.state(joints="stand"),
            )
            for key, motion in motions.items()
        }  # fmt: skip
    assert found
    return found


@dataclass(frozen=True)
class Points:
    """Random points of a mode, at nodes of its motions; arguments of an evaluator's stage and terminal."""

    mode: ocp.LoweredMode
    stage: dict
    terminal: dict


def points(name):
    """Return the points of each mode that an example's problems lower to."""
    nodes = {}
    for problem in problems(name).values():
        for phase in ocp.compile_problem(problem).phases:
            nodes.setdefault(phase.mode, []).append(phase)
    return [points_of(mode, phases) for mode, phases in nodes.items()]


def points_of(mode, phases):
    random = np.random.default_rng(7)
    nx, nu, nz = mode.state.nx, mode.nu, mode.nz
    x = mode.state.np_normalise(random.normal(size=(POINTS, nx)) * random.choice([0.3, 1.0, 3.0], size=(POINTS, 1)))
    tables = [np.concatenate([getattr(phase, key) for phase in phases]) for key in ("p", "weight", "g_mask", "h_mask")]
    at = random.integers(len(tables[0]), size=STEPS)
    p, weight, g_mask, h_mask = (table[at] for table in tables)
    stage = {
        "states": x.reshape(SAMPLES, STEPS, nx), "controls": 10 * random.normal(size=(SAMPLES, STEPS, nu)),
        "z": 10 * random.normal(size=(SAMPLES, STEPS, nz)),
        "p": p, "weight": weight, "g_mask": g_mask, "h_mask": h_mask,
    }  # fmt: skip
    end = phases[random.integers(len(phases))]
    numbers = {"weight": end.end_weight, "g_mask": end.end_g_mask, "h_mask": end.end_h_mask}
    kinds = ("residual", "g", "h")  # the rows of the mode come first, those of the reset after them
    own = {key: numbers[key][: len(mode.rows[f"terminal_{kind}"])] for key, kind in zip(numbers, kinds, strict=True)}
    terminal = {"states": x, "p": end.p_end, **own}
    return Points(mode, stage, terminal)


# ---------------------------------------------------------------------------------------- what all are compared with


def call_by_call(function, points, p):
    """Return residual, g and h of a lowered function, each (n, S, rows), one call of CasADi per point.

    points are the arrays (n, S, size) of all inputs but the last, p (S, np) is that.
    """
    buffer, run = function.buffer()
    arguments = [np.zeros(max(1, function.size1_in(i))) for i in range(function.n_in())]
    for i, each in enumerate(arguments):
        buffer.set_arg(i, each.data)
    got = [np.zeros(max(1, function.size1_out(i))) for i in range(function.n_out())]
    for i, each in enumerate(got):
        buffer.set_res(i, each.data)
    wanted = [function.name_out().index(name) for name in ("residual", "g", "h")]
    samples, steps = points[0].shape[:2]
    rows = [np.zeros((samples, steps, function.size1_out(i))) for i in wanted]
    read = [(each, point) for each, point in zip(arguments, points, strict=False) if point.shape[2]]
    written = [(row, got[i]) for row, i in zip(rows, wanted, strict=True) if row.shape[2]]
    for step in range(steps):
        arguments[-1][:] = p[step]
        for sample in range(samples):
            for each, point in read:
                each[:] = point[sample, step]
            run()
            for row, each in written:
                row[sample, step] = each
    return rows


def score(residual, g, h, weight, g_mask, h_mask):
    """Return cost (n, S) and violation (nc, n, S) as the convention says."""
    cost = 0.5 * np.sum(weight * residual**2, axis=2)
    violation = np.concatenate([np.maximum(-g, 0) * g_mask, np.abs(h) * h_mask], axis=2)
    return np.asfortranarray(cost), np.ascontiguousarray(violation.T).transpose(0, 2, 1)  # as evaluators lay it out


@lru_cache(maxsize=1)  # some 100 MB a mode
def case(name):
    """Return points per mode, and cost and violation of the stage and of the last node from CasADi's own functions."""
    found = []
    for each in points(name):
        given, functions = each.stage, each.mode.functions
        rows = call_by_call(functions["stage"], [given["states"], given["controls"], given["z"]], given["p"])
        stage = score(*rows, given["weight"], given["g_mask"], given["h_mask"])
        given = each.terminal
        rows = call_by_call(functions["terminal"], [given["states"][:, None]], given["p"][None])
        cost, violation = score(*rows, given["weight"], given["g_mask"], given["h_mask"])
        found.append((each, (*stage, cost[:, 0], violation[:, :, 0])))
    return found


def assert_equal(got, want):
    """Equal to 1e-9 of the number, or of 1 where it is smaller."""
    error = np.abs(got - want) / np.maximum(1.0, np.abs(want))
    assert np.max(error) <= 1e-9


def assert_close(got, want):
    """Equal to 1e-4 of the number, or of the root mean square of its row where it is smaller, or of 1."""
    usual = max(1.0, np.sqrt(np.mean(want**2)))
    error = np.abs(np.asarray(got, dtype=float) - want) / np.maximum(usual, np.abs(want))
    assert np.max(error) <= 1e-4


def check(own, each, want, agree, number=np.float64):
    """Compare an evaluator's stage and last node with what is wanted."""
    given, end = ({key: np.asarray(a, dtype=number) for key, a in part.items()} for part in (each.stage, each.terminal))
    for got, wanted in zip((*own.stage(**given), *own.terminal(**end)), want, strict=True):
        assert got.dtype == number
        assert got.shape == wanted.shape
        rows = [[a] if wanted.shape in ((SAMPLES, STEPS), (POINTS,)) else a for a in (np.asarray(got), wanted)]
        for got_row, wanted_row in zip(*rows, strict=True):
            agree(got_row, wanted_row)


# ------------------------------------------------------------------------------------------------------------- tests

SAMPLED_AGAIN = {"train_value", "own_sampler"}  # the very problem of trot_mppi
MOTIONS = sorted({path.stem for path in EXAMPLES.glob("*.py")} - SAMPLED_AGAIN)
PRECISIONS = {"double": (np.float64, assert_equal), "single": (np.float32, assert_close)}


def test_every_shipped_motion_is_covered():
    assert {"barrel_roll", "cascade", "gaits", "own_dynamics", "own_terms", "biped", "run_roll_run"} <= set(MOTIONS)
    assert {"bound", "pace", "flying_trot", "pronk"} <= set(problems("gaits"))
    assert {"roll", "pace"} <= set(problems("run_roll_run"))
    assert [each.mode.model.name for each in points("cascade")] == ["mini_cheetah", "mini_cheetah rigid body"]
    assert all(each.stage["states"].shape[:2] == (SAMPLES, STEPS) for each in points("own_dynamics"))
    assert POINTS == 100_000


@pytest.fixture(scope="module", params=MOTIONS)
def motion(request):
    """Yield the name of an example; all tests of one run before those of the next, so that one is kept in memory."""
    yield request.param
    case.cache_clear()
    jax.clear_caches()  # operations of other sizes


def test_engines_agree(motion):
    for each, want in case(motion):
        assert all(np.isfinite(part).all() for part in want)
        for engine in ENGINES:
            check(evaluator(each.mode, engine), each, want, assert_equal)


def check_jax(motion, precision):
    number, agree = PRECISIONS[precision]
    with jax.enable_x64(precision == "double"):
        for each, want in case(motion):
            check(evaluator(each.mode, "jax"), each, want, agree, number)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_jax_agrees(motion, precision):
    with jax.disable_jit():  # operation by operation: nothing to compile
        check_jax(motion, precision)


SOME = [name if name == "gaits" else pytest.param(name, marks=pytest.mark.slow) for name in MOTIONS]


@pytest.mark.parametrize("motion", SOME, indirect=True)
def test_compiled_jax_agrees_in_double_precision(motion):
    check_jax(motion, "double")


@pytest.mark.slow
def test_compiled_jax_agrees_in_single_precision(motion):
    check_jax(motion, "single")
