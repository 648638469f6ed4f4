"""Options of the solver: one frozen value for every backend."""

from __future__ import annotations

from dataclasses import dataclass, fields

from piaffe.errors import SolverError


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of :class:`MSiLQR`.

    Args:
        max_iterations: iterations in all, barrier and multiplier updates included.
        max_defect: largest defect accepted, ∞-norm in the tangent.
        max_equality: largest equality violation accepted (raw SI divided by the row's scale).
        max_inequality: largest inequality violation accepted, likewise.
        cost_tolerance: expected decrease, relative to 1 + |cost|, below which an iterate is stationary.
        barrier_weight: first weight ε of the relaxed barrier.
        barrier_factor: what ε is multiplied by once a sub-problem is solved or has had its iterations.
        barrier_gap: declared suboptimality of the barrier, relative to 1 + |cost|: ε stops shrinking when its last
            decrease changed the cost by less.
        min_barrier_weight: smallest ε.
        relaxation: first relaxation δ of the barrier, in units of the row's scale.
        max_stiffness: largest curvature ε/δ² of a violated row; larger multipliers are carried by shifts instead.
        penalty: first penalty σ of the augmented Lagrangian.
        penalty_factor: what σ is multiplied by when a violation shrinks too slowly.
        max_penalty: largest σ.
        max_inner: iterations after which a sub-problem may be left unsolved, once its defects are small.
        armijo: share γ of the expected decrease that a step must achieve.
        merit_margin: share κ of the defects' decrease kept in the merit's expected change.
        merit_offset: least weight ρ of the defects in the merit.
        corrections: second-order corrections of a trial step whose defects grew.
        step_shrink: ratio of successive trial steps.
        min_step: smallest trial step.
        regularization: first Levenberg regularisation added to Q_xx and Q_uu.
        max_regularization: beyond this the solve stops.
        time_limit_s: seconds after which the solve stops with its best iterate; None for no limit.
    """

    max_iterations: int = 1000
    max_defect: float = 1e-5
    max_equality: float = 1e-4
    max_inequality: float = 1e-4
    cost_tolerance: float = 1e-5
    barrier_weight: float = 0.1
    barrier_factor: float = 0.3
    barrier_gap: float = 1e-4
    min_barrier_weight: float = 1e-8
    relaxation: float = 0.1
    max_stiffness: float = 1e5
    penalty: float = 200.0
    penalty_factor: float = 5.0
    max_penalty: float = 1e6
    max_inner: int = 5
    armijo: float = 0.1
    merit_margin: float = 0.1
    merit_offset: float = 0.1
    corrections: int = 1
    step_shrink: float = 0.5
    min_step: float = 1e-3
    regularization: float = 1e-6
    max_regularization: float = 1e6
    time_limit_s: float | None = None

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if value is not None and not value > 0:
                raise SolverError(
                    f"options: {item.name} is out of range - got {value}, expected a positive number; raise it"
                )
        for name in ("barrier_factor", "armijo", "merit_margin", "step_shrink", "min_step"):
            if not getattr(self, name) < 1:
                raise SolverError(
                    f"options: {name} is out of range - got {getattr(self, name)}, expected below 1; lower it"
                )
