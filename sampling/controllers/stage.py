"""Arguments and results of a stage, and the interface of a controller for it; for NumPy and JAX arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from piaffe.models import Mujoco
from piaffe.ocp import Nodes

from ..engines import Engine
from ..evaluators import Evaluator
from ..options import Options
from ..value import Value
from .spline import Spline

Array = NDArray[np.float64]

Memory = Mapping[str, Any]
"""Data of a sampler that are kept between stages and between plans: arrays by name, with constant shapes."""


class Stage(NamedTuple):
    """Index of a stage of a plan, and the schedule's deviations.

    Within ``jit`` the numbers are traced: use ``xp.where(stage.index == 0, a, b)`` instead of ``if``.

    Attributes:
        index: index i of the stage, from 0.
        count: number of stages of this plan.
        deviation: standard deviation of every node by the schedule of the options, (knots + 1, 1), in units of half the
            controls' range.
    """

    index: Any
    count: Any
    deviation: Any


class Rolled(NamedTuple):
    """The n roll-outs of a stage; the last one is that of the unperturbed plan.

    Attributes:
        k: index of the first node.
        states: (n, H + 2, nx).
        controls: controls in the model's units, (n, H + 1, nu).
        cost: running costs (n, H + 1).
        last: cost of terms ``at="end"``, (n,); None if there are none.
        value: the controller's value of the last states, (n,); None without a value.
        violation: violations of the rows of constraints, divided by each row's scale, (nc, n, H + 1).
        failed: which roll-outs failed, (n,). Their states are constant from the failure on.
    """

    k: Any
    states: Any
    controls: Any
    cost: Any
    last: Any
    value: Any
    violation: Any
    failed: Any


class Staged(NamedTuple):
    """The result of a stage.

    Attributes:
        plan: nodes (knots + 1, nu), scaled to [-1, 1].
        rolled: the roll-outs of the stage.
        returns: returns of the roll-outs (n,); the lowest one for failed roll-outs.
        weights: weights of the roll-outs (n,); their sum is one.
        memory: memory of the sampler.
    """

    plan: Any
    rolled: Rolled
    returns: Any
    weights: Any
    memory: Memory


class TerminalValue(Protocol):
    """The expected return of a roll-out after its last state."""

    def __call__(self, states: Array, k: int, nodes: Nodes) -> Array:
        """Return V ≥ 0 of states (n, nx) at node k, (n,)."""
        ...


class Method(Protocol):
    """The three methods of a sampler; see :class:`piaffe.sampling.Sampler`."""

    def sample(self, xp: Any, plan: Any, noise: Any, stage: Stage, memory: Memory) -> Any:
        """Return the plans to try."""
        ...

    def returns(self, xp: Any, rolled: Rolled, memory: Memory) -> tuple[Any, Memory]:
        """Return the return of every roll-out, and the memory."""
        ...

    def update(self, xp: Any, samples: Any, returns: Any, memory: Memory) -> tuple[Any, Any, Memory]:
        """Return the plan, the weight of every sample, and the memory."""
        ...


class Staging(Method, Protocol):
    """The interface of a controller for a stage, besides its three methods."""

    value: Value | TerminalValue | None

    @property
    def options(self) -> Options:
        """Its options."""
        ...

    @property
    def nodes(self) -> Nodes:
        """Nodes of its problem."""
        ...

    @property
    def model(self) -> Mujoco:
        """The model that it controls."""
        ...

    @property
    def steps(self) -> int:
        """The horizon H in steps."""
        ...

    @property
    def spline(self) -> Spline:
        """The map from nodes to controls."""
        ...

    @property
    def engine(self) -> Engine:
        """The engine of the roll-outs."""
        ...

    @property
    def evaluator(self) -> Evaluator:
        """The evaluator of cost and violations of roll-outs."""
        ...
