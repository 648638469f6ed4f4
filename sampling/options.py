"""Options of the sampling controllers: one frozen dataclass for all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from numbers import Integral, Real
from typing import Literal, get_args

from piaffe.errors import SamplingError
from piaffe.ocp import caller

NoiseSchedule = Literal["factors", "exponential"]
Shift = Literal["step", "elapsed"]


EngineName = Literal["auto", "native", "simd", "mjx"]
"""Names of the roll-out engines."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of :class:`MPPI` and the other controllers; each controller has its own defaults.

    Args:
        samples: perturbed roll-outs per stage, N; the unperturbed plan is added to them.
        knots: intervals of the spline over the horizon; the plan has ``knots + 1`` nodes per control.
        temperature: λ in the weights exp((R − R_best) / (λ std R)), without unit.
        sigma: standard deviation of the last node's perturbation at the first stage; 1 is half of a control's range.
        stages: annealing stages per plan.
        first_stages: annealing stages of the first plan.
        noise: ``"factors"``: σ = sigma · stage_factor^i · node_factor^(n − j) for stage i and node j of n;
            ``"exponential"``: σ = sigma · exp(−i / (stage_factor · stages) − (n − j) / (node_factor · n)), as in the
            paper of DIAL-MPC.
        stage_factor: β₁, decrease of the perturbations from stage to stage.
        node_factor: β₂, decrease of the perturbations from the end of the horizon to its start.
        shift: how the last plan is shifted to become the initial plan: ``"step"``: by the time since the last plan in
            whole steps, with the centre of the controls' range at the end; ``"elapsed"``: by the time since the last
            plan, with the spline extrapolated beyond its end.
        discount: γ₀ per step of the constraint-discounted return.
        p_max: largest discount per constraint: one number for all, or numbers by name of the constraint; 0 turns a
            constraint's discount off.
        violation_rate: τ of the moving maximum of each violation.
        violation_floor: lower limit of the moving maximum, in units of the row's scale. It limits the discount of very
            small violations.
        seed: seed of the perturbations.
        engine: engine of the roll-outs: ``"native"`` (mujoco.rollout on threads), ``"simd"`` (MuJoCo's step in SIMD
            code, for feet on planes and boxes), ``"mjx"`` (JAX), or ``"auto"``: ``"simd"`` if it supports the model,
            else ``"native"``.
        threads: number of threads of roll-outs and evaluation; None for one per core.
    """

    samples: int = 1024
    knots: int = 4
    temperature: float = 0.2
    sigma: float = 1.0
    stages: int = 1
    first_stages: int = 10
    noise: NoiseSchedule = "factors"
    stage_factor: float = 0.5
    node_factor: float = 0.9
    shift: Shift = "step"
    discount: float = 0.9
    p_max: float | Mapping[str, float] = field(default=0.25)
    violation_rate: float = 0.5
    violation_floor: float = 1e-3
    seed: int = 0
    engine: EngineName = "auto"
    threads: int | None = None

    def __post_init__(self) -> None:
        if isinstance(self.p_max, Mapping):
            object.__setattr__(self, "p_max", dict(self.p_max))
        whole = {"samples": 1, "knots": 2, "stages": 1, "first_stages": 1, "seed": 0}
        for name, least in whole.items():
            if not _whole(getattr(self, name), least):
                self._refuse(name, f"a whole number, at least {least}")
        for name in ("temperature", "sigma", "stage_factor", "node_factor", "violation_floor"):
            if not (_number(getattr(self, name)) and getattr(self, name) > 0):
                self._refuse(name, "a positive number")
        for name in ("discount", "violation_rate"):
            if not (_number(getattr(self, name)) and 0 < getattr(self, name) <= 1):
                self._refuse(name, "a number in (0, 1]")
        if not (self.threads is None or _whole(self.threads, 1)):
            self._refuse("threads", "a whole number, at least 1, or None")
        for name, choices in (
            ("noise", ("factors", "exponential")),
            ("shift", ("step", "elapsed")),
            ("engine", get_args(EngineName)),
        ):
            if (name, getattr(self, name)) == ("engine", "lanes"):
                self._refuse(name, "'simd', its name now")
            if getattr(self, name) not in choices:
                self._refuse(name, " or ".join(f"'{choice}'" for choice in choices))
        shares = self.p_max.values() if isinstance(self.p_max, Mapping) else (self.p_max,)
        if not all(_number(share) and 0 <= share <= 1 for share in shares):
            self._refuse("p_max", "a number in [0, 1], or one for each constraint by name")

    def _refuse(self, name: str, expected: str) -> None:
        raise SamplingError(
            f"sampling options ({caller()}): {name} is out of range - got {getattr(self, name)!r}, expected "
            f"{expected}; change it"
        )


def _number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)


def _whole(value: object, least: int) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= least
