"""Base class of the models of legged robots: contact sets as modes, keyframes, the planar frame of a motion."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, ShapeError, UnknownNameError
from piaffe.ocp import (
    BallisticPoint,
    Block,
    Bound,
    ContactPoint,
    Manifold,
    ModelBase,
    Node,
    Path,
    ProblemWarning,
    Quantities,
    Quantity,
    Sizes,
    Slot,
)

from . import natural
from .borrowed import trajectory_warnings
from .footing import Footing
from .ground import SLOTS
from .ground_warnings import fastest, ground_warnings
from .kinematics import Kinematics
from .postures import XYZ, RobotState, translate, with_joints
from .quantities import base, com, feet, joints
from .robot import Robot
from .robots import robot_recipe
from .speed_warnings import speed_warnings
from .stance import Stance, stance
from .standing_warnings import standing_warnings
from .terrain import Flat, Terrain
from .warnings import keyframe_warnings

Array = NDArray[np.float64]

POSE_BLOCKS = (Block(base.position, XYZ), Block(base.orientation, XYZ))
VELOCITY_BLOCKS = (
    Block(base.linear_velocity, XYZ, rate_of=base.position),
    Block(base.angular_velocity, XYZ, rate_of=base.orientation),
)


def state_blocks(robot: Robot) -> tuple[Block, ...]:
    """Return the blocks of a state with all joints: with a fixed base positions and velocities of the joints alone."""
    position = Block(joints.position, robot.joint_names)
    velocity = Block(joints.velocity, robot.joint_names, rate_of=joints.position)
    if robot.base == "fixed":
        return position, velocity
    return *POSE_BLOCKS, position, *VELOCITY_BLOCKS, velocity


def require_floating(robot: Robot, where: str) -> None:
    """Raise ModelError unless the base floats."""
    if robot.base == "fixed":
        raise ModelError(
            f"{where}: the base of '{robot.name}' is fixed - got base='fixed', expected a base that floats; use "
            "models.WholeBody, or load the robot with base='free'"
        )


class LeggedModel(ModelBase):
    """A model of a robot whose modes are contact sets; all contact sets share the dynamics ``"contact"``.

    Args:
        robot: the robot.
        name: name of the model.
        state: the blocks of its state.
        control: its control space.
        slots: its parameters and their defaults.
        positive: names of those that must be above zero.
        checks: name → check of values that replace its default, see ``ocp.Slot``.
        cut_by_modes: whether a change of contacts begins a new phase.
        terrain: the ground on which ``state(...)`` places the robot; level at z = 0 by default. If it is not level and
            the model has the slots of planes, feet stand on the planes of the terrain below their reference.
    """

    state: RobotState
    robot: Robot

    def __init__(
        self,
        robot: Robot,
        name: str,
        state: tuple[Block, ...],
        control: Manifold,
        *,
        slots: Mapping[str, Any],
        positive: Sequence[str] = (),
        checks: Mapping[str, Callable[[Array], str]] | None = None,
        cut_by_modes: bool = True,
        terrain: Terrain | None = None,
    ) -> None:
        fixed = tuple(
            Slot(
                key,
                np.size(value),
                tuple(np.ravel(value).astype(float).tolist()),
                key in positive,
                {"gravity": _downwards, **(checks or {})}.get(key),
            )
            for key, value in slots.items()
        )
        super().__init__(name, RobotState(state, robot, terrain), control, slots=fixed, cut_by_modes=cut_by_modes)
        self.robot = robot

    @cached_property
    def sizes(self) -> Sizes:
        """The natural sizes of its lengths, times and masses: 1 in SI units for robots of 1.4 to 49 kilograms."""
        return natural.sizes(self.robot)

    def __repr__(self) -> str:
        return f"{type(self).__name__}('{self.name}')"

    @property
    def nodes_after_liftoff(self) -> int:
        """Number of nodes after its liftoff at which a foot's position depends on the stance, and not on the swing.

        It is 2 if a step moves positions by the velocity at its start: the second node then depends on the last
        velocity of the stance.
        """
        return 2

    @property
    def num_feet(self) -> int:
        """Number of feet nf."""
        return len(self.robot.feet)

    @cached_property
    def kinematics(self) -> Kinematics:
        """The kinematics of the robot's legs."""
        return Kinematics(self.robot)

    # ---- modes

    def mode_key(self, mode: Hashable) -> str:
        """Return ``"contact"``: contact sets differ only in numbers, and share their functions."""
        self.resolve(mode)
        return "contact"

    def resolve(self, mode: Hashable) -> Stance:
        """Return a contact set with the robot's foot names, from a stance or a string of names.

        Raises:
            ModelError: the mode is not a contact set.
        """
        if isinstance(mode, str):
            mode = stance(mode)
        if not isinstance(mode, Stance):
            raise ModelError(
                f"model '{self.name}': mode is not a contact set - got {mode!r}, expected the feet on the ground; give "
                f"stance('{' '.join(self.robot.foot_names)}'), or stance('') for flight"
            )
        return mode.resolve(self.robot)

    def flags(self, mode: Hashable) -> Array:
        """Return 1 for each foot of a contact set and 0 for the others, (nf,)."""
        return self._standing(self.resolve(mode))

    def _standing(self, resolved: Hashable) -> Array:
        """Return the flags of a resolved contact set, (nf,)."""
        assert isinstance(resolved, Stance)
        return np.array([float(foot.name in resolved.feet) for foot in self.robot.feet])

    def node_parameters(self, node: Node) -> dict[str, Array]:
        """Return the slots ``contact``, ``landing`` and ``lifting`` of a node, (nf,) each.

        ``landing`` is 1 for feet that touch down at the end of the phase. ``lifting`` is 1 at the first
        :attr:`nodes_after_liftoff` nodes after a foot's stance.
        """
        contact = self._standing(node.mode)
        just_left = node.previous_mode is not None and node.steps < self.nodes_after_liftoff
        previous = self._standing(node.previous_mode) if just_left else np.zeros(self.num_feet)
        lifting = np.maximum(previous - contact, 0.0)
        ends = node.next_mode is not None
        landing = np.maximum(self._standing(node.next_mode) - contact, 0.0) if ends else np.zeros(self.num_feet)
        values = {"contact": contact, "landing": landing, "lifting": lifting}
        return values | {slot: np.asarray(node.sample[quantity]) for slot, quantity in self.slots_of_ground.items()}

    # ---- the ground

    @property
    def terrain(self) -> Terrain:
        """The ground."""
        return self.state.terrain

    @cached_property
    def slots_of_ground(self) -> Mapping[str, Quantity]:
        """The slots of the planes below the feet, and the quantities that they are; none if it is flat."""
        own = {slot.name for slot in self.slots}
        return dict(zip(SLOTS, (feet.surfaces, feet.normals), strict=True)) if set(SLOTS) <= own else {}

    @property
    def slots_from_motion(self) -> Mapping[str, Quantity]:
        """The planes below the feet follow from where the reference puts them."""
        return self.slots_of_ground

    @property
    def reference_ground(self) -> Terrain:
        """The ground on which references put the feet: the terrain, if feet stand on its planes."""
        return self.terrain if self.slots_of_ground or isinstance(self.terrain, Flat) else Flat()

    def added_targets(self, path: object) -> object | None:
        """Return the planes below the feet of a motion; None if the ground is flat."""
        if not (isinstance(path, Path) and self.slots_of_ground):
            return None
        return Footing(self.kinematics, self.terrain, self.flags, path)

    @property
    def _recorded(self) -> tuple[Quantity, ...]:
        """What a trajectory records beside forces: the normals of the planes, if the ground is not flat."""
        return (feet.normal,) if self.slots_of_ground else ()

    def true_heights(self, quantities: Quantities, p: Mapping[str, cs.SX]) -> list[cs.SX]:
        """Return the distance of each foot's ball from the terrain itself, not from the plane of its reference [m]."""
        if not self.slots_of_ground:
            return cs.vertsplit(quantities.bind(feet.height).value) if self.num_feet else []
        places = cs.vertsplit(quantities.bind(feet.position).value, 3)
        upward = cs.vertsplit(p["normals"], 3)[: self.num_feet]
        return [
            (place[2] - self.terrain.height(place[0], place[1])) * normal[2] - p["foot_radius"]
            for place, normal in zip(places, upward, strict=True)
        ]

    def lands(self, node: Node) -> bool:
        """Return whether a foot touches down at this phase end."""
        return bool(self.node_parameters(node).get("landing", np.zeros(1)).any())

    def landing_heights(self, quantities: Quantities, p: Mapping[str, cs.SX]) -> Bound:
        """Return the heights of the feet, with those that touch down at the phase's end as mask."""
        height = quantities.bind(feet.height)
        return Bound(height.quantity, height.value, height.labels, mask=p["landing"], scale=natural.length(self))

    def standing_points(self, quantities: Quantities, p: Mapping[str, cs.SX]) -> tuple[ContactPoint, ...]:
        """Return that the feet on the ground do not move."""
        place, height = quantities.bind(feet.position).value, self.true_heights(quantities, p)
        return tuple(
            ContactPoint(name, p["contact"][i], place[3 * i : 3 * i + 3], height[i])
            for i, name in enumerate(self.robot.foot_names)
        )

    def ballistic_centre(self, quantities: Quantities, p: Mapping[str, cs.SX]) -> BallisticPoint:
        """Return that the centre of mass falls freely if no foot is on the ground."""
        place, speed = (quantities.bind(each).value for each in (com.position, com.velocity))
        flag = cs.SX(float(self.robot.base == "free"))
        for i in range(self.num_feet):
            flag *= 1 - p["contact"][i]
        return BallisticPoint("centre of mass", flag, place, speed, p["gravity"])

    # ---- files

    def recipe(self) -> dict[str, object]:
        """Return the kind of model, and the robot as :func:`piaffe.models.robots.robot_recipe` stores it."""
        terrain = {} if self.terrain == Flat() else {"terrain": self.terrain.recipe()}
        return {"kind": type(self).__name__, "robot": robot_recipe(self.robot), **terrain}

    # ---- targets

    def complete_keyframe(self, values: Mapping[str, object]) -> Mapping[str, object]:
        """Return the entries of a keyframe with the joint angles in place of ``feet``."""
        return with_joints(self.robot, f"keyframe for model '{self.name}'", values)

    def keyframe(self, values: Mapping[str, object]) -> dict[Quantity, Array]:
        """Translate the entries of a keyframe to quantities, see :func:`piaffe.models.postures.translate`."""
        return translate(self.robot, f"keyframe for model '{self.name}'", values)

    def warnings(self, path: object) -> list[ProblemWarning]:
        """Return warnings about the robot's file, keyframes, the ground, and trajectories of other robots."""
        found = [ProblemWarning(f"robot '{self.robot.name}', {one.where}", one.text) for one in self.robot.warnings]
        if not isinstance(path, Path):
            return found
        ground = self.reference_ground
        found += [*keyframe_warnings(self.robot, ground, self.resolve, path), *speed_warnings(self.robot, path)]
        if self.robot.base == "free":
            found += ground_warnings(self.robot, self.terrain, self.resolve, path)
            found += standing_warnings(self.robot, self.resolve, path)
        if ground == self.terrain:
            found += trajectory_warnings(self.robot, self.terrain, self.resolve, path)
        return found

    @property
    def planar_pose(self) -> tuple[Quantity, Quantity] | None:
        """The base's position and orientation; None if the base is fixed."""
        return (base.position, base.orientation) if self.robot.base == "free" else None

    @property
    def fastest(self) -> float | None:
        """Speed of the base above which targets are reported, :func:`ground_warnings` [m/s]; None if it is fixed."""
        return fastest(self.robot) if self.robot.base == "free" else None

    # ---- parameters in numbers

    def numbers(self, **changed: Any) -> dict[str, Array]:
        """Return the value of every slot; slots that are not in ``changed`` have their defaults."""
        values = {slot.name: np.array(slot.default) for slot in self.slots}
        for name, value in changed.items():
            if name not in values:
                raise UnknownNameError(f"model '{self.name}'", "parameter", name, values)
            array: Array = np.ravel(np.asarray(value, dtype=float))
            if array.shape != values[name].shape:
                raise ShapeError(
                    f"model '{self.name}', parameter '{name}': wrong size - got {array.size} entries, expected "
                    f"{values[name].size}; give that many numbers"
                )
            values[name] = array
        return values

    def checked(self, name: str, values: Any, size: int) -> Array:
        """Return an argument as a flat array; raise ShapeError unless it has ``size`` entries."""
        array: Array = np.ravel(np.asarray(values, dtype=float))
        if array.size != size:
            raise ShapeError(
                f"model '{self.name}', argument '{name}': wrong size - got {array.size} entries, expected {size}; "
                "give one per component"
            )
        return array

    def symbols(self) -> dict[str, cs.SX]:
        """Return a symbol for every slot, and ``"dt"``."""
        return {**{slot.name: cs.SX.sym(slot.name, slot.size) for slot in self.slots}, "dt": cs.SX.sym("dt")}


def _downwards(gravity: Array) -> str:
    """Return what is expected of a gravity (3,) that points up; empty if it does not."""
    return "a vector that does not point up, (0, 0, -9.81)" if gravity.size == 3 and gravity[2] > 0 else ""
