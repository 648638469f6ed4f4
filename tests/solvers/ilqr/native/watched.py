"""The NumPy solver with a note of every iterate and of how close each decision was."""

from piaffe.solvers import Record, constants
from piaffe.solvers.ilqr.iterate import Iterate
from piaffe.solvers.ilqr.riccati import Direction
from piaffe.solvers.ilqr.run import Evaluated, Run


class Watched(Run):
    """A run that keeps its iterates, and per iteration the smallest relative margin of its decisions."""

    def __init__(self, *arguments: object) -> None:
        self.iterates: list[Iterate] = []
        self.margins: list[float] = []
        self.margin = float("inf")
        super().__init__(*arguments)

    def note(self, value: float, bound: float, scale: float) -> None:
        self.margin = min(self.margin, abs(value - bound) / scale)

    def is_stationary(self, direction: Direction) -> bool:
        tolerance = self.o.cost_tolerance * self.outer.size(self.current.cost)
        self.note(abs(direction.dV1 + 0.5 * direction.dV2), tolerance, tolerance)
        self.note(max(self.gains[-constants.PATIENCE :], default=0.0), tolerance, tolerance)
        self.note(self.current.max_defect, self.o.max_defect, self.o.max_defect)
        equality, inequality = self.violations(self.current)
        self.note(equality, self.o.max_equality, self.o.max_equality)
        self.note(inequality, self.o.max_inequality, self.o.max_inequality)
        return super().is_stationary(direction)

    def update_merit(self, direction: Direction) -> None:
        super().update_merit(direction)
        self.given = direction
        self.before = self.augmented(self.current) + self.rho * self.current.gap

    def trial(self, start: Iterate, dx: list, du: list, size: float) -> Evaluated:
        tried = super().trial(start, dx, du, size)
        if start is self.current.iterate:
            self.size = size
        s, gap, scale = self.size, self.current.gap, self.outer.size(self.before)
        expected = s * self.given.dV1 + 0.5 * s**2 * self.given.dV2 - s * self.rho * gap
        merit = self.augmented(tried) + self.rho * tried.gap
        bound = self.before + self.o.armijo * expected + constants.MERIT_ROUNDING * abs(self.before)
        self.note(merit, bound, scale)
        if merit > bound:
            self.note(tried.gap, (1 - constants.GAP_DECREASE * s) * gap, scale)
        return tried

    def record(self, direction: Direction, size: float) -> None:
        super().record(direction, size)
        self.iterates.append(self.current.iterate)
        self.margins.append(self.margin)
        self.margin = float("inf")


def same_decisions(a: tuple[Record, ...], b: tuple[Record, ...]) -> int:
    """Return after how many iterations two histories decide differently, or their common length."""
    decided = [[(r.step_size, r.regularization, r.barrier_weight) for r in history] for history in (a, b)]
    return next((k for k, (p, q) in enumerate(zip(*decided, strict=False)) if p != q), min(len(a), len(b)))
