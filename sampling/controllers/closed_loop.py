"""What an episode asks of a sampling controller besides its plans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Mujoco, base, joints
from piaffe.ocp import NodeNumbers, Nodes, Problem
from piaffe.simulation import Judgement

from ..evaluators import Evaluator
from ..reward import Reward

Array = NDArray[np.float64]


class ClosedLoop:
    """Where a problem begins, what its states and controls cost, and where its reference is.

    Attributes:
        problem: the declaration.
        reward: how cost becomes reward.
        nodes: of the problem.
        model: what is controlled.
        dt: of a step [s].
        evaluator: what scores states and controls.
        constraints: the constraint that each row of a violation belongs to, (nc,).
    """

    problem: Problem
    reward: Reward
    nodes: Nodes
    model: Mujoco
    dt: float
    evaluator: Evaluator
    constraints: tuple[str, ...]

    @property
    def initial(self) -> Array:
        """Initial state of the problem (nx,)."""
        return self.problem.initial

    def hold(self, x: Array) -> Array:
        """Return the control that holds the joints at their positions, (nu,); zero if the controls are torques."""
        if self.model.action.quantity == joints.target:
            return np.asarray(x[self.model.state.slices[joints.position]])
        return np.zeros_like(self.model.action.centre)

    def judge(self, states: Array, actions: Array, t: float) -> Judgement:
        """Return cost, reward and violations of a part of an episode.

        Args:
            states: (T, nx), ``dt`` apart.
            actions: (T, nu).
            t: time of the first state [s].
        """
        numbers = self.nodes.running(round(t / self.dt), len(actions))
        cost, violation = self.score(states[None], actions[None], numbers)
        return Judgement(cost[0].copy(), self.reward(cost[0]), violation[:, 0].copy(), self.constraints)

    def place(self, t: float) -> Array:
        """Return the base's target position at a time [s], x and y, (2,) [m]."""
        return np.asarray(self.nodes.sample(round(t / self.dt))[base.position], dtype=float)[:2]

    def score(self, states: Array, controls: Array, numbers: NodeNumbers) -> tuple[Array, Array]:
        """Return running costs (n, S) and violations (nc, n, S); the next call of this size overwrites them.

        Args:
            states: (n, S, nx).
            controls: (n, S, nu).
            numbers: parameters, weights and masks of the S nodes.
        """
        return self.evaluator.stage(states, controls, numbers.p, numbers.weight, numbers.g_mask, numbers.h_mask)
