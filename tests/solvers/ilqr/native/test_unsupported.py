"""Expressions without a form in C are refused by term, file and line; NumPy solves them."""

import casadi as cs
import numpy as np
import pytest

from piaffe import ocp, solvers
from piaffe.errors import ProblemError

GRID = np.linspace(-2.0, 2.0, 9)


def table(kind):
    return cs.interpolant("hill", kind, [GRID], 0.5 * GRID)


def problem(*terms, slope=None):
    def roll(s):
        return {"x": s.v, "v": s.push - (slope(s.x) if slope else 0)}

    cart = ocp.Model("cart", state={"x": 1, "v": 1}, control={"push": 1}, modes={"roll": roll})
    objective = ocp.Objective(ocp.regularize("push"), ocp.track("x", weight=1.0, to=1.0), *terms)
    motion = ocp.Motion(ocp.Phase("go", "roll", 1.0))
    return ocp.Problem(motion, cart.until_end(dt=0.1), objective, initial=(0.0, 0.0))


@pytest.mark.parametrize("kind", ["linear", "bspline"])
@pytest.mark.parametrize("at", ["running", "end"])
def test_a_table_in_a_term_is_named(kind, at):
    hill = table(kind)
    term = ocp.residual(lambda s: hill(s.x) - 0.25).weighted(100.0, at=at, name="hill")
    message = rf"^term 'hill' \({term.source}\): an expression has no form in C - got a call of another function"
    with pytest.raises(ProblemError, match=message.replace(".py", r"\.py")):
        solvers.MSiLQR(problem(term))
    solution = solvers.MSiLQR(problem(term), backend="numpy").solve()
    same = ocp.residual(lambda s: 0.5 * s.x - 0.25).weighted(100.0, at=at, name="hill")
    expected = solvers.MSiLQR(problem(same), backend="numpy").solve()
    assert solution.converged
    np.testing.assert_allclose(solution.cost, expected.cost, rtol=1e-6)


def test_a_table_in_a_model_is_named():
    with pytest.raises(ProblemError, match=r"dynamics of model 'cart' .*: an expression has no form in C"):
        solvers.MSiLQR(problem(slope=table("linear")))
