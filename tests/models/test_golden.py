"""Published numbers of the whole-body and single-rigid-body models of the Mini Cheetah.

They are given in the publication's layout: positions, then yaw, pitch, roll and their rates; the whole body has a
contact point at the centre of the foot (radius 0), no rotors, and a Baumgarte gain of 20 / s.
"""

import numpy as np
import pytest

from piaffe.models import SingleRigidBody, WholeBody, load
from piaffe.ocp.language.rotation import np_body_rate, np_from_rpy

ALL = "FL FR HL HR"


@pytest.fixture(scope="module")
def body() -> WholeBody:
    return WholeBody(load("mini_cheetah", foot_radius=0.0, rotors=False), baumgarte=20.0, integrator="euler")


def rate_map(ypr: np.ndarray) -> np.ndarray:
    """Return B with body rate ω = B (yaw, pitch, roll rates)."""
    return np.column_stack([np_body_rate(ypr[::-1], axis[::-1]) for axis in np.eye(3)])


def rate_map_slope(ypr: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return dB/dt times the rates, by central differences of B along them."""
    h = 1e-6
    return (rate_map(ypr + h * rates) - rate_map(ypr - h * rates)) @ rates / (2 * h)


def from_euler(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the state of published positions and velocities."""
    return np.concatenate([q[:3], np_from_rpy(q[5:2:-1]), q[6:], v[:3], rate_map(q[3:6]) @ v[3:6], v[6:]])


def to_euler(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return the published acceleration of one in the state's layout: ω̇ = B ë + Ḃ ė."""
    angles = np.linalg.solve(rate_map(q[3:6]), a[3:6] - rate_map_slope(q[3:6], v[3:6]))
    return np.concatenate([a[:3], angles, a[6:]])


ONES = np.ones(18)
NOMINAL = np.array([0, 0, 0.2183, 0, 0, 0, *[0, -1.0, 2.0] * 4])
REST = np.zeros(18)


def test_flight_acceleration_of_the_unit_state(body: WholeBody) -> None:
    a = to_euler(ONES, ONES, body.acceleration(from_euler(ONES, ONES), np.zeros(12), ""))
    expected = [0.0167, 0.0347, -9.8007, 3.0514, -0.7017, 4.1830, 0.8268, 0.6603, -5.2010, -0.2201, 1.3537, -4.9655]
    expected += [1.0438, -1.0924, -0.5153, 0.1417, -0.2949, -0.2164]
    np.testing.assert_allclose(a, expected, atol=0.6e-4)


def test_contact_acceleration_and_forces_of_the_unit_state(body: WholeBody) -> None:
    x = from_euler(ONES, ONES)
    a = to_euler(ONES, ONES, body.acceleration(x, np.zeros(12), ALL))
    expected = [-6.3095, -4.2604, -14.1384, 22.9058, 17.9408, 39.8478, 90.4579, -65.9947, 66.0292]
    expected += [138.4558, 22.0186, 7.8347, -434.0716, 5.2086, 99.9593, -386.0737, -60.6831, -18.4982]
    np.testing.assert_allclose(a, expected, atol=0.6e-4)
    forces = [[5.6718, 3.3482, 4.9412], [9.5903, 5.4040, 6.7458], [-40.7861, -21.8598, -24.2717]]
    forces += [[-37.9467, -20.9369, -24.4426]]
    np.testing.assert_allclose(body.contact_forces(x, np.zeros(12), ALL), forces, atol=0.6e-4)


def test_foot_positions_of_the_unit_state(body: WholeBody) -> None:
    expected = [[1.184079, 1.341408, 0.602812], [1.096458, 1.202452, 0.497336]]
    expected += [[1.073147, 1.168641, 0.922571], [0.985526, 1.029685, 0.817095]]
    np.testing.assert_allclose(body.foot_positions(from_euler(ONES, ONES)), expected, atol=0.6e-6)


def test_feet_and_mass_matrix_of_the_nominal_posture(body: WholeBody) -> None:
    x = from_euler(NOMINAL, REST)
    feet = [[x, y, 0.000018] for x in (0.178219, -0.201781) for y in (0.111, -0.111)]
    np.testing.assert_allclose(body.foot_positions(x), feet, atol=0.6e-6)
    B = np.eye(18)
    B[3:6, 3:6] = rate_map(NOMINAL[3:6])
    diagonal = [8.252] * 3 + [0.276394, 0.237047, 0.063896] + [0.005036, 0.004959, 0.000486] * 4
    np.testing.assert_allclose(np.diag(B.T @ body.mass_matrix(x) @ B), diagonal, atol=0.6e-6)


def test_gravity_and_static_torque_of_the_nominal_posture(body: WholeBody) -> None:
    x = from_euler(NOMINAL, REST)
    n = body.bias(x)
    leg = np.array([0.515731, -0.182861, 0.032227])
    mirrored = leg * [-1, 1, 1]
    np.testing.assert_allclose(n[6:], [*leg, *mirrored, *leg, *mirrored], atol=0.6e-6)
    np.testing.assert_allclose(n[[2, 4]], [80.95212, 0.731444], atol=0.6e-5)
    static = n - body.contact_jacobian(x).T @ np.tile([0.0, 0.0, 20.238], 4)
    leg = np.array([-0.739027, 0.055555, -3.288568])
    mirrored = leg * [-1, 1, 1]
    # the published vertical force is rounded, 20.23803 N
    np.testing.assert_allclose(static[6:], [*leg, *mirrored, *leg, *mirrored], atol=1e-5)
    assert static[4] == pytest.approx(-0.222, abs=6e-4)


def test_contact_acceleration_of_the_nominal_posture(body: WholeBody) -> None:
    x = from_euler(NOMINAL, REST)
    a = body.acceleration(x, np.zeros(12), ALL)
    np.testing.assert_allclose(a[:6], [-0.115131, 0, -9.90774, 0, 0, 0], atol=0.6e-5)
    np.testing.assert_allclose(a[7::3], -27.658428, atol=0.6e-6)
    np.testing.assert_allclose(a[8::3], 58.395343, atol=0.6e-6)
    force = body.contact_forces(x, np.zeros(12), ALL)[0]
    np.testing.assert_allclose(force, [-0.56206, 0.028714, 0.505757], atol=0.6e-5)


def test_single_rigid_body() -> None:
    inertia = [[0.061578036, 0, 5.38e-5], [0, 0.2207093, 0], [5.38e-5, 0, 0.272612336]]
    model = SingleRigidBody(load("mini_cheetah"), mass=8.912, inertia=inertia, integrator="euler")
    published = np.array([0.1, -0.2, 0.3, 0.4, 0.3, 0.2, 0.5, -0.6, 0.7, 0.8, -0.9, 1.0])
    q, v = published[:6], published[6:]
    x = from_euler(q, v)
    footholds = [[0.2, 0.1, 0], [0.2, -0.1, 0], [-0.2, 0.1, 0], [-0.2, -0.1, 0]]
    dt = 1e-3
    after = model.step(x, np.arange(1.0, 13.0), "FL FR HL", footholds, dt)
    a = to_euler(q, v, (after - x)[7:] / dt)
    np.testing.assert_allclose((after - x)[:3] / dt, v[:3], atol=1e-12)
    expected = [1.3464991, 1.68312388, -7.79025135, -9.89059873, -23.20902277, 132.00455587]
    np.testing.assert_allclose(a, expected, atol=0.6e-7)
