"""Options of the solver, the same for every backend, and a barrier that a solve keeps."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from piaffe.errors import SolverError
from piaffe.ocp import caller


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of :class:`MSiLQR`.

    Args:
        max_iterations: iterations in all, barrier and multiplier updates included.
        max_defect: largest defect accepted, ∞-norm in the tangent, in natural sizes of the model (see ``ocp.Sizes``).
        max_equality: largest equality violation accepted (SI units divided by the row's scale).
        max_inequality: largest inequality violation accepted (SI units divided by the row's scale).
        cost_tolerance: expected decrease, relative to the cost (see ``cost_floor``), below which an iterate is
            stationary.
        barrier_weight: first weight ε of the relaxed barrier.
        barrier_factor: factor of ε after a sub-problem that is solved or has had ``max_inner`` iterations.
        barrier_gap: accepted suboptimality of the barrier, relative to the cost (see ``cost_floor``): ε stays constant
            once its last decrease has changed the cost by less than this. Violations may change the cost by as much.
        min_barrier_weight: smallest ε.
        relaxation: first relaxation δ of the barrier, in units of the row's scale.
        stiffness: first limit of the curvature ε/δ² of a violated row; rows with larger multipliers use shifts.
        max_stiffness: largest such limit: it grows by ``penalty_factor`` if violations decrease too slowly.
        penalty: first penalty σ of the augmented Lagrangian.
        penalty_factor: factor of σ, and of the stiffness, when a violation decreases too slowly.
        max_penalty: largest σ.
        max_inner: iterations after which the solver may leave a sub-problem unsolved, if its defects are small.
        armijo: fraction γ of the expected decrease that a step must achieve.
        merit_margin: fraction κ of the defects' decrease that remains in the merit's expected change.
        merit_offset: smallest weight ρ of the defects in the merit.
        corrections: largest number of second-order corrections of a trial step whose defects grow.
        step_shrink: ratio of successive trial steps.
        min_step: smallest trial step.
        regularization: first Levenberg regularisation added to Q_xx and Q_uu, for a state or control of size 1.
        max_regularization: largest regularisation; the solve stops beyond it.
        cost_scale: natural size of the cost; barrier weights, stiffness, penalties, ``merit_offset`` and regularisation
            are multiplied by it. None: the solver computes it from the problem, so that nothing depends on the unit of
            the cost; without ``adapt``, 1.
        cost_floor: changes of the cost are relative to |cost| plus |cost| limited to the interval from this to
            ``cost_scale``. None: a hundredth of ``cost_scale``; without ``adapt``, 1.
        time_scale: natural time [s]. Barrier weights, stiffness and penalties of running terms are divided by it,
            because these terms are integrals over time. None: that of the problem's first model, which is 1 s for
            most; without ``adapt``, 1.
        time_limit_s: time after which the solve stops with its last accepted iterate [s]; it is asked before every
            trial step. None for no limit.
        adapt: whether the solve changes barrier, multipliers and penalties. Without, they stay as they are at its
            start, and it ends at the first stationary iterate: as ``CONVERGED`` if every tolerance is met, the
            barrier's included, otherwise as ``STATIONARY``. See :class:`Fixed` and :class:`Adapting`.
    """

    max_iterations: int = 1000
    max_defect: float = 1e-5
    max_equality: float = 1e-4
    max_inequality: float = 1e-4
    cost_tolerance: float = 2e-6
    barrier_weight: float = 0.1
    barrier_factor: float = 0.3
    barrier_gap: float = 3e-5
    min_barrier_weight: float = 1e-8
    relaxation: float = 0.1
    stiffness: float = 1e5
    max_stiffness: float = 1e10
    penalty: float = 200.0
    penalty_factor: float = 5.0
    max_penalty: float = 1e8
    max_inner: int = 5
    armijo: float = 0.1
    merit_margin: float = 0.1
    merit_offset: float = 0.1
    corrections: int = 1
    step_shrink: float = 0.5
    min_step: float = 1e-3
    regularization: float = 1e-6
    max_regularization: float = 1e6
    cost_scale: float | None = None
    cost_floor: float | None = None
    time_scale: float | None = None
    time_limit_s: float | None = None
    adapt: bool = True

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if value is not None and not isinstance(value, bool) and not value > 0:
                raise SolverError(
                    f"options ({caller()}): {item.name} is out of range - got {value}, expected a positive number; "
                    "increase it"
                )
        for name in ("barrier_factor", "armijo", "merit_margin", "step_shrink", "min_step"):
            if not getattr(self, name) < 1:
                raise SolverError(
                    f"options ({caller()}): {name} is out of range - got {getattr(self, name)}, expected below 1; "
                    "lower it"
                )

    def number(self, name: str) -> float | int:
        """Return an option as a number: 0 for no limit of time; without scale and floor of the cost, 1."""
        value = getattr(self, name)
        if value is None and name == "cost_floor":
            value = self.cost_scale
        if value is None:
            return 0.0 if name == "time_limit_s" else 1.0
        return value  # type: ignore[no-any-return]  # a number in every field but the one of time

    def absolute(self, scale: float, time: float = 1.0) -> Options:
        """Return these options for costs in the problem's unit, and running costs in this unit by seconds.

        Args:
            scale: natural size of the cost.
            time: natural time [s].
        """
        scaled = {name: getattr(self, name) * scale for name in _RELATIVE}
        scaled |= {name: getattr(self, name) * scale / time for name in _RATES}
        floor = _FLOOR * scale if self.cost_floor is None else self.cost_floor
        return replace(self, **scaled, cost_scale=scale, cost_floor=floor, time_scale=time)


_FLOOR = 0.01
"""Changes of a cost below this share of the scale are relative to this share, not to the cost."""
_RELATIVE = ("merit_offset", "regularization", "max_regularization")
"""The options that are multiplied by the scale of the cost."""
_RATES = ("barrier_weight", "min_barrier_weight", "stiffness", "max_stiffness", "penalty", "max_penalty")
"""The options that are multiplied by the scale of the cost and divided by the natural time."""


@dataclass(frozen=True)
class Fixed:
    """A relaxed barrier that stays as it is during a solve, for the ticks of a receding horizon.

    A solve with it minimises one function: cost, barrier and augmented Lagrangian with the multipliers of its start.
    Active rows may violate their bounds by λ δ²/ε − 2δ, where λ is the row's multiplier. A warm start brings its own
    weight, relaxations, shifts, multipliers and penalties; these stay, too.

    Args:
        weight: weight ε of the barrier.
        relaxation: relaxation δ of every row, in units of the row's scale.
    """

    weight: float
    relaxation: float

    def __post_init__(self) -> None:
        for name in ("weight", "relaxation"):
            if not getattr(self, name) > 0:
                raise SolverError(
                    f"fixed barrier: {name} is out of range - got {getattr(self, name)}, expected a "
                    "positive number; increase it"
                )

    def options(self, others: Options | None = None) -> Options:
        """Return options with this barrier, which a solve does not change.

        Args:
            others: all other options; the default ones if None.
        """
        return replace(others or Options(), barrier_weight=self.weight, relaxation=self.relaxation, adapt=False)
