"""What ``explain()`` says: the row that pushes most comes first, wandering and scales are told."""

from dataclasses import replace

import pytest

from piaffe import ocp
from piaffe.solvers import MSiLQR, Record, Solution, Status
from piaffe.solvers.solution.explanation import ranked, scales, wandering


@pytest.fixture(scope="module")
def braked() -> Solution:
    """A cart that would move by 3 m is held back by its largest speed; its force is limited, too, in newtons."""
    model = ocp.Model("cart", state={"x": 1, "v": 1}, control={"u": 1}, modes={"go": lambda s: {"x": s.v, "v": s.u}})
    objective = ocp.Objective(ocp.track("x", 50.0, to=3.0, at="end"), ocp.regularize("u", 1e-4))
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.v, upper=1.0, name="speed", unit="m/s"),
        ocp.inequality(lambda s: s.u, lower=-40.0, upper=40.0, name="force", unit="N"),
    )
    motion = ocp.Motion(ocp.Phase("go", "go", 1.0, {"x": 0.0}))
    return MSiLQR(ocp.Problem(motion, model.until_end(dt=0.05), objective, limits, initial=[0.0, 0.0])).solve()


def test_the_constraint_that_costs_most_is_first_although_another_is_violated_more(braked: Solution) -> None:
    assert braked.converged
    worse = tuple(replace(v, amount=1e-3) if v.term == "force" else v for v in braked.violations)
    assert [v.term for v in ranked(worse, Status.ITERATION_LIMIT)] == ["speed", "force"]
    first = next(line for line in braked.explain().splitlines() if line.startswith("- "))
    assert first.startswith("- inequality 'speed upper' (test_explanation.py:")


def test_push_is_what_a_wider_bound_saves(braked: Solution) -> None:
    """50 (x − 3)²/2 with x ≈ 1 at the largest speed: one more m/s saves 50 · 2 per second, for nearly a second."""
    speed = next(v for v in braked.violations if v.term == "speed")
    reached = braked.trajectory.phases[-1].states[-1, 0]
    assert speed.push == pytest.approx(50.0 * (3.0 - reached) * reached, rel=0.05)


def test_a_converged_solution_needs_no_relaxation(braked: Solution) -> None:
    assert braked.relaxation is None


def record(k: int, cost: float, violation: float) -> Record:
    return Record(
        iteration=k, cost=cost, merit=cost, expected=0.1, max_defect=1e-9, max_equality=violation, max_inequality=0.0,
        step_size=0.25, regularization=0.0, barrier_weight=1e-3, wall_s=0.1,
    )  # fmt: skip


def test_a_search_that_gets_nowhere_wanders() -> None:
    history = [record(k, 5.0 + (k % 7), 0.2 + 0.01 * (k % 5)) for k in range(200)]
    assert wandering(history).startswith("Over the last 60 iterations neither cost nor violations fell")
    assert "0.25" in wandering(history)
    assert not wandering(history[:100])
    assert not wandering([record(k, 5.0, 0.99**k) for k in range(200)])
    assert not wandering([record(k, 0.99**k, 0.2) for k in range(200)])


def test_rows_of_very_different_sizes_are_named(braked: Solution) -> None:
    assert not scales(braked.violations)
    huge = tuple(replace(v, size=1e7 * v.size) if v.term == "force" else v for v in braked.violations)
    assert "'speed' (test_explanation.py:" in scales(huge)
    assert "give scale=" in scales(huge)
