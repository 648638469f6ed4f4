"""Compiled phases: the parts of the horizon, as solvers use them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..language import PlacedPhase
from .mode import LoweredMode, Row
from .transition import LoweredTransition

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CompiledPhase:
    """A part of the horizon with one mode and one time step.

    Args:
        name: the motion phase's name.
        label: the mode as text.
        interval: the motion phase (the first one, if a model spans several).
        mode: the functions.
        dt: time step [s].
        times: node times (N+1,) [s].
        p: parameters of the stages (N, np).
        p_end: parameters of the last node (np,).
        applies: whether each term has an effect at each node (N+1, terms), see ``Cost.counts_in``; new weights and
            targets are written where it has.
        weight: residual weights of the stages times their masks (N, nr).
        g_mask: 0 or 1 per stage and inequality row (N, ng).
        h_mask: the same for equalities (N, nh).
        end_weight, end_g_mask, end_h_mask: the same for the last node's rows, see :meth:`end_rows`.
        ends_phase: whether the motion's phase ends at the last node.
        transition: to the next phase; None at the end of the horizon.
        p_transition: its parameters.
        resets: whether the transition does more than copy the state (an impact, a user's reset, another model).
        lands: whether the model's own reset changes the state there (an impact).
        guess_states: initial guess (N+1, nx).
        guess_controls: initial guess (N, nu).
    """

    name: str
    label: str
    interval: PlacedPhase
    mode: LoweredMode
    dt: float
    times: Array
    p: Array
    p_end: Array
    applies: NDArray[np.bool_]
    weight: Array
    g_mask: Array
    h_mask: Array
    end_weight: Array
    end_g_mask: Array
    end_h_mask: Array
    ends_phase: bool
    transition: LoweredTransition | None
    p_transition: Array
    resets: bool
    lands: bool
    guess_states: Array
    guess_controls: Array

    @property
    def num_stages(self) -> int:
        """Number of stages N."""
        return len(self.p)

    def end_rows(self, kind: str) -> tuple[Row, ...]:
        """Return the last node's rows of a kind: the mode's, then those that the transition adds (on impulses).

        Args:
            kind: ``"residual"``, ``"g"`` or ``"h"``.
        """
        own = self.mode.rows[f"terminal_{kind}"]
        return own if self.transition is None else own + self.transition.rows[kind]
