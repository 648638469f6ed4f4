"""Problems without a solution end as INFEASIBLE, name the row at fault first, and propose a relaxation that helps."""

from functools import cache

import pytest

from piaffe.solvers import MSiLQR, Solution, Status

from .infeasible_problems import CASES


@cache
def solved(name: str) -> Solution:
    return MSiLQR(CASES[name].problem("", 0.0), backend="numpy").solve()


@pytest.mark.parametrize("name", CASES)
def test_a_problem_without_a_solution_is_infeasible(name: str) -> None:
    assert solved(name).status is Status.INFEASIBLE


@pytest.mark.parametrize("name", CASES)
def test_the_explanation_begins_with_a_row_at_fault(name: str) -> None:
    first = next(line for line in solved(name).explain().splitlines() if line.startswith("- "))
    assert any(f"'{row}" in first for row in CASES[name].at_fault), first
    assert "(infeasible_problems.py:" in first


NOT_LINEAR = ("weak motor holds", "surface beyond the rail", "start too fast")
"""The rows at fault change too much on the way for one linear model: what it proposes is not enough."""


@pytest.mark.parametrize("name", [name for name in CASES if name not in NOT_LINEAR])
def test_the_proposed_relaxation_makes_the_problem_feasible(name: str) -> None:
    proposed = solved(name).relaxation
    assert proposed is not None
    assert proposed.term in CASES[name].at_fault
    assert MSiLQR(CASES[name].problem(proposed.term, proposed.amount), backend="numpy").solve().converged


@pytest.mark.parametrize("name", ["two places", "slow and far", "tip too far", "slippery start"])
def test_both_backends_find_the_same_contradiction(name: str) -> None:
    solution = MSiLQR(CASES[name].problem("", 0.0)).solve()
    assert solution.status is Status.INFEASIBLE
    assert solution.relaxation is not None
    assert solved(name).relaxation is not None
    assert solution.relaxation.term == solved(name).relaxation.term
    assert solution.relaxation.amount == pytest.approx(solved(name).relaxation.amount, rel=1e-2)


def test_a_relaxation_is_exact_where_the_problem_is_linear() -> None:
    """Two equalities 0.2 apart: moving one by 0.2 is enough, and a tenth is added."""
    proposed = solved("two places").relaxation
    assert proposed is not None
    assert proposed.amount == pytest.approx(1.1 * 0.2, rel=1e-3)
