"""Legs as expressions, against the legs in NumPy."""

import casadi as cs
import numpy as np
import pytest

from piaffe import models
from piaffe.models.leg_expressions import LegExpression, foot_expressions, leg_expressions
from piaffe.models.legs import Legs
from piaffe.ocp import rotation
from tests.robots import ROBOTS

CHAINS = ("R", "P", "RR", "RP", "PP", "RRR", "RRP", "PRP", "RRRP", "RRRRRR")  # revolute and prismatic joints


def leg_pair(chain, rng):
    """Return one leg of random numbers, in NumPy and as expressions."""
    k = len(chain)
    quaternions = rng.normal(size=(k, 4))
    axes = rng.normal(size=(k, 3))
    numbers = {
        "rotation": rotation.np_matrix(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)),
        "offset": rng.uniform(-0.3, 0.3, (k, 3)),
        "axis": axes / np.linalg.norm(axes, axis=1, keepdims=True),
        "revolute": np.array([float(kind == "R") for kind in chain]),
        "tip": rng.uniform(-0.3, 0.3, 3),
    }
    legs = Legs(np.array([0]), np.arange(k)[None], **{key: value[None] for key, value in numbers.items()})
    bounds = np.full(k, -0.4), np.array([0.3, *[np.inf] * (k - 1)])
    return legs, LegExpression(0, tuple(range(k)), *numbers.values(), *bounds)


def evaluate(inputs, outputs, values):
    function = cs.Function("f", inputs, [cs.densify(output) for output in outputs])
    return [result.full() for result in function.call([cs.DM(value) for value in values])]


@pytest.mark.parametrize("chain", CHAINS)
def test_a_leg_has_the_foot_and_the_jacobian_of_numpy(chain):
    rng = np.random.default_rng(0)
    legs, leg = leg_pair(chain, rng)
    q = cs.SX.sym("q", len(chain))
    for _ in range(5):
        angles = rng.uniform(-2, 2, len(chain))
        foot, jacobian = evaluate([q], leg.jacobian(q), [angles])
        expected_foot, expected_jacobian = legs.jacobian(angles[None])
        assert foot.ravel() == pytest.approx(expected_foot[0], abs=1e-12)
        assert jacobian == pytest.approx(expected_jacobian[0], abs=1e-12)


@pytest.mark.parametrize("chain", CHAINS)
def test_a_leg_has_the_inverse_and_the_rates_of_numpy(chain):
    rng = np.random.default_rng(1)
    legs, leg = leg_pair(chain, rng)
    q, r = cs.SX.sym("q", len(chain)), cs.SX.sym("r", 3)
    for _ in range(5):
        first, wanted = rng.uniform(-0.2, 0.2, len(chain)), rng.uniform(-0.2, 0.3, len(chain))
        target = legs.forward(wanted[None])[0][0]
        (angles,) = evaluate([q, r], [leg.inverse(r, q, 60)], [first, target])
        bounds = leg.lower[None], leg.upper[None]
        expected, miss = legs.inverse(target[None], first[None], bounds, 0.0)
        assert miss.max() < 1e-6
        assert np.all(angles.ravel() >= leg.lower)
        assert np.all(angles.ravel() <= leg.upper)
        assert angles.ravel() == pytest.approx(expected[0], abs=1e-6)
        velocity = rng.normal(size=3)
        (rates,) = evaluate([q, r], [leg.rates(q, r)], [wanted, velocity])
        assert rates.ravel() == pytest.approx(legs.rates(wanted[None], velocity[None])[0], rel=1e-5)


def test_limits_hold_for_a_foot_out_of_reach():
    rng = np.random.default_rng(2)
    _, leg = leg_pair("RRR", rng)
    q, r = cs.SX.sym("q", 3), cs.SX.sym("r", 3)
    for _ in range(10):
        (angles,) = evaluate([q, r], [leg.inverse(r, q, 8)], [np.zeros(3), rng.uniform(-3, 3, 3)])
        assert np.all(angles.ravel() >= leg.lower)
        assert np.all(angles.ravel() <= leg.upper)


@pytest.mark.parametrize("name", ROBOTS)
def test_feet_of_a_robot_are_those_of_its_kinematics(name):
    legs = models.Kinematics(models.load(name))
    q, rng = cs.SX.sym("q", legs.robot.num_joints), np.random.default_rng(3)
    angles = rng.uniform(-2, 2, legs.robot.num_joints)
    found = evaluate([q], foot_expressions(legs, q), [angles])
    assert pytest.approx(legs.feet(angles), abs=1e-12) == np.hstack(found).T
    assert [leg.foot for leg in leg_expressions(legs)] == list(legs.groups[0].feet)
