"""Limits of exported controllers hold at all times of a motion."""

import numpy as np

from piaffe import ocp, solvers
from piaffe.solvers.export.layout import _widened

CART = ocp.Model("cart", state={"x": 1, "v": 1}, control={"push": 1}, modes={"roll": lambda s: {"x": s.v, "v": s.push}})


def planner(upper):
    limit = ocp.inequality(lambda s: s.push, lower=-9.0, upper=upper, name="motor", unit="N")
    motion = ocp.Motion(ocp.Phase("go", "roll", 0.5), ocp.Phase("stay", "roll", 0.5))
    objective = ocp.Objective(ocp.track("x", 10.0, to=1.0), ocp.regularize("push", 1e-3))
    problem = ocp.Problem(motion, CART.over(0.2, dt=0.05), objective, ocp.Constraints(limit), initial=[0.0, 0.0])
    return solvers.RecedingHorizon(problem, period=0.05)


def limits(upper):
    """Return the limits of the first stage, and those for a whole motion."""
    mpc = planner(upper)
    plan = mpc.plan([0.0, 0.0], 0.0)
    low, first = solvers.Riccati(plan), plan.phases[0]
    found = low.rows[first.mode].limits(first.states[0], first.p[0], first.g_mask[0])
    return found, _widened(low, first.states[0], found, mpc.horizon)


def test_bounds_over_phases_are_as_wide_as_they_ever_are():
    first, widened = limits(ocp.over_phase(lambda at: 2.0 + 10.0 * at.t))
    np.testing.assert_allclose(np.ravel(first), [-9.0, 2.0])
    np.testing.assert_allclose(np.ravel(widened), [-9.0, 7.0])


def test_constant_bounds_stay_to_the_bit():
    first, widened = limits(0.3)
    assert np.array_equal(first, widened)
