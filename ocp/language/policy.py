"""The policy of a solution, u = ū + K (x ⊖ x̄), at any time of its plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError, ShapeError

from .interpolation import interpolate, node_before, phase_index
from .trajectory import PhaseTrajectory, Trajectory

Array = NDArray[np.float64]


class PhasePolicy(Protocol):
    """The policy of one phase of a solution, with N stages."""

    @property
    def feedback(self) -> Array:
        """Gains K, (N, nu, ndx)."""
        ...


class SolutionLike(Protocol):
    """A solution of any solver: a trajectory, and gains for each of its phases."""

    @property
    def trajectory(self) -> Trajectory:
        """Times, states and controls."""
        ...

    @property
    def phases(self) -> Sequence[PhasePolicy]:
        """Gains, aligned with the trajectory's phases."""
        ...


class Planned(NamedTuple):
    """A plan at one time.

    Attributes:
        phase: index of the phase.
        part: the phase.
        stage: index of the stage in the phase.
        state: x̄, interpolated between the nodes, (nx,).
    """

    phase: int
    part: PhaseTrajectory
    stage: int
    state: Array


class Policy:
    """A plan with feedback gains, u = ū + K (x ⊖ x̄): ``policy(x, t)`` is the control of a state at a time.

    x̄ is interpolated between the nodes; ū and K are constant in a stage. On a boundary, the later phase applies. Before
    the plan's start, the first stage and the first state apply, and after its end the last ones.

    Args:
        trajectory: the plan; if its phases are of several models, x is a state of the model at time t.
        feedback: K of each phase, (N, nu, ndx).

    Raises:
        ShapeError: gains do not fit the trajectory.
    """

    def __init__(self, trajectory: Trajectory, feedback: Sequence[Array]) -> None:
        if len(feedback) != len(trajectory.phases):
            raise ShapeError(
                f"policy: gains do not fit the trajectory - got those of {len(feedback)} phases, expected "
                f"{len(trajectory.phases)}; give one table per phase"
            )
        for part, table in zip(trajectory.phases, feedback, strict=True):
            expected = (*part.controls.shape, part.state.ndx)
            if np.shape(table) != expected:
                raise ShapeError(
                    f"policy, phase '{part.name}': gains have the wrong size - got shape {np.shape(table)}, expected "
                    f"{expected}; give K for each stage, (N, nu, ndx)"
                )
        self.trajectory, self.feedback = trajectory, tuple(feedback)

    @staticmethod
    def of(solution: SolutionLike, nx: int) -> Policy:
        """Return the policy of a solution, up to the first phase with states of another size.

        Args:
            solution: the solution.
            nx: size of the plant's states.

        Raises:
            ModelError: the first phase has states of another size.
        """
        parts = solution.trajectory.phases
        n = next((i for i, part in enumerate(parts) if part.states.shape[1] != nx), len(parts))
        if n == 0:
            raise ModelError(
                f"policy: the solution does not begin with such states - got model '{parts[0].model}' with "
                f"{parts[0].states.shape[1]} states, expected {nx}; give a solution that begins with the plant's model"
            )
        return Policy(Trajectory(parts[:n]), [phase.feedback for phase in solution.phases[:n]])

    @property
    def start(self) -> float:
        """Time of the first node [s]."""
        return self.trajectory.start

    @property
    def end(self) -> float:
        """Time of the last node [s]."""
        return self.trajectory.end

    @property
    def initial(self) -> Array:
        """First state of the plan, (nx,)."""
        return np.asarray(self.trajectory.phases[0].states[0])

    def planned(self, t: float) -> Planned:
        """Return the plan at time t [s]."""
        i = phase_index(self.trajectory, t)
        part = self.trajectory.phases[i]
        return Planned(i, part, node_before(part, t)[0], interpolate(part, part.states, t))

    def off(self, x: ArrayLike, t: float) -> Array:
        """Return the deviation of a state from the plan at time t [s], x ⊖ x̄, (ndx,)."""
        planned = self.planned(t)
        return planned.part.state.np_minus(self._checked(x, planned), planned.state)

    def __call__(self, x: ArrayLike, t: float) -> Array:
        """Return u = ū + K (x ⊖ x̄), (nu,).

        Args:
            x: state (nx,).
            t: time [s].

        Raises:
            ShapeError: the state has another size than the plan's at this time.
        """
        planned = self.planned(t)
        deviation = planned.part.state.np_minus(self._checked(x, planned), planned.state)
        control: Array = planned.part.controls[planned.stage] + self.feedback[planned.phase][planned.stage] @ deviation
        return control

    def control(self, x: ArrayLike, t: float) -> Array:
        """Return the same as ``policy(x, t)``, (nu,)."""
        return self(x, t)

    def _checked(self, x: ArrayLike, planned: Planned) -> Array:
        """Return a state as an array; raise ShapeError if it does not fit the plan."""
        state: Array = np.asarray(x, dtype=float)
        if state.shape != planned.state.shape:
            raise ShapeError(
                f"policy, phase '{planned.part.name}': state has the wrong size - got shape {state.shape}, expected "
                f"{planned.state.shape}; give a state of model '{planned.part.model}'"
            )
        return state
