"""Translation: every operation on arrays gives CasADi's numbers, in NumPy and in JAX."""

import sys

import casadi as cs
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from piaffe.codegen import simd
from piaffe.errors import ModelError, SamplingError
from piaffe.sampling.translate import NUMPY_ERF, instructions, translate

ANY = (-77.3, -2.0, -1.5, -1.0, -0.4, -1e-9, -0.0, 0.0, 1e-9, 0.3, 1.0, 1.5, 2.0, 2.5, 3.0, 12.7)
POSITIVE = (1e-9, 0.3, 1.0, 1.5, 2.0, 77.3)
NONZERO = tuple(x for x in ANY if x)
UNIT = (-0.999, -0.5, -1e-9, 0.0, 1e-9, 0.5, 0.999)
TRUTH = (-1.0, -0.0, 0.0, 0.5, 1.0)

UNARY = {
    "OP_NEG": (lambda x: -x, ANY), "OP_SQ": (lambda x: x**2, ANY), "OP_TWICE": (lambda x: 2 * x, ANY),
    "OP_INV": (lambda x: 1 / x, NONZERO), "OP_SQRT": (cs.sqrt, POSITIVE), "OP_EXP": (cs.exp, ANY),
    "OP_EXPM1": (cs.expm1, ANY), "OP_LOG": (cs.log, POSITIVE), "OP_LOG1P": (cs.log1p, POSITIVE),
    "OP_SIN": (cs.sin, ANY), "OP_COS": (cs.cos, ANY), "OP_TAN": (cs.tan, ANY), "OP_ASIN": (cs.asin, UNIT),
    "OP_ACOS": (cs.acos, UNIT), "OP_ATAN": (cs.atan, ANY), "OP_SINH": (cs.sinh, ANY), "OP_COSH": (cs.cosh, ANY),
    "OP_TANH": (cs.tanh, ANY), "OP_ASINH": (cs.asinh, ANY), "OP_ACOSH": (cs.acosh, (1.0, 1.5, 77.3)),
    "OP_ATANH": (cs.atanh, UNIT), "OP_ERF": (cs.erf, ANY), "OP_FLOOR": (cs.floor, ANY), "OP_CEIL": (cs.ceil, ANY),
    "OP_FABS": (cs.fabs, ANY), "OP_SIGN": (cs.sign, ANY), "OP_NOT": (cs.logic_not, ANY),
    "OP_CONSTPOW": (lambda x: cs.constpow(x, 2.5), POSITIVE),
}  # fmt: skip
BINARY = {
    "OP_ADD": (lambda x, y: x + y, ANY, ANY), "OP_SUB": (lambda x, y: x - y, ANY, ANY),
    "OP_MUL": (lambda x, y: x * y, ANY, ANY), "OP_DIV": (lambda x, y: x / y, ANY, NONZERO),
    "OP_POW": (cs.power, POSITIVE, ANY[1:-1]), "OP_ATAN2": (cs.atan2, ANY, ANY), "OP_HYPOT": (cs.hypot, ANY, ANY),
    "OP_FMOD": (cs.fmod, ANY, (-2.0, 0.3, 1.0, 1.5)), "OP_REMAINDER": (cs.remainder, ANY, (-2.0, 0.3, 1.0, 1.5)),
    "OP_COPYSIGN": (cs.copysign, ANY, ANY), "OP_FMIN": (cs.fmin, ANY, ANY), "OP_FMAX": (cs.fmax, ANY, ANY),
    "OP_LT": (lambda x, y: x < y, ANY, ANY), "OP_LE": (lambda x, y: x <= y, ANY, ANY),
    "OP_EQ": (lambda x, y: x == y, ANY, ANY), "OP_NE": (lambda x, y: x != y, ANY, ANY),
    "OP_AND": (cs.logic_and, TRUTH, TRUTH), "OP_OR": (cs.logic_or, TRUTH, TRUTH),
    "OP_IF_ELSE_ZERO": (lambda x, y: cs.if_else(x, y, 0), TRUTH, ANY),
}  # fmt: skip


def operation(name):
    """Return the function of an operation, and its points (points, 2)."""
    make, *values = (UNARY | BINARY)[name]
    x, y = cs.SX.sym("x"), cs.SX.sym("y")
    function = cs.Function(name, [cs.vertcat(x, y)], [make(x) if name in UNARY else make(x, y)])
    first, second = values if name in BINARY else (values[0], (0.0,))
    return function, np.array([(a, b) for a in first for b in second])


def called(function, points):
    return np.array([function(point).full().ravel() for point in points])


@pytest.mark.parametrize("name", UNARY | BINARY)
def test_an_operation_gives_casadis_numbers(name):
    function, points = operation(name)
    ids = [function.instruction_id(k) for k in range(function.n_instructions())]
    assert getattr(cs, name) in ids
    want = called(function, points)
    in_numpy = instructions(function, np, NUMPY_ERF).columns(points.T)[0][0]
    np.testing.assert_allclose(in_numpy, want[:, 0], rtol=1e-14, atol=1e-15)
    with jax.enable_x64(True):
        (in_jax,) = translate(function)(points)
        assert in_jax.dtype == np.float64
        np.testing.assert_allclose(in_jax, want, rtol=1e-13, atol=1e-14)


def test_every_operation_of_the_simd_code_is_here():
    assert {getattr(cs, name) for name in UNARY | BINARY} | {cs.OP_SIN, cs.OP_COS} == set(simd._TEMPLATES) | {
        cs.OP_SIN, cs.OP_COS,
    }  # fmt: skip


def two_outputs():
    x, p = cs.SX.sym("x", 3), cs.SX.sym("p", 2)
    sparse = cs.vertcat(p[0] * x[1], cs.SX(1, 1), 4.0, x[2])
    return cs.Function("two", [x, p], [sparse, cs.norm_2(x)])


def test_constants_zeros_and_inputs_are_rows_like_others():
    points = np.array([[1.0, 2.0, 3.0], [-1.0, 0.5, 2.0]])
    first, second = translate(two_outputs())(points, np.array([2.0, 0.0]))
    np.testing.assert_allclose(first, [[4.0, 0.0, 4.0, 3.0], [1.0, 0.0, 4.0, 2.0]], rtol=1e-6)
    np.testing.assert_allclose(second[:, 0], np.linalg.norm(points, axis=1), rtol=1e-6)


def test_within_jit_vmap_and_grad():
    function = translate(two_outputs())
    x, p = jnp.array([1.0, 2.0, 2.0]), jnp.array([2.0, 0.0])
    gradient = jax.jit(jax.grad(lambda x: function(x, p)[1][0]))(x)
    np.testing.assert_allclose(gradient, [1 / 3, 2 / 3, 2 / 3], rtol=1e-6)
    many = jax.jit(jax.vmap(lambda x: function(x, p)[0]))(jnp.stack([x, 2 * x]))
    np.testing.assert_allclose(many[:, 0], [4.0, 8.0], rtol=1e-6)


def test_an_mx_function_is_expanded():
    x = cs.MX.sym("x", 2)
    function = cs.Function("f", [x], [cs.sin(x) + 1])
    np.testing.assert_allclose(translate(function)(np.array([0.3, 0.4]))[0], np.sin([0.3, 0.4]) + 1, rtol=1e-6)


def test_single_precision_stays_single_where_double_is_enabled():
    function, points = operation("OP_LT")
    with jax.enable_x64(True):
        assert translate(function)(points.astype(np.float32))[0].dtype == np.float32


def test_an_operation_without_a_form_is_named():
    x = cs.SX.sym("x")
    with pytest.raises(ModelError, match=r"function 'f': an operation has no form on arrays - got OP_ERFINV, expected"):
        translate(cs.Function("f", [x], [cs.erfinv(x)]))


def test_without_jax_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(SamplingError, match=r"pip install 'piaffe\[sampling\]', or choose engine=\"native\""):
        translate(two_outputs())
