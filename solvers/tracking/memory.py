"""The memory of a tick in C: what the low level has of its modes, contacts, and the plan."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import LoadedLibrary
from piaffe.ocp import ORIGIN, LoweredMode

from .contacts import MeasuredContacts
from .gains import JointPD
from .plan import StagedPlan, followed
from .plan_memory import PlanMemory
from .slots import Changes

Array = NDArray[np.float64]


class _OwnMode(ct.Structure):
    _fields_ = [
        ("kept", ct.c_void_p), ("changed_at", ct.c_void_p), ("num_parameters", ct.c_int), ("contact_at", ct.c_int),
    ]  # fmt: skip


class _Contacts(ct.Structure):
    _fields_ = [
        *((name, ct.c_double) for name in ("last", "debounce", "leave", "early", "late")),
        *((name, ct.c_void_p) for name in ("measured", "scheduled", "soon", "on", "before", "since", "due")),
    ]


class _LowLevel(ct.Structure):
    _fields_ = [
        *((name, ct.c_void_p) for name in ("plan", "modes", "contacts", "changed", "kp", "kd", "limits", "contact_of")),
        *((name, ct.c_void_p) for name in ("in_contact",)),
        *((name, ct.c_double) for name in ("in_stance", "damping", "gradient")),
        *((name, ct.c_int) for name in ("num_changed", "new_masks", "num_contacts", "gains", "law")),
    ]


class Law(IntEnum):
    """What a low level returns before gains and bounds; see ``tick.h``."""

    ACTION_VALUE = 0
    FEEDBACK = 1
    FEEDFORWARD = 2


class Outcome(ct.Structure):
    """What a tick did; see ``tick.h``."""

    _fields_ = [
        ("status", ct.c_int), ("iterations", ct.c_int), ("damped", ct.c_int), ("mode", ct.c_int),
        ("num_active", ct.c_int), ("excess", ct.c_double), ("active", ct.c_void_p), ("nominal", ct.c_void_p),
        ("recorded", ct.c_void_p),
    ]  # fmt: skip


class NativeTick:
    """A plan in C memory, and the memory of a tick; nothing is allocated in :meth:`__call__` but the result.

    Args:
        library: the compiled tick of the plan's modes.
        modes: the modes of the library.
        kept: per mode, 0 for components of the tangent that do not count (ndx,).
        gains: PD gains; None for none.
        measured: settings of measured contacts; None if the schedule's hold.
        num_contacts: number of contact flags; 0 for none.
        contact_slot: slot with the contact flags.
        damping: of the last resort.
        law: what the low level returns before gains and bounds.
        limits: of the controls in the first stage, lower and upper (nu,).
    """

    def __init__(
        self,
        library: LoadedLibrary,
        modes: Sequence[LoweredMode],
        kept: Mapping[LoweredMode, Array],
        *,
        gains: JointPD | None,
        measured: MeasuredContacts | None,
        num_contacts: int,
        contact_slot: str,
        damping: float,
        law: Law,
        limits: tuple[Array, Array],
    ) -> None:
        self._modes, self._plan = tuple(modes), PlanMemory(modes)
        self._kept = [np.ascontiguousarray(kept[mode]) for mode in modes]
        self._own = (_OwnMode * len(modes))()
        for own, mode, counts in zip(self._own, modes, self._kept, strict=True):
            own.kept, own.num_parameters = counts.ctypes.data, mode.layout.size
            own.contact_at = mode.layout.slots[contact_slot].start if num_contacts else -1
        nu, nx = modes[0].nu, modes[0].state.nx
        nothing = np.zeros(nu), np.zeros(nu), np.zeros(nu, np.int32)
        self._gains = nothing if gains is None else gains.numbers(modes[0], num_contacts)
        self.readings, self.in_contact = np.zeros(num_contacts), np.zeros(num_contacts)
        self._flags = [np.zeros(num_contacts) for _ in range(6)]
        self._contacts = _Contacts(np.inf)
        if measured is not None:
            places = (array.ctypes.data for array in (self.readings, *self._flags))
            self._contacts = _Contacts(
                np.inf, measured.debounce, measured.leave, measured.early, measured.late, *places
            )
        self._low = _LowLevel(
            plan=self._plan.address, modes=ct.addressof(self._own),
            contacts=None if measured is None else ct.addressof(self._contacts),
            in_contact=self.in_contact.ctypes.data, in_stance=1.0 if gains is None else gains.in_stance,
            num_contacts=num_contacts, gains=int(gains is not None), damping=damping, gradient=1.0,
            law=int(law),
        )  # fmt: skip
        self._low.kp, self._low.kd, self._low.contact_of = (part.ctypes.data for part in self._gains)
        self._limits = np.concatenate(limits)
        self._low.limits = self._limits.ctypes.data
        most = max(len(mode.rows["stage_g"]) for mode in modes)
        self.active = np.zeros(max(most, 1), dtype=np.int32)
        self.outcome = Outcome(active=self.active.ctypes.data)
        self._x, self._u = np.zeros(nx), np.zeros(nu)
        self._library = library
        self._owner: object = None
        self._given = self._x.ctypes.data, self._u.ctypes.data, ct.addressof(self.outcome)
        self.address, self.function = ct.addressof(self._low), ct.cast(library.piaffe_tick, ct.c_void_p).value
        """Addresses of ``struct low_level`` and of ``piaffe_tick``, for other C that calls the tick."""
        self.followed = self.address + _LowLevel.plan.offset
        """Address of the pointer to the plan that is followed."""
        self.tick_by_itself()

    def follow(self, plan: StagedPlan) -> None:
        """Refer to another plan.

        Raises:
            ShapeError: an array has another size than its mode's.
        """
        address: int | None = getattr(plan, "address", None)
        if address is not None and getattr(plan, "modes", ()) == self._modes:
            self._low.plan = address
            return
        self._plan.hold(followed(plan), getattr(plan, "anchor", ORIGIN))
        self._low.plan = self._plan.address

    def change(self, slots: Mapping[LoweredMode, Changes], masks: bool) -> None:
        """Set parameters of each mode in the following ticks.

        Args:
            slots: places and values; all modes have as many.
            masks: whether the masks of rows depend on them.
        """
        places, values = [], np.zeros(0)
        for mode in self._modes:
            at = [np.arange(where.start, where.stop) for where, _ in slots[mode]]
            own = [np.broadcast_to(value, each.shape) for (_, value), each in zip(slots[mode], at, strict=True)]
            places.append(np.concatenate([np.zeros(0), *at]).astype(np.int32))
            values = np.concatenate([np.zeros(0), *own])
        self._changed = places, values
        for target, place in zip(self._own, places, strict=True):
            target.changed_at = place.ctypes.data
        self._low.changed, self._low.num_changed, self._low.new_masks = values.ctypes.data, len(values), int(masks)

    def weigh_gradient(self, factor: float) -> None:
        """Set the factor of Q_u in the following ticks; it is 1 at first."""
        self._low.gradient = factor

    def __call__(self, x: Array, t: float) -> Array:
        """Return the control of a state (nx,) at a time [s], (nu,); ``outcome`` and ``active`` tell of it."""
        state, control, outcome = self._given
        self._x[:] = x
        self._call(self._first, state, t, control, outcome)
        return self._u.copy()

    def contacts(self, t: float) -> Array:
        """Return the flags of the plan that is followed at a time [s], (nf,)."""
        flags = np.zeros(self._low.num_contacts)
        self._library.piaffe_scheduled(self.address, t, flags.ctypes.data)
        return flags

    def tick_through(self, function: Any, address: int, owner: object) -> None:
        """Let other C call the tick.

        Args:
            function: called in place of ``piaffe_tick``, with the same arguments but the first.
            address: its first argument.
            owner: of the memory at this address, which is kept.
        """
        self._call, self._first, self._owner = function, address, owner

    def tick_by_itself(self) -> None:
        """Call the tick directly."""
        self._call, self._first, self._owner = self._library.piaffe_tick, self.address, None

    @property
    def library(self) -> LoadedLibrary:
        """The compiled tick."""
        return self._library

    @property
    def c(self) -> ct.Structure:
        """``struct low_level``."""
        return self._low

    @property
    def modes(self) -> tuple[LoweredMode, ...]:
        """The modes, in the order of their numbers."""
        return self._modes

    @property
    def scheduled(self) -> Array:
        """The plan's contact flags in the last tick, (nf,)."""
        return (self._flags[0] if self._low.contacts else self.in_contact).copy()
