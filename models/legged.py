"""What the models of one legged robot share: contact sets as modes, keyframes, the frame a motion moves in."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from functools import cached_property
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, ShapeError, UnknownNameError
from piaffe.ocp import Block, Manifold, ModelBase, Node, Path, ProblemWarning, Quantity, Sample, Slot, rotation

from .kinematics import Kinematics
from .postures import XYZ, RobotState, translate
from .quantities import base
from .robot import Robot
from .robots import robot_recipe
from .stance import Stance, stance
from .terrain import Terrain
from .warnings import keyframe_warnings

Array = NDArray[np.float64]

POSE_BLOCKS = (Block(base.position, XYZ), Block(base.orientation, XYZ))
VELOCITY_BLOCKS = (
    Block(base.linear_velocity, XYZ, rate_of=base.position),
    Block(base.angular_velocity, XYZ, rate_of=base.orientation),
)


def integrate(q: cs.SX, v: cs.SX, dt: cs.SX) -> cs.SX:
    """Return q ⊕ v dt of a floating base and joints, (nq, 1); v in the state's layout."""
    turned = rotation.multiply(q[3:7], rotation.exp(v[3:6] * dt))
    return cs.vertcat(q[:3] + v[:3] * dt, turned, q[7:] + v[6:] * dt)


class LeggedModel(ModelBase):
    """A model of a robot whose modes are contact sets; all contact sets share one set of dynamics, ``"contact"``.

    Args:
        robot: the robot.
        name: name of the model.
        state: the blocks of its state.
        control: its control space.
        slots: its parameters and their defaults.
        cut_by_modes: whether a change of contacts begins a new phase.
        terrain: what its states are placed on; level ground at z = 0 by default.
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
        cut_by_modes: bool = True,
        terrain: Terrain | None = None,
    ) -> None:
        fixed = tuple(
            Slot(key, np.size(value), tuple(np.ravel(value).astype(float).tolist())) for key, value in slots.items()
        )
        super().__init__(name, RobotState(state, robot, terrain), control, slots=fixed, cut_by_modes=cut_by_modes)
        self.robot = robot

    def __repr__(self) -> str:
        return f"{type(self).__name__}('{self.name}')"

    @property
    def num_feet(self) -> int:
        """Number of feet nf."""
        return len(self.robot.feet)

    @cached_property
    def kinematics(self) -> Kinematics:
        """The robot's legs, in numbers."""
        return Kinematics(self.robot)

    # ---- modes

    def mode_key(self, mode: Hashable) -> str:
        """Return ``"contact"``: contact sets differ in numbers alone."""
        self.resolve(mode)
        return "contact"

    def resolve(self, mode: Hashable) -> Stance:
        """Return the contact set in the robot's names of feet, from a stance or a string of names."""
        if isinstance(mode, str):
            mode = stance(mode)
        if not isinstance(mode, Stance):
            raise ModelError(
                f"model '{self.name}': mode is no contact set - got {mode!r}, expected the feet on the ground; give "
                f"stance('{' '.join(self.robot.foot_names)}'), or stance('') for flight"
            )
        return mode.resolve(self.robot)

    def flags(self, mode: Hashable) -> Array:
        """Return 1 for each foot of a contact set and 0 for the others, (nf,)."""
        return self._standing(self.resolve(mode))

    def _standing(self, resolved: Hashable) -> Array:
        """Return the flags of a contact set that has been resolved."""
        assert isinstance(resolved, Stance)
        return np.array([float(foot.name in resolved.feet) for foot in self.robot.feet])

    def node_parameters(self, node: Node) -> dict[str, Array]:
        """Return the contact flags of a node, which feet land at the phase's end, and which have only just left.

        A foot has just left at the first two nodes after a stance: its place there follows from the stance's last
        state alone (position and, one explicit step later, velocity), whatever the swing does.
        """
        contact = self._standing(node.mode)
        fresh = node.previous_mode is not None and node.steps <= 1
        lifting = np.maximum(self._standing(node.previous_mode) - contact, 0.0) if fresh else np.zeros(self.num_feet)
        ends = node.next_mode is not None
        landing = np.maximum(self._standing(node.next_mode) - contact, 0.0) if ends else np.zeros(self.num_feet)
        return {"contact": contact, "landing": landing, "lifting": lifting}

    def lands(self, node: Node) -> bool:
        """Return whether a foot touches down at this phase end."""
        return bool(self.node_parameters(node).get("landing", np.zeros(1)).any())

    # ---- files

    def recipe(self) -> dict[str, object]:
        """Return the kind of model, and the robot as :func:`piaffe.models.robots.robot_recipe` stores it."""
        return {"kind": type(self).__name__, "robot": robot_recipe(self.robot)}

    # ---- targets

    def keyframe(self, values: Mapping[str, object]) -> dict[Quantity, Array]:
        """Translate a keyframe's entries to quantities, see :func:`piaffe.models.postures.translate`."""
        return translate(self.robot, f"keyframe for model '{self.name}'", values)

    def warnings(self, path: object) -> list[ProblemWarning]:
        """Return warnings about keyframes, see :mod:`piaffe.models.warnings`."""
        return keyframe_warnings(self.robot, self.resolve, path) if isinstance(path, Path) else []

    def planar_frame(self, sample: Sample) -> tuple[float, float, float]:
        """Return x, y [m] and yaw [rad] of the base."""
        position = sample[base.position]
        yaw = rotation.np_to_rpy(sample[base.orientation])[2]
        return (float(position[0]), float(position[1]), float(yaw))

    # ---- parameters in numbers

    def numbers(self, **changed: Any) -> dict[str, Array]:
        """Return the value of every slot, its default unless given."""
        values = {slot.name: np.array(slot.default) for slot in self.slots}
        for name, value in changed.items():
            if name not in values:
                raise UnknownNameError(f"model '{self.name}'", "parameter", name, values)
            array: Array = np.ravel(np.asarray(value, dtype=float))
            if array.shape != values[name].shape:
                raise ShapeError(
                    f"model '{self.name}', parameter '{name}': wrong size - got {array.size} entries, expected "
                    f"{values[name].size}; give one per entry"
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
