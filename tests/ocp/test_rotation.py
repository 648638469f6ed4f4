"""Rotations: the algebra of Exp and Log, derivatives at their branches, agreement of both implementations."""

from math import pi

import casadi as cs
import numpy as np
import pytest

from piaffe.ocp import rotation

ANGLES = (0.0, 1e-12, 1e-8, 1e-5, 3.1e-3, 3.2e-3, 0.1, 1.0, 3.0, pi - 1e-6)  # 3.16e-3: where the series takes over


def compiled(function, *sizes):
    symbols = [cs.SX.sym(f"a{i}", size) for i, size in enumerate(sizes)]
    return cs.Function("f", symbols, [function(*symbols)])


def jacobian(function, size):
    a = cs.SX.sym("a", size)
    return cs.Function("J", [a], [cs.jacobian(function(a), a)])


EXP, LOG = compiled(rotation.exp, 3), compiled(rotation.log, 4)


@pytest.fixture
def axes():
    drawn = np.random.default_rng(0).standard_normal((5, 3))
    return np.vstack([drawn / np.linalg.norm(drawn, axis=1, keepdims=True), np.eye(3), -np.eye(3)])


@pytest.mark.parametrize("angle", ANGLES)
def test_log_undoes_exp(axes, angle):
    for axis in axes:
        phi = angle * axis
        q = np.array(EXP(phi)).ravel()
        assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)
        assert np.array(LOG(q)).ravel() == pytest.approx(phi, abs=1e-9 if angle > 3 else 2e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_casadi_and_numpy_agree(axes, angle):
    phi = angle * axes
    q = rotation.np_exp(phi)
    assert np.array([np.array(EXP(p)).ravel() for p in phi]) == pytest.approx(q, abs=1e-15)
    assert np.array([np.array(LOG(a)).ravel() for a in q]) == pytest.approx(rotation.np_log(q), abs=1e-13)
    for a in q:
        matrix = np.array(compiled(rotation.matrix, 4)(a))
        assert matrix == pytest.approx(rotation.np_matrix(a), abs=1e-15)
    product = compiled(rotation.multiply, 4, 4)
    assert np.array(product(q[0], q[1])).ravel() == pytest.approx(rotation.np_multiply(q[0], q[1]), abs=1e-15)
    assert np.array(compiled(rotation.conjugate, 4)(q[0])).ravel() == pytest.approx(rotation.np_conjugate(q[0]), abs=0)


def test_log_ignores_the_sign_of_the_quaternion(axes):
    for angle in ANGLES:
        q = rotation.np_exp(angle * axes)
        assert rotation.np_log(-q) == pytest.approx(rotation.np_log(q), abs=1e-15)
        for a in q:
            assert np.array(LOG(-a)).ravel() == pytest.approx(np.array(LOG(a)).ravel(), abs=1e-15)


def test_log_is_never_longer_than_half_a_turn(axes):
    for angle in np.linspace(0.0, 4 * pi, 41):
        length = np.linalg.norm(rotation.np_log(rotation.np_exp(angle * axes)), axis=1)
        nearest = abs((angle + pi) % (2 * pi) - pi)
        assert length == pytest.approx(nearest, abs=1e-9)


@pytest.mark.parametrize("angle", [*ANGLES, pi])
def test_derivatives_are_finite_on_both_sides_of_every_branch(axes, angle):
    """Both sides of a branch are evaluated, and a NaN in the unused one would spread through the derivative."""
    of_exp, of_log = jacobian(rotation.exp, 3), jacobian(rotation.log, 4)
    for axis in axes:
        assert np.all(np.isfinite(np.array(of_exp(angle * axis))))
        assert np.all(np.isfinite(np.array(of_log(rotation.np_exp(angle * axis)))))
        assert np.all(np.isfinite(np.array(of_log(-rotation.np_exp(angle * axis)))))


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-3, 0.5, 2.5])
def test_derivatives_match_central_differences(axes, angle):
    step = 1e-6
    for function, J, at in [
        (EXP, jacobian(rotation.exp, 3), angle * axes[0]),
        (LOG, jacobian(rotation.log, 4), rotation.np_exp(angle * axes[0])),
    ]:
        columns = [
            (np.array(function(at + d)) - np.array(function(at - d))).ravel() / (2 * step)
            for d in step * np.eye(len(at))
        ]
        assert np.array(J(at)) == pytest.approx(np.array(columns).T, abs=1e-8)


def test_second_derivatives_are_finite_at_the_identity():
    q = cs.SX.sym("q", 4)
    hessian = cs.Function("H", [q], [cs.hessian(cs.sumsqr(rotation.log(q)), q)[0]])
    assert np.all(np.isfinite(np.array(hessian(np.eye(4)[0]))))


def test_product_turns_vectors_in_the_order_of_matrices():
    rng = np.random.default_rng(1)
    a, b = rotation.np_exp(rng.standard_normal(3)), rotation.np_exp(rng.standard_normal(3))
    together = rotation.np_matrix(rotation.np_multiply(a, b))
    assert together == pytest.approx(rotation.np_matrix(a) @ rotation.np_matrix(b), abs=1e-15)
    assert rotation.np_matrix(rotation.np_conjugate(a)) == pytest.approx(rotation.np_matrix(a).T, abs=1e-15)


def test_exp_turns_about_its_axis_by_its_length():
    quarter = rotation.np_matrix(rotation.np_exp(np.array([0.0, 0.0, pi / 2])))
    assert quarter @ np.array([1.0, 0.0, 0.0]) == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)


def test_rpy_is_yaw_after_pitch_after_roll():
    roll, pitch, yaw = 0.3, -0.4, 2.0
    x, y, z = (rotation.np_exp(v) for v in np.diag([roll, pitch, yaw]))
    expected = rotation.np_multiply(rotation.np_multiply(z, y), x)
    assert rotation.np_from_rpy(np.array([roll, pitch, yaw])) == pytest.approx(expected, abs=1e-15)
    assert rotation.np_to_rpy(expected) == pytest.approx([roll, pitch, yaw], abs=1e-12)


def test_rpy_survives_batches_and_full_turns():
    rpy = np.random.default_rng(2).uniform(-1.5, 1.5, (4, 7, 3))
    assert rotation.np_to_rpy(rotation.np_from_rpy(rpy)) == pytest.approx(rpy, abs=1e-12)
    assert rotation.np_matrix(rotation.np_from_rpy(np.array([2 * pi, 0, 0]))) == pytest.approx(np.eye(3), abs=1e-15)


def test_body_rate_is_the_derivative_of_the_orientation():
    rng, step = np.random.default_rng(3), 1e-6
    rpy, rate = rng.uniform(-1, 1, (6, 3)), rng.standard_normal((6, 3))
    before, after = rotation.np_from_rpy(rpy - step * rate), rotation.np_from_rpy(rpy + step * rate)
    moved = rotation.np_log(rotation.np_multiply(rotation.np_conjugate(before), after)) / (2 * step)
    assert rotation.np_body_rate(rpy, rate) == pytest.approx(moved, abs=1e-8)


def test_roll_pitch_yaw_as_expressions_are_those_of_numpy():
    rng = np.random.default_rng(4)
    quaternion, angles = compiled(rotation.from_rpy, 3), compiled(rotation.to_rpy, 4)
    rate = compiled(rotation.body_rate, 3, 3)
    for rpy in np.vstack([rng.uniform([-3, -1.5, -7], [3, 1.5, 7], (20, 3)), [[0, pi / 2, 0.3], [0, -pi / 2, 0]]]):
        q, speeds = rotation.np_from_rpy(rpy), rng.normal(size=3)
        assert quaternion(rpy).full().ravel() == pytest.approx(q, abs=1e-15)
        assert angles(q).full().ravel() == pytest.approx(rotation.np_to_rpy(q), abs=1e-12)
        assert rate(rpy, speeds).full().ravel() == pytest.approx(rotation.np_body_rate(rpy, speeds), abs=1e-14)
