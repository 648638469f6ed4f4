"""What a low-level controller needs of a plan: phases with arrays, and the stage at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import UnknownNameError
from piaffe.ocp import SAME_TIME, LoweredMode

Array = NDArray[np.float64]

CONTACT = "contact"
"""Name of the slot with the contact flags, unless another one is given."""


@dataclass(frozen=True, eq=False)
class PlanStage:
    """A plan at one time.

    Args:
        mode: the mode of the stage: its functions, rows and state space.
        x: x̄, interpolated between the nodes of a phase, never across a reset (nx,).
        u: ū of the stage (nu,).
        feedback: K of the stage (nu, ndx).
        Q_u: gradient of the action value by the control (nu,).
        Q_ux: mixed second derivatives of the action value (nu, ndx).
        Q_uu: Hessian of the action value by the control (nu, nu).
        p: parameters of the stage (np,).
        g_mask: 0 or 1 per inequality row (ng,).
        h_mask: 0 or 1 per equality row (nh,).
    """

    mode: LoweredMode
    x: Array
    u: Array
    feedback: Array
    Q_u: Array
    Q_ux: Array
    Q_uu: Array
    p: Array
    g_mask: Array
    h_mask: Array


@dataclass(frozen=True, eq=False)
class PlanPhase:
    """A phase of a plan, with N stages.

    A low level in C refers to arrays of 64-bit numbers that lie row by row in memory, and copies others.
    Do not write into them while the plan is followed.

    Args:
        mode: its mode.
        times: node times (N+1,) [s].
        states: (N+1, nx).
        controls: (N, nu).
        feedback: (N, nu, ndx).
        Q_u: (N, nu).
        Q_ux: (N, nu, ndx).
        Q_uu: (N, nu, nu).
        p: parameters of the stages (N, np).
        g_mask: 0 or 1 per stage and inequality row (N, ng), those of ``p``.
        h_mask: the same for equalities (N, nh).
    """

    mode: LoweredMode
    times: Array
    states: Array
    controls: Array
    feedback: Array
    Q_u: Array
    Q_ux: Array
    Q_uu: Array
    p: Array
    g_mask: Array
    h_mask: Array


class StagedPlan(Protocol):
    """A plan that a low-level controller follows.

    Its phases from the first one with states or controls of another size on are left out, as the tail of a cascade.
    After its last stage, this stage is held: its control, and the state at its end.

    A plan may also have ``modes``, a tuple of all modes that it and the plans after it have, and ``address``, where
    it lies in memory as ``struct plan`` of ``plan.h``, with modes numbered as in ``modes``. The low level in C then
    reads that memory. A plan in a frame of its own has ``anchor``, this frame in the world (x, y, yaw), and
    ``local(x)``, which moves a measured state (nx,) into it.
    """

    @property
    def phases(self) -> Sequence[PlanPhase]:
        """The phases, in the order of time."""
        ...

    def row_name(self, mode: LoweredMode, kind: str, row: int) -> str:
        """Return the name of a row ``"g"`` or ``"h"`` of a mode's stages."""
        ...


def followed(plan: StagedPlan) -> Sequence[PlanPhase]:
    """Return the phases before the first one with states or controls of another size."""
    phases = plan.phases
    nx, nu = phases[0].states.shape[1], phases[0].controls.shape[1]
    for i, phase in enumerate(phases):
        if phase.states.shape[1] != nx or phase.controls.shape[1] != nu:
            return phases[:i]
    return phases


def modes_of(plan: StagedPlan) -> tuple[LoweredMode, ...]:
    """Return the modes of a plan, each once: those that it says, or those of the phases that are followed."""
    own: tuple[LoweredMode, ...] | None = getattr(plan, "modes", None)
    return own or tuple(dict.fromkeys(phase.mode for phase in followed(plan)))


def place_at(phases: Sequence[PlanPhase], t: float) -> tuple[int, int]:
    """Return phase and stage at time t [s]; on a boundary the later one applies."""
    i = max((i for i, each in enumerate(phases) if each.times[0] <= t + SAME_TIME), default=0)
    times = phases[i].times
    return i, int(np.clip(np.searchsorted(times, t + SAME_TIME, side="right") - 1, 0, len(times) - 2))


def stage_at(plan: StagedPlan, t: float) -> PlanStage:
    """Return a plan at time t [s]; on a boundary of phases, the later phase applies.

    Before its start and after its end, its first or last stage and state apply.
    """
    phases = followed(plan)
    i, k = place_at(phases, t)
    phase = phases[i]
    share = float(np.clip((t - phase.times[k]) / (phase.times[k + 1] - phase.times[k]), 0.0, 1.0))
    space, here = phase.mode.state, phase.states[k]
    return PlanStage(
        mode=phase.mode, x=space.np_plus(here, share * space.np_minus(phase.states[k + 1], here)),
        u=phase.controls[k], feedback=phase.feedback[k], Q_u=phase.Q_u[k], Q_ux=phase.Q_ux[k], Q_uu=phase.Q_uu[k],
        p=phase.p[k], g_mask=phase.g_mask[k], h_mask=phase.h_mask[k],
    )  # fmt: skip


def contacts_at(plan: StagedPlan, t: float, slot: str = CONTACT) -> Array:
    """Return the scheduled contact flags at time t [s], (nf,).

    Raises:
        UnknownNameError: the model at this time has no such slot.
    """
    phases = followed(plan)
    i, k = place_at(phases, t)
    mode = phases[i].mode
    if slot not in mode.layout.slots:
        raise UnknownNameError(f"contacts, model '{mode.model.name}'", "slot", slot, mode.layout.slots)
    return np.array(phases[i].p[k, mode.layout.slots[slot]])
