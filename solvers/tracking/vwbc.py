"""VWBC: a whole-body controller whose objective is the solver's action-value function."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ShapeError, SolverError, UnknownNameError
from piaffe.ocp import TIME_STEP, LoweredMode

from ..qp import QpMethod, QpStatus, qp_method
from .low_level import JointPD, LowLevel
from .native import NativeTick, tick_library
from .plan import PlanStage, StagedPlan, modes_of, stage_at

Array = NDArray[np.float64]
Backend = Literal["native", "numpy"]

_STATUSES = tuple(QpStatus)


class Program(NamedTuple):
    """The quadratic program of a tick, in δu: minimise ½ δuᵀH δu + gᵀδu subject to A δu = b, C δu ≥ d.

    Attributes:
        H: (nu, nu).
        g: (nu,).
        A: (m, nu).
        b: (m,).
        C: (k, nu).
        d: (k,).
        rows: index of each inequality among the rows of the mode, (k,).
    """

    H: Array
    g: Array
    A: Array
    b: Array
    C: Array
    d: Array
    rows: NDArray[np.int_]


@dataclass(frozen=True)
class VwbcTick:
    """What the last tick did.

    Args:
        status: of the quadratic program; None if the state was not finite.
        iterations: of the quadratic program.
        active: names of the inequality rows that hold as equalities.
    """

    status: QpStatus | None
    iterations: int
    active: tuple[str, ...]


class Vwbc(LowLevel):
    """The control that minimises the action value among those that keep the declared limits at the measured state.

    At a state x and a time t, δx = x ⊖ x̄, and δu solves::

        minimise    (Q_u + Q_ux δx)ᵀ δu + ½ δuᵀ Q_uu δu
        subject to  g(x, ū + δu, z) ≥ 0,   h(x, ū + δu, z) = 0,   z = −K⁻¹ r0(x, ū + δu)

    The rows are the problem's running constraints that depend on the control or the implicit part (for a whole body:
    accelerations and contact forces). Rows that are not affine in u and z are linearised at ū. Rows of the state alone
    are left out, because no control changes them at once.
    Without rows the control is ū + k + K δx, the solver's policy with its whole feedforward.

    z is that of a step of length zero, the continuous dynamics at x: the torque acts at once, and a controller repeats
    its tick many times within a step of the plan.

    If the program has no solution, the control is ū + K δx within the bounds of single controls.
    ``statuses`` counts the results; ``last`` is the last tick. One controller serves one thread.

    After [Li2025CafeMpc], whose program has accelerations and forces as variables; here they are eliminated.

    Args:
        plan: the plan.
        leave_out: components of the state that do not count in δx, see :class:`LowLevel`.
        gains: added to the control after the program; none by default.
        damping: of the last resort [Nm s/rad].
        slots: other values of the model's slots in the low level, by name, as ``{"gamma": 20.0}``.
        qp: method of the quadratic program, see :func:`solve_qp`.
        step_feedforward: whether the gradient Q_u counts.
        backend: ``"native"``: the whole tick in C; ``"numpy"`` is the readable reference, also without a compiler.

    Raises:
        UnknownNameError: a model has no such slot, or no state such a component.
        ShapeError: a slot has another size.
        SolverError: the method is unknown.
    """

    def __init__(
        self,
        plan: StagedPlan,
        *,
        leave_out: Sequence[str] = (),
        gains: JointPD | None = None,
        damping: float = 1.0,
        slots: Mapping[str, ArrayLike] | None = None,
        qp: QpMethod = "own",
        step_feedforward: bool = True,
        backend: Backend = "native",
    ) -> None:
        if backend not in ("native", "numpy"):
            raise SolverError(f"vwbc: backend is unknown - got {backend!r}, expected 'native' or 'numpy'; choose one")
        super().__init__(plan, leave_out=leave_out, gains=gains, damping=damping)
        self._solve, self._gradient = qp_method(qp), 1.0 if step_feedforward else 0.0
        self._modes = modes_of(plan)
        self._changes = {
            mode: [(mode.layout.slices[TIME_STEP], np.zeros(1)), *_changes(mode, slots or {})] for mode in self._modes
        }
        self._measured: dict[LoweredMode, list[tuple[slice, Array]]] = {mode: [] for mode in self._modes}
        self._wants_native = backend == "native" and qp == "own"
        self._tick = self._native() if self._wants_native else None
        self._row_names = {
            mode: [plan.row_name(mode, "g", i) for i in range(len(mode.rows["stage_g"]))] for mode in self._modes
        }
        self.statuses: Counter[QpStatus] = Counter()
        self.iterations: Counter[int] = Counter()
        self.last: VwbcTick | None = None
        if not any(rows.g or rows.h for rows in self.rows.values()):
            warnings.warn(
                "vwbc: no constraint depends on control or contact force - got none, expected limits such as "
                "torque_limits and friction_cone; the control is the solver's policy without limits",
                stacklevel=2,
            )

    @property
    def limits(self) -> tuple[str, ...]:
        """Names of the rows that the program has, each once."""
        kinds = [(m, kind, own) for m, rows in self.rows.items() for kind, own in (("g", rows.g), ("h", rows.h))]
        return tuple(dict.fromkeys(self.plan.row_name(m, kind, i) for m, kind, own in kinds for i in own))

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of the inequality rows of the state alone, which the program does not have."""
        return tuple(
            dict.fromkeys(self.plan.row_name(m, "g", i) for m, rows in self.rows.items() for i in rows.left_out)
        )

    @property
    def fallbacks(self) -> int:
        """Number of ticks whose program had no solution."""
        return sum(count for status, count in self.statuses.items() if status is not QpStatus.SOLVED)

    @property
    def backend(self) -> Backend:
        """The implementation in use; ``"numpy"`` also without a compiler, and for other methods of the program."""
        return "numpy" if self._tick is None else "native"

    def _native(self) -> NativeTick | None:
        """Return the tick in C with the plan in its memory; None if no compiler works."""
        library = tick_library(self._modes, self.rows)
        if library is None:
            return None
        nu, gains = self._modes[0].nu, None
        if self.gains is not None:
            gains = np.broadcast_to(self.gains.kp, nu) + 0.0, np.broadcast_to(self.gains.kd, nu) + 0.0
        numbers = [
            (p, *self.rows[phase.mode].masks(p))
            for phase in self.plan.phases
            for p in (_written(phase.p, self._changes[phase.mode]),)
        ]
        return NativeTick(library, self._modes, self.plan, numbers, self._kept, gains, self.damping, self._gradient)

    def follow(self, plan: StagedPlan) -> None:
        """Follow another plan with the same modes from now on; nothing is compiled.

        Raises:
            SolverError: the plan has a mode that the first one does not have.
        """
        if not set(modes_of(plan)) <= set(self._modes):
            others = ", ".join(f"'{mode.model.name}' {mode.key}" for mode in modes_of(plan) if mode not in self._modes)
            raise SolverError(
                f"vwbc: the plan has other modes - got {others}, expected modes of the first plan; compile both "
                "problems in one process with the same model and terms, or make another controller"
            )
        self.plan = plan
        if self._tick is not None:
            self._tick = self._native()
            self._tell()

    def measure(self, slots: Mapping[str, ArrayLike] | None = None) -> None:
        """Set slots of the models in the following ticks, in place of the plan's; masks of rows follow.

        ``controller.measure({"contact": flags})`` replaces the scheduled contacts by measured ones, (nf,);
        ``controller.measure()`` returns to the schedule. The action value stays the plan's.

        Raises:
            UnknownNameError: a model has no such slot.
            ShapeError: a slot has another size.
        """
        self._measured = {mode: _changes(mode, slots or {}) for mode in self._modes}
        self._tell()

    def _tell(self) -> None:
        """Write what is measured into the memory of the tick in C."""
        if self._tick is not None:
            self._tick.measure(self._measured)

    def control(self, x: ArrayLike, t: float) -> Array:
        """Return the control of a state (nx,) at time t [s], (nu,).

        Raises:
            ShapeError: the state has another size than the plan's.
        """
        state = np.asarray(x, dtype=float)
        if self._tick is None or state.shape != self.plan.phases[0].states.shape[1:]:
            self.last = VwbcTick(None, 0, ())
            return super().control(state, t)
        u, told = self._tick(state, t), self._tick.outcome
        self.ticks += 1
        self.damped += told.damped
        status = None if told.status < 0 else _STATUSES[told.status]
        if status is not None:
            self.statuses[status] += 1
            self.iterations[told.iterations] += 1
        rows = self._tick.active[: told.num_active]
        active = tuple(self._row_names[self._modes[told.mode]][i] for i in rows) if len(rows) else ()
        self.last = VwbcTick(status, told.iterations, active)
        return u

    __call__ = control

    def program(self, x: ArrayLike, t: float) -> Program:
        """Return the quadratic program of a state (nx,) at time t [s]."""
        at, state = stage_at(self.plan, t), np.asarray(x, dtype=float)
        return self._program(at, state, at.mode.state.np_minus(state, at.x) * self._kept[at.mode])

    def _program(self, at: PlanStage, x: Array, deviation: Array) -> Program:
        rows = self.rows[at.mode](x, at.u, *self._numbers(at))
        slope = self._gradient * at.Q_u + at.Q_ux @ deviation
        return Program(at.Q_uu, slope, rows.A, rows.b, rows.C, rows.d, rows.rows)

    def _numbers(self, at: PlanStage) -> tuple[Array, Array, Array]:
        p = _written(at.p, self._changes[at.mode] + self._measured[at.mode])
        g_mask, h_mask = self.rows[at.mode].masks(p[None])
        return p, g_mask[0], h_mask[0]

    def _control(self, at: PlanStage, x: Array, deviation: Array) -> Array:
        made = self._program(at, x, deviation)
        result = self._solve(made.H, made.g, made.A, made.b, made.C, made.d, None)
        self.statuses[result.status] += 1
        self.iterations[result.iterations] += 1
        active = tuple(self._row_names[at.mode][i] for i in made.rows[result.active])
        self.last = VwbcTick(result.status, result.iterations, active)
        return at.u + (result.x if result.status is QpStatus.SOLVED else at.feedback @ deviation)


def _written(p: Array, changes: Sequence[tuple[slice, Array]]) -> Array:
    """Return parameters of stages with other values in some places, (..., np)."""
    changed = p.copy()
    for where, value in changes:
        changed[..., where] = value
    return changed


def _changes(mode: LoweredMode, slots: Mapping[str, ArrayLike]) -> list[tuple[slice, Array]]:
    """Return the places of slots in the parameter vector, and their values."""
    changes = []
    for name, given in slots.items():
        if name not in mode.layout.slots:
            raise UnknownNameError(f"vwbc, model '{mode.model.name}'", "slot", name, mode.layout.slots)
        where, value = mode.layout.slots[name], np.atleast_1d(np.asarray(given, dtype=float)).ravel()
        if value.size not in (1, where.stop - where.start):
            raise ShapeError(
                f"vwbc, model '{mode.model.name}', slot '{name}': wrong size - got {value.size} entries, expected "
                f"{where.stop - where.start}; fix it"
            )
        changes.append((where, value))
    return changes
