"""A solution for display: the robot's pose, forces and phase at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import mujoco_spec, robot_from_recipe, terrain
from piaffe.ocp import PhaseTrajectory, Trajectory
from piaffe.simulation import interpolate, phase_index

from .curves import feet_of

if TYPE_CHECKING:
    from piaffe.models import Robot
    from piaffe.solvers import Solution

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Snapshot:
    """The robot at one time, as a picture shows it.

    Args:
        time: time since the motion's start [s].
        qpos: base position, unit quaternion (w, x, y, z), joint angles: MuJoCo's own layout. With a fixed base joint
            angles alone.
        forces: forces on the feet in world axes (nf, 3) [N]; zeros if unknown.
        phase: name of the phase.
        contact: per foot, whether it is on the ground.
        ghost: qpos of a second pose, drawn transparent; None for none.
    """

    time: float
    qpos: Array
    forces: Array
    phase: str
    contact: tuple[bool, ...]
    ghost: Array | None = None


class Playback:
    """Poses of a solution's robot over time; in phases of a model without joints, joint angles are constant.

    Args:
        solution: solution of a problem with a robot.

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
        ground = [recipe["terrain"] for recipe in solution.models.values() if "terrain" in recipe]
        self.terrain: terrain.Terrain = terrain.from_recipe(ground[0]) if ground else terrain.flat()
        self.feet = feet_of(solution)

    def scene(self) -> Any:
        """Return a ``mujoco.MjSpec`` of the robot on the solution's ground, without contacts."""
        return mujoco_spec(self.robot, contacts="none", terrain=self.terrain)

    @property
    def start(self) -> float:
        """Time of the first node [s]."""
        return self.trajectory.start

    @property
    def end(self) -> float:
        """Time of the last node [s]."""
        return self.trajectory.end

    def at(self, t: float, *, ghost: bool = False) -> Snapshot:
        """Return the snapshot at time t [s]; with ``ghost`` also the target pose."""
        i = phase_index(self.trajectory, t)
        part = self.trajectory.phases[i]
        sample = {quantity.path: value for quantity, value in part.sample(t).items()}
        count = len(self.feet)
        forces = np.asarray(sample.get("feet.force", np.zeros(3 * count))).reshape(-1, 3)
        target = None
        if ghost:
            target = self.pose(part, interpolate(part, self.solution.phases[i].target_states, t), i)
        contact = tuple(bool(np.any(np.abs(force) > 1e-6)) for force in forces)
        pose = self.pose(part, interpolate(part, part.states, t), i)
        return Snapshot(t, pose, forces, part.name, contact, target)

    def pose(self, part: PhaseTrajectory, state: Array, i: int) -> Array:
        """Return MuJoCo's qpos of a state of phase i."""
        values = {quantity.path: value for quantity, value in part.state.unpack(state).items()}
        joints = values.get("joints.position")
        pose = [] if self.robot.base == "fixed" else [values["base.position"], values["base.orientation"]]
        return np.concatenate([*pose, self.last_joints(i) if joints is None else joints])

    def last_joints(self, i: int) -> Array:
        """Return the joint angles at the end of the last phase before i with joints; else those of standing."""
        for part in reversed(self.trajectory.phases[:i]):
            for quantity, where in part.state.slices.items():
                if quantity.path == "joints.position":
                    return np.asarray(part.states[-1, where])
        return self.robot.pose("stand")


def caption(part: PhaseTrajectory) -> str:
    """Return a phase's name; the model's name if the phase spans several motion phases."""
    return part.model if part.mode == "scheduled" else part.name
