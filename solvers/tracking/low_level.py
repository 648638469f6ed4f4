"""What low-level controllers share: the plan, its deviation, contacts, bounds of single controls, and PD gains."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ShapeError, SolverError
from piaffe.ocp import ORIGIN, LoweredMode, transform_state

from .components import damped, kept
from .contacts import ContactFilter, Contacts, contact_settings, count_contacts, readings, scheduled_soon
from .gains import JointPD
from .memory import Law, NativeTick
from .native import tick_library
from .plan import CONTACT, PlanStage, StagedPlan, contacts_at, followed, modes_of, place_at, stage_at
from .rows import ControlRows

Array = NDArray[np.float64]
Backend = Literal["native", "numpy"]


class LowLevel(ABC):
    """A controller that follows a plan: ``control(x, t)`` is the control of a state at a time.

    The control is kept within the declared bounds of single controls. If a number is not finite, the control is
    −damping times the speeds of the joints, as far as these are finite, else zero; ``damped`` counts these.

    Args:
        plan: the plan.
        leave_out: components of the state that do not count in x ⊖ x̄, by name, or by quantity for all of them:
            ``("base.position x", "base.position y")``.
        gains: added to the control; none by default.
        damping: of the last resort [Nm s/rad].
        contacts: ``"schedule"``: the plan's; ``"measured"`` or settings: flags that are given at every tick,
            ``control(x, t, flags)``, merged with the plan's, see :class:`MeasuredContacts`.
        contact_slot: slot of the models with the contact flags.
        backend: ``"native"``: the whole tick in C; ``"numpy"`` is the readable reference, also without a compiler.

    Raises:
        UnknownNameError: no state of the plan has such a component.
        SolverError: the backend is unknown; gains are given, and the state has no velocities of the controls; contacts
            are measured, or gains depend on them, and the models have no such flags.
        ShapeError: another number of gains than of controls.
    """

    law: ClassVar[Law]
    """What C returns before gains and bounds; :meth:`_control` is the same in NumPy."""

    def __init__(
        self,
        plan: StagedPlan,
        *,
        leave_out: Sequence[str] = (),
        gains: JointPD | None = None,
        damping: float = 1.0,
        contacts: Contacts = "schedule",
        contact_slot: str = CONTACT,
        backend: Backend = "native",
    ) -> None:
        if backend not in ("native", "numpy"):
            raise SolverError(
                f"{type(self).__name__}: backend is unknown - got {backend!r}, expected 'native' or 'numpy'; choose one"
            )
        self.plan, self.gains, self.damping, self.contact_slot = plan, gains, damping, contact_slot
        self._name, self._modes = type(self).__name__, modes_of(plan)
        self._known = frozenset(self._modes)
        self.rows = {mode: ControlRows(mode) for mode in self._modes}
        self._kept = {mode: kept(mode.state, leave_out, self._name) for mode in self._modes}
        self._settings = contact_settings(contacts, self._name)
        why = f"{self._name}, measured contacts" if self._settings is not None else None
        if gains is not None and gains.by_contact:
            why = why or f"{self._name}, gains by contact"
        self._num_contacts = count_contacts(self._modes, contact_slot, why)
        if gains is not None:
            for mode in self._modes:
                gains.numbers(mode, self._num_contacts)
        self._filter = None if self._settings is None else ContactFilter(self._settings, self._num_contacts)
        self._in_contact, self._shape = np.zeros(self._num_contacts), (self._modes[0].state.nx,)
        self.ticks = self.damped = 0
        self._tick = self._native() if backend == "native" else None

    @property
    def measures_contacts(self) -> bool:
        """Whether :meth:`control` needs measured contact flags."""
        return self._settings is not None

    @property
    def in_contact(self) -> Array:
        """Which points counted as in contact in the last tick, (nf,); empty if the models have no such flags."""
        return (self._in_contact if self._tick is None else self._tick.in_contact).copy()

    @property
    def backend(self) -> Backend:
        """The implementation in use; ``"numpy"`` also without a compiler."""
        return "numpy" if self._tick is None else "native"

    @property
    def compiled(self) -> NativeTick | None:
        """The tick in C; None for the readable reference."""
        return self._tick

    def _native(self) -> NativeTick | None:
        """Return the tick in C with the plan in its memory; None if no compiler works."""
        library = tick_library(self._modes, self.rows)
        if library is None:
            return None
        tick = NativeTick(
            library, self._modes, self._kept, gains=self.gains, measured=self._settings,
            num_contacts=self._num_contacts, contact_slot=self.contact_slot, damping=self.damping, law=self.law,
            limits=self._limits(),
        )  # fmt: skip
        tick.follow(self.plan)
        return tick

    def _limits(self) -> tuple[Array, Array]:
        """Return the limits of the controls in the first stage, lower and upper (nu,)."""
        first = followed(self.plan)[0]
        return self.rows[first.mode].limits(first.states[0], first.p[0], first.g_mask[0])

    def contacts(self, t: float) -> Array:
        """Return the plan's contact flags at time t [s], (nf,).

        Raises:
            UnknownNameError: the model at this time has no such slot.
        """
        if self._tick is None or self._num_contacts == 0:
            return contacts_at(self.plan, t, self.contact_slot)
        return self._tick.contacts(t)  # of the plan that acts, also while a loop makes the plans

    def follow(self, plan: StagedPlan) -> None:
        """Follow another plan with the same modes from now on; nothing is compiled, and no array is copied.

        Raises:
            SolverError: the plan has a mode that the first one does not have.
            ShapeError: an array has another size than its mode's.
        """
        self._check_modes(plan)
        if self._tick is not None:
            self._tick.follow(plan)
        self.plan = plan

    def _in_plan(self, x: ArrayLike) -> Array:
        """Return a measured state in the frame of the plan."""
        state, local = np.asarray(x, dtype=float), getattr(self.plan, "local", None)
        if local is None or state.shape != self.plan.phases[0].states.shape[1:]:
            return state
        return np.asarray(local(state))

    def _in_world(self, mode: LoweredMode, u: Array) -> Array:
        """Return a control of the frame of the plan in the world: forces turn, torques do not."""
        return transform_state(mode.model.control, u, getattr(self.plan, "anchor", ORIGIN))

    def control(self, x: ArrayLike, t: float, contacts: ArrayLike | None = None) -> Array:
        """Return the control of a state (nx,) at time t [s], (nu,).

        Args:
            x: measured state (nx,).
            t: time [s].
            contacts: measured contact flags (nf,), if contacts are measured.

        Raises:
            ShapeError: the state has another size than the plan's at this time, or there are not nf flags.
            SolverError: contacts are measured and not given, or given and not measured.
        """
        state, tick = np.asarray(x, dtype=float), self._tick
        if tick is None or state.shape != self._shape:
            return self._readable(state, t, contacts)
        return self._ticked(tick, state, t, contacts)

    def _ticked(self, tick: NativeTick, x: Array, t: float, contacts: ArrayLike | None) -> Array:
        """Return :meth:`control` in C."""
        if contacts is not None or self._settings is not None:
            tick.readings[:] = self._readings(contacts)
        u = tick(x, t)
        self.ticks += 1
        self.damped += tick.outcome.damped
        return u

    def _readable(self, x: Array, t: float, contacts: ArrayLike | None) -> Array:
        """Return :meth:`control` in NumPy."""
        state, at = self._in_plan(x), stage_at(self.plan, t)
        if state.shape != at.x.shape:
            raise ShapeError(
                f"{self._name}: state has the wrong size - got shape {state.shape}, expected {at.x.shape}; "
                f"give a state of model '{at.mode.model.name}'"
            )
        self._in_contact = self._touching(at, t, self._readings(contacts))
        self.ticks += 1
        if np.isfinite(state).all():
            deviation = at.mode.state.np_minus(state, at.x)
            u = self._control(at, state, deviation * self._kept[at.mode])
            if self.gains is not None:
                u = u + self.gains(at.mode, deviation, self._in_contact)
            u = self.bounded(at, state, u)
            if np.isfinite(u).all():
                return self._in_world(at.mode, u)
        self.damped += 1
        return self._in_world(at.mode, self.bounded(at, at.x, damped(at.mode, x, self.damping)))

    def __call__(self, x: ArrayLike, t: float, contacts: ArrayLike | None = None) -> Array:
        """Return :meth:`control`."""
        return self.control(x, t, contacts)

    @abstractmethod
    def _control(self, at: PlanStage, x: Array, deviation: Array) -> Array:
        """Return the control of a finite state and its deviation, (nu,); bounds are applied to the result."""

    def bounded(self, at: PlanStage, x: Array, u: Array) -> Array:
        """Return a control within the declared bounds of single controls at a state, (nu,)."""
        p, g_mask, _ = self._numbers(at)
        return np.clip(u, *self.rows[at.mode].limits(x, p, g_mask))

    def _numbers(self, at: PlanStage) -> tuple[Array, Array, Array]:
        """Return the parameters of a stage, and the masks of its inequality and equality rows."""
        return at.p, at.g_mask, at.h_mask

    def _check_modes(self, plan: StagedPlan) -> None:
        modes = modes_of(plan)
        if modes != self._modes and not self._known.issuperset(modes):
            others = ", ".join(f"'{mode.model.name}' {mode.key}" for mode in modes if mode not in self._known)
            raise SolverError(
                f"{self._name}: the plan has other modes - got {others}, expected modes of the first plan; compile "
                "both problems in one process with the same model and terms, or make another controller"
            )

    def _readings(self, contacts: ArrayLike | None) -> Array | None:
        """Return measured flags if they are measured."""
        if (contacts is None) != (self._settings is None):
            got, expected = ("none", "flags") if contacts is None else ("flags", "none")
            raise SolverError(
                f"{self._name}: contacts do not fit - got {got}, expected {expected}; call control(x, t, flags) if and "
                "only if the controller was made with contacts='measured'"
            )
        return None if contacts is None else readings(contacts, self._num_contacts, self._name)

    def _touching(self, at: PlanStage, t: float, measured: Array | None) -> Array:
        """Return which points count as in contact, (nf,)."""
        if self._num_contacts == 0:
            return np.zeros(0)
        if self._filter is None or self._settings is None or measured is None:
            return self._numbers(at)[0][at.mode.layout.slots[self.contact_slot]] + 0.0
        phases = followed(self.plan)
        soon = scheduled_soon(phases, place_at(phases, t), t + self._settings.early, self.contact_slot)
        return self._filter(measured, at.p[at.mode.layout.slots[self.contact_slot]], soon, t)
