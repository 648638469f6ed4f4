"""Fourteen small problems against Ipopt: CONVERGED means optimal, whatever the unit of the cost."""

from functools import cache

import numpy as np
import pytest

from piaffe.ocp import CompiledProblem, compile_problem
from piaffe.solvers import MSiLQR, Options, Solution, Status

from .ilqr.referee import referee
from .referee_problems import PROBLEMS

TIGHT = Options(max_defect=1e-7, max_equality=1e-7, max_inequality=1e-7, cost_tolerance=1e-7, barrier_gap=1e-7)
SEVERAL_OPTIMA = ("quadrotor",)
"""Ipopt starts from our solution there: from the guess it flies past the poles on other sides, at twice the cost."""


@cache
def compiled(name: str, factor: float = 1.0) -> CompiledProblem:
    return compile_problem(PROBLEMS[name](factor))


@cache
def solved(name: str, tight: bool, factor: float = 1.0) -> Solution:
    return MSiLQR(compiled(name, factor), TIGHT if tight else None).solve()


@cache
def optimum(name: str, tight: bool) -> float:
    parts = solved(name, tight and name in SEVERAL_OPTIMA).trajectory.phases
    start = ([p.states for p in parts], [p.controls for p in parts]) if name in SEVERAL_OPTIMA else None
    return referee(compiled(name), start).cost


@pytest.mark.parametrize("name", PROBLEMS)
def test_defaults_are_within_a_ten_thousandth_of_ipopt(name: str) -> None:
    solution = solved(name, False)
    assert solution.status is Status.CONVERGED, solution.explain()
    assert max(solution.max_defect, solution.max_equality, solution.max_inequality) <= 1e-4
    assert solution.cost == pytest.approx(optimum(name, False), rel=1e-4)


@pytest.mark.parametrize("name", PROBLEMS)
def test_tight_tolerances_are_within_a_millionth_of_ipopt(name: str) -> None:
    solution = solved(name, True)
    assert solution.status is Status.CONVERGED, solution.explain()
    assert max(solution.max_defect, solution.max_equality, solution.max_inequality) <= 1e-7
    assert solution.cost == pytest.approx(optimum(name, True), rel=1e-6)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
@pytest.mark.parametrize("tight", [False, True])
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_unit_of_the_cost_does_not_matter(name: str, tight: bool, factor: float) -> None:
    reference, solution = solved(name, tight), solved(name, tight, factor)
    assert solution.status is reference.status
    assert solution.iterations == reference.iterations
    assert solution.cost == pytest.approx(factor * reference.cost, rel=1e-9)
    for part, other in zip(solution.trajectory.phases, reference.trajectory.phases, strict=True):
        np.testing.assert_allclose(part.states, other.states, atol=1e-6)


@pytest.mark.parametrize("name", PROBLEMS)
def test_both_backends_agree(name: str) -> None:
    solution, other = solved(name, False), MSiLQR(compiled(name), backend="numpy").solve()
    assert other.status is solution.status
    assert other.cost == pytest.approx(solution.cost, rel=1e-6)
