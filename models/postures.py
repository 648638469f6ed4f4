"""Keyframes and states of a robot by short names: ``position``, ``rpy``, ``joints`` and their velocities."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError, ShapeError, UnknownNameError
from piaffe.ocp import Block, Manifold, Quantity, rotation

from . import quantities
from .inverse_kinematics import inverse_kinematics
from .quantities import base, com, feet, momentum
from .robot import Robot, to_pinocchio
from .terrain import Flat, Terrain

Array = NDArray[np.float64]
XYZ = ("x", "y", "z")
HEIGHT = ("z",)
MANY_TURNS = 8 * np.pi  # [rad], of roll and pitch of a state; the yaw of a long run may be any number of turns
SHORT_NAMES = {
    "position": base.position,
    "rpy": base.orientation,
    "joints": quantities.joints.position,
    "linear_velocity": base.linear_velocity,
    "angular_velocity": base.angular_velocity,
    "joint_velocities": quantities.joints.velocity,
}


def foot_labels(robot: Robot) -> tuple[str, ...]:
    """Return the labels of stacked feet: ``"FL x"``, ``"FL y"``, and so on."""
    return tuple(f"{foot.name} {axis}" for foot in robot.feet for axis in XYZ)


def reach_labels(robot: Robot) -> tuple[str, ...]:
    """Return the labels of ``feet.reach``: ``"FL ahead"``, ``"FL left"``, and so on."""
    return tuple(f"{foot.name} {side}" for foot in robot.feet for side in ("ahead", "left"))


def quantity_labels(robot: Robot) -> dict[Quantity, tuple[str, ...]]:
    """Return the quantities of a robot that can have targets, and the labels of their components."""
    joints, stacked = quantities.joints, foot_labels(robot)
    of_base: dict[Quantity, tuple[str, ...]] = {
        **dict.fromkeys([base.position, base.orientation, base.linear_velocity, base.angular_velocity], XYZ),
        base.height: HEIGHT,
        base.ground_normal: XYZ,
        feet.reach: reach_labels(robot),
    }
    return {
        **(of_base if robot.base == "free" else {}),
        **dict.fromkeys([joints.position, joints.velocity, joints.acceleration], robot.joint_names),
        **dict.fromkeys([joints.torque, joints.target], robot.motor_names),
        **dict.fromkeys([feet.position, feet.velocity, feet.force, feet.impulse], stacked),
        feet.height: robot.foot_names,
        **dict.fromkeys([com.position, com.velocity, momentum], XYZ),
    }


def translate(robot: Robot, where: str, values: Mapping[str, object]) -> dict[Quantity, Array]:
    """Translate the entries of a keyframe to quantities.

    Args:
        robot: the robot.
        where: subject of the error messages.
        values: any of ``position`` [m], ``rpy`` (full turns count) [rad], ``joints`` (numbers, a pose's name or a
            mapping of joint names) [rad], ``linear_velocity`` (world) [m/s], ``angular_velocity`` (body axes) [rad/s],
            ``joint_velocities`` [rad/s], or the path of a quantity, for example ``"feet.force"``. ``feet``, a mapping
            of names to places in the world [m], moves the joints of these legs; it needs ``position``.
    """
    values = with_joints(robot, where, values)
    labels = quantity_labels(robot)
    paths = {quantity.path: quantity for quantity in labels}
    targets: dict[Quantity, Array] = {}
    for key, value in values.items():
        quantity = SHORT_NAMES.get(key) or paths.get(key)
        if quantity is not None and quantity not in labels:
            raise ModelError(
                f"{where}, target '{key}': the base of '{robot.name}' is fixed - got {value!r}, expected targets of "
                "joints or frames; leave it out, or load the robot with base='free'"
            )
        if quantity is None:
            raise UnknownNameError(where, "target", key, [*SHORT_NAMES, *paths])
        if quantity == quantities.joints.position:
            targets[quantity] = robot.pose(value)
            continue
        array: Array = np.atleast_1d(np.array(value, dtype=float))
        if array.shape != (len(labels[quantity]),):
            raise ShapeError(
                f"{where}, target '{key}': wrong size - got shape {array.shape}, expected ({len(labels[quantity])},) "
                f"for {', '.join(labels[quantity])} [{quantity.unit}]; give one per component"
            )
        targets[quantity] = array
    return targets


def with_joints(robot: Robot, where: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the entries of a keyframe with joint angles in place of ``feet``, the places of feet in the world [m].

    Args:
        robot: the robot.
        where: subject of the error messages.
        values: the entries, see :func:`translate`.
    """
    if "feet" not in values:
        return values
    rest = {key: value for key, value in values.items() if key != "feet"}
    if rest.get("position") is None or np.shape(rest["position"]) != (3,):
        raise ModelError(
            f"{where}, target 'feet': the base has no place - got no position with three numbers, expected one, "
            "because places of feet are in the world; give position="
        )
    given = {key: rest[key] for key in ("position", "rpy", "joints") if key in rest}
    return {**rest, "joints": inverse_kinematics(robot, values["feet"], **given, where=where)}


def place_feet(robot: Robot, position: Array, orientation: Array, joint_angles: Array) -> Array:
    """Return the world positions of the feet's frames, (nf, 3) [m], from the base's pose and the joint angles."""
    q, _ = to_pinocchio(np.concatenate([position, orientation, joint_angles, np.zeros(robot.model.nv)]))
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return np.array([data.oMf[robot.frame_id(foot.frame)].translation for foot in robot.feet])


class RobotState(Manifold):
    """The state space of a robot. A call returns a state: ``body.state(joints="crouch", rpy=(0, 0.1, 0))``.

    Args:
        blocks: the blocks of the state; keyframes must be able to name each of them.
        robot: the robot.
        terrain: the ground; level at z = 0 by default.
    """

    robot: Robot
    terrain: Terrain

    def __init__(self, blocks: tuple[Block, ...], robot: Robot, terrain: Terrain | None = None) -> None:
        super().__init__(blocks)
        object.__setattr__(self, "robot", robot)
        object.__setattr__(self, "terrain", terrain or Flat())

    def __eq__(self, other: object) -> bool:
        return self.blocks == other.blocks if isinstance(other, Manifold) else NotImplemented

    def __hash__(self) -> int:
        return hash((self.blocks,))

    def __call__(
        self,
        position: ArrayLike | None = None,
        rpy: ArrayLike = (0.0, 0.0, 0.0),
        joints: object = "stand",
        linear_velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        joint_velocities: ArrayLike | None = None,
        feet: Mapping[str, ArrayLike] | None = None,
    ) -> Array:
        """Return a state, (nx,), at rest unless velocities are given.

        A robot with a fixed base takes ``joints`` and ``joint_velocities`` alone.

        Args:
            position: of the base: x, y, z, or x, y, or None for x = y = 0. Without z, the base has the height at which
                the first foot touches the ground [m].
            rpy: roll, pitch, yaw of the base [rad].
            joints: a pose's name, n numbers, or a mapping of joint names [rad].
            linear_velocity: of the base's origin, world axes [m/s].
            angular_velocity: of the base, body axes [rad/s].
            joint_velocities: n numbers [rad/s].
            feet: name → place of a foot in the world [m]; the joints of its leg are moved. It needs three numbers of
                ``position``.
        """
        if isinstance(position, str):
            raise ModelError(
                f"state of '{self.robot.name}', position: is unusable - got '{position}', expected two or three "
                f"numbers [m]; a pose has a name of its own: state(joints='{position}')"
            )
        values: dict[str, object] = {
            "rpy": rpy,
            "joints": joints,
            "linear_velocity": linear_velocity,
            "angular_velocity": angular_velocity,
            "joint_velocities": np.zeros(self.robot.num_joints) if joint_velocities is None else joint_velocities,
        }
        where = f"state of '{self.robot.name}'"
        if feet is not None:
            values["joints"] = with_joints(self.robot, where, {**values, "position": position, "feet": feet})["joints"]
        if self.robot.base == "fixed":
            moved = [
                key for key in ("rpy", "linear_velocity", "angular_velocity") if not np.any(np.asarray(values[key]))
            ]
            asked = {} if position is None else {"position": position}
            return self.pack(translate(self.robot, where, {k: v for k, v in values.items() if k not in moved} | asked))
        state = translate(self.robot, where, values)
        if np.any(np.abs(state[base.orientation][:2]) > MANY_TURNS):
            got = np.round(state[base.orientation], 3).tolist()
            most = float(np.max(np.abs(got[:2])))
            raise ModelError(
                f"{where}, target 'rpy': is many turns - got {got} rad, expected at most 4 turns of roll and pitch; "
                f"give radians ({most:g} degrees are {np.radians(most):.4g} rad)"
            )
        state[base.orientation] = rotation.np_from_rpy(state[base.orientation])
        if position is None or np.shape(position) == (2,):
            x, y = (0.0, 0.0) if position is None else np.asarray(position, dtype=float)
            flat: Array = np.array([x, y, 0.0])
            placed = place_feet(self.robot, flat, state[base.orientation], state[SHORT_NAMES["joints"]])
            standing = self.terrain.standing(placed[:, :2], self.robot.foot_radius)
            position = (x, y, float(np.max(standing[:, 2] - placed[:, 2])))
        state.update(translate(self.robot, where, {"position": position}))
        return self.pack(state)
