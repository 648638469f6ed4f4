"""What a stage is given and returns, and what it needs of a controller; the same for NumPy and JAX arrays."""

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
"""What a sampler remembers from stage to stage and from plan to plan: arrays by name, of fixed shapes."""


class Stage(NamedTuple):
    """Which stage of a plan this is.

    Within ``jit`` its numbers are traced: use ``xp.where(stage.index == 0, a, b)`` instead of ``if``.

    Attributes:
        index: i, from 0.
        count: stages of this plan.
        deviation: standard deviation of every node by the schedule of the options, (knots + 1, 1), in halves of the
            controls' range.
    """

    index: Any
    count: Any
    deviation: Any


class Rolled(NamedTuple):
    """The roll-outs of a stage, n of them; the last one is that of the unperturbed plan.

    Attributes:
        k: index of the first node.
        states: (n, H + 2, nx).
        controls: in the model's units, (n, H + 1, nu).
        cost: running costs (n, H + 1).
        last: cost of terms ``at="end"``, (n,); None if there are none.
        value: what the controller's value says of the last states, (n,); None without a value.
        violation: of the rows of constraints, divided by each row's scale, (nc, n, H + 1).
        failed: which ended in NaN, (n,). Their states stand still from there on.
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
        plan: nodes (knots + 1, nu) in halves of the controls' range.
        rolled: the roll-outs it was made from.
        returns: of the roll-outs (n,), the worst one where they failed.
        weights: of the roll-outs (n,); their sum is one.
        memory: what the sampler remembers.
    """

    plan: Any
    rolled: Rolled
    returns: Any
    weights: Any
    memory: Memory


class TerminalValue(Protocol):
    """What a roll-out that ends in a state is still going to return."""

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
    """What a stage needs of a controller besides its three methods."""

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
        """What it controls."""
        ...

    @property
    def steps(self) -> int:
        """H."""
        ...

    @property
    def spline(self) -> Spline:
        """From nodes to controls."""
        ...

    @property
    def engine(self) -> Engine:
        """What rolls out."""
        ...

    @property
    def evaluator(self) -> Evaluator:
        """What scores roll-outs."""
        ...
