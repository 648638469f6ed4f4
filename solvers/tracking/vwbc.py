"""VWBC: a whole-body controller whose objective is the solver's action-value function."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import SolverError
from piaffe.ocp import TIME_STEP, LoweredMode

from ..qp import QpMethod, QpStatus, qp_method, solve_elastic
from .contacts import Contacts
from .gains import JointPD
from .low_level import Backend, LowLevel
from .memory import Law
from .plan import CONTACT, PlanStage, StagedPlan, stage_at
from .program import Program, VwbcTick
from .slots import Changes, slot_changes

Array = NDArray[np.float64]

_STATUSES = tuple(QpStatus)
_FOUND = QpStatus.SOLVED, QpStatus.RELAXED


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

    If no control meets all rows, as when a foot that should stand slips or has not landed, the rows that depend on z
    give way, all by the same least excess; rows of the control alone always hold. ``relaxed`` counts these ticks.
    If there is still no solution, the control is ū + K δx within the bounds of single controls; ``fallbacks`` counts
    these.
    ``statuses`` counts the results; ``last`` is the last tick. One controller serves one thread.

    After [Li2025CafeMpc], whose program has accelerations and forces as variables; here they are eliminated.

    Args:
        plan: the plan.
        leave_out: components of the state that do not count in δx, see :class:`LowLevel`.
        gains: added to the control after the program; none by default.
        damping: of the last resort [Nm s/rad].
        contacts: ``"schedule"``, ``"measured"`` or settings, see :class:`LowLevel`. Masks of rows follow.
        contact_slot: slot of the models with the contact flags.
        slots: other values of the model's slots in the low level, by name, as ``{"gamma": 20.0}``.
        qp: method of the quadratic program, see :func:`solve_qp`.
        step_feedforward: whether the gradient Q_u counts.
        backend: ``"native"``: the whole tick in C; ``"numpy"`` is the readable reference, also without a compiler.

    Raises:
        UnknownNameError: a model has no such slot, or no state such a component.
        ShapeError: a slot has another size.
        SolverError: the method is unknown; gains or contacts do not fit the models.
    """

    law = Law.ACTION_VALUE

    def __init__(
        self,
        plan: StagedPlan,
        *,
        leave_out: Sequence[str] = (),
        gains: JointPD | None = None,
        damping: float = 1.0,
        contacts: Contacts = "schedule",
        contact_slot: str = CONTACT,
        slots: Mapping[str, ArrayLike] | None = None,
        qp: QpMethod = "own",
        step_feedforward: bool = True,
        backend: Backend = "native",
    ) -> None:
        super().__init__(
            plan, leave_out=leave_out, gains=gains, damping=damping, contacts=contacts, contact_slot=contact_slot,
            backend="numpy" if backend == "native" and qp != "own" else backend,
        )  # fmt: skip
        self._solve, self._gradient = qp_method(qp), 1.0 if step_feedforward else 0.0
        self._refuse_contacts(slots or {})
        self._changes: dict[LoweredMode, Changes] = {
            mode: [(mode.layout.slices[TIME_STEP], np.zeros(1)), *slot_changes(mode, slots or {})]
            for mode in self._modes
        }
        self._new_masks = bool(slots) or self.measures_contacts
        self._measured: dict[LoweredMode, Changes] = {mode: [] for mode in self._modes}
        if self._tick is not None:
            self._tick.change(self._changes, self._new_masks)
            self._tick.weigh_gradient(self._gradient)
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
        return sum(count for status, count in self.statuses.items() if status not in _FOUND)

    @property
    def relaxed(self) -> int:
        """Number of ticks in which limits on contact forces gave way, because no control met all of them."""
        return self.statuses[QpStatus.RELAXED]

    def _refuse_contacts(self, slots: Mapping[str, ArrayLike]) -> None:
        if self.measures_contacts and self.contact_slot in slots:
            raise SolverError(
                f"vwbc: two sources of contacts - got slot '{self.contact_slot}' and contacts='measured', expected "
                "one; give the flags to control(x, t, flags)"
            )

    def measure(self, slots: Mapping[str, ArrayLike] | None = None) -> None:
        """Set slots of the models in the following ticks, in place of the plan's; masks of rows follow.

        ``controller.measure({"gravity": g})`` replaces the plan's gravity by a measured one, (3,);
        ``controller.measure()`` returns to the plan's. The action value stays the plan's. Flags of contact replace
        the plan's as they are; ``contacts="measured"`` merges them with the schedule.

        Raises:
            SolverError: the slot is that of contacts, and these are measured.
            UnknownNameError: a model has no such slot.
            ShapeError: a slot has another size.
        """
        self._refuse_contacts(slots or {})
        self._measured = {mode: slot_changes(mode, slots or {}) for mode in self._modes}
        if self._tick is not None:
            every = {mode: [*self._changes[mode], *self._measured[mode]] for mode in self._modes}
            self._tick.change(every, self._new_masks or bool(slots))

    def control(self, x: ArrayLike, t: float, contacts: ArrayLike | None = None) -> Array:
        """Return the control of a state (nx,) at time t [s], (nu,).

        Args:
            x: measured state (nx,).
            t: time [s].
            contacts: measured contact flags (nf,), if contacts are measured.

        Raises:
            ShapeError: the state has another size than the plan's, or there are not nf flags.
            SolverError: contacts are measured and not given, or given and not measured.
        """
        state, tick = np.asarray(x, dtype=float), self._tick
        if tick is None or state.shape != self._shape:
            self.last = VwbcTick(None, 0, ())
            return super().control(x, t, contacts)
        u, told = self._ticked(tick, state, t, contacts), tick.outcome
        status = None if told.status < 0 else _STATUSES[told.status]
        if status is not None:
            self.statuses[status] += 1
            self.iterations[told.iterations] += 1
        rows = tick.active[: told.num_active]
        active = tuple(self._row_names[self._modes[told.mode]][i] for i in rows) if len(rows) else ()
        self.last = VwbcTick(status, told.iterations, active, told.excess)
        return u

    def program(self, x: ArrayLike, t: float) -> Program:
        """Return the quadratic program of a measured state (nx,) at time t [s], in the frame of the plan."""
        at, state = stage_at(self.plan, t), self._in_plan(x)
        return self._program(at, state, at.mode.state.np_minus(state, at.x) * self._kept[at.mode])

    def _program(self, at: PlanStage, x: Array, deviation: Array) -> Program:
        rows = self.rows[at.mode](x, at.u, *self._numbers(at))
        slope = self._gradient * at.Q_u + at.Q_ux @ deviation
        return Program(at.Q_uu, slope, rows.A, rows.b, rows.C, rows.d, rows.rows, rows.soft)

    def _numbers(self, at: PlanStage) -> tuple[Array, Array, Array]:
        p = at.p.copy()
        for where, value in (*self._changes[at.mode], *self._measured[at.mode]):
            p[where] = value
        if self.measures_contacts:
            p[at.mode.layout.slots[self.contact_slot]] = self.in_contact
        if not (self._new_masks or self._measured[at.mode]):
            return p, at.g_mask, at.h_mask
        g_mask, h_mask = self.rows[at.mode].masks(p[None])
        return p, g_mask[0], h_mask[0]

    def _control(self, at: PlanStage, x: Array, deviation: Array) -> Array:
        made = self._program(at, x, deviation)
        result = solve_elastic(self._solve, made.H, made.g, made.A, made.b, made.C, made.d, made.soft)
        self.statuses[result.status] += 1
        self.iterations[result.iterations] += 1
        active = tuple(self._row_names[at.mode][i] for i in made.rows[result.active])
        self.last = VwbcTick(result.status, result.iterations, active, result.excess)
        return at.u + (result.x if result.status in _FOUND else at.feedback @ deviation)
