"""A plan of a receding horizon: states, controls and policy of every phase, in a frame of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.ocp import (
    ORIGIN,
    Horizon,
    LoweredMode,
    LoweredTransition,
    PlanarFrame,
    relative,
    transform_state,
)

from ..solution import Status
from ..tracking import PlanPhase

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlannedPhase:
    """One phase of a plan, with N stages.

    Args:
        segment: index of the schedule's segment.
        number: number of motion phases before it since the motion's start.
        name: name of the motion phase at its start.
        mode: its mode.
        times: node times since the motion's start, by the clock of the world (N+1,) [s].
        states: (N+1, nx). controls: (N, nu).
        feedforward: k (N, nu). feedback: K (N, nu, ndx).
        Q_x: (N, ndx). Q_u: (N, nu). Q_xx: (N, ndx, ndx). Q_ux: (N, nu, ndx). Q_uu: (N, nu, nu).
        p: parameters of the stages (N, np). g_mask: (N, ng). h_mask: (N, nh).
        transition: to the next phase; None at the end. p_transition: its parameters. resets: whether it changes the
            state.
        multipliers: numbers of the rows with which the next plan begins, named as those of a ``PhaseSolution``; empty
            if the barrier is fixed.
    """

    segment: int
    number: int
    name: str
    mode: LoweredMode
    times: Array
    states: Array
    controls: Array
    feedforward: Array
    feedback: Array
    Q_x: Array
    Q_u: Array
    Q_xx: Array
    Q_ux: Array
    Q_uu: Array
    p: Array
    g_mask: Array
    h_mask: Array
    transition: LoweredTransition | None
    p_transition: Array
    resets: bool
    multipliers: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan: what :meth:`RecedingHorizon.plan` returns.

    States and controls are in the frame of the plan; :attr:`anchor` is this frame in the world. ``Vwbc`` and the other
    low-level controllers move the measured state into it.

    Args:
        horizon: the problem at any time.
        parts: the phases.
        anchor: the plan's frame in the world, (x, y, yaw) [m, m, rad].
        moved: planar motion from the frame of the plan before to this one.
        status: reason why the solve ended.
        iterations: number of iterations.
        has_policy: whether the backward sweep at the last iterate succeeded.
        cost: declared cost.
        max_defect, max_equality, max_inequality: largest defect and violations.
        seconds: time of each part of the work [s].
        measured_at: time of the measured state [s]; the plan begins at the first grid time at which it is ready.
        shift: time by which the motion is later than declared [s], see :class:`Retiming`; times of nodes contain it.
        barrier_weight: weight ε of the barrier with which the next plan begins.
        motion: the motion that it plans, of several, see :class:`Motions`; empty for a planner of one.
        request: the motion that is asked for, and has not begun; empty for none.
        every_mode: modes that low levels follow, of all motions; empty for those of the horizon.
    """

    horizon: Horizon
    parts: Sequence[PlannedPhase]
    anchor: PlanarFrame
    moved: PlanarFrame
    status: Status
    iterations: int
    has_policy: bool
    cost: float
    max_defect: float
    max_equality: float
    max_inequality: float
    seconds: Mapping[str, float]
    measured_at: float
    shift: float = 0.0
    barrier_weight: float = 0.0
    motion: str = ""
    request: str = ""
    every_mode: tuple[LoweredMode, ...] = ()

    @property
    def address(self) -> int | None:
        """Where low levels in C read the plan, see ``StagedPlan``; None for a plan of the NumPy backend."""
        return getattr(self.parts, "address", None)

    @property
    def modes(self) -> tuple[LoweredMode, ...]:
        """The modes that low levels follow, in this plan or another of the same planner."""
        return self.every_mode or followed_modes(self.horizon)

    def local(self, x: ArrayLike) -> Array:
        """Return a state in the world (nx,) in the frame of the plan."""
        turn, shift = self._into_frame
        return np.asarray(turn @ np.asarray(x, dtype=float) + shift)

    def world(self, x: ArrayLike) -> Array:
        """Return a state in the frame of the plan (nx,) in the world."""
        return transform_state(self.horizon.models[0].state, np.asarray(x, dtype=float), self.anchor)

    @cached_property
    def _into_frame(self) -> tuple[Array, Array]:
        """The motion of a state into the frame, which is affine also for quaternions: matrix and vector.

        A low level moves ten states per plan; to move one block by block takes as long as five ticks.
        """
        space, motion = self.horizon.models[0].state, relative(ORIGIN, self.anchor)
        shift = transform_state(space, np.zeros(space.nx), motion)
        return (transform_state(space, np.eye(space.nx), motion) - shift).T, shift

    @property
    def start(self) -> float:
        """Time of the first node [s]."""
        return float(self.parts[0].times[0])

    def age(self, t: float) -> float:
        """Return the time since the plan's state was measured [s]."""
        return t - self.measured_at

    @cached_property
    def phases(self) -> Sequence[PlanPhase]:
        """The phases that a low-level controller follows: up to the first with states of another size."""
        found = []
        for part in self.parts:
            if part.states.shape[1] != self.parts[0].states.shape[1]:
                break
            found.append(
                PlanPhase(
                    mode=part.mode, times=part.times, states=part.states, controls=part.controls,
                    feedback=part.feedback, Q_u=part.Q_u, Q_ux=part.Q_ux, Q_uu=part.Q_uu, p=part.p,
                    g_mask=part.g_mask, h_mask=part.h_mask,
                )
            )  # fmt: skip
        return tuple(found)

    def row_name(self, mode: LoweredMode, kind: str, row: int) -> str:
        """Return the name of a row of a mode's stages: term, component and side."""
        return self.horizon.row_name(mode.rows[f"stage_{kind}"][row])


def followed_modes(horizon: Horizon) -> tuple[LoweredMode, ...]:
    """Return the modes that low levels follow: those with states and controls of the first model's size."""
    head = horizon.models[0]
    every = (store.lowered for store in horizon.tables.modes)
    return tuple(
        mode for mode in every
        if isinstance(mode, LoweredMode) and (mode.state.nx, mode.nu) == (head.state.nx, head.control.nx)
    )  # fmt: skip
