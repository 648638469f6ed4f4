"""A solution as something to look at: the robot's pose, forces and phase at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import robot_from_recipe
from piaffe.ocp import SAME_TIME, PhaseTrajectory, Trajectory

from .curves import feet_of

if TYPE_CHECKING:
    from piaffe.models import Robot
    from piaffe.solvers import Solution

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Snapshot:
    """What is seen at one instant.

    Args:
        time: since the motion's start [s].
        qpos: base position, unit quaternion (w, x, y, z), joint angles: MuJoCo's own layout.
        forces: on the feet, world axes (nf, 3) [N]; zeros if unknown.
        phase: name of the phase.
        contact: per foot, whether it is on the ground.
        ghost: another pose to draw faintly, or None.
    """

    time: float
    qpos: Array
    forces: Array
    phase: str
    contact: tuple[bool, ...]
    ghost: Array | None = None


class Playback:
    """Poses of a solution's robot over time; phases of a model without joints keep the joints they start with.

    Args:
        solution: of a problem with a robot.

    Raises:
        ModelError: no model of the solution has a robot that can be rebuilt.
    """

    def __init__(self, solution: Solution) -> None:
        self.solution = solution
        self.trajectory: Trajectory = solution.trajectory
        recipes = [recipe for recipe in solution.models.values() if recipe.get("robot")]
        if not recipes:
            raise ModelError(
                f"solution: there is no robot to show - got models {list(solution.models)}, expected one of a robot "
                "that models.load made; plot it instead"
            )
        self.robot: Robot = robot_from_recipe(recipes[0])
        self.feet = feet_of(solution)

    @property
    def start(self) -> float:
        """Time of the first node [s]."""
        return float(self.trajectory.phases[0].times[0])

    @property
    def end(self) -> float:
        """Time of the last node [s]."""
        return float(self.trajectory.phases[-1].times[-1])

    def at(self, t: float, *, ghost: bool = False) -> Snapshot:
        """Return what is seen at time t [s]; with ``ghost`` also the pose that the motion was asked for."""
        i = self.phase_index(t)
        part = self.trajectory.phases[i]
        sample = {quantity.path: value for quantity, value in part.sample(t).items()}
        count = len(self.feet)
        forces = np.asarray(sample.get("feet.force", np.zeros(3 * count))).reshape(-1, 3)
        asked = None
        if ghost:
            asked = self.pose(part, self.interpolate(part, self.solution.phases[i].target_states, t), i)
        contact = tuple(bool(np.any(np.abs(force) > 1e-6)) for force in forces)
        return Snapshot(
            t, self.pose(part, self.interpolate(part, part.states, t), i), forces, part.name, contact, asked
        )

    def phase_index(self, t: float) -> int:
        """Return the phase at time t; the later one on a boundary."""
        parts = self.trajectory.phases
        return max((i for i, part in enumerate(parts) if part.times[0] <= t + SAME_TIME), default=0)

    @staticmethod
    def interpolate(part: PhaseTrajectory, states: Array, t: float) -> Array:
        """Return a state between nodes, (nx,)."""
        k, share = node_before(part, t)
        return part.state.np_plus(states[k], share * part.state.np_minus(states[k + 1], states[k]))

    def pose(self, part: PhaseTrajectory, state: Array, i: int) -> Array:
        """Return MuJoCo's qpos of a state of phase i."""
        values = {quantity.path: value for quantity, value in part.state.unpack(state).items()}
        joints = values.get("joints.position")
        return np.concatenate([
            values["base.position"], values["base.orientation"], self.last_joints(i) if joints is None else joints
        ])  # fmt: skip

    def last_joints(self, i: int) -> Array:
        """Return the joint angles at the end of the last phase before i that has some; else those of standing."""
        for part in reversed(self.trajectory.phases[:i]):
            for quantity, where in part.state.slices.items():
                if quantity.path == "joints.position":
                    return np.asarray(part.states[-1, where])
        return self.robot.pose("stand")


def caption(part: PhaseTrajectory) -> str:
    """Return a phase's name; the model's where one stretch spans several phases."""
    return part.model if part.mode == "scheduled" else part.name


def node_before(part: PhaseTrajectory, t: float) -> tuple[int, float]:
    """Return the stage that contains time t, and the share of it that has passed; clamped to the phase."""
    k = int(np.clip(np.searchsorted(part.times, t + SAME_TIME, side="right") - 1, 0, len(part.times) - 2))
    return k, float(np.clip((t - part.times[k]) / (part.times[k + 1] - part.times[k]), 0.0, 1.0))
