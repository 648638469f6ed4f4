"""The line search: what it asks of a step, and what a second-order correction does to the defects of a trial."""

from dataclasses import dataclass

import numpy as np
import pytest

from piaffe.ocp import Problem, compile_problem
from piaffe.solvers import MSiLQR, Options, Status
from piaffe.solvers.ilqr.iterate import Iterate
from piaffe.solvers.ilqr.riccati import Direction, backward, close_defects
from piaffe.solvers.ilqr.run import Evaluated, Run

from ...problems import PROBLEMS, linear_quadratic


@dataclass(frozen=True)
class Search:
    """A line search: its direction, the step that it took, the weight ρ of the defects, cost and gap around it."""

    direction: Direction
    size: float
    rho: float
    augmented: tuple[float, float]
    gap: tuple[float, float]


class Listening(Run):
    """A run that keeps each line search, and the sums of defects before and after each correction."""

    def __init__(self, *arguments: object) -> None:
        self.searches: list[Search] = []
        self.corrections: list[tuple[float, float]] = []
        self.tried: Evaluated | None = None
        super().__init__(*arguments)

    def search(self, direction: Direction) -> float:
        before = self.augmented(self.current), self.current.gap
        size = super().search(direction)
        after = self.augmented(self.current), self.current.gap  # barrier and multipliers are the same still
        self.searches.append(Search(direction, size, self.rho, (before[0], after[0]), (before[1], after[1])))
        return size

    def trial(self, start: Iterate, dx: list, du: list, size: float) -> Evaluated:
        found = super().trial(start, dx, du, size)
        if self.tried is not None and start is self.tried.iterate and start is not self.current.iterate:
            self.corrections.append((self.tried.gap, found.gap))
        self.tried = found
        return found


def listening(problem: Problem, options: Options) -> Listening:
    solver = MSiLQR(compile_problem(problem), options, backend="numpy")
    return Listening(solver.functions, options, solver.start(None), solver.flags(True), None)


@pytest.mark.parametrize("share", [0.1, 0.7])
@pytest.mark.parametrize("name", ["swing up", "flying body", "rope"])
def test_an_accepted_step_achieves_its_share_of_the_expected_decrease(name: str, share: float) -> None:
    """A step α changes the cost by α dV1 + ½ α² dV2, as far as the model goes, and leaves 1 − α of the defects."""
    run = listening(PROBLEMS[name](), Options(armijo=share))
    run.loop()
    for s in run.searches:
        model = s.size * s.direction.dV1 + 0.5 * s.size**2 * s.direction.dV2 - s.size * s.rho * s.gap[0]
        change = s.augmented[1] + s.rho * s.gap[1] - s.augmented[0] - s.rho * s.gap[0]
        assert s.size == 0.0 or change <= share * model + 2e-12 * abs(s.augmented[0] + s.rho * s.gap[0])
    assert any(0.0 < s.size < 1.0 for s in run.searches)


@pytest.mark.parametrize("name", ["flying body", "rope"])
def test_a_correction_closes_defects_that_grew_with_the_step(name: str) -> None:
    run = listening(PROBLEMS[name](), Options())
    assert run.loop() is Status.CONVERGED
    assert run.corrections
    assert np.median([after / before for before, after in run.corrections]) < 0.5


def test_a_correction_closes_all_defects_of_a_linear_problem() -> None:
    run = listening(linear_quadratic(), Options())
    rng = np.random.default_rng(0)
    states, controls = (
        [a + rng.normal(size=a.shape) for a in tables]
        for tables in (run.current.iterate.states, run.current.iterate.controls)
    )
    run.current = run.evaluate(Iterate(states, controls))
    models = run.linearise()
    sweeps = backward(models, 0.0)
    assert sweeps is not None
    dx, du = close_defects(models, sweeps, run.current.defects)
    closed = Iterate(
        [x + step for x, step in zip(states, dx, strict=True)], [u + step for u, step in zip(controls, du, strict=True)]
    )
    assert run.current.max_defect > 1.0
    assert run.evaluate(closed).max_defect < 1e-12
