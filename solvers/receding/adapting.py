"""A barrier and multipliers that follow the ticks of a receding horizon."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from piaffe.errors import SolverError

from ..ilqr import Options


@dataclass(frozen=True)
class Adapting:
    """A barrier that adapts between the ticks of a receding horizon, and multipliers that it keeps.

    A plan minimises one function, as with :class:`Fixed`. After it, the numbers of its rows change once by the rules of
    :class:`MSiLQR`: relaxations δ of violated rows decrease, multipliers λ of equalities take up σ h, and their
    penalties σ increase if the violation decreases too slowly. They stay as they are after a plan that made no step, or
    whose defects are still large. The next plan takes over the numbers of the rows at the same time of the motion;
    rows of new nodes begin with the first numbers. The barrier's weight ε is the same for all rows.

    Args:
        weight: first weight ε of the barrier.
        relaxation: first relaxation δ of every row, in units of the row's scale.
        min_weight: smallest ε; None: ε stays as it is.
        max_stiffness: largest curvature ε/δ² of a row; rows with larger multipliers use shifts.
        max_penalty: largest penalty σ of an equality; the first one is ``Options.penalty``.
        max_defect: largest defect of a plan, ∞-norm in the tangent, after which the numbers adapt. With joints, it is
            usually that of a joint velocity [rad/s].

    Raises:
        SolverError: a number is not positive, or ``min_weight`` is larger than ``weight``.
    """

    weight: float = 0.05
    relaxation: float = 0.1
    min_weight: float | None = None
    max_stiffness: float = 1000.0
    max_penalty: float = 1e4
    max_defect: float = 1.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if value is not None and not 0 < value < float("inf"):
                raise SolverError(
                    f"adapting barrier: {item.name} is out of range - got {value}, expected a positive number; "
                    "change it"
                )
        if self.min_weight is not None and self.min_weight > self.weight:
            raise SolverError(
                f"adapting barrier: min_weight is out of range - got {self.min_weight}, expected at most the weight, "
                f"{self.weight}; lower it"
            )

    def options(self, others: Options | None = None) -> Options:
        """Return options of the solve of a tick with this barrier.

        Args:
            others: all other options; the default ones if None.

        Raises:
            SolverError: the first penalty is larger than ``max_penalty``.
        """
        given = others or Options()
        if self.max_penalty < given.penalty:
            raise SolverError(
                f"adapting barrier: max_penalty is out of range - got {self.max_penalty}, expected at least the first "
                f"penalty of the options, {given.penalty:g}; change one"
            )
        return replace(
            given, barrier_weight=self.weight, relaxation=self.relaxation, adapt=False,
            min_barrier_weight=self.min_weight or self.weight, stiffness=self.max_stiffness,
            max_stiffness=self.max_stiffness,
            max_penalty=self.max_penalty,
        )  # fmt: skip
