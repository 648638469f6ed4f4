"""SIMD: the C code of a function, compiled for 1, 4 and 8 doubles per vector, returns CasADi's numbers."""

import ctypes
import os
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi as cs
import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.codegen import simd
from piaffe.errors import ModelError
from piaffe.models import base, joints, stance

WIDTHS = (1, 2, 4, 8)
FLAGS = ["-std=c11", "-O1", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math"]
COMPILER = shutil.which(os.environ.get("CC") or "gcc") or shutil.which("clang")

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler (gcc or clang) on this machine")


class Library:
    """Functions compiled for one width; `call` has arguments and results (width, nonzeros)."""

    def __init__(self, functions: dict[str, cs.Function], width: int, folder: Path, **options: int) -> None:
        units = simd.generate(functions, **options)
        self.functions, self.width, self.work = functions, width, units.work
        folder.mkdir(parents=True)
        for name, text in [*units.headers.items(), *((f"{unit.name}.c", unit.text) for unit in units.units)]:
            (folder / name).write_text(text)
        native = [] if self._refused(["-march=native"], folder) else ["-march=native"]
        warnings = ["-Wall", "-Werror", "-Wno-psabi"]
        flags = [*FLAGS, *native, *warnings, f"-DPIAFFE_W={width}", "-fPIC", "-c"]
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda unit: self._run([*flags, f"{unit.name}.c"], folder), units.units))
        self._run(["-shared", "-o", "lib.so", *(f"{unit.name}.o" for unit in units.units), "-lm"], folder)
        self.library = ctypes.CDLL(str(folder / "lib.so"))

    @staticmethod
    def _refused(flags: list[str], folder: Path) -> bool:
        empty = [COMPILER, *flags, "-x", "c", "-fsyntax-only", os.devnull]
        return subprocess.run(empty, cwd=folder, capture_output=True).returncode != 0

    @staticmethod
    def _run(arguments: list[str], folder: Path) -> None:
        done = subprocess.run([COMPILER, *arguments], cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[:4000]

    def buffer(self, nonzeros: int) -> np.ndarray:
        """Return NaN of shape (nonzeros, width), aligned; a guard row behind it stays NaN."""
        raw = np.empty((nonzeros + 1) * self.width + 8)
        start = (-raw.ctypes.data % 64) // 8
        array = raw[start : start + (nonzeros + 1) * self.width].reshape(-1, self.width)
        array[:] = np.nan
        return array

    def call(self, name: str, *arguments: np.ndarray) -> list[np.ndarray]:
        function = self.functions[name]
        inputs = [self.buffer(function.nnz_in(i)) for i in range(function.n_in())]
        for buffer, argument in zip(inputs, arguments, strict=True):
            buffer[:-1] = argument.T
        outputs = [self.buffer(function.nnz_out(i)) for i in range(function.n_out())]
        work = self.buffer(self.work[name])
        pointers = [(ctypes.c_void_p * len(x))(*(y.ctypes.data for y in x)) for x in (inputs, outputs)]
        getattr(self.library, name)(*pointers, ctypes.c_void_p(work.ctypes.data))
        assert all(np.isnan(buffer[-1]).all() for buffer in [*outputs, work]), "wrote beyond the end"
        return [buffer[:-1].T for buffer in outputs]

    def expected(self, name: str, *arguments: np.ndarray) -> list[np.ndarray]:
        function = self.functions[name]
        points = [
            function.call([cs.DM(function.sparsity_in(i), a[lane]) for i, a in enumerate(arguments)])
            for lane in range(self.width)
        ]
        return [np.array([p[i].nonzeros() for p in points]).reshape(self.width, -1) for i in range(function.n_out())]


# ------------------------------------------------------------------------------------------------------- operations

ANY = (-1e5, -77.3, -2.0, -1.5, -1.0, -0.4, -1e-9, -0.0, 0.0, 1e-300, 1e-9, 0.3, 1.0, 1.5, 2.0, 3.0, 12.7, 1e5)
SMALL = tuple(x for x in ANY if abs(x) < 100)
POSITIVE = (1e-300, 1e-9, 0.3, 1.0, 1.5, 2.0, 77.3, 1e5, 1e300)
UNIT = (-1.0, -0.999, -0.5, -1e-9, 0.0, 1e-9, 0.5, 0.999, 1.0)
TRUTH = (-1.0, -0.0, 0.0, 0.5, 1.0)
NONZERO = tuple(x for x in ANY if x)

UNARY = {
    "OP_NEG": (lambda x: -x, ANY),
    "OP_SQ": (lambda x: x**2, ANY),
    "OP_TWICE": (lambda x: 2 * x, ANY),
    "OP_INV": (lambda x: 1 / x, (-77.3, -2.0, 1e-9, 0.3, 1e5)),
    "OP_SQRT": (cs.sqrt, (0.0, *POSITIVE)),
    "OP_EXP": (cs.exp, SMALL),
    "OP_EXPM1": (cs.expm1, SMALL),
    "OP_LOG": (cs.log, POSITIVE),
    "OP_LOG1P": (cs.log1p, (-0.999, -1e-9, 0.0, *POSITIVE)),
    "OP_SIN": (cs.sin, ANY),
    "OP_COS": (cs.cos, ANY),
    "OP_TAN": (cs.tan, SMALL),
    "OP_ASIN": (cs.asin, UNIT),
    "OP_ACOS": (cs.acos, UNIT),
    "OP_ATAN": (cs.atan, ANY),
    "OP_SINH": (cs.sinh, SMALL),
    "OP_COSH": (cs.cosh, SMALL),
    "OP_TANH": (cs.tanh, ANY),
    "OP_ASINH": (cs.asinh, ANY),
    "OP_ACOSH": (cs.acosh, (1.0, 1.5, 77.3)),
    "OP_ATANH": (cs.atanh, UNIT[1:-1]),
    "OP_ERF": (cs.erf, ANY),
    "OP_FLOOR": (cs.floor, ANY),
    "OP_CEIL": (cs.ceil, ANY),
    "OP_FABS": (cs.fabs, ANY),
    "OP_SIGN": (cs.sign, ANY),
    "OP_NOT": (cs.logic_not, (*TRUTH, *ANY)),
    "OP_CONSTPOW": (lambda x: cs.constpow(x, 2.5), POSITIVE[:-1]),
}
BINARY = {
    "OP_ADD": (lambda x, y: x + y, ANY, ANY),
    "OP_SUB": (lambda x, y: x - y, ANY, ANY),
    "OP_MUL": (lambda x, y: x * y, ANY, ANY),
    "OP_DIV": (lambda x, y: x / y, ANY, NONZERO),
    "OP_POW": (cs.power, POSITIVE[1:-1], SMALL[2:]),
    "OP_ATAN2": (cs.atan2, ANY, ANY),
    "OP_HYPOT": (cs.hypot, ANY, ANY),
    "OP_FMOD": (cs.fmod, ANY, NONZERO),
    "OP_REMAINDER": (cs.remainder, ANY, NONZERO),
    "OP_COPYSIGN": (cs.copysign, ANY, ANY),
    "OP_FMIN": (cs.fmin, ANY, ANY),
    "OP_FMAX": (cs.fmax, ANY, ANY),
    "OP_LT": (lambda x, y: x < y, ANY, ANY),
    "OP_LE": (lambda x, y: x <= y, ANY, ANY),
    "OP_EQ": (lambda x, y: x == y, ANY, ANY),
    "OP_NE": (lambda x, y: x != y, ANY, ANY),
    "OP_AND": (cs.logic_and, TRUTH, TRUTH),
    "OP_OR": (cs.logic_or, TRUTH, TRUTH),
    "OP_IF_ELSE_ZERO": (lambda x, y: cs.if_else(x, y, 0), TRUTH, ANY),
}
OPERATIONS = UNARY | BINARY
SIGNED_ZEROS = {"OP_NEG", "OP_FABS", "OP_SIGN", "OP_COPYSIGN", "OP_FLOOR", "OP_CEIL", "OP_MUL", "OP_DIV", "OP_SQRT"}


def operation(name: str) -> cs.Function:
    x, y = cs.SX.sym("x"), cs.SX.sym("y")
    function = OPERATIONS[name][0]
    return cs.Function(name, [x, y], [function(x) if name in UNARY else function(x, y)])


@pytest.fixture(scope="module", params=WIDTHS)
def operations(request, tmp_path_factory) -> Library:
    return Library({name: operation(name) for name in OPERATIONS}, request.param, tmp_path_factory.mktemp("ops") / "c")


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_agrees_with_casadi(operations, name):
    function = operations.functions[name]
    assert getattr(cs, name) in [function.instruction_id(i) for i in range(function.n_instructions())]
    sets = OPERATIONS[name][1:]
    rng = np.random.default_rng(7)
    x = np.repeat(sets[0], len(sets[-1])) if len(sets) == 2 else np.array(sets[0])
    y = np.tile(sets[1], len(sets[0])) if len(sets) == 2 else np.zeros(len(x))
    low, high = max(min(sets[0]), -1e3), min(max(sets[0]), 1e3)
    between = rng.uniform(low, high, 64) if name not in ("OP_AND", "OP_OR") else rng.choice(TRUTH, 64)
    x, y = np.concatenate([x, between]), np.concatenate([y, rng.choice(sets[-1], 64)])
    width = operations.width
    for start in range(0, len(x), width):
        point = [np.resize(v[start : start + width], (width, 1)) for v in (x, y)]
        (got,), (expected,) = operations.call(name, *point), operations.expected(name, *point)
        np.testing.assert_allclose(got, expected, rtol=4e-15, atol=1e-15 if name in ("OP_SIN", "OP_COS") else 0)
        if name in SIGNED_ZEROS:
            np.testing.assert_array_equal(np.signbit(got), np.signbit(expected))


def test_every_operation_that_can_be_lowered_is_tested():
    assert {getattr(cs, name) for name in OPERATIONS} == {*simd._TEMPLATES, cs.OP_SIN, cs.OP_COS}


@pytest.mark.parametrize(("name", "function"), [("OP_ERFINV", cs.erfinv), ("OP_PRINTME", lambda x: x.printme(1))])
def test_an_operation_without_a_simd_form_is_named(name, function):
    x = cs.SX.sym("x")
    with pytest.raises(ModelError, match=rf"function 'odd': .* got {name}, expected"):
        simd.generate({"odd": cs.Function("f", [x], [function(x)])})


def test_sine_and_cosine_are_exact_to_rounding(operations):
    rng = np.random.default_rng(11)
    turns = np.arange(-60000, 60000, 97) * (np.pi / 2)  # where one of them vanishes
    angles = np.concatenate([rng.uniform(-1e5, 1e5, 4000), rng.uniform(-4, 4, 4000), turns])
    for name, exact in (("OP_SIN", np.sin), ("OP_COS", np.cos)):
        parts = [np.resize(angles[i : i + operations.width], (operations.width, 1)) for i in range(len(angles))]
        got = np.array([operations.call(name, part, part)[0][0, 0] for part in parts])
        assert np.abs(got - exact(angles.astype(np.longdouble))).max() < 2e-16


def test_inverse_tangent_is_exact_to_rounding(operations):
    rng = np.random.default_rng(12)
    y, x = rng.standard_normal((2, 4000)) * 10.0 ** rng.integers(-12, 12, (2, 4000))
    width = operations.width
    parts = [[v[i : i + width, None] for v in (y, x)] for i in range(0, len(x), width)]
    got = np.concatenate([operations.call("OP_ATAN2", *part)[0][:, 0] for part in parts])
    exact = np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble))
    assert np.abs(got / exact - 1).max() < 5e-16


@pytest.mark.parametrize("name", OPERATIONS)
def test_what_is_not_a_number_stays_so(operations, name):
    kept = {"OP_FMIN", "OP_FMAX", "OP_LT", "OP_LE", "OP_EQ", "OP_NE", "OP_NOT", "OP_AND", "OP_OR", "OP_IF_ELSE_ZERO"}
    point = [np.full((operations.width, 1), x) for x in (np.nan, 0.5)]
    (got,), (expected,) = operations.call(name, *point), operations.expected(name, *point)
    np.testing.assert_array_equal(got, expected)
    assert np.isnan(got).all() or name in kept


def test_a_branch_that_is_not_taken_may_be_nan(tmp_path):
    x = cs.SX.sym("x")
    function = cs.Function(
        "f", [x], [cs.if_else(x > 0, cs.log(x), cs.sqrt(-x)), cs.if_else(cs.logic_not(x < 1), 1 / x, 2)]
    )
    library = Library({"f": function}, 4, tmp_path / "c")
    points = np.array([[0.5], [-4.0], [2.0], [0.0]])
    first, second = library.call("f", points)
    np.testing.assert_allclose(first[:, 0], [np.log(0.5), 2, np.log(2), 0], rtol=1e-15)
    np.testing.assert_array_equal(second[:, 0], [2, 2, 0.5, 2])


# ---------------------------------------------------------------------------------------------------- whole functions


def agree(library: Library, name: str, rng: np.random.Generator, scale: float = 1.0) -> None:
    function = library.functions[name]
    points = [scale * rng.standard_normal((library.width, function.nnz_in(i))) for i in range(function.n_in())]
    got, expected = library.call(name, *points), library.expected(name, *points)
    for i, (a, b) in enumerate(zip(got, expected, strict=True)):
        where = f"{name}, output {function.name_out(i)}"
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * max(1.0, np.abs(b).max(initial=0)), err_msg=where)


def shapes() -> dict[str, cs.Function]:
    x, y, m = cs.SX.sym("x", 3), cs.SX.sym("y", 0), cs.SX.sym("m", cs.Sparsity.upper(3))
    symbol = cs.MX.sym("v", 3)
    outputs = [x, cs.SX(2, 0), cs.vertcat(0, 0, 0, 0, 0, x[0], 0, -2.5, -2.5, 1e300, 0.1), m.T @ x, x[0] * x, y]
    zeros = cs.vertcat(cs.SX.zeros(9), cs.sin(x[1]), cs.SX.zeros(3), x[1], x[1], x[1], x[1], cs.cos(x[2]), cs.sin(x[2]))
    return {
        "shapes": cs.Function("shapes", [x, y, m], [*outputs, zeros, cs.SX(cs.inf), -cs.SX(cs.inf)]),
        "expanded": cs.Function("expanded", [symbol], [cs.dot(symbol, symbol) * cs.sin(symbol)]),
        "nothing": cs.Function("nothing", [x], []),
    }


@pytest.mark.parametrize("width", WIDTHS)
def test_literals_inputs_and_empty_outputs_are_stored(width, tmp_path):
    library = Library(shapes(), width, tmp_path / "c")
    for name in library.functions:
        agree(library, name, np.random.default_rng(2))


def leg() -> cs.Function:
    """A function with values of short and long life."""
    x = cs.SX.sym("x", 6)
    values = [x[i] for i in range(6)]
    for i in range(300):
        values.append(0.5 * cs.sin(values[i]) * values[-1] + 0.4 * values[len(values) // 2] - 0.1 * values[i % 6])
    return cs.Function("leg", [x], [cs.vertcat(*values[::7]), cs.jacobian(values[40], x)])


@pytest.mark.parametrize("chunk", [2, 50, 100_000])
def test_values_cross_from_chunk_to_chunk(chunk, tmp_path):
    library = Library({"leg": leg()}, 4, tmp_path / "c", chunk=chunk, unit=700)
    agree(library, "leg", np.random.default_rng(3))
    assert (library.work["leg"] == 0) == (chunk == 100_000)
    assert library.work["leg"] < 320


def test_generated_text_is_the_same_every_time():
    first, second = (simd.generate({"leg": leg(), **shapes()}, chunk=50, unit=100) for _ in range(2))
    assert first == second
    assert len({unit.name for unit in first.units}) == len(first.units) > 3
    assert [unit.instructions for unit in first.units] == sorted((u.instructions for u in first.units), reverse=True)


def test_sparsified_keeps_the_nonzeros_alone():
    x = cs.SX.sym("x", 3)
    dense = cs.Function("f", [x], [cs.densify(cs.diag(x**2)), cs.SX.zeros(4)], ["x"], ["square", "none"])
    sparse = simd.sparsified(dense)
    assert [sparse.nnz_out(i) for i in range(2)] == [3, 0]
    assert (sparse.name(), sparse.name_in(), sparse.name_out()) == ("f", ["x"], ["square", "none"])
    np.testing.assert_array_equal(sparse([1, 2, 3])[0].full(), np.diag([1, 4, 9]))


@pytest.mark.parametrize("chunk", [0, -3])
def test_sizes_are_positive(chunk):
    with pytest.raises(ValueError, match=f"got chunk={chunk}"):
        simd.generate({}, chunk=chunk)


@pytest.fixture(scope="module")
def shipped() -> dict[str, cs.Function]:
    """Every function of both shipped models' modes and of the way from one to the other."""
    robot = models.load("mini_cheetah")
    body, block = models.WholeBody(robot), models.SingleRigidBody(robot)
    motion = ocp.Motion(
        ocp.Phase("stand", stance("FL FR HL HR"), 0.1, ocp.Keyframe(position=(0, 0, 0.26), joints="stand")),
        ocp.Phase("fly", stance(""), 0.1, ocp.Keyframe(position=(0, 0, 0.3), joints="stand")),
        ocp.Phase("land", stance("FL FR HL HR"), 0.1, ocp.Keyframe(position=(0, 0, 0.26), joints="stand")),
    )
    objective = ocp.Objective(
        ocp.track(base.position, 1.0), ocp.track(base.orientation, 1.0), ocp.track(joints.position, 1.0),
        ocp.regularize(joints.torque, 0.1), ocp.regularize(models.feet.force, 0.1),
        ocp.track(base.orientation, 2.0, at="phase_end"),
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(mu=0.6), models.torque_limits(), models.foot_clearance(minimum=0.0))
    schedule = body.over(0.25, dt=0.05) + block.over(0.05, dt=0.05)
    start = body.state(joints="stand")
    compiled = ocp.compile_problem(ocp.Problem(motion, schedule, objective, limits, initial=start))
    functions: dict[str, cs.Function] = {}
    for phase in compiled.phases:
        groups = {phase.mode.model.name + "_" + phase.mode.key: phase.mode.functions}
        if phase.transition is not None:
            groups["transition"] = phase.transition.functions  # of several the last, between the models
        for group, members in groups.items():
            prefix = "".join(c if c.isalnum() else "_" for c in group)
            functions |= {f"{prefix}_{name}": simd.sparsified(function) for name, function in members.items()}
    return functions


@pytest.mark.parametrize("width", WIDTHS)
def test_functions_of_the_shipped_models_agree_with_casadi(shipped, width, tmp_path):
    library = Library(shipped, width, tmp_path / "c", chunk=300)
    rng = np.random.default_rng(width)
    for name in library.functions:
        for _ in range(max(1, 4 // width)):
            agree(library, name, rng)
