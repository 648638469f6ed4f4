"""Manifolds: ⊕ and ⊖ undo each other, ignore the quaternion's sign, and have the derivatives that they claim."""

import casadi as cs
import numpy as np
import pytest

from piaffe.errors import ShapeError, UnknownNameError
from piaffe.ocp import Block, Manifold, Quantity, rotation

POSITION = Quantity("position", "m", "point")
ATTITUDE = Quantity("attitude", "rad", "rotation")
SPEED = Quantity("speed", "m/s")
XYZ = ("x", "y", "z")
STATE = Manifold((Block(POSITION, XYZ), Block(ATTITUDE, XYZ), Block(SPEED, ("a", "b"), rate_of=None)))


def drawn(rng, count):
    """Return random states, quaternions of either sign."""
    x = rng.standard_normal((count, STATE.nx))
    return STATE.np_normalise(x)


def compiled(function, *sizes):
    symbols = [cs.SX.sym(f"a{i}", size) for i, size in enumerate(sizes)]
    return cs.Function("f", symbols, [function(*symbols)])


PLUS = compiled(STATE.plus, STATE.nx, STATE.ndx)
MINUS = compiled(STATE.minus, STATE.nx, STATE.nx)


def test_sizes_slices_and_labels():
    assert (STATE.nx, STATE.ndx) == (9, 8)
    assert STATE.slices[SPEED] == slice(7, 9)
    assert STATE.tangent_slices[SPEED] == slice(6, 8)
    assert STATE.labels == (
        "position x", "position y", "position z", "attitude x", "attitude y", "attitude z", "speed a", "speed b",
    )  # fmt: skip


def test_integrate_then_difference_is_identity():
    rng = np.random.default_rng(0)
    x, dx = drawn(rng, 50), rng.uniform(-1.8, 1.8, (50, STATE.ndx))  # turns by less than pi
    assert STATE.np_minus(STATE.np_plus(x, dx), x) == pytest.approx(dx, abs=1e-12)
    for a, d in zip(x, dx, strict=True):
        assert np.array(MINUS(PLUS(a, d), a)).ravel() == pytest.approx(d, abs=1e-12)


def test_difference_then_integrate_is_identity_up_to_sign():
    rng = np.random.default_rng(1)
    x0, x1 = drawn(rng, 50), drawn(rng, 50)
    back = STATE.np_plus(x0, STATE.np_minus(x1, x0))
    q, expected = back[:, 3:7], x1[:, 3:7]
    sign = np.sign(np.sum(q * expected, axis=1, keepdims=True))
    assert sign * q == pytest.approx(expected, abs=1e-12)
    assert back[:, :3] == pytest.approx(x1[:, :3], abs=1e-14)


def test_difference_ignores_the_sign_of_either_quaternion():
    rng = np.random.default_rng(2)
    x0, x1 = drawn(rng, 20), drawn(rng, 20)
    expected = STATE.np_minus(x1, x0)
    flipped = x1.copy()
    flipped[:, 3:7] *= -1
    assert STATE.np_minus(flipped, x0) == pytest.approx(expected, abs=1e-14)
    assert STATE.np_minus(x0, flipped) == pytest.approx(STATE.np_minus(x0, x1), abs=1e-14)
    for a, b, c in zip(flipped, x0, expected, strict=True):
        assert np.array(MINUS(a, b)).ravel() == pytest.approx(c, abs=1e-12)


def test_casadi_and_numpy_agree():
    rng = np.random.default_rng(3)
    for a, b, d in zip(drawn(rng, 10), drawn(rng, 10), rng.standard_normal((10, STATE.ndx)), strict=True):
        assert np.array(PLUS(a, d)).ravel() == pytest.approx(STATE.np_plus(a, d), abs=1e-14)
        assert np.array(MINUS(a, b)).ravel() == pytest.approx(STATE.np_minus(a, b), abs=1e-13)


def test_a_rotation_is_moved_on_the_right():
    """Body axes: turning about the body's x after a quarter turn of yaw turns about the world's y."""
    yawed = rotation.np_exp(np.array([0.0, 0.0, np.pi / 2]))
    x = np.concatenate([np.zeros(3), yawed, np.zeros(2)])
    moved = STATE.np_plus(x, np.array([0, 0, 0, 0.2, 0, 0, 0, 0]))
    assert rotation.np_matrix(moved[3:7]) == pytest.approx(
        rotation.np_matrix(rotation.np_exp(np.array([0.0, 0.2, 0.0]))) @ rotation.np_matrix(yawed), abs=1e-14
    )


def test_nudge_has_the_derivative_of_plus():
    x, dx = cs.SX.sym("x", STATE.nx), cs.SX.sym("dx", STATE.ndx)
    at = [x, dx]
    slopes = [cs.Function("J", at, [cs.jacobian(f(x, dx), dx)]) for f in (STATE.plus, STATE.nudge)]
    here = drawn(np.random.default_rng(4), 1)[0]
    exact, nudged = (np.array(f(here, np.zeros(STATE.ndx))) for f in slopes)
    assert nudged == pytest.approx(exact, abs=1e-14)


def test_derivative_of_the_difference_at_zero_is_the_identity():
    x, dx, x0 = cs.SX.sym("x", STATE.nx), cs.SX.sym("dx", STATE.ndx), cs.SX.sym("x0", STATE.nx)
    J = cs.Function("J", [x, dx, x0], [cs.jacobian(STATE.minus(STATE.nudge(x, dx), x0), dx)])
    here = drawn(np.random.default_rng(5), 1)[0]
    assert np.array(J(here, np.zeros(STATE.ndx), here)) == pytest.approx(np.eye(STATE.ndx), abs=1e-14)


def test_pack_and_unpack_undo_each_other():
    x = drawn(np.random.default_rng(6), 3)
    assert STATE.pack(STATE.unpack(x)) == pytest.approx(x, abs=0)


def test_pack_names_a_block_of_the_wrong_size():
    with pytest.raises(ShapeError, match=r"quantity 'speed': wrong size - got 3 entries, expected 2 \(a, b\) \[m/s\]"):
        STATE.pack({POSITION: np.zeros(3), ATTITUDE: np.eye(4)[0], SPEED: np.zeros(3)})


def test_block_by_path_and_by_a_wrong_one():
    assert STATE.block("speed").quantity is SPEED
    with pytest.raises(UnknownNameError, match=r"no quantity 'sped'.*did you mean 'speed'"):
        STATE.block("sped")


def test_normalise_leaves_vectors_alone():
    x = np.arange(1.0, 10.0)
    y = STATE.np_normalise(x)
    assert np.linalg.norm(y[3:7]) == pytest.approx(1.0)
    assert y[[0, 1, 2, 7, 8]] == pytest.approx(x[[0, 1, 2, 7, 8]], abs=0)


def test_an_empty_manifold_has_size_zero():
    assert (Manifold(()).nx, Manifold(()).ndx, Manifold(()).labels) == (0, 0, ())
